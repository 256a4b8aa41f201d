# What C needs of kin.py, which has the meaning of each name.

cimport cython

cdef double _MOST_NUMBER, _unit
cdef Py_ssize_t _object_size, _most_objects
cdef long long _HIGHEST
cdef object _Neighbor, _KinMessage, _KinOpinions
cdef Py_ssize_t _most_names
cdef Py_ssize_t _MOST_PEERS, _MOST_TRACKS, _SECTORS
cdef double _EDGE
cdef Py_ssize_t _MEMORY
cdef double _MOST_GAP, _MOST_AHEAD, _SILENCE, _MOVING_PERIOD, _RESTING_PERIOD, _READING_PERIOD
cdef double _EARLY, _MOVED, _COMPARED, _FEW, _DELAY_FORGOTTEN, _SAME_DISTANCE, _FIRST_SD, _TURNED
cdef double _EMPTY, _UNSEEN, _DROPPED, _CONFIRMED, _SURE, _MARGIN, _UNSURE
cdef Py_ssize_t _LEAST_NEWS
cdef double _LOST, _LEAST_EXTENT, _FADE, _REACH, _FREE_REACH, _SEEN_MOST, _LONGEST, _AGREED
cdef double _EARLIER, _STILL, _STILL_TIME, _OWN_WAY, _CLEARED, _ELSEWHERE
cdef double _ROOM, _JUDGED, _PATH_FITS, _PATH_MAY_FIT, _CONTESTED, _SETTLED, _STRAYED, _TOLD_STRAYED
cdef double _TOLD_TURNED, _ANCHORED, _STRAY_KEPT, _TURN_ERROR

@cython.final
cdef class _Track:
    cdef long long id
    cdef double still_x, still_y, still_since, still_way
    cdef object claimant
    cdef double claimed_at, contested_at
    cdef double[::1] _places
    cdef Py_ssize_t _count
    def __init__(self, long long id)

    cdef int claim(self, id, double time)

    @cython.locals(places=cython.double[::1], i=cython.Py_ssize_t)
    cdef int add(self, double time, double x, double y, double own_way)
    cdef bint is_other(self, _Peer peer)

    @cython.locals(
        places=cython.double[::1], newer=cython.double, newer_x=cython.double,
        newer_y=cython.double, is_there=cython.bint, k=cython.Py_ssize_t, i=cython.Py_ssize_t,
        at=cython.double, x=cython.double, y=cython.double, share=cython.double
    )
    cdef place_at(self, double time)

@cython.final
cdef class _Peer:
    cdef double x, y, yaw
    cdef object resets
    cdef double stamp, delay, heard_at, time, compared_at, told_x, told_y, told_yaw
    cdef double ahead, left, turn, began_x, began_y, began_at, moved_since, own_x, own_y, own_yaw
    cdef double since
    cdef Py_ssize_t row
    cdef bint is_plain, in_reach
    cdef double stands_since, stood_at, stood_x, stood_y, stood_yaw, track_x, track_y
    cdef double own_turned, strayed_at, strayed
    cdef bint has_stood
    cdef object message
    cdef int forget_stand(self)
    cdef int stray(self, double way)
    cdef int forget_doubts(self)
    cdef confirmed(self, double now)

    @cython.locals(delay=cython.double)
    cdef double time_of(self, double stamp, double now)

    @cython.locals(way=cython.double)
    cdef int follow(self)
    cdef double seconds_ahead(self, double now)

    @cython.locals(seconds=cython.double, c=cython.double, s=cython.double)
    cdef int expect(self, Hypothesis pose, double now)

@cython.final
cdef class Kin:
    cdef double _middle, _radius
    cdef bint _is_partial
    cdef long long _resets
    cdef double _shift, _x, _y, _yaw, _last_x, _last_y, _last_yaw
    cdef double _way, _turned, _seen_at
    cdef double[::1] _free
    cdef double _forgot_at, _told_at, _told_x, _told_y, _told_yaw
    cdef double[::1] _places, _objects
    cdef double _stands_since, _judged_at
    cdef bint _has_told
    cdef object _doubted, _straying
    cdef Py_ssize_t _fitting
    def __init__(
        self, double middle=*, long long resets=*, bint is_partial=*,
        double radius=*
    )

    @cython.locals(taken=cython.int)
    def on_odometry(self, odometry, double now)

    @cython.locals(
        c=cython.double, s=cython.double, id=cython.longlong, x=cython.double, y=cython.double
    )
    def observe(self, tracks, scan, double now)

    @cython.locals(
        free=cython.double[::1], ranges=cython.const_double[::1],
        bearings=cython.const_double[::1], i=cython.Py_ssize_t, sector=cython.Py_ssize_t,
        least=cython.double, most=cython.double, distance_of_ray=cython.double, ray=cython.double
    )
    cdef int _find_free(self)
    cdef bint _is_free(self, double bearing, double distance)

    @cython.locals(free=cython.double[::1], least=cython.double, i=cython.Py_ssize_t)
    cdef bint _has_room(self)

    @cython.locals(
        moved=cython.double, period=cython.double, points=cython.double[::1], i=cython.Py_ssize_t,
        k=cython.Py_ssize_t, count=cython.Py_ssize_t, most=cython.Py_ssize_t, n=cython.Py_ssize_t,
        dx=cython.double, dy=cython.double, distance=cython.longlong, bearing=cython.longlong,
        start=cython.Py_ssize_t
    )
    def next_message(self, double now, bint asks, bint stands)

    @cython.locals(
        period=cython.double, stamp_ms=cython.longlong, x_mm=cython.longlong, y_mm=cython.longlong,
        yaw_mrad=cython.longlong, stood_ms=cython.longlong, stamp=cython.double, x=cython.double,
        y=cython.double, yaw=cython.double, gap=cython.double, time=cython.double, dx=cython.double,
        dy=cython.double, turn=cython.double, c=cython.double, s=cython.double,
        ahead=cython.double, left=cython.double
    )
    cpdef on_message(self, id, message, double now)
    def on_message_many(kins, id, message, double now)
    def names(self, double now)

    @cython.locals(count=cython.Py_ssize_t)
    def complete(self, neighbors, double now)

    @cython.locals(count=cython.Py_ssize_t)
    cdef int _find_row(self, _Peer peer, neighbors)

    @cython.locals(
        seen_at=cython.double, yaw=cython.double, is_there=cython.bint, dx=cython.double,
        dy=cython.double, age=cython.double, error=cython.double
    )
    cdef _completed(self, known, _Peer peer, Hypothesis best, double now)
    cdef int _set_own(self, double time)
    cdef int _forget_silent(self, double now)

    @cython.locals(own_way=cython.double, own_turn=cython.double)
    cdef int _move(self, _Peer peer, double ahead, double left, double turn)

    @cython.locals(
        places=cython.double[::1], objects=cython.double[::1], i=cython.Py_ssize_t,
        k=cython.Py_ssize_t, m=cython.Py_ssize_t, n=cython.Py_ssize_t, count=cython.Py_ssize_t,
        told_count=cython.Py_ssize_t, is_sure=cython.bint, distance_mm=cython.longlong,
        bearing_mrad=cython.longlong, distance=cython.double, bearing=cython.double,
        to_own=cython.double, yaw=cython.double
    )
    cdef int _compare(self, packed, _Peer peer, double gap, bint is_partial)

    @cython.locals(least=cython.double, second=cython.double, rest=cython.double)
    cdef int _look(self, _Peer peer, Py_ssize_t told_count)

    @cython.locals(is_taken=cython.bint)
    cdef bint _is_taken(self, _Track track)

    @cython.locals(
        time=cython.double, told=cython.double, turned=cython.double, seen=cython.double,
        most=cython.double, dx=cython.double, dy=cython.double, distance=cython.double
    )
    cdef int _watch_stand(self, _Peer peer, double since, double stood)
    cdef int _drop_moved(self, _Peer peer)

    @cython.locals(opinion=cython.Py_ssize_t)
    def opinions(self, missed_by, double now)

    @cython.locals(
        dx=cython.double, dy=cython.double, distance=cython.double, is_news=cython.bint,
        is_lost=cython.bint, is_empty=cython.bint
    )
    cdef int _judge(
        self, Hypothesis one, _Peer peer, double gap, Py_ssize_t count, Py_ssize_t told_count
    )
    cdef int _begin(self, _Peer peer, double x, double y, double yaw, double distance)

    @cython.locals(second=cython.double, is_sure=cython.bint, least=cython.double)
    cdef int _rank(self, _Peer peer)

    @cython.locals(
        c=cython.double, s=cython.double, dx=cython.double, dy=cython.double, ahead=cython.double,
        left=cython.double, is_due=cython.bint
    )
    cdef int _agree(self, _Peer peer, double gap, Py_ssize_t told_count)

    @cython.locals(
        objects=cython.double[::1], i=cython.Py_ssize_t, k=cython.Py_ssize_t, turn=cython.double
    )
    cdef bint _is_told(self, double ahead, double left, Py_ssize_t told_count)

    @cython.locals(far=cython.double, later=cython.double)
    cdef int _match(self, double now)
    cdef bint _stands(self, _Track track, double now)

@cython.locals(sector=cython.double)
cdef inline Py_ssize_t _sector_of(double bearing) noexcept

@cython.locals(is_small=cython.bint)
cdef inline long long _units(double number) noexcept
