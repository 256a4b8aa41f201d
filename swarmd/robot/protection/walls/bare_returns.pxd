# What C needs of bare_returns.py, which has the meaning of each name.

cimport cython

cdef double _PART, _HEAD, _PARALLEL_RAY
cdef Py_ssize_t _LOST_SECTORS
cdef double _FLAT_RADIUS
cdef Py_ssize_t _LEAST_MEMBERS
cdef double _WIDE_SECTOR
cdef long long _UNMEASURED, _RETURN, _TOO_CLOSE, _BORROWED

@cython.final
cdef class BareReturns:
    cdef double longest_heard, _length, _extent, _range_min, _lidar_height
    cdef Py_ssize_t _rays, _borrowed
    cdef long long[::1] _state
    cdef double[::1] _x, _y, _hides_from
    cdef long long[::1] _is_open, _is_member
    cdef double[::1] _along, _across
    cdef long long[::1] _is_candidate, _stretch

    @cython.locals(i=cython.Py_ssize_t, j=cython.Py_ssize_t)
    cdef int mark(
        self, long long[::1] kinds, StraightRuns runs, const double[::1] ranges,
        double[::1] directions, const double[::1] ages, const double[::1] filled,
        Py_ssize_t borrowed, double[:, ::1] hidden
    ) except? -1

    @cython.locals(i=cython.Py_ssize_t, is_filled=cython.bint, is_of_revolution=cython.bint)
    cdef int _place_rays(
        self, const double[::1] ranges, double[::1] directions, const double[::1] ages,
        const double[::1] filled, double oldest
    ) except? -1

    @cython.locals(
        k=cython.Py_ssize_t, own=cython.Py_ssize_t, first=cython.Py_ssize_t,
        begin=cython.Py_ssize_t, last=cython.Py_ssize_t, i=cython.Py_ssize_t
    )
    cdef int _find_hiding(self, double[::1] directions) except? -1

    @cython.locals(own=cython.Py_ssize_t)
    cdef inline Py_ssize_t _own_ray(self, Py_ssize_t number) except? -2

    @cython.locals(k=cython.Py_ssize_t, i=cython.Py_ssize_t)
    cdef int _set_hiding(
        self, Py_ssize_t last, Py_ssize_t end, double angle, double[::1] directions
    ) except? -1
    cdef int _hide(self, Py_ssize_t ray, double angle, double[::1] directions) except? -1

    @cython.locals(
        i=cython.Py_ssize_t, k=cython.Py_ssize_t, ray=cython.Py_ssize_t, is_on_line=cython.bint
    )
    cdef int _find_members(self, Run run, StraightRuns runs) except? -1
    cdef inline double _height(self, Run run, StraightRuns runs, double x, double y) noexcept

    @cython.locals(
        k=cython.Py_ssize_t, own=cython.Py_ssize_t, first=cython.Py_ssize_t,
        last=cython.Py_ssize_t, steps=cython.Py_ssize_t, count=cython.Py_ssize_t,
        lost=cython.Py_ssize_t, i=cython.Py_ssize_t, is_next=cython.bint, before=cython.Py_ssize_t
    )
    cdef int _find_stretches(self, Run run, StraightRuns runs, long long[::1] kinds) except? -1

    @cython.locals(first=cython.Py_ssize_t, last=cython.Py_ssize_t)
    cdef int _take_stretch(self, Py_ssize_t count, Py_ssize_t lost, long long[::1] kinds) except? -1

    @cython.locals(k=cython.Py_ssize_t)
    cdef int _is_flat(self, Py_ssize_t count) except? -1

    @cython.locals(
        k=cython.Py_ssize_t, i=cython.Py_ssize_t, number=cython.Py_ssize_t, is_behind=cython.bint,
        is_before=cython.bint
    )
    cdef int _mark_candidates(self, Py_ssize_t count, long long[::1] kinds) except? -1

    @cython.locals(
        i=cython.Py_ssize_t, is_finite=cython.bint, is_measured=cython.bint,
        is_filled_wall=cython.bint
    )
    cdef int _deny_returns(self, Run run, StraightRuns runs, double[::1] directions) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int _deny_hidden(self, Run run, StraightRuns runs, double[:, ::1] hidden) except? -1

    @cython.locals(i=cython.Py_ssize_t, is_measured=cython.bint)
    cdef int _deny_unmeasured(self, Run run, StraightRuns runs, double[::1] directions) except? -1
    cdef inline double _rise(self, Run run, StraightRuns runs, double ray_x, double ray_y) noexcept

    @cython.locals(k=cython.Py_ssize_t)
    cdef int _deny_along(
        self, Run run, StraightRuns runs, double ray_x, double ray_y, double least,
        double farthest
    ) except? -1

    cdef inline double _place(
        self, Run run, StraightRuns runs, double ray_x, double ray_y, double distance
    ) noexcept
    cdef int _deny_beside(self, Run run, StraightRuns runs, double x, double y) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int _deny(self, double first, double last) except? -1

cdef inline double _between(double[::1] directions, Py_ssize_t ray, Py_ssize_t other) except? -1.0
