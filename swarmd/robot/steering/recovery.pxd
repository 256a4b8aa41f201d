# What C needs of recovery.py, which has the meaning of each name.

cimport cython

cdef double _BLOCKED_SHARE, _MOVE_BLOCKED_TIME, _TURN_BLOCKED_TIME, _MIN_SPEED_SHARE, _HARDLY_MOVES
cdef double _FOLLOW_TIME, _FOLLOW_GAIN, _BACK_OFF_TIME, _MAX_RECOVERY_TIME, _SIDE_HOLD_TIME
cdef double _HEADING_TOLERANCE, _OTHER_SIDE_COST, _YIELD_TIME, _ROUND_TIME, _LIMITED_SHARE
cdef double _PASSAGE_GAIN, _PASSAGE_TURN_RATE, _SIDES_FROM, _SIDES_TO, _SPEED_UP, _SPEED_STEP
cdef double _STOPPED_TIME, _STALL_DISTANCE, _STALL_TURN, _STALL_TIME, _CREEP_TIME, _LEAVING_DISTANCE
cdef double _LEAVING_TIME, _LEAVING_BACK_TIME, _CREPT_TIME, _DECISION_PERIOD, _WAY_HOLD_TIME
cdef double _STRAIGHT_ESCAPE, _CREEPING, _GAINS_GROUND, _KEEPS_DIRECTION, _BESIDE_BODY
cdef double _CROWD_PATIENCE

@cython.final
cdef class Recovery:
    cdef readonly double lookahead
    cdef readonly bint is_active, has_taken_over
    cdef double _half_width, _width, _flank, _linear_limit, _angular_limit, _turn_rate, _turn_weight
    cdef double _side, _side_until, _bearing, _planned_at_yaw, _speed
    cdef bint _is_backing, _is_set_down
    cdef double _leaving_time, _decided_at, _crept_at
    cdef bint _leaves, _is_way_back
    cdef double _way_until, _gained_at
    cdef long long _back_off_count
    cdef double _back_time, _last_block_at, _began_at, _blocked_since, _state_since
    cpdef set_down(self)
    cpdef reset(self)

    @cython.locals(
        linear=cython.double, lateral=cython.double, now=cython.double, has_taken_over=cython.bint,
        patience=cython.double, is_blocked=cython.bint
    )
    cpdef replacement(self, requested, safe, context, Points points, others=*, safe_for=*)

    @cython.locals(now=cython.double, is_creep=cython.bint)
    cdef _observe(self, requested, safe, context)
    cdef bint _is_near_start(self, context)

    @cython.locals(is_gaining=cython.bint)
    cdef bint _is_over(self, double now)
    cdef _start(self, requested, context, points)

    @cython.locals(
        linear=cython.double, angular=cython.double, lateral=cython.double, is_passing=cython.bint,
        is_moving=cython.bint, share=cython.double, least=cython.double
    )
    cdef bint _is_blocked(self, safe, double now, double patience)

    @cython.locals(asked=cython.double, allowed=cython.double)
    cdef bint _creeps(self, safe)

    @cython.locals(gained=cython.double, speed=cython.double)
    cdef bint _gains_ground(self, safe)
    cdef bint _is_creep(self, safe)

    @cython.locals(now=cython.double, has_stayed=cython.bint)
    cdef bint _is_stalled(self, context, Points points)

    cdef double _product(
        self, double linear, double angular, double lateral, double other_linear,
        double other_angular, double other_lateral
    )

    @cython.locals(is_new=cython.bint, longest=cython.double)
    cdef _set_back_time(self, double now, points)

    @cython.locals(places=cython.const_double[:, ::1])
    cdef bint _is_enclosed(self, points)

    @cython.locals(linear=cython.double, allowed=cython.double, is_limited=cython.bint)
    cdef _through_passage(self, requested, safe, Points points)

    @cython.locals(
        now=cython.double, back_time=cython.double, yaw_error=cython.double, turn=cython.double,
        is_leaving=cython.bint
    )
    cdef _recover(self, safe, context, Points points, bint is_blocked, safe_for)

    @cython.locals(speed=cython.double)
    cdef _backing(self)
    cdef bint _is_fast(self, double linear, double lateral)
    cdef bint _is_turning(self, double angular)
    cdef _leave_passage(self)
    cpdef middle(self, points)

    @cython.locals(places=cython.const_double[:, ::1], half_width=cython.double)
    cdef _back_off(self, points, double now)
    cdef _fastest_escape(self, safe_for)

    @cython.locals(now=cython.double, places=cython.const_double[:, ::1])
    cdef _plan(self, double heading, context, points)
    cdef double _body_half_width(self)

    @cython.locals(least_cost=cython.double)
    cdef _choose(self, const double[:, ::1] places, double heading, double half_width)
    cdef double _free_length(self, const double[:, ::1] places, double bearing, double half_width)
    cdef double _turned_since_plan(self, context)
    cdef _enter(self, state, double now)

cdef double _turn_to(target)
