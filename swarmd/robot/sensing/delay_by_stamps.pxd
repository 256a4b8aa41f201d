# What C needs of delay_by_stamps.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t _STAMPS, _MIN_STAMPS, _PERIODS
cdef double _PERIOD_TIME, _RESTART_TIME, _MAX_DRIFT, _CLOCK_JUMP, _MAX_AGE, _LONGEST_AGE, _MAX_LEAD

cdef class DelayByStamps:
    cdef double offset
    cdef bint is_restarting
    cdef double _restart_ends
    cdef Py_ssize_t _scan_count
    cdef double _stamp, _scan_stamp, _lowest, _lowest_before, _period_ends
    cdef bint _drifts
    cdef Py_ssize_t _period_count, _age_count, _oldest
    cdef double _last_scan_at
    cdef bint _is_shared
    cdef double _lead

    @cython.locals(is_of_ages=cython.bint)
    def check_indices(self)

    @cython.locals(is_set=cython.bint)
    cdef bint read(self, double stamp, double now)

    @cython.locals(is_back=cython.bint)
    cdef bint goes_back(self, double stamp, double now)
    cdef int _restart(self, double now)

    @cython.locals(
        k=cython.Py_ssize_t, change=cython.double, previous_lowest=cython.double,
        rise_count=cython.int, fall_count=cython.int
    )
    cdef int _end_period(self, double now)

    @cython.locals(stamp=cython.double, age=cython.double)
    cdef double take(self, scan, double now)
    cdef int _store_age(self, double age)

    @cython.locals(k=cython.Py_ssize_t)
    cdef double _delay(self)
    cdef figure(self, double now)
    cdef _forget(self, why)
