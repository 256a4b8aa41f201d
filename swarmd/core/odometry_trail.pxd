# What C needs of odometry_trail.py, which has the meaning of each name.

cimport cython

cdef double LONGEST_EXTRAPOLATION
cdef int REFUSED, SAME, NEXT, ANEW
cdef Py_ssize_t _READINGS
cdef double _spacing, _most, _max_step, _max_speed
cdef Py_ssize_t R_X, R_Y, R_YAW, R_LINEAR, R_ANGULAR, R_LATERAL, _FIELDS

cdef inline bint is_jump(double dx, double dy, double turn, double seconds)

@cython.final
cdef class OdometryTrail:
    cdef Py_ssize_t count
    cdef double latest
    cdef double[::1] readings
    cdef double x, y, yaw
    cdef Py_ssize_t _newest

    @cython.locals(
        stamp=cython.double, x=cython.double, y=cython.double, yaw=cython.double,
        linear=cython.double, angular=cython.double, lateral=cython.double, taken=cython.int,
        start=cython.Py_ssize_t
    )
    cpdef int take(self, odometry, bint checks=*)
    cpdef int clear(self) except? -1
    cdef Py_ssize_t place(self, Py_ssize_t before) noexcept
    cpdef bint covers(self, double stamp) except? -1
    def pose_at(self, double stamp)

    @cython.locals(k=cython.Py_ssize_t, later=cython.Py_ssize_t, earlier=cython.Py_ssize_t)
    cdef int set_pose(self, double stamp) except? -1
    cdef inline int _extrapolate_measured(self, Py_ssize_t start, double seconds) except? -1

    cdef int extrapolate(
        self, Py_ssize_t start, double linear, double angular, double lateral, double seconds
    ) except? -1
