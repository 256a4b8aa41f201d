# What C needs of assumption_monitor.py, which has the meaning of each name.

cimport cython

cdef double _MIN_DROP_SHARE, _FOLLOWED
cdef Py_ssize_t _CRUISE, _MIN_CRUISE
cdef double _END_SHARE, _NOISE_RISE, _MAX_WAIT, _MAX_PERIOD, _COMMAND_RISE, _OTHER_AXIS_CHANGE
cdef Py_ssize_t _MAX_COMMANDS, _MAX_TRAVELS
cdef double _NEAR_GAP, _MAX_GAP_TIME, _max_step, _max_speed, _inf

@cython.final
cdef class _Stop:
    cdef double sign, begin_speed, least_speed, fell_at

@cython.final
cdef class _Brake:
    cdef double declared, braking, _min_drop, _command
    cdef Py_ssize_t _commands, _cruise_count
    cdef double _variance, _freedom, _log_likelihood_sum
    cdef Py_ssize_t _stop_count

    @cython.locals(k=cython.Py_ssize_t)
    cpdef share_with(self, _Brake axis, double speed, double stamp)

    @cython.locals(place=cython.Py_ssize_t)
    cdef _note(self, double stamp, double command)

    @cython.locals(
        previous=cython.double, new_speed=cython.double, change=cython.double,
        begin_speed=cython.double, sign=cython.double, drop=cython.double
    )
    cpdef bint on_command(self, double command, double speed, double stamp)

    @cython.locals(was_pushed=cython.bint, has_followed=cython.bint)
    cpdef bint on_step(self, double begin, double end, double moved)

    @cython.locals(start=cython.Py_ssize_t)
    cdef _cruise_on(self, double begin, double end, double moved)
    cdef bint _end(self, _Stop stop)

@cython.locals(
    j=cython.Py_ssize_t, k=cython.Py_ssize_t, coarse=cython.double[::1], fine=cython.double[::1],
    model_speeds=cython.double[::1], result=cython.double[:, ::1], best_coarse=cython.double,
    delay=cython.double
)
cdef _weighted_residuals(
    double[:, ::1] periods, double[::1] stamps, double[::1] speeds, double[::1] brakings,
    double total
)

@cython.locals(k=cython.Py_ssize_t)
cdef int _model_speeds_at(
    double[::1] stamps, double[::1] speeds, double braking, double[::1] model_speeds
)

@cython.locals(
    i=cython.Py_ssize_t, part=cython.Py_ssize_t, command=cython.Py_ssize_t,
    count=cython.Py_ssize_t
)
cdef double _residual(
    double[:, ::1] periods, double[::1] stamps, double[::1] speeds, double[::1] model_speeds,
    double braking, double delay, double total
)

@cython.final
cdef class AssumptionMonitor:
    cdef readonly double speed_share
    cdef double _radius, _stamp, _x, _y, _yaw, _linear_speed, _angular_speed, _lateral_speed
    cdef double _travelled
    cdef Py_ssize_t _travel_first, _travel_end
    cdef double _approach_share, _wall_moved_at

    @cython.locals(
        end=cython.double, x=cython.double, y=cython.double, yaw=cython.double, dx=cython.double,
        dy=cython.double, place=cython.Py_ssize_t, axis_distance=cython.double
    )
    def on_odometry(self, odometry)
