# What C needs of right_of_way.py, which has the meaning of each name.

cimport cython

cdef WaySettings _way
cdef double _THIS_SIDE, _OTHER_SIDE

@cython.final
cdef class RightOfWay:
    cdef readonly object state
    cdef double _linear_limit, _angular_limit, _lead, _x, _y, _yaw
    cdef public double _passed_at
    cdef double _speed, _sign, _chosen_at, _wanted_yaw, _lean
    cdef readonly dict _sides
    cdef double _progress_along, _progress_at
    cdef bint _is_backing
    cdef double _busy_at, _keep_clear_for, _waiting_side
    cdef bint _is_lined_up
    cdef object _middle_offset
    cpdef reset(self)
    cpdef on_odometry(self, odometry)
    cdef _release(self)

    @cython.locals(x=cython.double, y=cython.double, bearing=cython.double)
    def passed(self, context)

    @cython.locals(c=cython.double, s=cython.double)
    cpdef observe(self, scan, offset, context)

    @cython.locals(
        now=cython.double, base_x=cython.double, base_y=cython.double, yaw=cython.double,
        linear=cython.double, angular=cython.double, lateral=cython.double, depth=cython.double,
        yaw_off=cython.double, heading=cython.double, is_passed=cython.bint,
        cos_to_request=cython.double, is_too_long=cython.bint, c=cython.double, s=cython.double,
        since=cython.double
    )
    cpdef command(self, requested, context, Surroundings surroundings, safe_for, Points points)
    cdef double _requested_yaw(self, double linear, double angular, double lateral, double yaw)

    @cython.locals(
        wanted_yaw=cython.double, angle=cython.double, meets_aside=cython.double,
        wall_length=cython.double, leads_in=cython.bint, leads_to_wall=cython.bint,
        distance=cython.double
    )
    cdef _choose(self, double x, double y, double now)
    cdef _judge_traffic(self, place, others, now)
    cdef _decide_state(self, place, others, now, safe_for, Points points)
    cdef _update_progress(self, place, traffic, now)
    cdef _next_state(self, place, traffic, now)
    cdef _giving_way(self, place)

    @cython.locals(
        bearing=cython.double, error=cython.double, behind=cython.double, turn=cython.double,
        is_in_corridor=cython.bint, leans=cython.bint, most=cython.double, lean=cython.double
    )
    cdef _request(self, place, safe_for)
    cdef _find_middle(self, place, Points points)
    cpdef _fastest(self, twist, safe_for)
    cdef _drive(self, goal_along, goal_aside, place)

@cython.locals(
    left=cython.Py_ssize_t, right=cython.Py_ssize_t, left_sum=cython.double,
    right_sum=cython.double, i=cython.Py_ssize_t, bearing=cython.double
)
cdef double _older_to_the_right(const double[::1] ages, const double[::1] bearings)
cdef inline _moved(double x, double y, double base_x, double base_y, double c, double s)
