# What C needs of fence_stops.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t _FENCE_STEPS
cdef double _PLACE_ROUNDING

cdef double _squared_distance(double[:, ::1] edges, Py_ssize_t i, double x, double y) noexcept

@cython.locals(i=cython.Py_ssize_t)
cdef bint _permits(double[:, ::1] edges, double x, double y) noexcept

@cython.locals(i=cython.Py_ssize_t)
cdef double _clearance(
    double[:, ::1] edges, double[:, ::1] near, Py_ssize_t count, double x, double y, double radius
) noexcept

@cython.locals(table=cython.double[:, ::1], given=cython.double[:, ::1], i=cython.Py_ssize_t)
def clearances(edges, places, double radius)

@cython.locals(table=cython.double[:, ::1])
def clearance(edges, double x, double y, double radius)

@cython.locals(
    i=cython.Py_ssize_t, j=cython.Py_ssize_t, count=cython.Py_ssize_t, near=cython.double[:, ::1]
)
cdef _nearby(double[:, ::1] edges, double x, double y, double way)

@cython.final
@cython.auto_pickle(False)
cdef class _Stops:
    cdef double[:, ::1] edges, near, places
    cdef Py_ssize_t count
    cdef double radius, x, y, yaw, present, need, turn_error, speed_ahead, speed_left, speed_turn
    cdef double braking, turning
    @cython.locals(i=cython.Py_ssize_t)
    cdef bint permits(self, double ahead, double left, double turn) noexcept

    cdef bint permits_here(self, double ahead, double left, double turn) noexcept

    @cython.locals(i=cython.Py_ssize_t, is_clear=cython.bint, has_fallen=cython.bint)
    cdef bint is_inside(
        self, double ahead, double left, double turn, double to_ahead, double to_left,
        double to_turn, double braking, double turning
    ) noexcept

@cython.locals(
    table=cython.double[:, ::1], given=cython.double[:, ::1], best=cython.Py_ssize_t,
    i=cython.Py_ssize_t, share=cython.double, turn_share=cython.double, spread=cython.double
)
def nearest_permitted(edges, shares, request, sizes, places, double yaw, speeds, brakings, room)
