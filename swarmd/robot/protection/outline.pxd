# What C needs of outline.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t CHUNK
cdef double _ON_OUTLINE, _ALONG_EDGE

@cython.final
cdef class Chunk:
    cdef Py_ssize_t count

@cython.final
cdef class Outline:
    cdef Py_ssize_t edges
    cdef double[::1] corner_x, corner_y, axis_x, axis_y, origin, length
    cdef bint is_box
    cdef double front, rear, left, right, radius, lidar_x, lidar_y, inner, outer
    cdef inline double gap_of(self, double x, double y) except? -1.0

    @cython.locals(
        ranges=cython.const_double[::1], bearings=cython.const_double[::1],
        count=cython.Py_ssize_t, i=cython.Py_ssize_t, range_min=cython.double,
        least_range=cython.double, farthest=cython.double, least_gap=cython.double,
        distance=cython.double, x=cython.double, y=cython.double, gap=cython.double
    )
    cpdef min_gap(self, scan)

    @cython.locals(k=cython.Py_ssize_t, edges=cython.Py_ssize_t)
    cdef double _gap_of_polygon(self, double x, double y) except? -1.0

    @cython.locals(
        j=cython.Py_ssize_t, is_number=cython.bint, is_inside=cython.bint,
        is_on_outline=cython.bint
    )
    cdef int separate(self, Chunk chunk, double blind) except? -1

    @cython.locals(
        j=cython.Py_ssize_t, k=cython.Py_ssize_t, count=cython.Py_ssize_t, edges=cython.Py_ssize_t,
        x=cython.p_double, y=cython.p_double, nearest=cython.p_double,
        greatest_height=cython.p_double, edge_number=cython.p_double, axis_x=cython.p_double,
        axis_y=cython.p_double, origin=cython.p_double, lengths=cython.p_double,
        corner_x=cython.p_double, corner_y=cython.p_double, direction_x=cython.double,
        direction_y=cython.double, normal_x=cython.double, normal_y=cython.double,
        direction_origin=cython.double, normal_origin=cython.double, length=cython.double,
        number=cython.double, along=cython.double, above=cython.double,
        along_clamped=cython.double, beyond=cython.double, edge_square=cython.double,
        is_nearer=cython.bint, previous_number=cython.double, previous_square=cython.double,
        previous_height=cython.double
    )
    cdef int _find_nearest_edges(self, Chunk chunk) except? -1

    @cython.locals(k=cython.Py_ssize_t)
    cdef double along_ray(self, double ray_x, double ray_y) except? -1.0
    cdef double nearest_within(self, double nearest, double range_min) except? -1.0
