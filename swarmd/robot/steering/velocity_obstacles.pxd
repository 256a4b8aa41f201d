# What C needs of velocity_obstacles.py, which has the meaning of each name.

cimport cython

cdef double _EPSILON, _ROUNDED_UP

@cython.final
cdef class Line:
    cdef readonly double x, y, dx, dy

cdef Line _line(double x, double y, double dx, double dy)
cpdef double excess(Line line, double x, double y)

@cython.locals(
    square=cython.double, from_cap_x=cython.double, from_cap_y=cython.double, length=cython.double,
    along=cython.double, is_cap_nearest=cython.bint, nx=cython.double, ny=cython.double,
    off=cython.double, leg=cython.double, is_left=cython.bint, speed=cython.double
)
cpdef Line line_of(
    double px, double py, double vx, double vy, double robot_vx, double robot_vy, double radius,
    double share, double horizon
)

@cython.locals(places=cython.double[:, ::1], x=cython.double, y=cython.double)
cpdef wall_lines(
    walls, double lead, double robot_vx, double robot_vy, double radius, double reach,
    double horizon
)

@cython.locals(vx=cython.double, vy=cython.double)
cpdef track_lines(
    tracks, double lead, double robot_vx, double robot_vy, double radius, double share,
    double standing_speed, double horizon
)

@cython.locals(worst=cython.Py_ssize_t, worst_excess=cython.double, line_excess=cython.double)
cpdef Py_ssize_t most_violated(lines, Py_ssize_t first, double x, double y)

@cython.locals(
    i=cython.Py_ssize_t, k=cython.Py_ssize_t, places=cython.const_double[:, ::1],
    least_width=cython.double, dx=cython.double, dy=cython.double, width=cython.double
)
cpdef passage_between(walls, double nearest_ahead, double farthest_ahead, double farthest_aside)

@cython.locals(solved_count=cython.Py_ssize_t)
cpdef nearest(lines, Py_ssize_t wall_count, double x, double y, double max_speed)

@cython.final
cdef class _Programme:
    cdef double max_speed, x, y

    @cython.locals(max_speed=cython.double, length=cython.double)
    cdef Py_ssize_t solve(self, lines, double x, double y, bint is_direction)

    @cython.locals(
        along_line=cython.double, half_chord_square=cython.double, half_chord=cython.double,
        low=cython.double, high=cython.double, position=cython.double, cross=cython.double,
        offset=cython.double
    )
    cdef bint _place(self, lines, Py_ssize_t line_count, double x, double y, bint is_direction)

    @cython.locals(
        worst_excess=cython.double, previous_x=cython.double, previous_y=cython.double,
        cross=cython.double, x=cython.double, y=cython.double, dx=cython.double, dy=cython.double,
        length=cython.double, have_same_side=cython.bint, position=cython.double
    )
    cdef int relax(self, lines, Py_ssize_t wall_count, Py_ssize_t begin)
