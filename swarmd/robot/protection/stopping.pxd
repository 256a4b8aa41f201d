# What C needs of stopping.py, which has the meaning of each name.

cimport cython

cdef double NEGLIGIBLE_SPEED, FAULT_SPEED, IDEAL_BRAKING
cdef Py_ssize_t _STEPS, _BRAKES, _IDEAL_LINEAR, _IDEAL_ANGULAR
cdef double _ROUNDING, _SPEED_ROUNDING

cdef inline double _slowed(double start, double wanted, double seconds, double rate) noexcept

@cython.final
cdef class StopMotion:
    cdef double along_x, along_y, heading, x, y, turned, moved, aside, arc
    cdef inline int begin(self, double along_x, double along_y, double heading) noexcept

    cdef inline int advance(
        self, double middle_s, double step_s, double along, double aside, double turn,
        double to_along, double to_aside, double to_turn, double braking, double turning
    ) noexcept

@cython.final
cdef class Speeds:
    cdef double linear, angular

@cython.final
cdef class StopPoints:
    cdef Py_ssize_t count
    cdef double[::1] x, y, gap, needed_gap, others
    def _allocate(self, Py_ssize_t room)

    @cython.locals(
        i=cython.Py_ssize_t, points=cython.Py_ssize_t, count=cython.Py_ssize_t,
        is_return=cython.bint
    )
    cdef int collect(self, Constraints constraints, double seconds, double travel) except? -1

@cython.final
cdef class StopCheck:
    cdef double[:, ::1] _shares
    cdef Py_ssize_t _forbidding, _poses

    @cython.locals(i=cython.Py_ssize_t, is_unchanged=cython.bint)
    cdef int limit(self, Speeds speeds) except? -1

    @cython.locals(
        i=cython.Py_ssize_t, brake=cython.Py_ssize_t, count=cython.Py_ssize_t, is_safe=cython.bint
    )
    cdef int _is_clear(self, double linear, double angular) except? -1

    @cython.locals(j=cython.Py_ssize_t)
    cdef double _simulate(
        self, Py_ssize_t brake, double linear, double angular, double step_s
    ) except? -1.0

    @cython.locals(j=cython.Py_ssize_t, is_free=cython.bint)
    cdef int _forbids(self, Py_ssize_t point, double travel, double step_s) except? -1

    @cython.locals(
        k=cython.Py_ssize_t, edges=cython.Py_ssize_t, linear=cython.double, angular=cython.double,
        axis_x=cython.p_double, axis_y=cython.p_double, origin=cython.p_double,
        lengths=cython.p_double, nx=cython.double, ny=cython.double, above=cython.double,
        length=cython.double, along=cython.double, first=cython.double, last=cython.double,
        fastest_place=cython.double, corner_lever=cython.double, turn_speed=cython.double,
        linear_speed=cython.double, half_chord=cython.double, beyond=cython.double,
        rest=cython.double
    )
    cdef int _turns_outwards(self, Py_ssize_t pose, double x, double y, double reach) except? -1

cdef inline double _safe_gap(
    double needed_gap, double others, double seconds, double travel
) noexcept
