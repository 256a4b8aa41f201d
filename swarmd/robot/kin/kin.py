"""Kin: which tracked object is which peer, from the scans and the odometry of robots alone. Pure.

Robots tell each other their odometry and the narrow objects that they see
(`core/kin_message.py`). For each peer there are up to _MOST_HYPOTHESES poses in the frame of the
own odometry (`hypothesis.py`):

1. *Mutual sight* begins one: the peer tells an object at the distance at which the own robot tracks
   one. Both bearings give the yaw between the frames. (Mutual localisation by range and bearing
   without identities: Franchi, Oriolo, Stegagno, IJRR 32(11), 2013.)
2. A message moves the poses of its sender by the told motion; one of a peer without a confirmed
   pose is read only when a comparison is due. At most every _COMPARED s, in a crowd less often, the
   poses are compared with the tracks and with what the peer tells. What fits after motion raises
   the score, a place that rays cross lowers it, and so does a peer that should see the own robot
   and does not.
3. The best pose of a peer is *confirmed* once its score is high enough, both robots have moved, and
   no other pose of the peer is nearly as good.
4. A track where a confirmed pose expects the peer is that peer. A track has one peer, a peer one
   track. If two peers fit a track, the peer that was confirmed first keeps it; peers confirmed at
   much the same time make it unknown.
5. A track that stands while the own robot moves is no robot if no peer that was heard can be there:
   the peer has moved meanwhile, or its confirmed pose is elsewhere.

What a peer tells moves the poses of this peer alone, so a liar gives no other robot a name. If it
copies a peer, its own name may stand at the body of the peer.

Beside the names, kin has a *doubt* of a peer if what it tells to see does not fit where its path
shows it (`sight_fit.py`), and takes it to *stray* if it moves while it tells that its base has the
command zero. Robots tell each other both, and `robot/peer_faults.py` names the culprit. No pose,
name or motion depends on either.

The source of the objects is `Tracker` (`swarmd/robot/steering/tracks.py`) and not the clusters of a
scan:
its tracks have an identity over time, by which a track that stands is known, they reach further
than clusters that no nearer object hides, and steering computes them anyway.

Frames: the frame of the own odometry, unless a name says another. Times: s on the robot's clock.
Units: m, rad.

A kernel (see `core/kernels.py`), compiled into one unit with hypothesis.py and sight_fit.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import astuple, replace

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import PI, TURN, angle_between, wrap
from swarmd.core.buffers import doubles, view
from swarmd.core.cython_shadow import INFINITY, Doubles, atan2, cos, fabs, isnan, rint, sin
from swarmd.core.kin_message import (
    MOST_NAMES,
    MOST_OBJECTS,
    OBJECT,
    UNIT,
    KinMessage,
    KinOpinions,
)
from swarmd.core.odometry_trail import ANEW, NEXT, OdometryTrail, is_jump
from swarmd.core.values import Neighbor
from swarmd.robot.kin.hypothesis import POINT, Hypothesis, begun, length
from swarmd.robot.kin.sight_fit import FITS, MISFITS, SightFit

if TYPE_CHECKING:
    from collections.abc import Iterable, Set
    from typing import Any

    from swarmd.core.values import Odometry, Scan

# C names
_MOST_NUMBER = 1e12  # m, rad or s in a message
_unit = UNIT
_object_size = OBJECT.size
_most_objects = MOST_OBJECTS
_HIGHEST = 1 << 15  # bit of a number of 16 bits, its sign
_Neighbor = Neighbor
_KinMessage = KinMessage
_KinOpinions = KinOpinions
_most_names = MOST_NAMES
NO_ROBOT = ""
"""The name of a track that is no robot. None: unknown."""
_MOST_PEERS = 24
_MOST_TRACKS = 24
# directions, of each of which it is known how far the rays of a scan are free
_SECTORS = 72
# rad before the end of a sector, where rounding may count a bearing to the next
_EDGE = 1e-9
_MOST_HYPOTHESES = 8  # of one peer
# places of a track that are kept: 3 s at 5 Hz
_MEMORY = 16
# s between two messages, or two scans, between which a place is interpolated
_MOST_GAP = 1.5
_MOST_AHEAD = 0.4  # s for which a place is extrapolated
_SILENCE = 10.0  # s after which a silent peer is forgotten
_MOVING_PERIOD = 0.2  # s between two messages
_RESTING_PERIOD = 1.0  # s, at rest
_READING_PERIOD = 0.09  # s between two readings of odometry
_EARLY = 0.05  # s by which a scan may come early
_MOVED = 0.01  # m and rad that are a motion
_COMPARED = 0.55  # s between two comparisons of a peer, at least
_FEW = 8.0  # peers, of which each is compared so often
# s/s by which the least delay of messages is forgotten
_DELAY_FORGOTTEN = 0.01
# Beginning of a pose.
# m between both measured distances of a mutual sight
_SAME_DISTANCE = 0.10
_FIRST_SD = 0.07  # m
_TURNED = 0.4  # rad: directions that differ less are one
# Scores.
_EMPTY = 5.0  # 1/s, while rays cross the place of the peer
# 1/s, while the peer does not tell the own robot, or a third
_UNSEEN = 5.0
_DROPPED = -3.0  # score of a pose that is dropped
_CONFIRMED = 7.0
# with which a pose is sure: others begin no more, and poor ones are dropped
_SURE = 12.0
_MARGIN = 4.0  # to the next pose of the peer
_UNSURE = 1.0  # margin below which no pose is confirmed any more
# sights, and mutual sights, that a confirmed pose counts
_LEAST_NEWS = 3
# m, standard deviation beyond which a peer that comes back may be another object
_LOST = 0.15
_LEAST_EXTENT = 0.4  # m over which both robots have moved meanwhile
_FADE = 0.2  # 1/s, while nothing shows the peer
_REACH = 2.2  # m: what is not hidden is surely tracked
_FREE_REACH = 3.2  # m within which a ray without a return is free
_SEEN_MOST = 0.25  # m by which a ray passes a place it has crossed
# m, the greatest distance of which it is asked whether rays are longer
_LONGEST = _FREE_REACH + _SEEN_MOST
_AGREED = 1.8  # m within which a peer surely tells a third robot
_EARLIER = 2.0  # s: a peer confirmed so much earlier keeps a track
# Standing tracks.
_STILL = 0.12  # m
_STILL_TIME = 2.0  # s
_OWN_WAY = 0.3  # m
_CLEARED = 0.25  # m: a peer that moved so far is no standing track
_ELSEWHERE = 0.5  # m
# Doubts of peers.
# m around the own robot, within which it is one object with another for a lidar 1.8 m away: the
# widest gap in a cluster of `Tracker` there
_ROOM = 0.15
_JUDGED = 0.95  # s between two judgements
_PATH_FITS = 0.06  # m that remain between the path of a peer and that of its track
_PATH_MAY_FIT = 0.12  # m that remain of every other track
_CONTESTED = 5.0  # s for which a track counts for no peer after the paths of two have fitted it
_SETTLED = 1.5  # s with the command zero after which a base stands
_ANCHORED = 5.0  # s for which the place of a base that stands is compared
_STRAYED = 0.3  # m that a track moves from where its peer stands
# by which the own odometry may err in a turn: 0.05 in `realism: realistic`, with a fast turn
_TURN_ERROR = 0.1
_STRAY_KEPT = 30.0  # s after such a motion for which the peer strays
_TOLD_STRAYED = 0.2  # m by the told odometry
_TOLD_TURNED = 0.5  # rad by it


@cython.cclass
class _Track:
    """The path of one track, and the peers that it cannot be."""

    id: int
    still_x: float
    still_y: float
    still_since: float
    still_way: float
    claimant: str  # the peer whose path fitted last
    claimed_at: float  # s
    contested_at: float  # s, when the paths of two peers fitted last
    _places: Doubles  # a ring of times, x and y
    _count: int  # of all places since the first

    def __init__(self, id: int) -> None:
        self.id = id
        self._places = doubles(3 * _MEMORY)
        self.still_x = INFINITY
        self.claimant = ""
        self.contested_at = -INFINITY

    def claim(self, id: str, time: float) -> None:
        """Note that the path of the peer `id` fits that of the track."""
        if id != self.claimant and self.claimant != "" and time - self.claimed_at < _CONTESTED:
            self.contested_at = time
        self.claimant = id
        self.claimed_at = time

    def add(self, time: float, x: float, y: float, own_way: float) -> None:
        """Add a place. `own_way`: m that the own robot has travelled."""
        places = self._places
        i = 3 * (self._count % _MEMORY)
        places[i] = time
        places[i + 1] = x
        places[i + 2] = y
        self._count += 1
        if not length(x - self.still_x, y - self.still_y) <= _STILL:
            self.still_x = x
            self.still_y = y
            self.still_since = time
            self.still_way = own_way

    def is_other(self, peer: _Peer) -> bool:
        """True if the peer has moved while the track stood."""
        return peer.moved_since >= self.still_since

    def place_at(self, time: float) -> tuple[cython.double, cython.double, cython.bint]:
        """The place `x`, `y` at a time, and True; between two kept places it is interpolated.

        With False the nearest kept place: the track was not there any more, or not yet.
        """
        places = self._places
        newer = INFINITY
        newer_x = 0.0
        newer_y = 0.0
        for k in range(1, min(self._count, _MEMORY) + 1):
            i = 3 * ((self._count - k) % _MEMORY)
            at = places[i]
            x = places[i + 1]
            y = places[i + 2]
            if at <= time:
                if newer < INFINITY:
                    share = (time - at) / (newer - at)
                    x += share * (newer_x - x)
                    y += share * (newer_y - y)
                is_there = newer < INFINITY or time - at <= _MOST_AHEAD
                return x, y, is_there
            newer = at
            newer_x = x
            newer_y = y
        is_there = False
        return newer_x, newer_y, is_there


@cython.cclass
class _Peer:
    """What is known of one peer. `x`, `y`, `yaw`: what `expect` has found."""

    id: str
    x: float
    y: float
    yaw: float
    resets: int
    stamp: float  # s on the clock of the peer
    delay: float  # s, the least of arrival less stamp: between both clocks
    heard_at: float  # s, of the last message
    time: float  # s, of the pose in it
    compared_at: float  # s, of the last pose that was compared
    told_x: float
    told_y: float
    told_yaw: float
    ahead: float  # m/s, between the last two messages
    left: float
    turn: float  # rad/s
    # Where the peer was when it began the way that it now goes, and when; it has gone such a way in
    # the time from `moved_since` to the newest message.
    began_x: float
    began_y: float
    began_at: float
    moved_since: float
    # The own pose at the time of the newest message.
    own_x: float
    own_y: float
    own_yaw: float
    hypotheses: list[Hypothesis]
    best: Hypothesis | None  # the confirmed pose
    since: float  # s, when it was confirmed
    track: _Track | None  # that shows the peer in the last scan
    row: int  # of the neighbors that `complete` took last
    known: Neighbor | None  # what stood there
    is_plain: bool  # without a place of its own: distance, bearing and heading are None
    in_reach: bool  # of `known`
    fit: SightFit | None  # None until the peer moves
    # While it tells that its base has the command zero: since when on its clock, the track that
    # showed it then, the told pose and the place of this track once it has settled, and `strayed`,
    # m that it moved, last at `strayed_at`.
    stands_since: float  # ms
    stood_at: float  # s
    stood_x: float
    stood_y: float
    stood_yaw: float
    has_stood: bool
    stood_track: _Track | None
    track_x: float
    track_y: float
    own_turned: float  # rad that the own robot had turned then
    strayed_at: float
    strayed: float
    message: KinMessage | None  # the last one, if it tells of others

    def __init__(self, id: str) -> None:
        self.id = id
        self.resets = -1
        self.hypotheses = []
        self.stamp = -INFINITY
        self.heard_at = -INFINITY
        self.time = -INFINITY
        self.began_at = -INFINITY
        self.compared_at = -INFINITY
        self.delay = INFINITY
        self.stands_since = INFINITY
        self.strayed_at = -INFINITY

    def forget_stand(self) -> None:
        """Forget where the peer stood."""
        self.stands_since = INFINITY
        self.has_stood = False
        self.stood_track = None
        self.strayed_at = -INFINITY
        self.strayed = 0.0

    def stray(self, way: float) -> None:
        """Note that it has moved by `way` m while it stood."""
        self.strayed = max(self.strayed, way)
        self.strayed_at = self.time

    def forget_doubts(self) -> None:
        """Forget all that depends on the frame of an odometry."""
        self.fit = None
        self.forget_stand()

    def confirmed(self, now: float) -> Hypothesis | None:
        """The pose that is confirmed of a peer that is not silent."""
        return self.best if now - self.heard_at <= _SILENCE else None

    def time_of(self, stamp: float, now: float) -> float:
        """When the pose of a message was measured.

        The delay of messages varies: of all clock differences the least counts.
        """
        delay = now - stamp
        if not fabs(delay - self.delay) < _MOST_GAP:  # the first, or a clock was set
            self.delay = delay
        else:
            self.delay += _DELAY_FORGOTTEN * max(now - self.heard_at, 0.0)
        self.delay = min(self.delay, delay)
        return stamp + self.delay

    def follow(self) -> None:
        """Note that the peer has moved, once it has gone a way of _CLEARED; then begin another."""
        way = length(self.told_x - self.began_x, self.told_y - self.began_y)
        if self.began_at == -INFINITY or way > _CLEARED:
            self.moved_since = self.began_at
            self.began_at = self.time
            self.began_x = self.told_x
            self.began_y = self.told_y

    def seconds_ahead(self, now: float) -> float:
        """The s from the newest message for which the pose moves on at the told speed."""
        return min(max(now - self.time, 0.0), _MOST_AHEAD)

    def expect(self, pose: Hypothesis, now: float) -> None:
        """Set the pose to that of a hypothesis, moved on at the told speed."""
        seconds = self.seconds_ahead(now)
        c = cos(pose.yaw + 0.5 * self.turn * seconds)
        s = sin(pose.yaw + 0.5 * self.turn * seconds)
        self.x = pose.x + (c * self.ahead - s * self.left) * seconds
        self.y = pose.y + (s * self.ahead + c * self.left) * seconds
        self.yaw = pose.yaw + self.turn * seconds


@cython.cclass
class Kin:
    """Names the tracks of one robot. `_x`, `_y`, `_yaw`: the pose that `_set_own` has set."""

    _middle: float
    _is_partial: bool
    _radius: float
    _resets: int
    _trail: OdometryTrail
    _shift: float  # s, of the odometry's clock less the robot's
    _x: float
    _y: float
    _yaw: float
    _last_x: float  # the own middle at the last scan
    _last_y: float
    _last_yaw: float
    _way: float  # m that it has travelled
    _turned: float  # rad that it has turned, to either side
    _tracks: list[_Track]
    _scan: Scan | None  # the last scan if `_free` is not made of it yet
    _seen_at: float  # s, of the last scan
    _free: Doubles  # of each direction from -pi on, m to the nearest return
    _peers: dict[str, _Peer]
    _heard: list[_Peer]  # the same peers in the same order, which loops read faster
    _forgot_at: float  # s, when silent peers were forgotten last
    _told_at: float  # s, of the last message, and the pose in it
    _told_x: float
    _told_y: float
    _told_yaw: float
    # Points: of tracks at the time of a message, and of the objects in it, seen from the peer.
    _places: Doubles
    _objects: Doubles
    _stands_since: float  # s, of the own base
    _judged_at: float  # s, of the last `opinions`
    _has_told: bool  # they were not None
    _doubted: tuple[str, ...]  # as of then, for the own messages
    _straying: tuple[str, ...]
    _fitting: int

    def __init__(
        self, middle: float = 0.0, resets: int = 0, is_partial: bool = False, radius: float = 0.0
    ) -> None:
        """`middle`: m by which the middle of what others see lies ahead of the axle.

        `resets`: the first number that marks the frame of the odometry; another one in each life.
        `is_partial`: the lidar leaves out directions. `radius`: m, of a circle around the axle that
        contains the robot.
        """
        self._middle = middle
        self._is_partial = is_partial
        self._radius = radius
        self._resets = resets
        self._trail = OdometryTrail()
        self._tracks = []
        self._peers = {}
        self._heard = []
        self._seen_at = -INFINITY
        self._told_at = -INFINITY
        self._free = doubles(_SECTORS)
        self._places = doubles(POINT * _MOST_TRACKS)
        self._objects = doubles(POINT * _most_objects)
        self._stands_since = INFINITY
        self._judged_at = -INFINITY
        self._doubted = ()
        self._straying = ()

    def on_odometry(self, odometry: Odometry, now: float) -> None:
        """Take in an own reading, ten a second. A jump moves the frame: all is forgotten."""
        if 0.0 < odometry.stamp - self._trail.latest < _READING_PERIOD:
            return
        taken = self._trail.take(odometry)
        if taken != NEXT and taken != ANEW:
            return
        peer: _Peer
        if taken == ANEW:
            self._resets += 1
            self._tracks = []
            for peer in self._heard:
                peer.hypotheses = []
                peer.best = None
                peer.forget_doubts()
        self._shift = odometry.stamp - now

    def observe(self, tracks: Iterable[Any], scan: Scan, now: float) -> None:
        """Take in a scan, and the tracks after it: `id`, `x` and `y` in the base frame at `now`."""
        if self._trail.count == 0:
            return
        self._set_own(now)
        self._way += length(self._x - self._last_x, self._y - self._last_y)
        self._turned += angle_between(self._yaw, self._last_yaw)
        self._last_x = self._x
        self._last_y = self._y
        self._last_yaw = self._yaw
        c = cos(self._yaw)
        s = sin(self._yaw)
        known = self._tracks
        self._tracks = []
        track: _Track
        for seen in tracks:
            if len(self._tracks) == _MOST_TRACKS:
                break
            id = seen.id
            for track in known:
                if track.id == id:
                    break
            else:
                track = _Track(id)
            x = seen.x
            y = seen.y
            x -= self._middle
            track.add(now, self._x + c * x - s * y, self._y + s * x + c * y, self._way)
            self._tracks.append(track)
        self._seen_at = now
        self._scan = scan
        self._match(now)

    def _is_free(self, bearing: float, distance: float) -> bool:
        """True if the rays of the last scan in a direction are longer than a distance.

        `distance`: at most _LONGEST m.
        """
        self._find_free()
        return self._free[_sector_of(bearing)] > distance

    def _has_room(self) -> bool:
        """True if no return is so near that lidars may see both as one wide object."""
        self._find_free()
        free = self._free
        least = self._radius + _ROOM
        for i in range(_SECTORS):  # noqa: SIM110  # Cython makes no loop of C of a generator
            if 0.0 < free[i] < least:
                return False
        return True

    def _find_free(self) -> None:
        """Find how far the rays of the last scan are free, once for each scan."""
        free = self._free
        if self._scan is not None:
            ranges: Doubles = view(self._scan.ranges)
            bearings: Doubles = view(self._scan.bearings)
            self._scan = None
            for i in range(_SECTORS):
                free[i] = INFINITY
            sector = 0
            least = INFINITY  # bearings from here on, and below `most`, are in it
            most = -INFINITY
            for i in range(len(ranges)):
                distance_of_ray = ranges[i]
                if distance_of_ray > _LONGEST:
                    continue
                ray = bearings[i]
                if not least <= ray < most:
                    sector = _sector_of(ray)
                    # Of a bearing beyond half a turn the next may be in another sector.
                    least = ray if fabs(ray) < PI else INFINITY
                    most = (sector + 1) * (TURN / _SECTORS) - PI - _EDGE
                if not distance_of_ray >= free[sector]:
                    # Nothing is known of the direction of a ray without a number.
                    free[sector] = 0.0 if isnan(distance_of_ray) else distance_of_ray

    def next_message(self, now: float, asks: bool, stands: bool) -> KinMessage | None:
        """The message of this robot, after `observe`; None if it is not due yet.

        `asks`: this robot runs a pattern that needs the places of its peers. `stands`: its base has
        the command zero.
        """
        if not stands:
            self._stands_since = INFINITY
        elif self._stands_since == INFINITY:
            self._stands_since = now
        if self._trail.count == 0:
            return None
        self._set_own(now)
        if not fabs(self._x) + fabs(self._y) + fabs(self._yaw) < _MOST_NUMBER:
            return None
        moved = length(self._x - self._told_x, self._y - self._told_y)
        moved += angle_between(self._yaw, self._told_yaw)
        period = _MOVING_PERIOD if moved > _MOVED else _RESTING_PERIOD
        if now - self._told_at < period - _EARLY:
            return None
        self._told_at = now
        self._told_x = self._x
        self._told_y = self._y
        self._told_yaw = self._yaw
        points = self._places
        count = 0
        track: _Track
        for track in self._tracks:
            x, y, _ = track.place_at(now)
            dx = x - self._x
            dy = y - self._y
            points[count] = length(dx, dy)
            points[count + 1] = wrap(atan2(dy, dx) - self._yaw)
            count += 2
        most = min(count // 2, _most_objects)
        objects = bytearray(_object_size * most)
        for n in range(most):
            k = 0
            for i in range(2, count, 2):
                if points[i] < points[k]:
                    k = i
            # As OBJECT packs them, which takes five times as long.
            distance = min(_units(points[k]), 0xFFFF)
            bearing = _units(points[k + 1])
            start = _object_size * n
            objects[start] = distance >> 8
            objects[start + 1] = distance & 0xFF
            objects[start + 2] = (bearing >> 8) & 0xFF
            objects[start + 3] = bearing & 0xFF
            points[k] = INFINITY
        return _KinMessage(
            self._resets,
            _units(now),
            _units(self._x),
            _units(self._y),
            _units(wrap(self._yaw)),
            bytes(objects),
            asks != 0,
            _units(now) - _units(self._stands_since) if stands else 0,
            self._doubted,
            self._straying,
            self._fitting,
            self._is_partial != 0,
        )

    def on_message(self, id: str, message: KinMessage, now: float) -> None:
        """Take in the message of the peer `id`."""
        if self._trail.count == 0:
            return
        peer: _Peer | None = self._peers.get(id)
        if peer is None:
            if len(self._peers) >= _MOST_PEERS and now - self._forgot_at > 1.0:
                self._forget_silent(now)
            if len(self._peers) >= _MOST_PEERS:
                return
            peer = _Peer(id)
            self._peers[id] = peer
            self._heard.append(peer)
        # Of a crowd each peer is compared less often, so that kin takes no longer.
        period = _COMPARED * max(1.0, len(self._peers) / _FEW)
        # Only comparisons use the poses of a peer if none is confirmed.
        if now - peer.heard_at < period and peer.best is None:
            return
        # All fields in one call, which takes as long as two of them each by itself. Integers of
        # Python become doubles six times faster by way of integers of C.
        fields = astuple(message)
        resets, told_stamp, told_x, told_y, told_yaw, told_objects, _, told_stood, *others = fields
        *doubts, partial = others
        stamp_ms = told_stamp
        x_mm = told_x
        y_mm = told_y
        yaw_mrad = told_yaw
        stood_ms = told_stood
        stamp = stamp_ms * _unit
        x = x_mm * _unit
        y = y_mm * _unit
        yaw = yaw_mrad * _unit
        gap = stamp - peer.stamp
        if -_MOST_GAP < gap <= 0.0:  # late, or twice
            return
        time = peer.time_of(stamp, now)
        self._set_own(time)
        dx = x - peer.told_x
        dy = y - peer.told_y
        turn = wrap(yaw - peer.told_yaw)
        if resets == peer.resets and 0.0 < gap < _SILENCE and not is_jump(dx, dy, turn, gap):
            c = cos(peer.told_yaw)
            s = sin(peer.told_yaw)
            ahead = c * dx + s * dy
            left = c * dy - s * dx
            self._move(peer, ahead, left, turn)
            peer.ahead = ahead / gap
            peer.left = left / gap
            peer.turn = turn / gap
        else:
            peer.hypotheses = []
            peer.best = None
            peer.ahead = 0.0
            peer.left = 0.0
            peer.turn = 0.0
            peer.began_at = -INFINITY
            peer.forget_doubts()
        peer.resets = resets
        peer.stamp = stamp
        peer.heard_at = now
        peer.time = time
        peer.told_x = x
        peer.told_y = y
        peer.told_yaw = yaw
        peer.own_x = self._x
        peer.own_y = self._y
        peer.own_yaw = self._yaw
        peer.follow()
        gap = time - peer.compared_at
        if gap >= period - _EARLY:
            self._compare(told_objects, peer, min(gap, _MOST_GAP), partial)
            peer.compared_at = time
        peer.message = message if any(doubts) else None
        if stood_ms > 0:
            self._watch_stand(peer, stamp_ms - stood_ms, stood_ms * _unit)
        else:
            peer.forget_stand()

    @staticmethod
    def on_message_many(kins: list[Kin], id: str, message: KinMessage, now: float) -> None:
        """Hand the message of a peer to each of the robots that hear it at one time."""
        kin: Kin
        for kin in kins:
            kin.on_message(id, message, now)

    def names(self, now: float) -> dict[int, str | None]:
        """The name of each track: the id of a peer, NO_ROBOT, or None if it is not known."""
        named: dict[int, str] = {}
        peer: _Peer
        for peer in self._heard:
            if peer.track is not None and peer.best is not None:
                named[peer.track.id] = peer.id
        track: _Track
        found: dict[int, str | None] = {}
        for track in self._tracks:
            found[track.id] = named.get(track.id) or (
                NO_ROBOT if self._stands(track, now) else None
            )
        return found

    def complete(self, neighbors: tuple[Neighbor, ...], now: float) -> tuple[Neighbor, ...]:
        """The neighbors; those whose pose is confirmed with what is not known of them otherwise.

        Distance and bearing are from the own axle to the visible middle of the peer. `age`: s since
        a scan last showed it. `error`: two standard deviations of the place. No call changes what
        another gives: viewers ask at any time, which no recording has.
        """
        self._trail.set_pose(now + self._shift)
        completed: list[Neighbor] = list(neighbors)
        count = len(completed)
        peer: _Peer
        for peer in self._heard:
            best: Hypothesis | None = peer.confirmed(now)
            if best is None:
                continue
            if peer.row >= count or completed[peer.row] is not peer.known:
                self._find_row(peer, completed)
            if peer.row < count:
                completed[peer.row] = self._completed(completed[peer.row], peer, best, now)
        return tuple(completed)

    def _find_row(self, peer: _Peer, neighbors: list[Neighbor]) -> None:
        """Find a peer among the neighbors; mostly the same neighbor is asked for many times."""
        count = len(neighbors)
        if peer.row >= count or neighbors[peer.row].id != peer.id:
            ids = [one.id for one in neighbors]
            peer.row = ids.index(peer.id) if peer.id in ids else count
        if peer.row < count:
            known = neighbors[peer.row]
            peer.known = known
            peer.in_reach = known.in_reach
            peer.is_plain = (
                known.distance is None and known.bearing is None and known.heading is None
            )

    def _completed(self, known: Neighbor, peer: _Peer, best: Hypothesis, now: float) -> Neighbor:
        seen_at = best.seen_at
        yaw = best.yaw + peer.turn * peer.seconds_ahead(now)
        track: _Track | None = peer.track
        is_there = False
        if track is not None:
            peer.x, peer.y, is_there = track.place_at(self._seen_at)
        if is_there:
            seen_at = self._seen_at
        else:
            peer.expect(best, now)
        dx = peer.x - self._trail.x
        dy = peer.y - self._trail.y
        bearing = None if peer.is_plain else known.bearing
        heading = None if peer.is_plain else known.heading
        if bearing is None:
            bearing = wrap(atan2(dy, dx) - self._trail.yaw)
        if heading is None:
            heading = wrap(yaw - self._trail.yaw)
        if not peer.is_plain and known.distance is not None:
            return replace(known, bearing=bearing, heading=heading)
        age = max(now - seen_at, 0.0)
        error = 2.0 * best.sd()
        return _Neighbor(peer.id, age, length(dx, dy), bearing, heading, peer.in_reach, error)

    def _set_own(self, time: float) -> None:
        """Set the pose of the own visible middle at a time."""
        trail: OdometryTrail = self._trail
        trail.set_pose(time + self._shift)
        self._x = trail.x + self._middle * cos(trail.yaw)
        self._y = trail.y + self._middle * sin(trail.yaw)
        self._yaw = trail.yaw

    def _forget_silent(self, now: float) -> None:
        self._forgot_at = now
        peer: _Peer
        heard = self._heard
        self._heard = []
        for peer in heard:
            if now - peer.heard_at > _SILENCE:
                del self._peers[peer.id]
            else:
                self._heard.append(peer)

    def _move(self, peer: _Peer, ahead: float, left: float, turn: float) -> None:
        """Move the poses of a peer by what it tells, and widen them by the own motion."""
        own_way = length(self._x - peer.own_x, self._y - peer.own_y)
        own_turn = angle_between(self._yaw, peer.own_yaw)
        one: Hypothesis
        for one in peer.hypotheses:
            one.move(ahead, left, turn)
            one.drift(own_way, own_turn, length(one.x - self._x, one.y - self._y))

    def _compare(self, packed: bytes, peer: _Peer, gap: float, is_partial: bool) -> None:
        """Compare the poses of a peer with the tracks, and with what it tells; begin new poses.

        `packed`: the objects of the message. `is_partial`: as in it.
        """
        places = self._places
        objects = self._objects
        track: _Track
        one: Hypothesis
        i = 0
        k = 0
        for track in self._tracks:
            if track.is_other(peer):
                continue
            x, y, is_there = track.place_at(peer.time)
            if is_there:
                places[i] = x
                places[i + 1] = y
                places[i + 2] = length(x - self._x, y - self._y)
                i += POINT
        for n in range(len(packed) // _object_size):
            # As OBJECT unpacks them, which takes five times as long.
            m = _object_size * n
            distance_mm = (packed[m] << 8) + packed[m + 1]
            bearing_mrad = (packed[m + 2] << 8) + packed[m + 3]
            if bearing_mrad >= _HIGHEST:
                bearing_mrad -= 2 * _HIGHEST
            distance = _unit * distance_mm
            bearing = _unit * bearing_mrad
            objects[k] = distance * cos(bearing)
            objects[k + 1] = distance * sin(bearing)
            objects[k + 2] = distance
            k += POINT
        count = i // POINT
        told_count = k // POINT
        for one in peer.hypotheses:
            self._judge(one, peer, gap, count, told_count)
        is_sure = peer.best is not None and peer.best.score > _SURE
        for n in range(0 if is_sure else count):
            i = POINT * n
            for m in range(told_count):
                k = POINT * m
                if fabs(objects[k + 2] - places[i + 2]) <= _SAME_DISTANCE:
                    to_own = atan2(self._y - places[i + 1], self._x - places[i])
                    yaw = to_own - atan2(objects[k + 1], objects[k])
                    self._begin(peer, places[i], places[i + 1], yaw, max(places[i + 2], 0.3))
        self._rank(peer)
        self._agree(peer, gap, told_count)
        # Of more objects, or of a lidar that leaves out directions, the own robot may be none.
        if told_count < _most_objects and not is_partial:
            self._look(peer, told_count)

    def _look(self, peer: _Peer, told_count: int) -> None:
        """Compare what a peer tells to see with where its path shows it.

        A peer that `_match` has named is its track. Any other is the only track that its path fits,
        and no path of another peer may have fitted this track: two that go in step are not judged.
        """
        fit: SightFit | None = peer.fit
        if fit is None:
            fit = SightFit()
            peer.fit = fit
        if not fit.begin_mark(peer.time, peer.told_x, peer.told_y):
            return
        track: _Track
        for track in self._tracks:
            x, y, is_there = track.place_at(peer.time)
            if is_there:
                fit.add(track.id, x, y)
        found: _Track | None = None
        least = INFINITY
        second = INFINITY
        for track in self._tracks:
            if track is not peer.track and (peer.track is not None or self._is_taken(track)):
                continue
            rest = fit.fit(track.id, peer.told_yaw)
            if rest < _PATH_MAY_FIT:
                track.claim(peer.id, peer.time)
            if rest < least:
                second = least
                least = rest
                found = track
            else:
                second = min(second, rest)
        if found is None or least >= _PATH_FITS or second < _PATH_MAY_FIT:
            return
        if found is not peer.track and peer.time - found.contested_at < _CONTESTED:
            return
        fit.fit(found.id, peer.told_yaw)
        if not self._has_room():  # another lidar need not see this robot by itself
            return
        fit.look(self._x, self._y, self._objects, told_count, peer.time)

    def _is_taken(self, track: _Track) -> bool:
        """True if a track shows a peer that is named."""
        peer: _Peer
        is_taken = False
        for peer in self._heard:
            is_taken = is_taken or peer.track is track
        return is_taken

    def _watch_stand(self, peer: _Peer, since: float, stood: float) -> None:
        """Find out whether a peer moves while its base has the command zero, after a message.

        `since`: ms on the clock of the peer. `stood`: s.
        """
        time = peer.time
        if since != peer.stands_since:
            peer.forget_stand()
            peer.stands_since = since
            peer.stood_track = peer.track  # its pose may be lost as it moves
        if stood < _SETTLED:
            return
        if not peer.has_stood or time - peer.stood_at > _ANCHORED:
            # What stands drifts away in the frame of the own odometry, so it is compared anew.
            peer.stood_at = time
            if peer.track is not None:
                peer.stood_track = peer.track
            elif peer.has_stood:
                self._drop_moved(peer)
            peer.has_stood = True
            peer.stood_x = peer.told_x
            peer.stood_y = peer.told_y
            peer.stood_yaw = peer.told_yaw
            peer.own_turned = self._turned
            if peer.stood_track is not None:
                peer.track_x, peer.track_y, is_there = peer.stood_track.place_at(time)
                if not is_there:
                    peer.stood_track = None
            return
        told = length(peer.told_x - peer.stood_x, peer.told_y - peer.stood_y)
        turned = angle_between(peer.told_yaw, peer.stood_yaw)
        if told > _TOLD_STRAYED or turned > _TOLD_TURNED:
            peer.stray(told)
        track: _Track | None = peer.stood_track
        if track is None:
            return
        x, y, is_there = track.place_at(time)
        seen = length(x - peer.track_x, y - peer.track_y)
        dx = peer.track_x - self._x
        dy = peer.track_y - self._y
        distance = length(dx, dy)
        # The own odometry errs in turns, which moves what is far away.
        most = _STRAYED + _TURN_ERROR * (self._turned - peer.own_turned) * distance
        # A track may pass from a robot that stands to one that drives by: then the place shows it.
        if (
            is_there
            and seen > most
            and distance < _FREE_REACH
            and self._is_free(atan2(dy, dx) - self._yaw, distance + _SEEN_MOST)
        ):
            peer.stray(seen)

    def _drop_moved(self, peer: _Peer) -> None:
        """Forget the track of a peer that stands if it may have passed to another robot."""
        track: _Track | None = peer.stood_track
        if track is not None:
            x, y, is_there = track.place_at(peer.time)
            if not is_there or length(x - peer.track_x, y - peer.track_y) > _STILL:
                peer.stood_track = None

    def opinions(self, missed_by: Set[str], now: float) -> KinOpinions | None:
        """What this robot and its peers tell of others; None: it is no time, or nothing is told.

        `missed_by`: the peers whose lidar may miss this robot, which need not tell it.
        """
        if now - self._judged_at < _JUDGED:
            return None
        self._judged_at = now
        doubted: dict[str, str] = {}
        straying: dict[str, str] = {}
        fitting: set[str] = set()
        told: dict[str, KinMessage] = {}
        is_told = False
        peer: _Peer
        for peer in self._heard:
            if now - peer.heard_at > _SILENCE:
                continue
            if peer.message is not None:
                told[peer.id] = peer.message
                is_told = is_told or bool(peer.message.doubted) or bool(peer.message.straying)
            if now - peer.strayed_at <= _STRAY_KEPT:
                straying[peer.id] = f"moved by {peer.strayed:.2f} m"
            if peer.fit is None or peer.id in missed_by:
                continue
            fit: SightFit = peer.fit
            opinion = fit.opinion(now)
            if opinion == FITS:
                fitting.add(peer.id)
            elif opinion == MISFITS:
                doubted[peer.id] = fit.text()
        self._doubted = tuple(list(doubted)[:_most_names])
        self._straying = tuple(list(straying)[:_most_names])
        self._fitting = len(fitting)
        has_told = self._has_told
        self._has_told = is_told or bool(doubted) or bool(straying)
        if not (has_told or self._has_told):
            return None
        return _KinOpinions(doubted, straying, frozenset(fitting), told)

    def _judge(self, one: Hypothesis, peer: _Peer, gap: float, count: int, told_count: int) -> None:
        """Raise or lower the score of a pose by what both robots see."""
        dx = one.x - self._x
        dy = one.y - self._y
        distance = length(dx, dy)
        is_news = one.sights.is_news(peer.told_x, peer.told_y)
        is_lost = one.sd() > _LOST
        if not one.see(self._places, count, distance, is_news):
            # The rays of the last scan cross the place of the pose.
            is_empty = distance < _FREE_REACH and self._is_free(
                atan2(dy, dx) - self._yaw, distance + _SEEN_MOST
            )
            one.score -= gap * (_EMPTY if is_empty else _FADE)
            return
        if is_lost:
            if one is peer.best:
                peer.best = None
            one.prove(peer.told_x, peer.told_y, self._x, self._y)
        one.seen_at = peer.time
        if is_news:
            one.sights.add(peer.told_x, peer.told_y)
        is_news = one.mutual.is_news(self._x, self._y)
        if not one.be_seen(self._objects, told_count, self._x, self._y, is_news):
            one.score -= gap * (_UNSEEN if distance < _REACH else _FADE)
        elif is_news:
            one.mutual.add(self._x, self._y)

    def _begin(self, peer: _Peer, x: float, y: float, yaw: float, distance: float) -> None:
        """Begin a pose by mutual sight, unless it is known, or all that are known are better."""
        one: Hypothesis
        for one in peer.hypotheses:
            if one.is_like(x, y, yaw, 1.0):
                return
        if len(peer.hypotheses) >= _MOST_HYPOTHESES:
            worst: Hypothesis = peer.hypotheses[0]
            for one in peer.hypotheses:
                if one.score < worst.score:
                    worst = one
            if worst.score >= 0.0:
                return
            peer.hypotheses.remove(worst)
        one = begun(x, y, yaw, _FIRST_SD, _FIRST_SD / distance)
        one.prove(peer.told_x, peer.told_y, self._x, self._y)
        peer.hypotheses.append(one)

    def _rank(self, peer: _Peer) -> None:
        """Drop bad and double poses, and confirm the best if it is sure."""
        if not peer.hypotheses:
            return
        one: Hypothesis
        best: Hypothesis = peer.hypotheses[0]
        for one in peer.hypotheses:
            if one.score > best.score:
                best = one
        second = -INFINITY
        is_sure = best is peer.best and best.score > _SURE
        least = best.score - _SURE if is_sure else _DROPPED
        kept: list[Hypothesis] = []
        for one in peer.hypotheses:
            if one is not best:
                if one.score <= least or one.is_like(best.x, best.y, best.yaw, 0.5):
                    continue
                second = max(second, one.score)
            kept.append(one)
        peer.hypotheses = kept if best.score > _DROPPED else []
        if best is not peer.best:
            peer.best = None
        if best.score < 0.5 * _CONFIRMED or best.score - second < _UNSURE:
            peer.best = None
        elif (
            peer.best is None
            and best.score >= _CONFIRMED
            and best.score - second >= _MARGIN
            and min(best.sights.count, best.mutual.count) >= _LEAST_NEWS
            and min(best.sights.extent, best.mutual.extent) >= _LEAST_EXTENT
        ):
            peer.best = best
            peer.since = peer.time

    def _agree(self, peer: _Peer, gap: float, told_count: int) -> None:
        """Lower the pose of a peer that does not tell a third robot which it must see.

        Of the two poses the worse may be wrong. A peer lowers its own pose alone, and the third
        robot does the same by its messages: so a liar lowers no other.
        """
        best: Hypothesis | None = peer.best
        if best is None or told_count == _most_objects:
            return
        c = cos(best.yaw)
        s = sin(best.yaw)
        other: _Peer
        for other in self._heard:
            third: Hypothesis | None = other.confirmed(peer.heard_at)
            if other is peer or third is None or third.score < best.score:
                continue
            if peer.heard_at - other.heard_at > _MOST_GAP:  # it may be elsewhere by now
                continue
            other.expect(third, peer.time)
            dx = other.x - best.x
            dy = other.y - best.y
            ahead = c * dx + s * dy
            left = c * dy - s * dx
            # Two that are nearer claim one object: their messages need not tell each other.
            is_due = _ELSEWHERE <= length(dx, dy) < _AGREED
            if is_due and not self._is_told(ahead, left, told_count):
                best.score -= gap * _UNSEEN

    def _is_told(self, ahead: float, left: float, told_count: int) -> bool:
        """True if an object of the last message is at a place or hides it."""
        objects = self._objects
        for k in range(told_count):
            i = POINT * k
            if length(objects[i] - ahead, objects[i + 1] - left) < _ELSEWHERE:
                return True
            turn = angle_between(atan2(objects[i + 1], objects[i]), atan2(left, ahead))
            if objects[i + 2] < length(ahead, left) and turn < _TURNED:
                return True
        return False

    def _match(self, now: float) -> None:
        """Set the track of each peer that the last scan shows."""
        claims: list[tuple[float, str, int, _Peer, _Track]] = []
        peer: _Peer
        other: _Peer
        track: _Track
        for peer in self._heard:
            peer.track = None
            best: Hypothesis | None = peer.confirmed(now)
            if best is None:
                continue
            peer.expect(best, now)
            for track in self._tracks:
                x, y, _ = track.place_at(self._seen_at)
                far = best.fits(x - peer.x, y - peer.y)
                if far < INFINITY and not track.is_other(peer):
                    claims.append((far, peer.id, track.id, peer, track))
        claims.sort()
        taken: dict[int, _Peer] = {}
        for _, _, number, peer, track in claims:
            if peer.track is None and number not in taken:
                peer.track = track
                taken[number] = peer
        for _, _, number, peer, track in claims:  # a peer without a track contests another's
            other = taken.get(number, peer)
            if peer.track is None and other is not peer:
                later = peer.since - other.since
                if later < _EARLIER:
                    other.track = None
                if later < -_EARLIER:
                    peer.track = track
                    taken[number] = peer

    def _stands(self, track: _Track, now: float) -> bool:
        """True if a track stands while the own robot moves, and no peer can be there."""
        if now - track.still_since < _STILL_TIME or self._way - track.still_way < _OWN_WAY:
            return False
        peer: _Peer
        for peer in self._heard:
            best: Hypothesis | None = peer.confirmed(now)
            if best is not None:
                peer.expect(best, now)
                if length(peer.x - track.still_x, peer.y - track.still_y) < _ELSEWHERE:
                    return False
            elif now - peer.heard_at <= _SILENCE and not track.is_other(peer):
                return False
        return True


def _sector_of(bearing: float) -> int:
    """The number of a direction."""
    sector = (wrap(bearing) / TURN + 0.5) * _SECTORS
    return cython.cast(cython.Py_ssize_t, min(_SECTORS - 0.5, sector))  # also of NaN


def _units(number: float) -> int:
    """A number of m, rad or s as in a message; 0 if it is too great, or none."""
    is_small = fabs(number) < _MOST_NUMBER
    return cython.cast(cython.longlong, rint((number if is_small else 0.0) / _unit))
