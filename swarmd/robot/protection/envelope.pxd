# What C needs of envelope.py, which has the meaning of each name.

cimport cython

cdef double SURFACE_GAP, SURFACE_TIME, LOCKED_SHARE, PART_SPEED
cdef Py_ssize_t _LOCKED_STEP
cdef double _SLOWEST

@cython.final
cdef class Envelope:
    cdef double speed
    cdef double[::1] vertex_x, vertex_y, row_x, row_y, row_cap
    cdef double _along_x, _along_y

    @cython.locals(i=cython.Py_ssize_t, first=cython.Py_ssize_t)
    cdef int put(self, ConstraintRows rows, SpeedAxes axes) except? -1
    cdef int prepare(self, SpeedAxes axes) except? -1

    @cython.locals(
        i=cython.Py_ssize_t, following=cython.Py_ssize_t, directions=cython.double[:, ::1]
    )
    cdef int find_rows(self, SpeedAxes axes) except? -1

    @cython.locals(k=cython.Py_ssize_t)
    cdef double fastest_corner(self, double linear, double angular, SpeedAxes axes) except? -1.0

@cython.final
cdef class Creeping:
    cdef bint is_possible, is_touching
    cdef double cap
    cdef bint is_active
    cdef double[::1] _kept_cap

    @cython.locals(i=cython.Py_ssize_t)
    cdef int allow(self, PlacedPoints placed) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int begin(self, ConstraintRows rows, SpeedAxes axes) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int is_locked(self, Constraints constraints) except? -1
    cdef int begin_out(self, Constraints constraints, NearObstacles near, double least) except? -1

    @cython.locals(
        i=cython.Py_ssize_t, point=cython.Py_ssize_t, contacts=cython.Py_ssize_t,
        seen=cython.Py_ssize_t, highest=cython.double, cap=cython.double, source=cython.p_longlong,
        place_gap=cython.p_double, row_cap=cython.p_double, near_index=cython.p_longlong,
        first_row=cython.p_longlong, gap=cython.p_double, scan_gap=cython.p_double,
        contact=cython.p_double, age=cython.p_double, surface=cython.double, kept=cython.double
    )
    cdef int _raise(self, Constraints constraints, NearObstacles near, double least) except? -1

    @cython.locals(
        point=cython.Py_ssize_t, row=cython.Py_ssize_t, gap=cython.p_double,
        contact=cython.p_double, surface=cython.double
    )
    cdef int _raise_narrow(self, Constraints constraints, NearObstacles near) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int _keep(self, ConstraintRows rows) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int end(self, ConstraintRows rows, SpeedAxes axes) except? -1
