# What C needs of standing_walls.py, which has the meaning of each name.

cimport cython

cdef double _odometry_share, _still, _LATE_TURN
cdef Py_ssize_t _MISSED
cdef double _BIN
cdef Py_ssize_t _BINS, _WALLS
cdef double _PARALLEL, _FASTEST_WALL
cdef Py_ssize_t _SHOWN_TWICE
cdef double _MOVED
cdef Py_ssize_t _EDGE
cdef double _AT_REST

@cython.final
cdef class Wall:
    cdef double x, y, ux, uy, here_x, here_y, here_ux, here_uy, measured_at, way, turn, since
    cdef double confirmed, off
    cdef bint is_seen
    cdef Py_ssize_t moves, low, high, missed
    cdef double[::1] bins, next_bins

cdef Py_ssize_t _bin_at(Wall wall, Run run, double along) except? -3

@cython.final
cdef class StandingWalls(ReturnLayer):
    cdef bint is_trusted
    cdef double _length, _seconds, _period
    cdef Py_ssize_t _wall_count
    cdef double _overlap_first, _overlap_last, _off_first, _off_last, _way, _turn
    cdef Py_ssize_t _resets

    @cython.locals(i=cython.Py_ssize_t, count=cython.Py_ssize_t)
    cdef observe(
        self, const double[::1] ranges, double[::1] directions, const double[::1] ages,
        const double[::1] filled, Py_ssize_t borrowed, double[:, ::1] hidden, ScanMotion motion
    )

    @cython.locals(j=cython.Py_ssize_t, corner=cython.Py_ssize_t, is_on_wall=cython.bint)
    cdef int _compare(self, ScanMotion motion) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int _match(self, Run run, bint is_on_wall, ScanMotion motion) except? -1

    @cython.locals(i=cython.Py_ssize_t, k=cython.Py_ssize_t)
    cdef int _place_walls(self, ScanMotion motion) except? -1

    @cython.locals(k=cython.Py_ssize_t, shift=cython.Py_ssize_t, is_inside=cython.bint)
    cdef int _centre_bins(self, Wall wall) except? -1
    cdef int _overlap(self, Wall wall, Run run) except? -1
    cdef int _is_still(self, Wall wall, Run run) except? -1
    cdef double _odometry_error(self, Wall wall, Run run, double along) except? -1.0

    @cython.locals(has_overlap=cython.bint)
    cdef int _continue(self, Wall wall, Run run, bint is_on_wall, ScanMotion motion) except? -1

    @cython.locals(
        k=cython.Py_ssize_t, count=cython.Py_ssize_t, is_on_line=cython.bint, is_near=cython.bint
    )
    cdef int _cover_bins(self, Wall wall, Run run, double now) except? -1

    @cython.locals(
        k=cython.Py_ssize_t, count=cython.Py_ssize_t, is_on_line=cython.bint,
        place=cython.Py_ssize_t, bin_of_wall=cython.Py_ssize_t
    )
    cdef int _mark_standing(self, Wall wall, Run run, double now) except? -1
    cdef int _move_line(self, Wall wall, Run run, ScanMotion motion) except? -1

    @cython.locals(k=cython.Py_ssize_t, low=cython.Py_ssize_t, high=cython.Py_ssize_t)
    cdef int _cover(self, Wall wall, Run run, double begin, double end, double now) except? -1

    @cython.locals(k=cython.Py_ssize_t)
    cdef int _has_stood(self, Wall wall, Py_ssize_t bin_of_wall, double now) except? -1

    cdef int _set_line(
        self, Wall wall, Run run, double along, double direction, ScanMotion motion
    ) except? -1

    @cython.locals(i=cython.Py_ssize_t, kept=cython.Py_ssize_t)
    cdef int _drop_walls(self) except? -1

    @cython.locals(k=cython.Py_ssize_t)
    cdef int _keep_covered(self, Wall wall) except? -1

    @cython.locals(k=cython.Py_ssize_t, covered=cython.Py_ssize_t)
    cdef int _add_wall(self, Run run, ScanMotion motion) except? -1

    @cython.locals(
        i=cython.Py_ssize_t, scans_elsewhere=cython.Py_ssize_t, was_examined=cython.bint,
        was_elsewhere=cython.bint, is_elsewhere=cython.bint
    )
    cdef int _find_moved(self, ScanMotion motion) except? -1

    @cython.locals(
        is_robot_at_rest=cython.bint, is_odometry_right=cython.bint, may_judge=cython.bint
    )
    cdef inline int _may_judge(self, Wall wall) except? -1

    @cython.locals(j=cython.Py_ssize_t)
    cdef double _moved_by(self, Wall wall, bint was_elsewhere, double farthest) except? -1.0

    @cython.locals(j=cython.Py_ssize_t, is_known=cython.bint)
    cdef double _moved_away_by(self, Wall wall, double farthest) except? -1.0
    cdef double _distance(self, Wall wall, Run run) except? -1.0

    @cython.locals(
        k=cython.Py_ssize_t, b=cython.Py_ssize_t, count=cython.Py_ssize_t,
        least_bin=cython.Py_ssize_t, greatest_bin=cython.Py_ssize_t, place=cython.Py_ssize_t,
        is_on_line=cython.bint, is_other_side=cython.bint, bin_of_wall=cython.Py_ssize_t,
        is_covered=cython.bint
    )
    cdef int _is_seen_through(self, Wall wall, Run run) except? -1
