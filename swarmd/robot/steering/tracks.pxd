# What C needs of tracks.py, which has the meaning of each name.

cimport cython

cdef double REACH, _MAX_STEP, _MAX_EXACT, _EXACT, _MIN_WIDTH, _PART_SLACK, _GRAZING, _DEPTH_SHARE
cdef double _MIN_RADIUS, _MAX_RADIUS, _POSITION_NOISE, _RANGE_NOISE, _HIDDEN_NOISE, _ACCELERATION
cdef double _GROWTH, _SHRINKAGE, _GATE, _GATE_SLACK
cdef int _MIN_HITS, _MAX_MISSES
cdef double _HIDDEN_TIME, _MAX_EXTRAPOLATED, _SECTOR
cdef double[::1] _no_doubles

cdef double speed_of(double linear, double lateral)

@cython.final
cdef class Track:
    cdef readonly long long id
    cdef readonly double x, y, vx, vy, radius

@cython.final
cdef class ScanReturns:
    cdef Py_ssize_t count
    cdef double[::1] ranges, bearings, ages
    cdef long long[::1] _order
    cdef double[::1] _unsorted
    cdef long long[::1] _sorted
    def _make_room(self, Py_ssize_t count)

    @cython.locals(
        ranges=cython.const_double[::1], bearings=cython.const_double[::1], has_ages=cython.bint,
        ages=cython.const_double[::1], i=cython.Py_ssize_t, k=cython.Py_ssize_t,
        count=cython.Py_ssize_t, falls=cython.Py_ssize_t, lowest=cython.Py_ssize_t,
        order=cython.longlong[::1], own_ranges=cython.double[::1], own_bearings=cython.double[::1],
        own_ages=cython.double[::1]
    )
    cdef int take(self, scan)

@cython.final
cdef class _Cluster:
    cdef double x, y, ray_x, ray_y, half_width, range
    cdef int visible_ends
    cdef double measured_at
    cdef bint is_shared, is_used

@cython.final
cdef class _Filter:
    cdef long long id
    cdef double fastest, state_at, seen_at, radius, x, y, vx, vy, pp, pv, vv
    cdef long long hits, misses
    cdef int begin(self, _Cluster cluster)

    @cython.locals(dt=cython.double)
    cdef int predict(self, double time)

    @cython.locals(depth=cython.double, delay=cython.double, dx=cython.double, dy=cython.double)
    cdef double distance_to(self, _Cluster cluster, double gate)

    @cython.locals(
        noise=cython.double, depth=cython.double, delay=cython.double, off_x=cython.double,
        off_y=cython.double, inverse=cython.double, gain=cython.double,
        velocity_gain=cython.double, speed=cython.double, growth=cython.double
    )
    cdef int update(self, _Cluster cluster)

@cython.final
cdef class Surroundings:
    cdef double[::1] _wall_x, _wall_y
    cdef Py_ssize_t _wall_count
    cdef double _time, _x, _y, _yaw

    @cython.locals(
        cos_yaw=cython.double, sin_yaw=cython.double, seconds_ahead=cython.double,
        dx=cython.double, dy=cython.double
    )
    def tracks(self)

    @cython.locals(
        i=cython.Py_ssize_t, cos_yaw=cython.double, sin_yaw=cython.double,
        places=cython.double[:, ::1], dx=cython.double, dy=cython.double
    )
    def walls(self)

@cython.final
cdef class Tracker:
    cdef double _offset_x, _offset_y, _latency, _fastest, _widest, _spacing
    cdef long long _next_id
    cdef double[::1] _wall_x, _wall_y
    cdef Py_ssize_t _wall_count
    cdef double _lidar_x, _lidar_y, _lidar_yaw
    cdef double[::1] _x, _y
    cdef long long[::1] _is_gap, _run_first, _run_last

    @cython.locals(scan_time=cython.double, x=cython.double, y=cython.double, yaw=cython.double)
    def observe(self, scan, context)

    @cython.locals(time=cython.double)
    cpdef Surroundings surroundings(self, context)

    @cython.locals(
        now=cython.double, c=cython.double, s=cython.double, x=cython.double, y=cython.double
    )
    cdef _add_shared_places(self, clusters, context)

    @cython.locals(k=cython.Py_ssize_t)
    cdef int _add_wall(self, double x, double y)

    @cython.locals(x=cython.double[::1], k=cython.Py_ssize_t)
    cdef int _take_returns(self, scan, double base_x, double base_y, double yaw)

    @cython.locals(distance=cython.double, angle=cython.double)
    cdef int _place(self, Py_ssize_t k)

    @cython.locals(dx=cython.double, dy=cython.double)
    cdef double _squared_distance(self, Py_ssize_t i, Py_ssize_t j)
    def _make_room(self, Py_ssize_t count)

    @cython.locals(
        count=cython.Py_ssize_t, ranges=cython.double[::1], bearings=cython.double[::1],
        is_gap=cython.longlong[::1], size=cython.double, is_exact=cython.bint,
        surely_near=cython.double, surely_far=cython.double, cuts=cython.Py_ssize_t,
        first=cython.Py_ssize_t, i=cython.Py_ssize_t, j=cython.Py_ssize_t, max_step=cython.double,
        step=cython.double, is_cut=cython.bint, near=cython.double, max_distance=cython.double,
        bound=cython.double, across=cython.double, most=cython.double, least=cython.double
    )
    cdef Py_ssize_t _cut_into_runs(self)

    @cython.locals(
        n=cython.Py_ssize_t, runs=cython.Py_ssize_t, end=cython.Py_ssize_t,
        index=cython.Py_ssize_t
    )
    cdef _clusters(self, double at)

    @cython.locals(
        i=cython.Py_ssize_t, j=cython.Py_ssize_t, near=cython.double, max_distance=cython.double
    )
    cdef Py_ssize_t _end_of_surface(self, Py_ssize_t index, Py_ssize_t run_count)

    @cython.locals(
        i=cython.Py_ssize_t, ray=cython.Py_ssize_t, ranges=cython.double[::1],
        return_count=cython.Py_ssize_t, nearest=cython.double, farthest=cython.double,
        first=cython.Py_ssize_t, last=cython.Py_ssize_t, chord=cython.double, dx=cython.double,
        dy=cython.double, to_lidar=cython.double
    )
    cdef int _add_surface(self, clusters, Py_ssize_t index, Py_ssize_t end, double scan_time)

    @cython.locals(
        i=cython.Py_ssize_t, ray=cython.Py_ssize_t, x=cython.double, y=cython.double,
        distance=cython.double, age=cython.double, count=cython.Py_ssize_t
    )
    cdef _Cluster _mean_return(self, Py_ssize_t index, Py_ssize_t end, double scan_time)

    @cython.locals(
        count=cython.Py_ssize_t, before=cython.Py_ssize_t, after=cython.Py_ssize_t,
        visible_ends=cython.int
    )
    cdef int _visible_ends(self, Py_ssize_t first, Py_ssize_t last)

    @cython.locals(
        ranges=cython.double[::1], bearings=cython.double[::1], n=cython.Py_ssize_t,
        nearest=cython.Py_ssize_t, sector=cython.double, first=cython.Py_ssize_t,
        last=cython.Py_ssize_t, ray_sector=cython.double
    )
    cdef int _add_wall_sectors(self, Py_ssize_t index, Py_ssize_t end)
    cdef int _add_near_wall(self, Py_ssize_t i)

    @cython.locals(
        filter_index=cython.Py_ssize_t, cluster_index=cython.Py_ssize_t, gate=cython.double,
        distance=cython.double
    )
    cdef int _associate(self, clusters)

    @cython.locals(radius=cython.double, dx=cython.double, dy=cython.double)
    cdef bint _is_part(self, _Cluster cluster)
    cdef int _end_missed(self, double x, double y, double yaw, double at)

    @cython.locals(
        n=cython.Py_ssize_t, cos_yaw=cython.double, sin_yaw=cython.double, dx=cython.double,
        dy=cython.double, x=cython.double, y=cython.double, first=cython.Py_ssize_t
    )
    cdef bint _is_hidden(self, _Filter track, double base_x, double base_y, double yaw)
