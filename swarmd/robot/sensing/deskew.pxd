# What C needs of deskew.py, which has the meaning of each name.

cimport cython

cdef int _MAX_TIMED_RAYS

cdef class Deskewer:
    cdef double _latency, _stale_after, _unknown_span
    cdef double[::1] _limits, _sector_args
    cdef const double[::1] _bearings, _cos, _sin, _ages
    cdef double _span, _newest_age, _direction, _oldest, _spacing, _last_at
    cdef Py_ssize_t _filled_count

    @cython.locals(
        newest_age=cython.double, newest_at=cython.double, seconds_since_reading=cython.double,
        newest_stamp=cython.double
    )
    def deskew(self, scan, double now, odometry_age, double delay=*)

    @cython.locals(longest=cython.double)
    cdef _bounds_of(self, Py_ssize_t count, ages)
    cdef _set_rays(self, bearings, ages)

    @cython.locals(
        path_rows=cython.Py_ssize_t, lacks_rays=cython.bint, count=cython.Py_ssize_t,
        filled_count=cython.Py_ssize_t, capacity=cython.Py_ssize_t, distances=cython.double[::1],
        angles=cython.double[::1]
    )
    cdef _move_scan_rays(self, ranges_of_scan, double stamp, double seconds)
    cdef bint _can_fill(self, double stamp, double seconds)

    @cython.locals(i=cython.Py_ssize_t, count=cython.Py_ssize_t)
    cdef Py_ssize_t _fill_sector(
        self, last, double unmeasured, double seconds, double[::1] distances, double[::1] angles,
        double[::1] ages
    )

cdef bint _are_at_once(ages)
cdef _timed_rays(bearings, ages, sweep)
cdef _scan_with(scan, ranges, bearings, ages, double newest_age, filled, Py_ssize_t borrowed=*)
cdef _behind_borrowed(filled, Py_ssize_t borrowed)
