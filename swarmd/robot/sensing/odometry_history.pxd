# What C needs of odometry_history.py, which has the meaning of each name.

cimport cython

cdef double _MIN_STEP, _AT_REST, _SHIFT_WAY, _SHIFT_TURN, _TWIST_EXCESS, _MAX_GAP, _SHIFT_TIME
cdef double _SHIFTS

cdef class OdometryHistory:
    cdef readonly bint has_shifted
    cdef double _shifts
    cdef double[:, ::1] path
    cdef double[::1] motion

    @cython.locals(
        stamp=cython.double, is_new=cython.bint, is_shift=cython.bint, passed=cython.double,
        taken=cython.int
    )
    def take(self, odometry, double now)

    @cython.locals(
        last=cython.Py_ssize_t, x=cython.double, y=cython.double, yaw=cython.double,
        linear=cython.double, lateral=cython.double, angular=cython.double, seconds=cython.double
    )
    cdef bint _is_shift(self, odometry)
    cdef bint covers(self, double stamp)

    @cython.locals(rows=cython.Py_ssize_t, i=cython.Py_ssize_t, start=cython.Py_ssize_t)
    cdef Py_ssize_t set_path(self, double end, double seconds)
    cdef int _set_row(self, Py_ssize_t row, double before, double x, double y, double yaw)

    @cython.locals(i=cython.Py_ssize_t)
    cdef bint _makes_relative(self, Py_ssize_t rows)
    cdef int set_motion(self, double stamp, double end)
