# What C needs of blind_sector.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t _SECTORS
cdef double _COMPARE_PERIOD
cdef Py_ssize_t _MIN_MISSED
cdef double _MAX_TIME, _MAX_MOTION, _SAME_SHARE, _SAME_M
cdef int _STREAK, _CLEARING_SCANS
cdef unsigned char _MISSED, _LOST, _BLOCKED, _FROZEN
cdef Py_ssize_t _least_sectors
cdef double _SURE_SHARE, _OTHERS_SPEED, _LOOK_WAY, _LOOK_TURN, _STEADY_TURN

cdef class BlindSectors:
    cdef readonly object text, kinds
    cdef bint _is_used
    cdef double _compared_at, _compared_yaw, _range_min, _range_max
    cdef bint _is_zero_near
    cdef const double[::1] _bearings
    cdef long long[::1] _sector, _direction
    cdef unsigned char[::1] _is_return, _kind
    cdef double[::1] _returned_at, _mean
    cdef double _scan_at

    @cython.locals(k=cython.Py_ssize_t)
    def __init__(self, spec)

    @cython.locals(i=cython.Py_ssize_t)
    def check_indices(self)
    def take(self, ranges, bearings, odometry, double now)

    @cython.locals(i=cython.Py_ssize_t, kind=cython.uchar)
    cdef mark(self, double[::1] given, bearings, odometry, double now)

    @cython.locals(k=cython.Py_ssize_t, is_sure=cython.bint)
    cdef int _keep_scan(self, pose, double now)

    @cython.locals(yaw=cython.double, has_turned=cython.bint)
    cdef bint _look_from(self, double[::1] ranges, pose, double now)

    @cython.locals(
        k=cython.Py_ssize_t, count=cython.Py_ssize_t, shift=cython.Py_ssize_t,
        place=cython.Py_ssize_t
    )
    cdef Py_ssize_t _count_gone(self, double turned)
    cdef bint _mark(self, is_blind, unsigned char kind)

    @cython.locals(k=cython.Py_ssize_t)
    def forget_motion(self)

    @cython.locals(i=cython.Py_ssize_t, n=cython.Py_ssize_t)
    cdef _set_bearings(self, bearings)

    @cython.locals(
        i=cython.Py_ssize_t, k=cython.Py_ssize_t, count=cython.Py_ssize_t, is_return=cython.bint
    )
    cdef int _find_returns(self, double[::1] ranges)

    @cython.locals(k=cython.Py_ssize_t, has_return=cython.bint)
    cdef bint _count_returns(self, double now)
    cdef bint _is_due(self, double yaw, double now)

    @cython.locals(d=cython.Py_ssize_t, doubts=cython.int)
    cdef bint _compare_scan(self, double[::1] ranges, double x, double y, double yaw, double now)

    @cython.locals(i=cython.Py_ssize_t, d=cython.Py_ssize_t)
    cdef int _sum_by_direction(self, double[::1] ranges, double yaw)

    @cython.locals(
        k=cython.Py_ssize_t, is_seen=cython.bint, is_same=cython.bint, is_new=cython.bint,
        has_streak=cython.bint, is_static=cython.bint, is_decided=cython.bint
    )
    cdef int _compare_direction(self, Py_ssize_t d, double x, double y, double now, int doubts)

    @cython.locals(i=cython.Py_ssize_t, d=cython.Py_ssize_t, k=cython.Py_ssize_t)
    cdef int _await_confirmation(self)

    @cython.locals(d=cython.Py_ssize_t, k=cython.Py_ssize_t, count=cython.Py_ssize_t)
    cdef bint _judge_sectors(self)

@cython.locals(sector=cython.longlong)
cdef inline long long _sector_of(double angle)
