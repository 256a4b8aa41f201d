# What C needs of delay_by_turns.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t _CANDIDATES
cdef double _LONGEST_DELAY, _DELAY_STEP
cdef Py_ssize_t _HISTORY
cdef double _SPACING, _MIN_RATE_CHANGE, _MEAN_WEIGHT, _CHANGE_LASTS, _MAX_SCAN_PERIOD
cdef double _MIN_TURN_SPREAD, _MARGIN, _MAX_SEARCHED, _MAX_SHIFT
cdef Py_ssize_t _MIN_RAYS
cdef double _UNEVEN_SHARE, _MISSED_STEPS, _MAX_RANGE, _MIN_RELIEF, _MIN_CORRELATION, _FORGETTING
cdef double _MIN_PAIRS, _MIN_SPREAD, _ALIKE, _MIN_DELAY_SPREAD, _SQUARED_DEVIATIONS, _MAX_INTERVAL
cdef double _LOWEST_SCALE, _HIGHEST_SCALE, _MIN_SQUARE
cdef Py_ssize_t _ENOUGH_PAIRS

cdef class DelayByTurns:
    cdef double delay, spread, at
    cdef Py_ssize_t pairs
    cdef double[::1] _times, _yaws
    cdef Py_ssize_t _first, _end
    cdef double _stamp, _yaw, _turned, _mean_rate, _changed_at
    cdef Py_ssize_t _rays
    cdef double _ray_step
    cdef Py_ssize_t _scan_count
    cdef bint _has_last
    cdef double _scan_at, _x, _y
    cdef double[::1] _relief
    cdef double _norm
    cdef double[::1] _old_relief
    cdef double _old_norm, _mm, _weight

    @cython.locals(is_even=cython.bint)
    def check_indices(self)
    cdef figure(self, double now)

    @cython.locals(k=cython.Py_ssize_t)
    cdef forget(self)
    cdef forget_headings(self)

    @cython.locals(i=cython.Py_ssize_t)
    cdef read(self, double stamp, double yaw, double rate, pose)

    @cython.locals(
        saves_time=cython.bint, place_in_four=cython.Py_ssize_t, is_first=cython.bint,
        k=cython.Py_ssize_t
    )
    cdef compare(self, scan, double arrival, double now)

    @cython.locals(k=cython.Py_ssize_t, begin=cython.Py_ssize_t, end=cython.Py_ssize_t)
    cdef int _predict_turns(self, double before, double at)

    @cython.locals(step=cython.double, is_even=cython.bint)
    cdef _set_bearings(self, bearings)

    @cython.locals(
        ranges=cython.const_double[::1], range_min=cython.double, range_max=cython.double,
        count=cython.Py_ssize_t, i=cython.Py_ssize_t, return_count=cython.Py_ssize_t,
        mean=cython.double, is_return=cython.bint
    )
    cdef _store_ranges(self, scan)
    cdef double _heading(self, Py_ssize_t k, double at)

    @cython.locals(
        first=cython.Py_ssize_t, last=cython.Py_ssize_t, shift=cython.Py_ssize_t,
        best=cython.Py_ssize_t
    )
    cdef double _measured_turn(self, double low, double high)

    @cython.boundscheck(False)
    @cython.locals(n=cython.Py_ssize_t, first=cython.Py_ssize_t, i=cython.Py_ssize_t)
    cdef double _correlation(self, Py_ssize_t shift)

    @cython.locals(k=cython.Py_ssize_t, best=cython.Py_ssize_t)
    cdef _add(self, double turn)

    @cython.locals(lowest=cython.Py_ssize_t, highest=cython.Py_ssize_t, middle=cython.Py_ssize_t)
    cdef int _set_delay(self, Py_ssize_t best)
