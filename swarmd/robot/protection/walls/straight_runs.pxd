# What C needs of straight_runs.py, which has the meaning of each name.

cimport cython

cdef double SPACING, _CORNER, _STRAIGHT, _ROUGH, _ON_LINE, _THROUGH, _LEAST_RADIUS
cdef Py_ssize_t _FEWEST
cdef double _BRIDGED
cdef Py_ssize_t _LOST_ALONE
cdef double _LATE_RAY
cdef Py_ssize_t _RUNS, _STACK, _SUM_COUNT, _SUM_X, _SUM_Y, _SUM_XX, _SUM_XY, _SUM_YY, _SUMS

@cython.final
cdef class Run:
    cdef Py_ssize_t first, length
    cdef double[::1] sums
    cdef double x, y, ux, uy, begin, end
    cdef Py_ssize_t owner
    cdef bint is_long

@cython.final
cdef class StraightRuns:
    cdef Py_ssize_t count
    cdef double[::1] x, y
    cdef long long[::1] ray
    cdef double lidar_x, lidar_y, _length, oldest
    cdef Py_ssize_t _returns
    cdef bint _bridges
    cdef long long[::1] _is_single, _is_cut
    cdef double[::1] _sums, _places
    cdef long long[::1] _stack
    def _allocate(self, Py_ssize_t rays)

    @cython.locals(j=cython.Py_ssize_t, is_long=cython.bint)
    cdef int find(
        self, const double[::1] ranges, double[::1] directions, const double[::1] ages
    ) except? -1

    @cython.locals(k=cython.Py_ssize_t, on_line=cython.Py_ssize_t, is_on_line=cython.bint)
    cdef int _is_straight(self, Run run) except? -1

    @cython.locals(
        i=cython.Py_ssize_t, k=cython.Py_ssize_t, has_ages=cython.bint, passing=cython.Py_ssize_t,
        is_of_revolution=cython.bint
    )
    cdef int _place(
        self, const double[::1] ranges, double[::1] directions, const double[::1] ages
    ) except? -1

    @cython.locals(k=cython.Py_ssize_t, bridged=cython.Py_ssize_t)
    cdef int _bridge(self) except? -1

    @cython.locals(before=cython.Py_ssize_t, to=cython.Py_ssize_t)
    cdef inline int _add_to_sums(self, Py_ssize_t k, double x, double y) except? -1

    @cython.locals(k=cython.Py_ssize_t, begin=cython.Py_ssize_t, count=cython.Py_ssize_t)
    cdef int _find_runs(self) except? -1
    cdef int _are_within(self, double distance, Py_ssize_t a, Py_ssize_t b) except? -1

    @cython.locals(
        k=cython.Py_ssize_t, top=cython.Py_ssize_t, first=cython.Py_ssize_t,
        last=cython.Py_ssize_t, farthest=cython.Py_ssize_t
    )
    cdef int _split(self, Py_ssize_t begin, Py_ssize_t end) except? -1

    @cython.locals(j=cython.Py_ssize_t)
    cdef int _add_run(self, Py_ssize_t first, Py_ssize_t last) except? -1

    @cython.locals(first=cython.Py_ssize_t, last=cython.Py_ssize_t)
    cdef int _fit(self, Run run) except? -1

    @cython.locals(place=cython.Py_ssize_t)
    cdef Py_ssize_t return_of(self, Run run, Py_ssize_t number) except? -2

    @cython.locals(i=cython.Py_ssize_t, kept=cython.Py_ssize_t)
    cdef int _join_runs(self) except? -1

    @cython.locals(
        j=cython.Py_ssize_t, last=cython.Py_ssize_t, first=cython.Py_ssize_t,
        steps=cython.Py_ssize_t, kept=cython.Py_ssize_t
    )
    cdef int _join(self, Run run, Run after) except? -1

    @cython.locals(k=cython.Py_ssize_t, place=cython.Py_ssize_t)
    cdef int _passes_through(self, Run run, Py_ssize_t last, Py_ssize_t steps) except? -1

    @cython.locals(
        k=cython.Py_ssize_t, beside=cython.Py_ssize_t, near=cython.Py_ssize_t,
        own=cython.Py_ssize_t, far=cython.Py_ssize_t
    )
    cdef Py_ssize_t corner_of(self, Py_ssize_t number) except? -2
    cdef double _before(self, Run run, Py_ssize_t place) except? -1.0

    @cython.locals(place=cython.Py_ssize_t)
    cdef double along(self, Run run, Py_ssize_t number) except? -1.0
    cdef inline int is_on_line(self, Run run, double x, double y) except? -1
