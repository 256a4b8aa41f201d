# What C needs of constraints.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t ROWS_OF_A_POINT, ENVELOPE_ROWS
cdef double _SLACK, _NEAREST, _side_cos, _side_sin

@cython.final
cdef class SpeedAxes:
    cdef double along_x, along_y, limit, angular_limit

@cython.final
cdef class ConstraintRows:
    cdef Py_ssize_t count, all
    cdef double[::1] x, y, cap, gap
    cdef long long[::1] source
    cdef int reserve(self, Py_ssize_t room) except? -1
    def _allocate(self, Py_ssize_t room)

    @cython.locals(row=cython.Py_ssize_t)
    cdef int add(self, double x, double y, double cap, double gap, Py_ssize_t source) except? -1

@cython.final
cdef class PlacedPoints:
    cdef Py_ssize_t seen, contacts, discs
    cdef double[::1] x, y, gap, free, age, contact, scan_gap, radius, others
    cdef long long[::1] kind
    cdef double[::1] normal_x, normal_y
    cdef long long[::1] first_row, in_touch_zone, near_index
    cdef int reserve(self, Py_ssize_t room) except? -1
    def _allocate(self, Py_ssize_t room)

    @cython.locals(
        j=cython.Py_ssize_t, count=cython.Py_ssize_t, end=cython.Py_ssize_t, row=cython.Py_ssize_t
    )
    cdef int place(self, Chunk chunk, Py_ssize_t first, ConstraintRows rows) except? -1

cdef inline bint _is_near_corners(double gap, double free, double age, double others) noexcept

cdef inline double _wall_cap(
    Chunk chunk, Py_ssize_t j, double linear, double lever, double gap, Assumptions assumptions
) except? -1.0

@cython.locals(j=cython.Py_ssize_t)
cdef int _set_wall_caps(Chunk chunk, SpeedAxes axes, Assumptions assumptions) except? -1

@cython.locals(j=cython.Py_ssize_t)
cdef int _set_corner_wall_caps(
    Chunk chunk, SpeedAxes axes, Assumptions assumptions, double corner_x, double corner_y,
    Py_ssize_t begin, Py_ssize_t end
) except? -1

@cython.final
cdef class ToldPlaces:
    cdef Py_ssize_t count
    cdef double[::1] x, y, reach
    cdef int begin(self, Py_ssize_t room) except? -1
    def _allocate(self, Py_ssize_t room)
    cdef int add(self, double x, double y, double reach) except? -1

    @cython.locals(k=cython.Py_ssize_t, is_outside=cython.bint)
    cdef int hold(self, double x, double y) except? -1

@cython.final
cdef class Constraints:
    @cython.locals(
        count=cython.Py_ssize_t, end=cython.Py_ssize_t, contacts=cython.Py_ssize_t,
        touch_rows=cython.Py_ssize_t, rows_of_a_point=cython.Py_ssize_t, middle=cython.Py_ssize_t
    )
    cdef int begin(self, NearObstacles near, Py_ssize_t discs, double furthest) except? -1

    @cython.locals(
        count=cython.Py_ssize_t, taken=cython.Py_ssize_t, placed_count=cython.Py_ssize_t,
        in_chunk=cython.Py_ssize_t, contacts_in_chunk=cython.Py_ssize_t, is_beyond=cython.bint,
        kind=cython.longlong
    )
    cdef int add_seen(
        self, NearObstacles near, PlanarPose frame, double age, double free, double bare_free
    ) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int _add_contacts(self, Points rays, double cos_yaw, double sin_yaw) except? -1

    cdef int add_disc(
        self, Py_ssize_t point, double x, double y, double radius, double age, double moved
    ) except? -1

    @cython.locals(j=cython.Py_ssize_t, count=cython.Py_ssize_t, first_row=cython.Py_ssize_t)
    cdef int _add_chunk(self, Py_ssize_t first, double blind) except? -1

    cdef int _add(
        self, double linear, double lever, double cap, double gap, Py_ssize_t source
    ) except? -1

    @cython.locals(
        j=cython.Py_ssize_t, k=cython.Py_ssize_t, side=cython.Py_ssize_t, count=cython.Py_ssize_t
    )
    cdef int _add_sides(self, Py_ssize_t first) except? -1

    @cython.locals(j=cython.Py_ssize_t, row=cython.Py_ssize_t)
    cdef int _add_side(self, Py_ssize_t first, Py_ssize_t count) except? -1

    @cython.locals(j=cython.Py_ssize_t, ahead_point=cython.Py_ssize_t, back_point=cython.Py_ssize_t)
    cdef int _add_approaching(self, Py_ssize_t first) except? -1

    @cython.locals(j=cython.Py_ssize_t, k=cython.Py_ssize_t, end=cython.Py_ssize_t)
    cdef int _add_corners(self, Py_ssize_t first, Py_ssize_t begin) except? -1

    @cython.locals(j=cython.Py_ssize_t, row=cython.Py_ssize_t, room=cython.Py_ssize_t)
    cdef int _add_corner(self, Py_ssize_t first, Py_ssize_t begin, Py_ssize_t end) except? -1

    @cython.locals(j=cython.Py_ssize_t)
    cdef int _add_keep_out(self, Py_ssize_t first) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int allow_touch(self) except? -1
