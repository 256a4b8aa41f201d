# What C needs of conditioning.py, which has the meaning of each name.

cimport cython

cdef int _RESTART_SCANS
cdef double _MAX_RAY_AGE, _MOVES_LINEAR, _MOVES_ANGULAR, _NOTICE

cdef class ScanConditioner:
    cdef double _max_sector
    cdef bint _is_noisy
    cdef double _last_stamp, _newest_stamp
    cdef int _rising_scans, _repeat_count
    cdef bint _has_conflict
    cdef double _kept_at

    @cython.locals(stamp=cython.double, values=cython.double[::1], yaw=cython.double)
    def take(self, scan, odometry, double now)

    @cython.locals(is_new=cython.bint, n=cython.Py_ssize_t)
    cdef bint _has_form(self, scan)
    cdef bint _takes_bearings(self, bearings)
    cdef bint _takes_ages(self, ages, Py_ssize_t n)

    @cython.locals(is_next=cython.bint, has_same_stamp=cython.bint, is_new_message=cython.bint)
    cdef _not_newer(self, seq, double stamp, ranges)

    @cython.locals(
        i=cython.Py_ssize_t, return_count=cython.int, is_moving=cython.bint,
        needed_returns=cython.int
    )
    cdef bint _is_repeat(self, ranges, double[::1] values, odometry)
