# What C needs of dead_reckoning.py, which has the meaning of each name.

cimport cython

cdef double _AGE_TOLERANCE

@cython.final
cdef class PlanarPose:
    cdef double x, y, yaw
    cdef int set(self, double x, double y, double yaw) except? -1
    cdef int set_relative(self, PlanarPose pose, PlanarPose base) except? -1

cdef double _mean_speed(double now, double wanted, double rate, double seconds) noexcept

@cython.final
cdef class DeadReckoning:
    cdef Py_ssize_t version, resets

    @cython.locals(taken=cython.int)
    cdef record(self, odometry)
    cdef int find_pose(self, double odometry_age, double seconds_before, PlanarPose into) except? -1

    @cython.locals(newest=cython.Py_ssize_t)
    cdef int predict_pose(
        self, double odometry_age, double linear, double angular, double lateral, PlanarPose into
    ) except? -1

@cython.final
cdef class CommandRange:
    cdef double _least, _most, _least_before, _most_before
    cdef int note(self, double speed) except? -1
    cdef double explained(self, double moved, double seconds) noexcept

@cython.final
cdef class ScanMotion:
    cdef double measured_at, first_use_delay, oldest, extra_age
    cdef Py_ssize_t resets
    cdef double seconds

    @cython.locals(i=cython.Py_ssize_t)
    cdef bint begin(
        self, double now, double age, double newest_age, double delay, double odometry_age,
        const double[::1] ages
    )
    cdef driven(self)
