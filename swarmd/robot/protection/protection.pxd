# What C needs of protection.py, which has the meaning of each name.

cimport cython

cdef double _ZERO_TOLERANCE
cdef object _zero, _make_decision, _no_scan, _driver_lost

@cython.locals(linear=cython.double, angular=cython.double, lateral=cython.double)
cdef bint _is_finite(twist)

@cython.locals(linear=cython.double, angular=cython.double, lateral=cython.double)
cdef bint _is_nearly_zero(twist)

cdef class Protection:
    cdef readonly list events
    cdef readonly object following
    cdef readonly double moved_at
    cdef readonly object mode_command
    cdef public object _mode, _monitor
    cdef bint _is_bounded
    cdef double _latency
    cdef bint _has_walls, _is_running, _has_compared
    cdef Py_ssize_t _scan_seq
    cdef object _min_gap

    @cython.locals(is_replaced=cython.bint, is_active=cython.bint)
    def decide(self, requested, context, bint is_running, hold, permit=*, steered=*)
    cpdef clip(self, requested)

    @cython.locals(is_changed=cython.bint)
    cdef _judge(self, request, context, touch, speed)
    cdef _take_ring(self, context)

    @cython.locals(is_within_limits=cython.bint, share=cython.double)
    cdef _decision(
        self, clipped_request, twist, bint is_active, rows, reason, context, steered,
        bint is_bounded=*
    )
    cdef _least_gap(self)

@cython.final
cdef class ProtectionView:
    pass
