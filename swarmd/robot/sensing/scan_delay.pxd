# What C needs of scan_delay.py, which has the meaning of each name.

cdef double _CLEARS, _CERTAIN, _EXPIRES, _TOLERANCE

cdef class ScanDelay:
    cdef readonly double added
    cdef readonly bint is_late
    cdef readonly Py_ssize_t restarts
    cdef readonly bint is_clock_set
    cdef double _latency, _bound, _added_before
    cdef read(self, double stamp, double yaw, double rate, pose, double now)
    def on_scan(self, scan, double now)
    cdef _restart(self)
    def summary(self, double now)
