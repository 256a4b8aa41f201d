"""Kin: which tracked object is which peer, from the scans and the odometry of robots alone. Pure.

Robots tell each other their odometry and the narrow objects that they see (`core/told.py`). For
each peer there are up to _MOST_HYPOTHESES poses in the frame of the own odometry (`hypothesis.py`):

1. *Mutual sight* begins one: the peer tells an object at the distance at which the own robot tracks
   one. Both bearings give the yaw between the frames. (Mutual localisation by range and bearing
   without identities: Franchi, Oriolo, Stegagno, IJRR 32(11), 2013.)
2. *Paths* begin one: the told path, moved rigidly, lies on the path of a track (`path_fit.py`).
3. Each message moves all poses of its sender by the told motion, and compares them with the tracks,
   and with what the peer tells. What fits after motion raises the score, a place that rays cross
   lowers it, and so does a peer that should see the own robot and does not.
4. The best pose of a peer is *confirmed* once its score is high enough, it has been fitted in both
   ways or by a path with bends, and no other pose of the peer is nearly as good.
5. A track where a confirmed pose expects the peer is that peer. A track has one peer, a peer one
   track. If two peers fit a track, the peer that was confirmed first keeps it; peers confirmed at
   much the same time make it unknown.
6. A track that stands while the own robot moves is no robot if no peer that was heard can be there:
   the peer has moved meanwhile, or its confirmed pose is elsewhere.

What a peer tells moves the poses of this peer alone, so a liar names at most itself.

The source of the objects is `Tracker` (`swarmd/steering/tracks.py`) and not the clusters of a scan:
its tracks have an identity over time, which the fit of paths needs, they reach further than
clusters that no nearer object hides, and steering computes them anyway.

Frames: the frame of the own odometry, unless a name says another. Times: s on the robot's clock.
Units: m, rad.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from swarmd.core.kernels import load_kernel
from swarmd.core.odometry_trail import ANEW, NEXT
from swarmd.core.told import MOST_OBJECTS, UNIT, Told, tell
from swarmd.core.values import MAX_SPEED, MAX_STEP, Neighbor, Odometry, Pose, Scan
from swarmd.kin.hypothesis import Hypothesis, wrapped
from swarmd.kin.path_fit import PathFit

NO_ROBOT = ""
"""The name of a track that is no robot. None: unknown."""
_SECTORS = 72  # directions, of each of which it is known how far the rays of a scan are free
MOST_PEERS = 24
MOST_TRACKS = 24
_MOST_HYPOTHESES = 8  # of one peer
_MEMORY = 16  # places of a track that are kept: 3 s at 5 Hz
_MOST_GAP = 1.5  # s between two messages, or two scans, between which a place is interpolated
_MOST_AHEAD = 0.4  # s for which a place is extrapolated
_SILENCE = 10.0  # s after which a silent peer is forgotten
MOVING_PERIOD, RESTING_PERIOD = 0.2, 1.0  # s between two messages
_EARLY = 0.05  # s by which a scan may come early
_MOVED = 0.01  # m and rad that are a motion
_AHEAD_MEMORY = 0.01  # s/s by which the least delay of messages is forgotten
# Beginning of a pose.
_SAME_DISTANCE = 0.10  # m between both measured distances of a mutual sight
_FIRST_SD = 0.07  # m
_LEAST_PAIRS = 8.0
_LEAST_SPREAD = 0.25  # m, of a path that is fitted
_MOST_RESIDUAL = 0.05  # m
_OTHER_PATH = 0.12  # m, a residual above which a track is not the peer
_NEAR, _TURNED = 0.3, 0.4  # m, rad: poses that differ less are one
# Scores.
_PATH_SCORE = 2.0  # with which a pose by path begins
_EMPTY = 1.0  # for a message at which rays cross the place of the peer
_UNSEEN = 1.0  # for a message in which the peer does not tell the own robot
_DROPPED = -3.0  # score of a pose that is dropped
_CONFIRMED = 7.0
_MARGIN = 4.0  # to the next pose of the peer
_UNSURE = 1.0  # margin below which a confirmed pose is none any more
_LEAST_NEWS = 3  # sights, and mutual sights, that a confirmed pose counts
_LOST = 0.15  # m, standard deviation beyond which a peer that comes back may be another object
_LEAST_EXTENT = 0.4  # m over which both robots have moved meanwhile
_FADE = 0.2  # 1/s, while nothing shows the peer
_REACH = 2.2  # m within which an object that is not hidden is surely tracked
_FREE_REACH = 3.2  # m within which a ray without a return is free
_SEEN_MOST = 0.25  # m by which a ray must pass a place to have crossed it
_AGREED = 1.8  # m within which a peer surely tells a third robot
_EARLIER = 2.0  # s by which a peer was confirmed earlier that keeps a track
# Standing tracks.
_STILL = 0.12  # m
_STILL_TIME = 2.0  # s
_OWN_WAY = 0.3  # m
_CLEARED = 0.35  # m by which a peer has moved that cannot be a track that stands
_ELSEWHERE = 0.5  # m


class _Track:
    """The path of one track, and the peers that it cannot be."""

    __slots__ = ("cleared", "fits", "places", "still_at", "still_since", "still_way", "told_at")

    def __init__(self) -> None:
        self.places: list[tuple[float, float, float]] = []  # time, x, y
        self.fits: dict[str, PathFit] = {}
        self.cleared: set[str] = set()  # peers that have moved while the track stood
        self.told_at: dict[str, tuple[float, float]] = {}  # where peers were when it came to stand
        self.still_at = (math.inf, math.inf)
        self.still_since = self.still_way = 0.0

    def add(self, time: float, x: float, y: float, own_way: float) -> None:
        """Add a place. `own_way`: m that the own robot has travelled."""
        self.places.append((time, x, y))
        del self.places[:-_MEMORY]
        if math.hypot(x - self.still_at[0], y - self.still_at[1]) > _STILL:
            self.still_at, self.still_since, self.still_way = (x, y), time, own_way
            self.cleared.clear()
            self.told_at.clear()

    def forget(self, peer: str) -> None:
        """Forget what was known of a peer."""
        self.fits.pop(peer, None)
        self.told_at.pop(peer, None)
        self.cleared.discard(peer)

    def at(self, time: float) -> tuple[float, float] | None:
        """The place at a time; None if the track was not there, or not yet."""
        later = self.places[-1]
        if time >= later[0]:
            return later[1:] if time - later[0] <= _MOST_AHEAD else None
        for earlier in reversed(self.places[:-1]):
            if earlier[0] <= time:
                share = (time - earlier[0]) / (later[0] - earlier[0])
                x, y = later[1] - earlier[1], later[2] - earlier[2]
                return earlier[1] + share * x, earlier[2] + share * y
            later = earlier
        return None

    def is_other(self, peer: str) -> bool:
        """True if the path of the peer cannot be laid on that of the track."""
        fit = self.fits.get(peer)
        return fit is not None and fit.weight >= 3.0 and fit.residual > _OTHER_PATH


class _Peer:
    """What is known of one peer."""

    __slots__ = (*("delay", "heard_at", "hypotheses", "resets", "stamp", "time", "told", "twist"),)

    def __init__(self) -> None:
        self.resets = -1
        self.stamp = -math.inf  # s on the clock of the peer
        self.delay = math.inf  # s, the least of arrival less stamp: between both clocks
        self.heard_at = self.time = -math.inf  # s, of the last message, and of its pose
        self.told = Pose()
        self.twist = (0.0, 0.0, 0.0)  # ahead, left, turn in a second
        self.hypotheses: list[Hypothesis] = []  # best first

    @property
    def confirmed(self) -> Hypothesis | None:
        """The pose that is confirmed."""
        best = self.hypotheses[0] if self.hypotheses else None
        return best if best is not None and best.confirmed_at < math.inf else None

    def time_of(self, told: Told, now: float) -> float:
        """When the pose of a message was measured.

        The delay of messages varies: of all clock differences the least counts.
        """
        stamp = told.stamp * UNIT
        delay = now - stamp
        if not -_MOST_GAP < delay - self.delay < _MOST_GAP:  # the first, or a clock was set
            self.delay = delay
        waited = max(now - self.heard_at, 0.0) if self.heard_at > -math.inf else 0.0
        self.delay = min(self.delay + _AHEAD_MEMORY * waited, delay)
        return stamp + self.delay


class Kin:
    """Names the tracks of one robot."""

    def __init__(self, middle: float = 0.0, resets: int = 0) -> None:
        """`middle`: m by which the middle of what others see lies ahead of the axle.

        `resets`: the first number that marks the frame of the odometry; another one in each life.
        """
        self._middle, self._resets = middle, resets
        self._trail = load_kernel("swarmd.core.odometry_trail").OdometryTrail()
        self._shift = 0.0  # s, of the odometry's clock less the robot's
        self._last: Pose | None = None
        self._way = 0.0  # m that the own middle has travelled
        self._tracks: dict[int, _Track] = {}
        self._seen_at = -math.inf  # s, of the last scan
        self._free: Sequence[float] = ()
        self._peers: dict[str, _Peer] = {}
        self._told_at = -math.inf  # s, of the last message, and the pose in it
        self._told_pose = Pose()

    def on_odometry(self, odometry: Odometry, now: float) -> None:
        """Take in an own reading. A jump moves the frame: all is forgotten."""
        taken = self._trail.take(odometry)
        if taken not in (NEXT, ANEW):
            return
        if taken == ANEW:
            self._resets += 1
            self._tracks.clear()
            self._last = None
            for peer in self._peers.values():
                peer.hypotheses.clear()
        self._shift = odometry.stamp - now
        pose = self._pose(now)
        if self._last is not None:
            self._way += math.hypot(pose.x - self._last.x, pose.y - self._last.y)
        self._last = pose

    def observe(self, tracks: Iterable[tuple[int, float, float]], scan: Scan, now: float) -> None:
        """Take in a scan and the tracks after it: id, x, y in the base frame at `now`."""
        if self._last is None:
            return
        own = self._pose(now)
        c, s = math.cos(own.yaw), math.sin(own.yaw)
        places: dict[int, tuple[float, float]] = {}
        for id, x, y in tracks:
            if len(places) < MOST_TRACKS:
                x -= self._middle
                places[id] = (own.x + c * x - s * y, own.y + s * x + c * y)
        self._tracks = {id: self._tracks.get(id) or _Track() for id in places}
        for id, (x, y) in places.items():
            self._tracks[id].add(now, x, y, self._way)
        self._free, self._seen_at = _free_of(scan), now

    def tell(self, now: float, *, asks: bool) -> Told | None:
        """The message of this robot, after `observe`; None if it is not due yet.

        `asks`: this robot runs a pattern that needs the places of its peers.
        """
        if self._last is None:
            return None
        own, before = self._pose(now), self._told_pose
        moved = math.hypot(own.x - before.x, own.y - before.y) + abs(own.yaw - before.yaw)
        if now - self._told_at < (MOVING_PERIOD if moved > _MOVED else RESTING_PERIOD) - _EARLY:
            return None
        self._told_at, self._told_pose = now, own
        seen = []
        for track in self._tracks.values():
            _, x, y = track.places[-1]
            dx, dy = x - own.x, y - own.y
            seen.append((math.hypot(dx, dy), wrapped(math.atan2(dy, dx) - own.yaw)))
        return tell(self._resets, now, (own.x, own.y, wrapped(own.yaw)), seen, asks=asks)

    def hear(self, id: str, told: Told, now: float) -> None:
        """Take in the message of the peer `id`."""
        if self._last is None:
            return
        peer = self._peers.get(id)
        if peer is None:
            self._forget_silent(now)
            if len(self._peers) >= MOST_PEERS:
                return
            peer = self._peers[id] = _Peer()
        stamp = told.stamp * UNIT
        pose = Pose(told.x * UNIT, told.y * UNIT, told.yaw * UNIT)
        gap = stamp - peer.stamp
        way = math.hypot(pose.x - peer.told.x, pose.y - peer.told.y)
        if -_MOST_GAP < gap <= 0.0:  # late, or twice
            return
        time = peer.time_of(told, now)
        is_next = (
            told.resets == peer.resets
            and 0.0 < gap < _SILENCE
            and way <= MAX_STEP + MAX_SPEED * gap
        )
        if is_next:
            self._move(id, peer, pose, time, gap)
        else:
            peer.hypotheses.clear()
            peer.twist = (0.0, 0.0, 0.0)
            for track in self._tracks.values():
                track.forget(id)
        peer.resets, peer.stamp, peer.heard_at = told.resets, stamp, now
        peer.time, peer.told = time, pose
        self._compare(id, told, peer, time, gap)

    def names(self, now: float) -> dict[int, str | None]:
        """The name of each track: the id of a peer, NO_ROBOT, or None if it is not known."""
        named = {track: id for id, track in self._matches(now).items()}
        return {
            id: named.get(id) or (NO_ROBOT if self._stands(track, now) else None)
            for id, track in self._tracks.items()
        }

    def complete(self, neighbors: Iterable[Neighbor], now: float) -> tuple[Neighbor, ...]:
        """The neighbors; those whose pose is confirmed with what is not known of them otherwise.

        Distance and bearing are from the own axle to the visible middle of the peer. `age`: s since
        a scan last showed it. `error`: two standard deviations of the place.
        """
        own, matches = self._trail.pose_at(now + self._shift), self._matches(now)
        return tuple([self._completed(one, own, matches, now) for one in neighbors])

    def _completed(
        self, known: Neighbor, own: Pose, matches: Mapping[str, int], now: float
    ) -> Neighbor:
        peer = self._peers.get(known.id)
        best = None if peer is None else peer.confirmed
        if peer is None or best is None or now - peer.heard_at > _SILENCE:
            return known
        x, y, yaw = _expected(peer, best, now)
        seen_at, track = best.seen_at, matches.get(known.id)
        if track is not None:
            seen_at = self._seen_at
            _, x, y = self._tracks[track].places[-1]
        dx, dy = x - own.x, y - own.y
        bearing, heading = wrapped(math.atan2(dy, dx) - own.yaw), wrapped(yaw - own.yaw)
        bearing = bearing if known.bearing is None else known.bearing
        heading = heading if known.heading is None else known.heading
        if known.distance is not None:
            return replace(known, bearing=bearing, heading=heading)
        return Neighbor(
            known.id,
            max(now - seen_at, 0.0),
            math.hypot(dx, dy),
            bearing,
            heading,
            known.in_reach,
            2.0 * best.sd,
        )

    def _pose(self, time: float) -> Pose:
        """The pose of the own visible middle."""
        pose = self._trail.pose_at(time + self._shift)
        return Pose(
            pose.x + self._middle * math.cos(pose.yaw),
            pose.y + self._middle * math.sin(pose.yaw),
            pose.yaw,
        )

    def _forget_silent(self, now: float) -> None:
        for id in [id for id, peer in self._peers.items() if now - peer.heard_at > _SILENCE]:
            del self._peers[id]
            for track in self._tracks.values():
                track.forget(id)

    def _move(self, id: str, peer: _Peer, pose: Pose, time: float, gap: float) -> None:
        """Move the poses of a peer by what it tells, and fit its path since the last message."""
        c, s = math.cos(peer.told.yaw), math.sin(peer.told.yaw)
        dx, dy = pose.x - peer.told.x, pose.y - peer.told.y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        turn = wrapped(pose.yaw - peer.told.yaw)
        peer.twist = (ahead / gap, left / gap, turn / gap)
        before, after = self._pose(peer.time), self._pose(time)
        own_way = math.hypot(after.x - before.x, after.y - before.y)
        own_turn = abs(wrapped(after.yaw - before.yaw))
        for one in peer.hypotheses:
            one.move(ahead, left, turn)
            one.drift(own_way, own_turn, math.hypot(one.x - after.x, one.y - after.y))
        if gap > _MOST_GAP:
            return
        for track in self._tracks.values():
            fit = track.fits.setdefault(id, PathFit())
            for at, x, y in track.places:
                if peer.time < at <= time:
                    share = (at - peer.time) / max(time - peer.time, 1e-3)
                    fit.add(at, x, y, peer.told.x + share * dx, peer.told.y + share * dy)
            x, y = track.told_at.setdefault(id, (pose.x, pose.y))
            if math.hypot(pose.x - x, pose.y - y) > _CLEARED:
                track.cleared.add(id)

    def _compare(self, id: str, told: Told, peer: _Peer, time: float, gap: float) -> None:
        """Compare the poses of a peer with the tracks, and with what it tells; begin new poses."""
        own = self._pose(time)
        here = [
            (number, place)
            for number, track in self._tracks.items()
            if not track.is_other(id) and (place := track.at(time)) is not None
        ]
        places = [place for _, place in here]
        objects = [(d * UNIT, b * UNIT) for d, b in told.objects]
        offsets = [(d * math.cos(b), d * math.sin(b)) for d, b in objects]
        for one in peer.hypotheses:
            self._judge(one, peer, own, time, gap, places, offsets)
        for track, place in here:
            self._begin(id, peer, own, track, place, objects)
        self._rank(peer, time)
        self._agree(id, peer, time, offsets)

    def _judge(
        self,
        one: Hypothesis,
        peer: _Peer,
        own: Pose,
        time: float,
        gap: float,
        places: Sequence[tuple[float, float]],
        offsets: Sequence[tuple[float, float]],
    ) -> None:
        """Raise or lower the score of a pose by what both robots see."""
        distance = math.hypot(one.x - own.x, one.y - own.y)
        told = peer.told
        is_news = one.sights.is_news(told.x, told.y)
        sd = one.sd
        if one.see(places, distance, is_news) < 0:
            is_empty = distance < _FREE_REACH and self._is_crossed(one, own, distance)
            one.score -= _EMPTY if is_empty else _FADE * gap
            return
        if sd > _LOST:
            one.prove_again((told.x, told.y), (own.x, own.y))
        one.seen_at = time
        if is_news:
            one.sights.add(told.x, told.y)
        is_news = one.mutual.is_news(own.x, own.y)
        if one.be_seen(offsets, own.x, own.y, is_news) < 0:
            one.score -= _UNSEEN if distance < _REACH else _FADE * gap
        elif is_news:
            one.mutual.add(own.x, own.y)

    def _is_crossed(self, one: Hypothesis, own: Pose, distance: float) -> bool:
        """True if the rays of the last scan cross the place of a pose."""
        if not self._free:
            return False
        bearing = wrapped(math.atan2(one.y - own.y, one.x - own.x) - own.yaw)
        sector = int((bearing + math.pi) / math.tau * _SECTORS) % _SECTORS
        return self._free[sector] > distance + _SEEN_MOST

    def _begin(
        self,
        id: str,
        peer: _Peer,
        own: Pose,
        track: int,
        place: tuple[float, float],
        objects: Sequence[tuple[float, float]],
    ) -> None:
        """Begin poses of a peer at a track: by mutual sight, and by path."""
        x, y = place
        dx, dy = own.x - x, own.y - y
        distance = math.hypot(dx, dy)
        for told, bearing in objects:
            if abs(told - distance) <= _SAME_DISTANCE:
                pose = (x, y, wrapped(math.atan2(dy, dx) - bearing))
                self._add(peer, own, pose, _FIRST_SD / max(distance, 0.3), 0.0)
        fit = self._tracks[track].fits.get(id)
        if (
            fit is not None
            and fit.weight >= _LEAST_PAIRS
            and fit.spread >= _LEAST_SPREAD
            and fit.residual <= _MOST_RESIDUAL
        ):
            pose = (*fit.place(peer.told.x, peer.told.y), wrapped(peer.told.yaw + fit.turn))
            self._add(peer, own, pose, _FIRST_SD / fit.spread, _PATH_SCORE)

    def _add(
        self,
        peer: _Peer,
        own: Pose,
        pose: tuple[float, float, float],
        yaw_sd: float,
        score: float,
    ) -> None:
        """Add a pose, unless it is known, or all that are known are better."""
        if any(one.is_like(pose, _NEAR, _TURNED) for one in peer.hypotheses):
            return
        if len(peer.hypotheses) >= _MOST_HYPOTHESES:
            worst = min(peer.hypotheses, key=lambda one: one.score)
            if worst.score >= score:
                return
            peer.hypotheses.remove(worst)
        one = Hypothesis(pose, _FIRST_SD, yaw_sd, (peer.told.x, peer.told.y), (own.x, own.y))
        one.score = score
        peer.hypotheses.append(one)

    def _rank(self, peer: _Peer, time: float) -> None:
        """Order the poses, drop bad and double ones, and confirm the best if it is sure."""
        kept: list[Hypothesis] = []
        for one in sorted(peer.hypotheses, key=lambda one: -one.score):
            is_double = any(
                one.is_like((k.x, k.y, k.yaw), 0.5 * _NEAR, 0.5 * _TURNED) for k in kept
            )
            if one.score > _DROPPED and not is_double:
                kept.append(one)
        peer.hypotheses = kept
        margin = kept[0].score - kept[1].score if len(kept) > 1 else math.inf
        for rank, one in enumerate(kept):
            if rank > 0 or one.score < 0.5 * _CONFIRMED or margin < _UNSURE:
                one.confirmed_at = math.inf
            elif (
                one.score >= _CONFIRMED
                and margin >= _MARGIN
                and min(one.sights.count, one.mutual.count) >= _LEAST_NEWS
                and min(one.sights.extent, one.mutual.extent) >= _LEAST_EXTENT
            ):
                one.confirmed_at = min(one.confirmed_at, time)

    def _agree(
        self, id: str, peer: _Peer, time: float, offsets: Sequence[tuple[float, float]]
    ) -> None:
        """Lower the pose of a peer that does not tell a third robot which it must see.

        Of the two poses the worse may be wrong. A peer lowers its own pose alone, and the third
        robot does the same by its messages: so a liar lowers no other.
        """
        best = peer.confirmed
        if best is None or len(offsets) >= MOST_OBJECTS:
            return
        for name, other in self._peers.items():
            third = other.confirmed
            if name == id or third is None or third.score < best.score:
                continue
            x, y, _ = _expected(other, third, time)
            ahead, left = best.ahead_and_left(x, y)
            distance = math.hypot(ahead, left)
            if distance < _AGREED and not any(
                math.hypot(a - ahead, b - left) < _ELSEWHERE
                or (
                    math.hypot(a, b) < distance
                    and abs(wrapped(math.atan2(b, a) - math.atan2(left, ahead))) < _TURNED
                )
                for a, b in offsets
            ):
                best.score -= _UNSEEN

    def _matches(self, now: float) -> Mapping[str, int]:
        """The track of each peer that is in sight."""
        claims: list[tuple[float, str, int]] = []
        for id, peer in self._peers.items():
            best = peer.confirmed
            if best is None or now - peer.heard_at > _SILENCE:
                continue
            x, y, _ = _expected(peer, best, now)
            for track, path in self._tracks.items():
                _, tx, ty = path.places[-1]
                far = best.fits(best.x + tx - x, best.y + ty - y)
                if far < math.inf and id not in path.cleared and not path.is_other(id):
                    claims.append((far, id, track))
        claims.sort()
        matches: dict[str, int] = {}
        taken: dict[int, str] = {}
        for _, id, track in claims:
            if id not in matches and track not in taken:
                matches[id], taken[track] = track, id
        for _, id, track in claims:  # a peer without a track contests that of another
            other = taken.get(track, id)
            if id not in matches and other != id:
                first, second = self._confirmed_at(other), self._confirmed_at(id)
                if first > second - _EARLIER:
                    matches.pop(other, None)
                if second < first - _EARLIER:
                    matches[id], taken[track] = track, id
        return matches

    def _confirmed_at(self, id: str) -> float:
        best = self._peers[id].confirmed
        return best.confirmed_at if best is not None else math.inf

    def _stands(self, track: _Track, now: float) -> bool:
        """True if a track stands while the own robot moves, and no peer can be there."""
        if now - track.still_since < _STILL_TIME or self._way - track.still_way < _OWN_WAY:
            return False
        for id, peer in self._peers.items():
            best = peer.confirmed
            if now - peer.heard_at > _SILENCE:
                continue
            if best is None:
                if id in track.cleared:
                    continue
                return False
            x, y, _ = _expected(peer, best, now)
            if math.hypot(x - track.still_at[0], y - track.still_at[1]) < _ELSEWHERE:
                return False
        return True


def _free_of(scan: Scan) -> list[float]:
    """Of each of _SECTORS directions from the bearing -pi on, the least range; inf without one."""
    free = np.full(_SECTORS, math.inf)
    use = np.isfinite(scan.ranges)
    sectors = ((scan.bearings[use] + math.pi) / math.tau * _SECTORS).astype(int) % _SECTORS
    np.minimum.at(free, sectors, scan.ranges[use])
    return list(free.tolist())


def _expected(peer: _Peer, pose: Hypothesis, now: float) -> tuple[float, float, float]:
    """The pose of a peer now, moved on at its told speed."""
    seconds = min(max(now - peer.time, 0.0), _MOST_AHEAD)
    ahead, left, turn = (number * seconds for number in peer.twist)
    yaw = pose.yaw + 0.5 * turn
    c, s = math.cos(yaw), math.sin(yaw)
    return pose.x + c * ahead - s * left, pose.y + s * ahead + c * left, pose.yaw + turn
