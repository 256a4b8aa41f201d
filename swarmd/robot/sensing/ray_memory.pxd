# What C needs of ray_memory.py, which has the meaning of each name.

cimport cython

cdef double _SMALL_ANGLE, _MAX_UNEVENNESS, _MAX_TURN_ERROR
cdef Py_ssize_t _GUESSES
cdef double _BLIND_RETURNS, _BLIND_SHARE, _FAR_SHARE, _NEAR_MARGIN, _NEAR_MEMORY, _NEAR_SECTOR
cdef Py_ssize_t _PACKET_RAYS, _HIDING_RAYS
cdef double _HIDDEN_RANGE

@cython.locals(
    low=cython.Py_ssize_t, high=cython.Py_ssize_t, middle=cython.Py_ssize_t,
    after=cython.Py_ssize_t, before=cython.Py_ssize_t
)
cdef Py_ssize_t _nearest_angle(double[::1] rising, Py_ssize_t n, double wanted, Py_ssize_t hint)

cdef double _unwrapped(double step) noexcept

cdef class RayMemory:
    cdef readonly double known_at
    cdef public Py_ssize_t far_returns
    cdef readonly object filled
    cdef double _range_min, _range_max, _max_gap, _stale_after, _zero
    cdef bint _is_lds, _guesses_near
    cdef double _near_below, _step, _yaw
    cdef Py_ssize_t _ray_count
    cdef double[::1] _bearings
    cdef double _direction
    cdef bint _is_even
    cdef long long[::1] _order
    cdef double[::1] _rising
    cdef long long[::1] _place
    cdef double[::1] _ranges, _seen_at, _near_at
    cdef Py_ssize_t _shift
    cdef unsigned char[::1] _is_zero, _is_lost
    def condition(self, raw, bearings, double yaw, double now)

    @cython.locals(unknown_count=cython.Py_ssize_t)
    cdef bint interpret(self, double[::1] ranges, bearings, double yaw, double now)

    @cython.locals(is_same=cython.bint)
    cdef _turn_memory(self, bearings, double yaw)

    @cython.locals(unknown_count=cython.Py_ssize_t, i=cython.Py_ssize_t, index=cython.Py_ssize_t)
    cdef Py_ssize_t _fill_from_memory(self, double[::1] ranges, double now)

    @cython.locals(i=cython.Py_ssize_t, index=cython.Py_ssize_t, unknown_count=cython.Py_ssize_t)
    cdef Py_ssize_t _remember(self, double[::1] ranges, double now)
    cdef inline Py_ssize_t _index(self, Py_ssize_t ray)

    @cython.locals(i=cython.Py_ssize_t, far_count=cython.Py_ssize_t)
    cdef bint _goes_blind(self, double[::1] raw)
    cdef double _turn_of(self, double yaw)

    @cython.locals(
        count=cython.Py_ssize_t, old_count=cython.Py_ssize_t, i=cython.Py_ssize_t,
        angles=cython.double[::1]
    )
    cdef _set_bearings(self, bearings, double turned)

    @cython.locals(i=cython.Py_ssize_t, count=cython.Py_ssize_t)
    cdef bint _has_even_rays(self)

    @cython.locals(i=cython.Py_ssize_t, n=cython.Py_ssize_t)
    cdef int _set_empty_memory(self)

    @cython.locals(
        count=cython.Py_ssize_t, old_count=cython.Py_ssize_t, place=cython.Py_ssize_t,
        i=cython.Py_ssize_t, source=cython.Py_ssize_t, target=cython.Py_ssize_t
    )
    cdef int _recall(self, double[::1] rising, double turned)

    @cython.locals(i=cython.Py_ssize_t)
    cdef bint _interpret_ranges(self, double[::1] out)

    @cython.locals(
        n=cython.Py_ssize_t, first=cython.Py_ssize_t, begin=cython.Py_ssize_t,
        end=cython.Py_ssize_t, k=cython.Py_ssize_t, i=cython.Py_ssize_t, run=cython.Py_ssize_t
    )
    cdef int _interpret_zeros(self, double[::1] out, double now)

    @cython.locals(
        at=cython.Py_ssize_t, had_return=cython.bint, is_packet=cython.bint, may_hide=cython.bint
    )
    cdef double _meaning(self, Py_ssize_t ray, Py_ssize_t run, double now)

    @cython.locals(
        direction=cython.Py_ssize_t, step=cython.Py_ssize_t, beside=cython.Py_ssize_t,
        n=cython.Py_ssize_t
    )
    cdef bint _was_near(self, Py_ssize_t ray, double now)

    @cython.locals(i=cython.Py_ssize_t)
    cdef double _lost_since(self, double now)

    @cython.locals(
        n=cython.Py_ssize_t, first=cython.Py_ssize_t, last=cython.Py_ssize_t, k=cython.Py_ssize_t,
        i=cython.Py_ssize_t
    )
    cdef double _widest(self, double before)

    @cython.locals(
        count=cython.Py_ssize_t, first=cython.Py_ssize_t, last=cython.Py_ssize_t,
        k=cython.Py_ssize_t, i=cython.Py_ssize_t
    )
    cdef bint _bridge_sectors(self, double[::1] ranges)

    @cython.locals(k=cython.Py_ssize_t)
    cdef bint _fill_between(
        self, double[::1] ranges, Py_ssize_t last, Py_ssize_t next_known, double last_angle,
        double next_angle, double last_range, double next_range
    )
