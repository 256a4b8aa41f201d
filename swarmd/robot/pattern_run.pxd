# What C needs of pattern_run.py, which has the meaning of each name.

cimport cython

cdef double _STEP_TIMEOUT, _STEP_TOLERANCE, ROUNDING
cdef object NOTHING_PERMITTED

@cython.final
cdef class Running:
    cdef readonly object generation, pattern
    cdef public object params
    cdef readonly object rate, channels
    cdef public object values
    cdef readonly object wish, until
    cdef public object permit
    cdef readonly double finish_at, period
    cdef readonly bint needs_places
    cdef readonly double expiry
    cdef readonly object requested
    cdef readonly double requested_at
    cdef readonly Py_ssize_t scan_seq
    def __init__(self, loading, event, double finish_at, double now)
    cpdef channel(self, name)

@cython.final
cdef class PatternRun:
    cdef public Running running
    cdef public object loading
    cdef public double restart_at, awaiting_since, last_step
    cdef public object stepped_generation
    cdef public bint is_due, is_outdated
    cdef public object hand, generation
    cdef public Py_ssize_t restarts

    @cython.locals(finish_at=cython.double)
    def ready(self, event, double now)
    def stepped(self, outputs, Py_ssize_t scan_seq, double now)
    def is_expired(self, double now)

    @cython.locals(is_time=cython.bint)
    cpdef bint may_step(self, double now, bint is_new_scan) noexcept
    cpdef stepping(self, double now)
    def fault(self, double now)
    cdef double lifecycle_due_at(self) noexcept
    cdef double step_due_at(self) noexcept
    cpdef next_deadline(self, double now)

cdef inline double later(double at, double now) noexcept
