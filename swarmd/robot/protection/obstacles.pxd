# What C needs of obstacles.py, which has the meaning of each name.

cimport cython

cdef double REACH
cdef Py_ssize_t DISC_X, DISC_Y, DISC_RADIUS, DISC_AGE, _FIRST_RUN

cdef class ReturnLayer:
    cdef long long[::1] kinds
    cdef bint has_kinds, has_bare_walls, wants_all

    cdef observe(
        self, const double[::1] ranges, double[::1] directions, const double[::1] ages,
        const double[::1] filled, Py_ssize_t borrowed, double[:, ::1] hidden, ScanMotion motion
    )

@cython.final
cdef class Points:
    cdef Py_ssize_t count
    cdef double[::1] x, y, gap, age
    cdef long long[::1] kind
    cdef int reserve(self, Py_ssize_t room) except? -1

    @cython.locals(at=cython.Py_ssize_t)
    cdef int add(self, double x, double y, double gap, double age, long long kind) except? -1

@cython.final
cdef class NearObstacles:
    cdef double[::1] surface_gap
    cdef Py_ssize_t contacts
    cdef bint is_near, has_contact
    cdef object min_gap
    cdef double longest_peer
    cdef const double[::1] _bearings
    cdef double[::1] _directions, _unsorted_gap
    cdef Py_ssize_t _returns
    cdef bint _has_surfaces
    cdef long long[::1] _order, _spare
    cdef int has_bare_walls(self) except? -1
    cdef hear(self, double diagonal)

    @cython.locals(i=cython.Py_ssize_t, count=cython.Py_ssize_t)
    cdef set_bearings(self, bearings)
    cdef int _find_direction(self, Py_ssize_t ray) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int _find_directions(self, const double[::1] ranges, bint wants_all) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef find_min_gap(self, const double[::1] ranges, double range_min)
    cdef int _set_min_gap(self, double nearest, double smallest_gap) except? -1

    @cython.locals(count=cython.Py_ssize_t, room=cython.Py_ssize_t, has_contacts=cython.bint)
    cdef take_scan(
        self, const double[::1] ranges, double range_min, const double[::1] ages,
        const double[::1] filled, Py_ssize_t borrowed, double[:, ::1] hidden
    )

    @cython.locals(
        i=cython.Py_ssize_t, count=cython.Py_ssize_t, has_ages=cython.bint,
        near_count=cython.Py_ssize_t, has_direction=cython.bint
    )
    cdef double _take_returns(
        self, const double[::1] ranges, double range_min, const double[::1] ages,
        double longest_range, double binding_range
    ) except? -1.0

    @cython.locals(i=cython.Py_ssize_t, is_outside=cython.bint)
    cdef double _take_hidden(self, double[:, ::1] hidden, double binding_range) except? -1.0

    @cython.locals(i=cython.Py_ssize_t)
    cdef int _sort_points(self) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int find_surfaces(self) except? -1

    @cython.locals(
        left=cython.Py_ssize_t, right=cython.Py_ssize_t, target=cython.Py_ssize_t,
        first=cython.Py_ssize_t, middle=cython.Py_ssize_t, end=cython.Py_ssize_t,
        run_length=cython.Py_ssize_t
    )
    cdef int _sort(self, Py_ssize_t count) except? -1

@cython.locals(i=cython.Py_ssize_t)
cdef _take(
    double[::1] values, long long[::1] order, Py_ssize_t count, double[::1] into, Py_ssize_t begin
)

@cython.locals(i=cython.Py_ssize_t)
cdef double _least_of(const double[::1] ranges) except? -1.0

@cython.final
cdef class ObstacleDiscs:
    cdef double[:, ::1] table
    cdef Py_ssize_t count
    cdef long long[::1] binding
    cdef set(self, told)

    @cython.locals(i=cython.Py_ssize_t)
    cdef int find_binding(self, Assumptions assumptions, double radius) except? -1
