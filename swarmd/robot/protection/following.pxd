# What C needs of following.py, which has the meaning of each name.

cimport cython

cdef double WINDOW, DELAY, BLOCKED_TIME, _BLOCKED_SHARE, _LEAST_WAY, AGREE_TIME, _AGREE_SHARE
cdef double _JUMP_TIME, _JUMPS, _BEYOND, _MAX_PERIOD, _max_step, _max_speed, _inf

@cython.final
cdef class _Axis:
    cdef readonly object text
    cdef readonly double blocked
    cdef readonly object contradiction
    cdef double _demanded_way, _moved_way, _most_demanded, _pose_way, _twist_way, _path, _jumps
    cdef double _tolerance, _least, _acceleration
    cdef object _unit
    cdef double[::1] _stamps, _speeds
    cdef Py_ssize_t _first, _held, _end
    cdef double _slow_speed, _command, _begun_at, _outside_since
    cdef Py_ssize_t _outside_readings
    cpdef reset(self, double command, double stamp)
    cpdef on_command(self, double command, double stamp)

    @cython.locals(i=cython.Py_ssize_t, first=cython.Py_ssize_t, count=cython.Py_ssize_t)
    cdef _add(self, double command, double stamp)
    cdef _move_slow_base(self, double period, double stamp)
    cdef _follow(self)

    @cython.locals(counts=cython.bint, is_demanded=cython.bint, stands=cython.bint)
    cdef int _sum_ways(self, double period, double by_twist, double by_pose)
    cdef int _compare_ways(self, double period, double by_twist, double by_pose)

    @cython.locals(i=cython.Py_ssize_t, tolerance=cython.double)
    cpdef on_reading(self, double period, double stamp, double by_twist, double by_pose)

@cython.final
cdef class FollowingMonitor:
    cdef readonly object text
    cdef readonly double blocked_bearing
    cdef bint _is_lateral
    cdef double _far_jumps, _far_way, _far_turn
    cdef bint _has_last
    cdef double _stamp, _x, _y, _yaw

    @cython.locals(
        stamp=cython.double, x=cython.double, y=cython.double, yaw=cython.double,
        period=cython.double, dx=cython.double, dy=cython.double, is_jump=cython.bint
    )
    def on_odometry(self, odometry)
    cdef _jump_text(self)
