# What C needs of blind_zone.py, which has the meaning of each name.

cimport cython

cdef double _NARROW_TIME, _DOUBTFUL, _FORGET_DISTANCE, _RANGE_NOISE, _MIN_HIDDEN_RANGE, _MAX_SHIFT
cdef double _SHAPE_CHANGE
cdef Py_ssize_t _MAX_POINTS, _MIN_EMPTY_RUN
cdef double _MIN_WIDTH, _MIN_EMERGED, _MAX_SECTOR, _MAX_FACE
cdef Py_ssize_t _EDGE_RAYS
cdef double _MIN_APPROACH, _MAX_SLOPE, _FLAT

@cython.locals(
    low=cython.Py_ssize_t, high=cython.Py_ssize_t, middle=cython.Py_ssize_t,
    after=cython.Py_ssize_t, before=cython.Py_ssize_t
)
cdef Py_ssize_t _nearest(double[::1] rising, Py_ssize_t n, double wanted)

@cython.locals(i=cython.Py_ssize_t)
cdef bint _has_near(const double[::1] ranges, double limit)

@cython.locals(
    count=cython.Py_ssize_t, j=cython.Py_ssize_t, k=cython.Py_ssize_t, point_x=cython.p_double,
    point_y=cython.p_double
)
cdef Py_ssize_t _find_match(
    double[::1] xs, double[::1] ys, Py_ssize_t point_count, double x, double y, double within,
    Py_ssize_t stride, Py_ssize_t begin
)

@cython.locals(i=cython.Py_ssize_t)
cdef double[::1] _grown(double[::1] old, Py_ssize_t n)

cdef double _finite_range(double[::1] ranges, Py_ssize_t ray)

@cython.locals(face_rays=cython.Py_ssize_t, i=cython.Py_ssize_t)
cdef bint _crosses_rim(
    double[::1] ranges, Py_ssize_t ray_count, double radius, Py_ssize_t ray, Py_ssize_t direction,
    bint is_flat
)

@cython.locals(first=cython.Py_ssize_t, i=cython.Py_ssize_t, k=cython.Py_ssize_t)
cdef int _turn_rays(double[::1] bearings, Py_ssize_t count, double turned, double[::1] rising)

cdef class HiddenObstacles:
    cdef readonly object bearings, nearest
    cdef double _radius, _speed, _period, _narrowest_sector
    cdef Py_ssize_t _ray_count, _reserved
    cdef long long[::1] _order
    cdef double[::1] _bearing, _rising, _range
    cdef unsigned char[::1] _is_empty, _is_in_entered_sector, _was_near, _is_covered
    cdef double[::1] _age_by_ray, _nearest_by_ray
    cdef unsigned char[::1] _is_face_by_ray
    cdef double[::1] _exact_bearing
    cdef Py_ssize_t _sector_count
    cdef long long[::1] _sector_first, _sector_width, _crossings
    cdef double[::1] _corner
    cdef Py_ssize_t _point_count
    cdef double[::1] _x, _y
    cdef Py_ssize_t _old_point_count
    cdef double[::1] _old_x, _old_y
    cdef Py_ssize_t _old_empty_count
    cdef double[::1] _old_empty, _turned_angle
    cdef Py_ssize_t _angle_total
    cdef double[::1] _angles
    cdef long long[::1] _angle_rays
    cdef Py_ssize_t _hidden_count, _candidate_count
    cdef double[::1] _hidden_bearing, _age, _nearest_range, _is_face
    cdef unsigned char[::1] _is_hidden
    cdef double _entered_x, _entered_y, _emerged_m, _vanished_m

    @cython.locals(
        ranges=cython.const_double[::1], ray_count=cython.Py_ssize_t, range_min=cython.double,
        sensor_x=cython.double, sensor_y=cython.double, i=cython.Py_ssize_t, ray=cython.Py_ssize_t,
        order=cython.p_longlong, sorted_range=cython.p_double, sorted_bearing=cython.p_double,
        near_x=cython.p_double, near_y=cython.p_double, point_count=cython.Py_ssize_t,
        distance=cython.double, near_range=cython.double, old_empty=cython.p_double,
        empty_count=cython.Py_ssize_t
    )
    def update(self, scan, geometry, moved, driven, seconds)

    @cython.locals(values=cython.const_double[::1], n=cython.Py_ssize_t, i=cython.Py_ssize_t)
    cdef _set_bearings(self, bearings)
    cdef _reserve(self, Py_ssize_t size)
    cdef int _leave(self, double driven_x, double driven_y, double turned)

    @cython.locals(ray_count=cython.Py_ssize_t, i=cython.Py_ssize_t, k=cython.Py_ssize_t)
    cdef _update_hidden(
        self, double moved_x, double moved_y, double turned, double sensor_x, double sensor_y,
        double seconds, double obstacle_step
    )

    @cython.locals(i=cython.Py_ssize_t)
    cdef int _approach(self, double turned, double seconds)
    cdef _publish(self, Py_ssize_t count)

    @cython.locals(
        ray_count=cython.Py_ssize_t, i=cython.Py_ssize_t, first=cython.Py_ssize_t,
        end=cython.Py_ssize_t, last=cython.Py_ssize_t, ranges=cython.p_double
    )
    cdef int _find_sectors(self)

    @cython.locals(
        ray_count=cython.Py_ssize_t, k=cython.Py_ssize_t, i=cython.Py_ssize_t, is_flat=cython.bint
    )
    cdef int _add_sector(self, Py_ssize_t first, Py_ssize_t width)

    @cython.locals(
        stride=cython.Py_ssize_t, is_gone=cython.bint, match=cython.Py_ssize_t,
        last_match=cython.Py_ssize_t, i=cython.Py_ssize_t, k=cython.Py_ssize_t,
        ray=cython.Py_ssize_t
    )
    cdef int _add_vanished(
        self, double moved_x, double moved_y, double cos_turn, double sin_turn, double sensor_x,
        double sensor_y, double obstacle_step, bint is_entered
    )

    @cython.locals(
        i=cython.Py_ssize_t, k=cython.Py_ssize_t, near_count=cython.Py_ssize_t,
        width=cython.Py_ssize_t, is_covered=cython.bint
    )
    cdef int _find_covered(self, double obstacle_step)

    @cython.locals(
        ray_count=cython.Py_ssize_t, i=cython.Py_ssize_t, k=cython.Py_ssize_t,
        ray=cython.Py_ssize_t, is_robot_near=cython.bint
    )
    cdef int _place(self, double turned, double obstacle_step)

    @cython.locals(i=cython.Py_ssize_t, k=cython.Py_ssize_t, has_emerged=cython.bint)
    cdef int _drop_reappeared(self, double sideways_shift, double farthest_shift)

    @cython.locals(
        ray_count=cython.Py_ssize_t, i=cython.Py_ssize_t, bearing=cython.p_double,
        exact_bearing=cython.p_double, age=cython.p_double, nearest=cython.p_double
    )
    cdef int _clear_rays(self)

    @cython.locals(
        ray_count=cython.Py_ssize_t, old_empty_count=cython.Py_ssize_t, i=cython.Py_ssize_t,
        k=cython.Py_ssize_t, ranges=cython.p_double
    )
    cdef int _find_reappeared(self, double turned, double obstacle_step)

    @cython.locals(
        ray_count=cython.Py_ssize_t, i=cython.Py_ssize_t, k=cython.Py_ssize_t,
        first=cython.Py_ssize_t, after_last=cython.Py_ssize_t, is_obstacle_hidden=cython.bint,
        is_crossed=cython.bint, is_doubtful=cython.bint
    )
    cdef int _fill(self, double seconds)

    @cython.locals(i=cython.Py_ssize_t, ray=cython.Py_ssize_t)
    cdef int _fill_with_box(self, Py_ssize_t k)

    @cython.locals(i=cython.Py_ssize_t, first=cython.Py_ssize_t, after_last=cython.Py_ssize_t)
    cdef int _fill_evenly(self, Py_ssize_t k, double age)
