"""Right of way: robots pass a door or a corridor one direction at a time, without a message.

A robot remembers the openings that its scans show (openings.py). A robot whose request leads into
a wall drives to the opening in it. A robot waits aside while others come out; of two that meet
within an opening the deeper one goes on, and the other one backs out. Chance decides between two
that are as deep (Metcalfe and Boggs 1976).

The result is a request, which avoidance, recovery and protection treat as one of the pattern.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from random import Random
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swarmd.core.kernels import load_kernel
from swarmd.core.values import ZERO, Limits, Odometry, Pose, Scan, Twist
from swarmd.protection.decision import Avoided, DecisionContext, WayState
from swarmd.protection.recovery import Allows, Clearance, Points
from swarmd.protection.tracks import Surroundings

if TYPE_CHECKING:
    from swarmd.protection.openings import SIGHTINGS, Opening, Openings
    from swarmd.protection.tracks import pose_after
else:
    _kernel = load_kernel("swarmd.protection.openings")
    SIGHTINGS, Openings = _kernel.SIGHTINGS, _kernel.Openings
    pose_after = load_kernel("swarmd.protection.tracks").pose_after

_TURNING = 0.6  # rad/s of a turn during which no scan is exact enough

# Which opening is on the way of a request.
_AHEAD = 1.6  # m before an opening within which a robot that drives to it gives way
_FAR = 2.0  # m before an opening beyond which the robot does not give way
_AT_WALL = 0.5  # m before a wall at which a robot turns to its opening
_ALONG_WALL = 0.2  # rad between a request and the wall within which the request leads along it
_OTHER_WAY = -0.25  # cosine of the direction that leads away from an opening
_SIDEWAYS = 1.3  # rad: a request farther to the side is taken for a turn
_REVERSED = 0.5  # rad from straight back within which a turn keeps the direction behind the robot
_GIVE_UP = 240.0  # s for one opening
_LEAD_TIME, _LEAD_TIMES = 0.1, (0.05, 0.3)  # s of a turn ahead: without a limit, and the bounds

# Where the robot is. Distances in m along the axis count from the begin of the opening.
_IN = 0.25  # m before an opening at which an aligned robot is in it
_IN_ANYHOW = 0.05  # m before an opening at which a robot is in it at any heading
_IN_BESIDE = 0.05  # m beside an opening beyond which a robot is not in it
_ALIGNED, _ALIGNED_SHARE = 0.5, 0.25  # rad, and share of the half width, of an aligned robot
_BEYOND = 0.35  # m beyond an opening at which it is passed
_DEEP = 0.2  # m: a deeper opening is a corridor

# What the tracks do.
_PERSISTS = 1.0  # s after which a track is no part of a wall
_OUT, _SEEN_BEYOND = 0.9, 0.5  # m before and beyond an opening within which tracks count
_NARROWER, _WIDER = 0.06, 0.2  # m by which a track in and before an opening may be off its axis
_THRESHOLD = 0.3  # m around an opening: a track there keeps the side from which it came
_FIRST_SEEN_IN = -0.1  # m: a new track before it comes from the robot's side
_BACKS_OUT = 0.1  # m that a track has come back: it comes out
_MEETS = 0.8  # m, beside the depth, within which a track that comes is met
_CLOSE = 0.15  # m within which two are as deep
_FOLLOW, _FOLLOW_BEYOND = 0.27, 0.2  # m behind another robot that goes in, m beyond the opening

# How long the robot waits.
_CLEAR = (0.5, 1.5)  # s for which nothing has come out before a robot enters
_HIDDEN = 6.0  # s for which a robot that was last seen in an opening may still be there
_AFTER, _AGAIN = (6.0, 10.0), 120.0  # s for which a robot that has passed lets others pass
_PATIENCE = (3.0, 6.0)  # s after which it is drawn anew which of two goes on
_NO_PROGRESS, _MINE_SHARE = 2.0, 0.5  # s after which it is drawn, and the chance to go on
_STUCK, _PROGRESS = 6.0, 0.03  # s and m: with less a robot in an opening tries the other way
_HELD = 10.0  # s behind another that does not go on, after which a robot clears its way

# How the robot drives.
_LINE_UP = 0.5  # m before an opening, where a robot turns into its axis
_NEARLY_LINED_UP = 0.1  # m before that place within which a robot is at it
_AT_LINE_UP = 0.08  # m from that place within which a robot is lined up
_ON_AXIS, _ON_AXIS_FAR = 0.04, 0.4  # m from the axis, so far before an opening: lined up, too
_OFF_AXIS, _OFF_AXIS_NEAR = 0.12, 0.35  # m off the axis, so far before: no longer lined up
_OFF_AXIS_SHARE = 0.25  # of the half width, nearer
_PURSUIT = 0.15  # m ahead on the axis
_LEAN = 0.1  # m/s: a robot in a corridor keeps away from the side whose rays are older by this
_LEAN_FROM = 0.15  # m before a corridor at which that begins
_ABEAM, _ABEAM_WIDTH = 1.0, 0.6  # rad: the bearing of the walls beside, and how far around it
_BESIDE, _FREE = 0.5, 1.4  # m beside and before an opening that a robot leaves free for others
_FARTHER_BESIDE = 0.15  # m beside that, to which the robot drives
_ASIDE_FAR, _ASIDE_STEP = 0.4, 0.1  # m before an opening at least, and m back
_KEEPS_SIDE, _HAS_SIDE = 0.15, 0.05  # m beside the axis: keeps, and chooses, the side to wait on
_BACK_AIM = 0.4  # m behind, to which a robot backs out
_BACK_TURN, _BACK_SHARE = 0.3, 0.5  # rad/s, and share of the speed
_BACKS_TO = 2.0  # rad: a goal farther to the side is reached backwards
_GAIN = 3.0  # 1/s of the heading
_SPEEDS = (0.14, 0.1, 0.07, 0.04)  # m/s, of which the last lets protection creep
_TURN_COST = 0.15  # m/s for each rad/s that protection changes
_UNKNOWN_SPEED_SHARE = 0.5  # of the limit, before a request has shown a speed

# The middle of the opening, as the returns of its posts show it.
_WRONG = 0.1  # m by which the middle may be off; an opening farther off is looked for anew
_NEW = 0.03  # weight of a new measurement of the axis
_AT_POST, _SAME_WIDTH = 0.1, 0.08  # m within which returns are posts, and their gap is the opening
_POSTS_BEHIND, _POSTS_AHEAD = 0.15, 0.2  # m around the robot within which returns are posts
_PAST_POSTS = 0.05  # m beyond an opening at which its posts are not measured


class _Rule(Enum):
    """Which rule of the state machine holds: the first of these, whatever the state before is.

    The rules have memory: `_is_backing` (rules 1 and 2), `_clear` and `_busy_at` (rules 3 and 4),
    `_is_lined_up` (rule 5) and `_held` (rules 3, 4 and 6). Giving way ends the last two.
    """

    # 1. A robot in an opening backs out when it meets a robot that comes, until it is out of the
    #    opening. A robot without progress for _STUCK tries the other way.
    BACKS = 1
    # 2. A robot in an opening that does not back out passes the opening.
    IS_IN = 2
    # 3. The robot must give way, and stands where others can pass. It must while a robot comes,
    #    for a random time after that, while another robot is nearer, and for a time after it has
    #    stood for _HELD behind a robot that does not go on.
    MUST_GIVE_WAY_ASIDE = 3
    # 4. The robot must give way, and stands where others want to pass.
    MUST_GIVE_WAY = 4
    # 5. The robot is not lined up: it reaches the place before the opening, or the axis there, to
    #    be lined up, and must stay near the axis.
    IS_NOT_LINED_UP = 5
    # 6. Another robot that goes in is close ahead.
    FOLLOWS = 6
    # 7. The robot is lined up, at the place before the opening or beyond.
    IS_AT_LINE_UP = 7
    # 8. The robot is lined up before that place.
    IS_BEFORE_LINE_UP = 8


_TRANSITIONS: Mapping[_Rule, WayState] = {
    _Rule.BACKS: WayState.BACK,
    _Rule.IS_IN: WayState.IN,
    _Rule.MUST_GIVE_WAY_ASIDE: WayState.WAIT,
    _Rule.MUST_GIVE_WAY: WayState.ASIDE,
    _Rule.IS_NOT_LINED_UP: WayState.GO,
    _Rule.FOLLOWS: WayState.WAIT,
    _Rule.IS_AT_LINE_UP: WayState.LINE,
    _Rule.IS_BEFORE_LINE_UP: WayState.APPROACH,
}
"""The state that each rule leads to; `WayState.NONE` is without an opening on the way."""
_SETTLED = frozenset({WayState.IN, WayState.BACK, WayState.WAIT, WayState.LINE})


class _Place(NamedTuple):
    """The robot before an opening."""

    s: float  # m from the begin of the opening along its axis
    side: float  # m to the left of the axis
    heading: float  # rad from the axis
    depth: float  # m of the opening
    half: float  # m of its width

    @property
    def is_in(self) -> bool:
        """True if others must wait for the robot."""
        if abs(self.side) >= self.half + _IN_BESIDE:
            return False
        is_on_axis = abs(self.side) < _ALIGNED_SHARE * self.half
        is_aligned = abs(self.heading) < _ALIGNED and is_on_axis
        return self.s > -_IN_ANYHOW or (self.s > -_IN and is_aligned)

    @property
    def leaves_free(self) -> bool:
        """True if others can pass the robot."""
        return abs(self.side) > self.half + _BESIDE or self.s < -_FREE

    @property
    def to_line_up(self) -> float:
        """The distance in m to the place at which a robot lines up."""
        return math.hypot(self.s + _LINE_UP, self.side)


class _Traffic(NamedTuple):
    """What the tracks before and in an opening do."""

    is_busy: bool = False  # a robot comes out
    is_within: bool = False  # that robot is still in the opening
    is_behind: bool = False  # another robot that wants to pass is nearer
    is_met: bool = False  # a robot that is deeper in comes towards this robot in the opening
    is_close: bool = False  # another robot that goes in is close ahead


class RightOfWay:
    """Chooses the request of a robot before an opening. Times are in s and come with each call."""

    def __init__(self, clearance: Clearance, limits: Limits, seed: str) -> None:
        """`seed` seeds the random choices."""
        self._body, self._limits = clearance.body, limits
        lead = limits.linear / limits.angular if limits.angular > 0.0 else _LEAD_TIME
        shortest, longest = _LEAD_TIMES
        self._lead = min(max(lead, shortest), longest)
        self._rng = Random(f"way {seed}")
        self._openings = Openings(clearance.body)
        self._tracks: tuple[tuple[float, float, float], ...] = ()  # x, y, radius by odometry
        self._last: Odometry | None = None
        self._passed_at = -math.inf
        self._lean = 0.0
        self.reset()

    def reset(self) -> None:
        """Forget the request, and no opening that the robot knows."""
        self._speed = (
            _UNKNOWN_SPEED_SHARE * self._limits.linear
        )  # or the fastest request, as in recovery
        self._release()

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading. A jump of the pose moves the frame: all openings are forgotten."""
        last, self._last = self._last, odometry
        if last is not None and (odometry.stamp < last.stamp or odometry.jumps_from(last)):
            self._openings.clear()
            self._release()

    def _release(self) -> None:
        """Let requests pass until there is another opening on the way."""
        self._opening: Opening | None = None
        self._sign, self._since, self._wish = 1.0, 0.0, 0.0
        self._sides: dict[int, float] = {}  # by track: the side from which it came
        self._farthest: dict[int, float] = {}
        self._seen_since: dict[int, float] = {}
        self._best, self._best_at, self._is_backing = -math.inf, -math.inf, False
        self._busy_at, self._clear = -math.inf, 0.0
        self._is_mine, self._drawn_until = True, -math.inf
        self._aside, self._is_lined_up = 0.0, False
        self._off: float | None = None  # m, the measured middle less that of the sightings
        self._held = -math.inf, -math.inf  # when and where it began to wait for one ahead
        self.state = WayState.NONE

    @property
    def is_settled(self) -> bool:
        """True where neither avoidance nor recovery has anything to add."""
        return self.state in _SETTLED

    def passed(self, context: DecisionContext) -> Avoided | None:
        """The opening that changes the request of a robot; None without one."""
        opening, odometry = self._opening, context.odometry
        if self.state is WayState.NONE or opening is None or odometry is None:
            return None
        pose = pose_after(odometry, context.odometry_age or 0.0)
        x, y = opening.x - pose.x, opening.y - pose.y
        bearing = math.remainder(math.atan2(y, x) - pose.yaw, 2.0 * math.pi)
        return Avoided(bearing, math.hypot(x, y), self.state)

    def observe(self, scan: Scan, offset: tuple[float, float], context: DecisionContext) -> None:
        """Take in a conditioned scan; `offset` is the place of the sensor in the base frame."""
        odometry = context.odometry
        ages = scan.ages if self._opening is not None else None
        if ages is not None and len(ages) == len(scan.bearings):
            left, right = (
                ages[np.abs(scan.bearings - way * _ABEAM) < _ABEAM_WIDTH] for way in (1.0, -1.0)
            )
            if len(left) and len(right):
                self._lean = _LEAN * float(right.mean() - left.mean())
        if odometry is None or context.odometry_age is None:
            return
        if abs(odometry.twist.angular) > _TURNING:
            return
        ago = (scan.newest_age or 0.0) + context.scan_delay
        pose = pose_after(odometry, context.odometry_age - ago)
        self._openings.observe(scan, offset, pose, context.now, self._tracks, self._opening)

    def command(
        self,
        requested: Twist,
        context: DecisionContext,
        around: Surroundings,
        allows: Allows,
        points: Points,
    ) -> Twist:
        """The request to ask for; `requested` itself without an opening on the way."""
        odometry, now = context.odometry, context.now
        if odometry is None or context.odometry_age is None:
            return requested
        if self._last is not odometry:
            self.on_odometry(odometry)
        pose = pose_after(odometry, context.odometry_age)
        cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
        placed = [
            (track, pose.x + cos * track.x - sin * track.y, pose.y + sin * track.x + cos * track.y)
            for track in around.tracks
        ]
        self._tracks = tuple((x, y, track.radius) for track, x, y in placed)
        if requested.is_zero:
            self._release()
            return requested
        self._speed = max(self._speed, math.hypot(requested.linear, requested.lateral))
        self._wish = self._wished(requested, pose.yaw)
        if self._opening is None:
            self._choose(pose, now)
        opening = self._opening
        if opening is None:
            return requested
        s, side = opening.to_local(pose.x, pose.y, self._sign)
        first, last = opening.ends(self._sign)
        turned = pose.yaw - opening.angle - (0.0 if self._sign > 0.0 else math.pi)
        heading = math.remainder(turned, 2.0 * math.pi)
        place = _Place(s - first, side, heading, last - first, opening.half)
        is_passed = place.s > place.depth + _BEYOND
        if is_passed and around.tracks:
            self._passed_at = now
        wish = math.cos(self._wish - opening.angle) * self._sign
        is_over = now - self._since > _GIVE_UP
        if is_passed or place.s < -_FAR or wish < _OTHER_WAY or is_over:
            self._release()
            return requested
        self._seen_since = {
            track.id: self._seen_since.get(track.id, now) for track in around.tracks
        }
        for by_track in (self._sides, self._farthest):
            for id in by_track.keys() - self._seen_since.keys():
                del by_track[id]
        others = []
        for track, x, y in placed:
            along, across = opening.to_local(x, y, self._sign)
            if now - self._seen_since[track.id] >= _PERSISTS:
                others.append((track.id, along - first, across))
        return self._through(place, others, now, allows, points)

    def _wished(self, requested: Twist, yaw: float) -> float:
        """The direction of the request in the frame of the odometry.

        A base that turns on the spot wants to go anywhere on that side.
        """
        ahead = max(requested.linear, 0.0)
        off = math.atan2(requested.lateral + self._lead * requested.angular, ahead)
        if abs(off) > _SIDEWAYS and requested.lateral == 0.0:
            before = math.remainder(self._wish - yaw, 2.0 * math.pi)
            if before * off > 0.0 and abs(before) > _SIDEWAYS:
                off = before
            elif math.pi - abs(before) < _REVERSED:
                off = math.copysign(math.pi, off)
        return yaw + off

    def _choose(self, pose: Pose, now: float) -> None:
        """Take the nearest opening that the wish leads through, or whose wall it leads into."""
        nearest, chosen = math.inf, None
        for opening in self._openings:
            angle = math.remainder(self._wish - opening.angle, 2.0 * math.pi)
            if opening.hits < SIGHTINGS or abs(abs(angle) - 0.5 * math.pi) < _ALONG_WALL:
                continue
            sign = 1.0 if abs(angle) < 0.5 * math.pi else -1.0
            s, side = opening.to_local(pose.x, pose.y, sign)
            first, last = opening.ends(sign)
            s -= first
            if s > last - first or (s > -_IN_ANYHOW and abs(side) > opening.half):
                continue
            at = side - min(s, 0.0) * math.tan(angle)
            wall = opening.walls[0 if at * sign > 0.0 else 1]
            leads_in = abs(at) < opening.half and s > -_AHEAD
            leads_to_wall = s > -_AT_WALL and abs(at) < wall
            away = math.hypot(min(s, 0.0), side)
            if (leads_in or leads_to_wall) and away < nearest:
                nearest, chosen = away, (opening, sign)
        if chosen is None:
            return
        wish = self._wish
        self._release()
        self._wish, self._since = wish, now
        self._opening, self._sign = chosen
        if now - self._passed_at < _AGAIN:
            self._busy_at, self._clear = now, self._rng.uniform(*_AFTER)

    def _traffic(self, at: _Place, others: list[tuple[int, float, float]]) -> _Traffic:
        """What the tracks (id, m from the begin, m to the left of the axis) do."""
        slack = _CLOSE if self._is_mine else -_CLOSE
        is_busy = is_behind = is_met = is_within = is_close = False
        for id, s, off in others:
            side = self._sides.get(id)
            if side is None or s < -_THRESHOLD or s > at.depth + _THRESHOLD:
                least = _FIRST_SEEN_IN if side is None else 0.5 * at.depth
                side = self._sides[id] = -1.0 if s < least else 1.0
            wide = at.half - _NARROWER if s > 0.0 else at.half + _WIDER
            if not -_OUT < s < at.depth + _SEEN_BEYOND or abs(off) > wide:
                continue
            far = max(self._farthest.get(id, s) if s > -_LINE_UP else s, s)
            self._farthest[id] = far
            if side > 0.0 or (far > -_IN and s < far - _BACKS_OUT):
                back, its = at.s + _IN, at.depth + _IN - s
                if at.is_in and s > at.s:
                    is_met |= s - at.s < _MEETS + at.depth and its > max(back + slack, 0.0)
                elif s < at.depth + _IN or s - at.depth < -at.s + slack:
                    is_busy = True
                    is_within |= -_THRESHOLD < s < at.depth + _THRESHOLD
            elif s > at.s and s > -_IN:
                is_close |= s - at.s < _FOLLOW and s < at.depth + _FOLLOW_BEYOND
            elif math.hypot(s + _LINE_UP, off) < at.to_line_up + slack:
                is_behind = True
        return _Traffic(is_busy, is_within, is_behind, is_met, is_close)

    def _through(
        self,
        at: _Place,
        others: list[tuple[int, float, float]],
        now: float,
        allows: Allows,
        points: Points,
    ) -> Twist:
        """The request at a place."""
        if now > self._drawn_until and now - self._best_at > _NO_PROGRESS:
            self._is_mine = self._rng.random() < _MINE_SHARE
            self._drawn_until = now + self._rng.uniform(*_PATIENCE)
        self._find_middle(at, points)
        left = self._off or 0.0
        if abs(left) > _WRONG and self._openings.forget(self._opening):
            self._release()  # a robot was taken for a post
            return ZERO
        at = at._replace(side=at.side - left)
        traffic = self._traffic(at, [(id, s, off - left) for id, s, off in others])
        self._note_progress(at, traffic, now)
        if traffic.is_met or traffic.is_busy or self._is_backing:
            has_passed = now - self._passed_at < _AGAIN
            self._busy_at = now
            self._clear = self._rng.uniform(*(_AFTER if has_passed else _CLEAR))
            self._clear += _HIDDEN if traffic.is_within else 0.0
        self.state = _TRANSITIONS[self._rule(at, traffic, now)]
        return self._request(at, allows)

    def _note_progress(self, at: _Place, traffic: _Traffic, now: float) -> None:
        """Decide whether a robot in an opening backs out."""
        if not at.is_in:
            self._is_backing, self._best, self._best_at = False, at.s, now
        elif traffic.is_met or now - self._best_at > _STUCK:
            self._is_backing = traffic.is_met or not self._is_backing
            self._best, self._best_at = at.s, now
        elif abs(at.s - self._best) > _PROGRESS:
            self._best, self._best_at = at.s, now

    def _rule(self, at: _Place, traffic: _Traffic, now: float) -> _Rule:
        """The rule that holds at a place among traffic."""
        if self._is_backing:
            return _Rule.BACKS
        if at.is_in:
            return _Rule.IS_IN
        if now - self._busy_at < self._clear or traffic.is_behind:
            return self._giving_way(at)
        is_on_axis = abs(at.side) < _ON_AXIS and at.s < -_ON_AXIS_FAR
        self._is_lined_up |= at.to_line_up < _AT_LINE_UP or is_on_axis
        most = _OFF_AXIS if at.s < -_OFF_AXIS_NEAR else _OFF_AXIS_SHARE * at.half
        self._is_lined_up &= abs(at.side) < most
        if not self._is_lined_up:
            return _Rule.IS_NOT_LINED_UP
        if not traffic.is_close or at.s > self._held[1] + _PROGRESS:
            self._held = now, at.s
        elif now - self._held[0] > _HELD:
            self._busy_at, self._clear = now, self._rng.uniform(*_CLEAR) + _HIDDEN
            return self._giving_way(at)
        if traffic.is_close:
            return _Rule.FOLLOWS
        is_at_line_up = at.s > -_LINE_UP - _NEARLY_LINED_UP
        return _Rule.IS_AT_LINE_UP if is_at_line_up else _Rule.IS_BEFORE_LINE_UP

    def _giving_way(self, at: _Place) -> _Rule:
        self._is_lined_up, self._held = False, (-math.inf, -math.inf)
        return _Rule.MUST_GIVE_WAY_ASIDE if at.leaves_free else _Rule.MUST_GIVE_WAY

    def _request(self, at: _Place, allows: Allows) -> Twist:
        """The request of the present state at a place."""
        match self.state:
            case WayState.BACK:
                behind = math.atan2(-at.side, -_BACK_AIM) + math.pi - at.heading
                turn = min(max(math.remainder(behind, 2.0 * math.pi), -_BACK_TURN), _BACK_TURN)
                return self._fastest(Twist(-_BACK_SHARE * self._speed, turn), allows)
            case WayState.IN:
                is_in_corridor = at.depth > _DEEP and at.s > -_LEAN_FROM
                lean = self._lean if is_in_corridor else 0.0
                return self._fastest(self._drive(at.s + _PURSUIT, lean, at), allows)
            case WayState.ASIDE:
                if not self._aside or abs(at.side) > _KEEPS_SIDE:
                    is_off = abs(at.side) > _HAS_SIDE
                    self._aside = math.copysign(1.0, at.side) if is_off else self._aside or -1.0
                side = self._aside * (at.half + _BESIDE + _FARTHER_BESIDE)
                return self._drive(min(at.s, -_ASIDE_FAR) - _ASIDE_STEP, side, at)
            case WayState.GO:
                return self._drive(-_LINE_UP, 0.0, at)
            case WayState.LINE:
                return self._fastest(self._drive(at.s + _PURSUIT, 0.0, at), allows)
            case WayState.APPROACH:
                return self._drive(at.s + _PURSUIT, 0.0, at)
            case _:
                return ZERO

    def _find_middle(self, at: _Place, points: Points) -> None:
        """Measure how far to the left of the axis the middle of the opening is.

        The axis of sightings from afar is off by 1 cm, and by more where a robot was taken for a
        post. Between the posts 1 cm costs half of the speed.
        """
        if not -_LINE_UP - _NEARLY_LINED_UP < at.s < at.depth + _PAST_POSTS:
            return
        x, y = points().T
        cos, sin = math.cos(at.heading), math.sin(at.heading)
        along, across = at.s + cos * x - sin * y, at.side + sin * x + cos * y
        is_near = (along > max(at.s - _POSTS_BEHIND, -_AT_POST)) & (
            along < max(at.s, 0.0) + _POSTS_AHEAD
        )
        sides = np.sort(across[is_near & (along < at.depth + _AT_POST)])
        middles = 0.5 * (sides[1:] + sides[:-1])
        middles = middles[np.abs(np.diff(sides) - 2.0 * at.half) < _SAME_WIDTH]
        middles = middles[np.abs(middles) < at.half + _AT_POST]
        if len(middles):
            seen = float(middles[np.abs(middles - (self._off or 0.0)).argmin()])
            self._off = seen if self._off is None else self._off + _NEW * (seen - self._off)

    def _fastest(self, twist: Twist, allows: Allows) -> Twist:
        """The request along this way of which protection leaves most.

        Protection turns a robot aside that asks for much, and lets one creep that asks for little.
        """
        most = abs(twist.linear)
        best_gain, best = -math.inf, twist
        for speed in (most, *_SPEEDS):
            asked = Twist(math.copysign(min(speed, most), twist.linear), twist.angular)
            allowed = allows(asked)
            gain = math.copysign(allowed.linear, allowed.linear * asked.linear)
            gain -= _TURN_COST * abs(allowed.angular - asked.angular)
            if gain > best_gain:
                best_gain, best = gain, asked
        return best

    def _drive(self, s: float, side: float, at: _Place) -> Twist:
        """Towards a place."""
        limits = self._limits
        off = math.remainder(math.atan2(side - at.side, s - at.s) - at.heading, 2.0 * math.pi)
        if s < at.s > -_LINE_UP and abs(at.side) < at.half and abs(off) > _BACKS_TO:  # backs out
            off = math.remainder(off - math.pi, 2.0 * math.pi)
            turn = min(max(_GAIN * off, -limits.angular), limits.angular)
            return Twist(-self._speed * max(math.cos(off), 0.0) ** 2, turn)
        turn = min(max(_GAIN * off, -limits.angular), limits.angular)
        return Twist(self._speed * max(math.cos(off), 0.0) ** 2, turn)
