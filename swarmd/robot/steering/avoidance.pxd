# What C needs of avoidance.py, which has the meaning of each name.

cimport cython

cdef double _HORIZON, _WALL_HORIZON, _WALL_SLACK, _SHARE, _STANDING, _RIGHT_RAD, _WAIT_TIME
cdef double _RIGHT_TURN_RATE, _MAX_RIGHT_RAD, _LONGEST_PERIOD, _MAX_HELD_TIME, _RECOVERS
cdef double _HELD_UP_SHARE, _COMFORT, _PASSAGE_FROM, _PASSAGE_TO, PASSAGE_WIDTHS, _NEAR_DISTANCE

@cython.final
cdef class Avoidance:
    cdef public object avoiding
    cdef readonly bint are_near
    cdef double _radius, _width, _reach
    cdef bint _is_holonomic
    cdef double _lead, _min_request, _right_rad, _last_call_at, _held_s
    cpdef reset(self)

    @cython.locals(
        x=cython.double, y=cython.double, vx=cython.double, vy=cython.double,
        wall_count=cython.Py_ssize_t, worst_line=cython.Py_ssize_t, right_rad=cython.double,
        speed=cython.double
    )
    cpdef command(self, requested, safe, double now, Surroundings surroundings)

    @cython.locals(width=cython.double)
    cdef bint _is_in_passage(self, walls)

    @cython.locals(seconds=cython.double, change=cython.double)
    cdef int _update_held_up(self, double now, double share)
