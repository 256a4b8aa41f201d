# What C needs of openings.py, which has the meaning of each name.

cimport cython

cdef double _MAX_RANGE, _JUMP
cdef int _MIN_RETURNS, _MIN_RAYS
cdef double _POST_SLACK, _CLEAR_SHARE, _MIN_WALL, _FACE_LENGTH
cdef int _MIN_FACE_RETURNS
cdef double _ON_WALL, _MAX_HOLE, _TRACK_SLACK, _SAME_AXIS, _SAME_HALF, _SAME_SPAN, _SAME_ANGLE
cdef double _LENGTH_WEIGHT
cdef long long SIGHTINGS

@cython.locals(reach=cython.double, before=cython.double)
cdef double _reach(double[::1] places, Py_ssize_t count)

@cython.final
@cython.auto_pickle(False)
cdef class _PlacedReturns:
    cdef double[::1] ranges, bearings, x, y, tracks
    cdef double offset_x, offset_y, pose_x, pose_y, pose_cos, pose_sin
    cdef unsigned char[::1] is_wall
    cdef Py_ssize_t count
    cdef double[::1] along, side, places

    @cython.locals(yaw=cython.double, n=cython.Py_ssize_t, room=cython.double[::1])
    cdef int take(self, ScanReturns returns, offset, pose)

    @cython.locals(x=cython.double, y=cython.double)
    cdef int place(self, Py_ssize_t row)

    @cython.locals(k=cython.Py_ssize_t, x=cython.double, y=cython.double, radius=cython.double)
    cdef int set_tracks(self, tracks)

    @cython.locals(
        n=cython.Py_ssize_t, i=cython.Py_ssize_t, j=cython.Py_ssize_t, step=cython.double
    )
    cdef ends(self)

    @cython.locals(
        i=cython.Py_ssize_t, tracks=cython.double[::1], x=cython.double, y=cython.double,
        dx=cython.double, dy=cython.double
    )
    cdef bint is_free(self, Py_ssize_t row)

    @cython.locals(n=cython.Py_ssize_t, row=cython.Py_ssize_t)
    cdef int mark_walls(self)

    @cython.locals(
        count=cython.Py_ssize_t, row=cython.Py_ssize_t, steps_to_partner=cython.Py_ssize_t,
        partner=cython.Py_ssize_t, least_square=cython.double, clear_range=cython.double,
        clear_count=cython.double, dx=cython.double, dy=cython.double, square=cython.double
    )
    cdef Py_ssize_t partner(self, Py_ssize_t post, int direction, double narrowest)

    @cython.locals(n=cython.Py_ssize_t)
    cdef inline Py_ssize_t beside(self, Py_ssize_t row, int direction)

    @cython.locals(
        k=cython.Py_ssize_t, cos_angle=cython.double, sin_angle=cython.double, dx=cython.double,
        dy=cython.double
    )
    cdef int turn_into(self, Opening opening)

@cython.final
cdef class Opening:
    cdef readonly double x, y, angle, half, first, last, left, right
    cdef readonly long long hits
    cdef readonly double seen_at

    @cython.locals(c=cython.double, s=cython.double, dx=cython.double, dy=cython.double)
    cpdef to_local(self, double x, double y, double sign)
    cpdef ends(self, double sign)
    cdef int measure(self, _PlacedReturns returns)

    @cython.locals(
        count=cython.Py_ssize_t, along=cython.double, side=cython.double, covariance=cython.double,
        variance=cython.double, from_mean=cython.double
    )
    cdef bint align(self, _PlacedReturns returns)

    @cython.locals(off=cython.double)
    cdef bint is_face(self, _PlacedReturns returns, Py_ssize_t i)

    @cython.locals(count=cython.Py_ssize_t)
    cdef double reach_along(self, _PlacedReturns returns, double direction)

    @cython.locals(count=cython.Py_ssize_t, along=cython.double)
    cdef double reach_beside(self, _PlacedReturns returns, double direction)

    @cython.locals(c=cython.double, s=cython.double, dx=cython.double, dy=cython.double)
    cdef bint is_same(self, Opening sighting)

    @cython.locals(
        weight=cython.double, turn=cython.double, cos_angle=cython.double, sin_angle=cython.double,
        dx=cython.double, dy=cython.double, along=cython.double, side=cython.double,
        first=cython.double, last=cython.double, left=cython.double, right=cython.double
    )
    cdef int update(self, Opening sighting)

@cython.final
cdef class Openings:
    cdef double _narrowest
    cdef readonly list known
    cpdef clear(self)
    cpdef bint forget(self, opening)

    @cython.locals(memory_time=cython.double)
    def observe(self, scan, offset, pose, double now, tracks, kept)

    @cython.locals(post=cython.Py_ssize_t, partner=cython.Py_ssize_t, direction=cython.int)
    cdef _openings_in(self, scan, offset, pose, double now, tracks)

@cython.locals(dx=cython.double, dy=cython.double)
cdef Opening _opening(_PlacedReturns returns, Py_ssize_t post, Py_ssize_t partner)

@cython.locals(
    i=cython.Py_ssize_t, table=cython.const_double[:, ::1], robot_along=cython.double,
    robot_aside=cython.double, cos_heading=cython.double, sin_heading=cython.double,
    begin=cython.double, end=cython.double, wanted_width=cython.double, width_error=cython.double,
    expected=cython.double, farthest=cython.double, is_measured=cython.bint, best=cython.double,
    least_error=cython.double, x=cython.double, y=cython.double, along=cython.double,
    gap=cython.double
)
cpdef gap_middle(points, place, span, width, middle)
