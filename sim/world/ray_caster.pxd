# What C needs of ray_caster.py, which has the meaning of each name.

cimport cython

cdef double _BEARING_MARGIN, _MIN_SIDE, _ROUNDING, _WIDE
cdef Py_ssize_t _BLOCK

@cython.auto_pickle(False)
cdef class Caster:
    cdef Py_ssize_t _rays
    cdef Py_ssize_t[::1] _number
    cdef double[::1] _cos, _sin, _bearings
    cdef bint _is_even
    cdef double _ray_step, _range_min, _range_max, _sensor_x, _sensor_y
    cdef double[:, ::1] _walls, _poles
    cdef Py_ssize_t _polygon_count, _body_count, _corner_count
    cdef double[:, :, ::1] _edges
    cdef double[:, ::1] _discs
    cdef Py_ssize_t[::1] _owner
    cdef double[::1] _reach
    cdef double _max_reach
    cdef double[:, :, ::1] _placed_edges
    cdef double[:, ::1] _disc_centers, _body_places
    cdef Py_ssize_t _step
    cdef Py_ssize_t[::1] _cell_begin, _members, _cell_of
    cdef Py_ssize_t _grid_columns, _grid_rows
    cdef double _west, _south, _cell_size, _x, _y, _yaw, _cos_yaw, _sin_yaw
    cdef double[::1] _inverse
    cdef Py_ssize_t _first, _count
    cdef bint _is_wide
    cdef double _cos_middle, _sin_middle, _cos_half, _sin_half
    cdef int _set_rays(self, spec, rays)

    @cython.locals(grid_side=cython.Py_ssize_t)
    cdef int _make_buffers(self, edges_shape, Py_ssize_t discs)

    @cython.locals(request=cython.Py_ssize_t)
    def cast(self, double[:, ::1] poses, Py_ssize_t[::1] observers, double[:, ::1] ranges)

    @cython.locals(i=cython.Py_ssize_t)
    cdef int _cast_sector(
        self, double[:, ::1] poses, Py_ssize_t robot, Py_ssize_t first, Py_ssize_t count,
        double[:, ::1] ranges, Py_ssize_t row
    )

    @cython.locals(i=cython.Py_ssize_t, index=cython.Py_ssize_t, distance=cython.double)
    cdef int _write_ranges(self, double[:, ::1] ranges, Py_ssize_t row)

    @cython.boundscheck(False)
    @cython.locals(
        body=cython.Py_ssize_t, owner=cython.Py_ssize_t, x=cython.double, y=cython.double,
        west=cython.double, east=cython.double, south=cython.double, north=cython.double
    )
    cdef int _set_bodies(self, double[:, ::1] poses)

    @cython.boundscheck(False)
    @cython.locals(i=cython.Py_ssize_t, c=cython.double, s=cython.double)
    cdef int _place_polygon(self, Py_ssize_t body, double x, double y, double yaw)

    @cython.boundscheck(False)
    @cython.locals(c=cython.double, s=cython.double)
    cdef int _place_disc(self, Py_ssize_t disc, double x, double y, double yaw)
    cdef int _fill_grid(self, double west, double east, double south, double north)

    @cython.boundscheck(False)
    @cython.locals(
        body=cython.Py_ssize_t, cell=cython.Py_ssize_t, cells=cython.Py_ssize_t,
        total=cython.Py_ssize_t
    )
    cdef int _sort_bodies(self)
    cdef inline Py_ssize_t _cell_at(self, double x, double y) noexcept
    cdef int _set_sensor(self, double x, double y, double yaw)

    @cython.locals(low=cython.double, high=cython.double, middle=cython.double, half=cython.double)
    cdef int _set_cone(self)

    @cython.locals(along=cython.double, left=cython.double)
    cdef double _outside(self, double x, double y, double side)

    @cython.locals(along=cython.double, left=cython.double)
    cdef inline bint _is_outside(self, double x, double y, double radius)

    @cython.boundscheck(False)
    @cython.locals(
        i=cython.Py_ssize_t, x=cython.double, y=cython.double, end_x=cython.double,
        end_y=cython.double, side=cython.double
    )
    cdef int _meet_walls(self)

    @cython.boundscheck(False)
    @cython.locals(
        grid_row=cython.Py_ssize_t, south=cython.Py_ssize_t, north=cython.Py_ssize_t,
        member=cython.Py_ssize_t, sensor_row=cython.Py_ssize_t, sensor_column=cython.Py_ssize_t,
        west=cython.Py_ssize_t, east=cython.Py_ssize_t
    )
    cdef int _meet_bodies(self, Py_ssize_t carrier)

    @cython.boundscheck(False)
    @cython.locals(disc=cython.Py_ssize_t, radius=cython.double, x=cython.double, y=cython.double)
    cdef inline int _meet_body(self, Py_ssize_t body, Py_ssize_t carrier)

    @cython.boundscheck(False)
    @cython.locals(
        i=cython.Py_ssize_t, x=cython.double, y=cython.double, along_x=cython.double,
        along_y=cython.double, side=cython.double
    )
    cdef int _meet_polygon(self, Py_ssize_t body)

    @cython.locals(
        high=cython.double, width=cython.double, by_cos=cython.double, by_sin=cython.double,
        first=cython.Py_ssize_t, rays=cython.Py_ssize_t
    )
    cdef int _meet_surface(self, double x, double y, double along_x, double along_y, double side)

    @cython.boundscheck(False)
    @cython.locals(
        end=cython.Py_ssize_t, i=cython.Py_ssize_t, index=cython.Py_ssize_t, inverse=cython.double
    )
    cdef inline int _note_surface(
        self, Py_ssize_t begin, Py_ssize_t rays, double by_cos, double by_sin
    )

    @cython.locals(
        tangent_squared=cython.double, middle=cython.double, half=cython.double,
        is_around_sensor=cython.bint, first=cython.Py_ssize_t, rays=cython.Py_ssize_t
    )
    cdef int _meet_circle(self, double x, double y, double radius)

    @cython.boundscheck(False)
    @cython.locals(
        end=cython.Py_ssize_t, i=cython.Py_ssize_t, index=cython.Py_ssize_t, aside=cython.double,
        farther=cython.double, inverse=cython.double
    )
    cdef inline int _note_circle(
        self, Py_ssize_t begin, Py_ssize_t rays, double ahead, double left, double radius,
        double tangent_squared
    )

    @cython.locals(low=cython.Py_ssize_t, high=cython.Py_ssize_t, middle=cython.Py_ssize_t)
    cdef Py_ssize_t _ray_index(self, double bearing) except? -1

@cython.auto_pickle(False)
cdef class Sweeps:
    cdef Py_ssize_t _steps
    cdef Py_ssize_t[::1] _first, _counts
    cdef double[:, ::1] _ranges
    cdef Py_ssize_t[:, ::1] _scans
    cdef Py_ssize_t _count

    @cython.locals(place=cython.Py_ssize_t)
    def begin(self, Py_ssize_t robot, Py_ssize_t step, Py_ssize_t row)

    @cython.locals(
        i=cython.Py_ssize_t, robot=cython.Py_ssize_t, row=cython.Py_ssize_t,
        sector=cython.Py_ssize_t
    )
    def advance(self, double[:, ::1] poses, Py_ssize_t step, bint ends_only)

    @cython.locals(i=cython.Py_ssize_t, k=cython.Py_ssize_t)
    cdef int _remove_first(self, Py_ssize_t count)

@cython.auto_pickle(False)
cdef class Errors:
    cdef double _near, _near_sd, _far_sd, _resolution, _dropout
    cdef double[::1] _factors
    cdef double[:, ::1] _reach
    cdef double[::1] _lost
    cdef double[:, ::1] _encoded
    cdef double[::1] _block_dropout, _normal
    cdef float[::1] _uniform

    @cython.locals(
        i=cython.Py_ssize_t, rays=cython.Py_ssize_t, r=cython.double, spread=cython.double,
        factor=cython.double, range_min=cython.double, range_max=cython.double,
        block_dropout=cython.double, drops_out=cython.bint
    )
    def measure(self, Py_ssize_t row, double[::1] ranges)

    @cython.locals(i=cython.Py_ssize_t, near=cython.double, nothing=cython.double)
    cpdef encode(self, Py_ssize_t row, double[::1] ranges)
