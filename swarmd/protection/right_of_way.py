"""Right of way: robots pass a door or a corridor one direction at a time, without a message.

A robot remembers the openings that its scans show (openings.py). A robot whose request leads into
a wall drives to the opening in it. A robot waits aside while others come out; of two that meet
within an opening the deeper one goes on, and the other one backs out. Chance decides between two
that are as deep (Metcalfe and Boggs 1976).

The result is a request, which avoidance, recovery and protection treat as one of the pattern.
"""

from __future__ import annotations

import math
from random import Random
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swarmd.core.kernels import load_kernel
from swarmd.core.values import ZERO, Limits, Odometry, Pose, Scan, Twist
from swarmd.protection.decision import Avoided, DecisionContext
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

_AHEAD = 1.6  # m before an opening within which a robot that drives to it gives way
_FAR = 2.0  # m before an opening beyond which it does not
_AT_WALL = 0.5  # m before a wall at which a robot turns to its opening
_OTHER_WAY = -0.25  # cosine of the direction that leads away from an opening
_SIDEWAYS = 1.3  # rad: a request farther to the side is taken for a turn
_GIVE_UP = 240.0  # s for one opening

_IN = 0.25  # m before an opening at which a robot is in it
_BEYOND = 0.35  # m beyond an opening at which it is passed
_OUT, _SEEN_BEYOND = 0.9, 0.5  # m before and beyond an opening within which others count
_LINE_UP = 0.5  # m before an opening, where a robot turns into its axis
_LEAN = 0.1  # m/s: a robot in a corridor keeps away from the side whose rays are older by this
_ABEAM = 1.0  # rad: the bearing of the walls beside and ahead that limit its speed
_DEEP = 0.2  # m: a deeper opening is a corridor
_PURSUIT = 0.15  # m ahead on the axis
_WRONG = 0.1  # m by which the middle may be off; an opening farther off is looked for anew
_NEW = 0.03  # weight of a new measurement of the axis
_BESIDE, _FREE = 0.5, 1.4  # m beside and before an opening that a robot leaves free for others
_FOLLOW = 0.27  # m behind another robot that goes in
_PERSISTS = 1.0  # s after which a track is no part of a wall
_CLEAR = (0.5, 1.5)  # s for which nothing has come out before a robot enters
_HIDDEN = 6.0  # s for which a robot that was last seen in an opening may still be there
_AFTER, _AGAIN = (6.0, 10.0), 120.0  # s for which a robot that has passed lets others pass
_PATIENCE = (3.0, 6.0)  # s after which it is drawn anew which of two goes on
_CLOSE = 0.15  # m within which two are as deep
_STUCK, _PROGRESS = 6.0, 0.03  # s and m: with less a robot in an opening tries the other way
_AT_POST, _SAME_WIDTH = 0.1, 0.08  # m within which returns are posts, and their gap is the opening
_HELD = 10.0  # s behind another that does not go on, after which a robot clears its way
_GAIN = 3.0  # 1/s of the heading
_SPEEDS = (0.14, 0.1, 0.07, 0.04)  # m/s, of which the last lets protection creep
_TURN_COST = 0.15  # m/s for each rad/s that protection changes


class _Place(NamedTuple):
    """The robot before an opening: m from its begin, m to the left of its axis, and the heading.

    `depth` and `half` of the width of the opening.
    """

    s: float
    side: float
    heading: float
    depth: float
    half: float

    @property
    def is_in(self) -> bool:
        """True if others must wait for the robot."""
        if abs(self.side) >= self.half + 0.05:
            return False
        is_aligned = abs(self.heading) < 0.5 and abs(self.side) < 0.25 * self.half
        return self.s > -0.05 or (self.s > -_IN and is_aligned)

    @property
    def to_line_up(self) -> float:
        """The distance in m to the place at which a robot lines up."""
        return math.hypot(self.s + _LINE_UP, self.side)


class _Traffic(NamedTuple):
    """What others do: come out (`is_within`: still in the opening), wait nearer, meet, go ahead."""

    is_busy: bool = False
    is_within: bool = False
    is_behind: bool = False
    is_met: bool = False
    is_close: bool = False


class RightOfWay:
    """Chooses the request of a robot before an opening. Times are in s and come with each call.

    `state`: in, back, wait, aside, go (to where it lines up) or line; empty without an opening.
    """

    def __init__(self, clearance: Clearance, limits: Limits, seed: str) -> None:
        """`seed` seeds the random choices."""
        self._body, self._limits = clearance.body, limits
        lead = limits.linear / limits.angular if limits.angular > 0.0 else 0.1
        self._lead = min(max(lead, 0.05), 0.3)
        self._rng = Random(f"way {seed}")
        self._openings = Openings(clearance.body)
        self._tracks: tuple[tuple[float, float, float], ...] = ()  # x, y, radius by odometry
        self._last: Odometry | None = None
        self._passed_at = -math.inf
        self._lean = 0.0
        self.reset()

    def reset(self) -> None:
        """Forget the request, and no opening that the robot knows."""
        self._speed = 0.5 * self._limits.linear  # or the fastest request, as in recovery
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
        self.state = ""

    @property
    def is_settled(self) -> bool:
        """True where neither avoidance nor recovery has anything to add."""
        return self.state in {"in", "back", "wait", "line"}

    def passed(self, context: DecisionContext) -> Avoided | None:
        """The opening that changes the request of a robot; None without one."""
        opening, odometry = self._opening, context.odometry
        if not self.state or opening is None or odometry is None:
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
                ages[np.abs(scan.bearings - way * _ABEAM) < 0.6 * _ABEAM] for way in (1.0, -1.0)
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
            (one, pose.x + cos * one.x - sin * one.y, pose.y + sin * one.x + cos * one.y)
            for one in around.tracks
        ]
        self._tracks = tuple((x, y, one.radius) for one, x, y in placed)
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
        self._seen_since = {one.id: self._seen_since.get(one.id, now) for one in around.tracks}
        for by_track in (self._sides, self._farthest):
            for id in by_track.keys() - self._seen_since.keys():
                del by_track[id]
        others = []
        for one, x, y in placed:
            there, off = opening.to_local(x, y, self._sign)
            there -= first
            if now - self._seen_since[one.id] >= _PERSISTS:
                others.append((one.id, there, off))
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
            elif math.pi - abs(before) < 0.5:
                off = math.copysign(math.pi, off)
        return yaw + off

    def _choose(self, pose: Pose, now: float) -> None:
        """Take the nearest opening that the wish leads through, or whose wall it leads into."""
        nearest, chosen = math.inf, None
        for one in self._openings:
            angle = math.remainder(self._wish - one.angle, 2.0 * math.pi)
            if one.hits < SIGHTINGS or abs(abs(angle) - 0.5 * math.pi) < 0.2:
                continue
            sign = 1.0 if abs(angle) < 0.5 * math.pi else -1.0
            s, side = one.to_local(pose.x, pose.y, sign)
            first, last = one.ends(sign)
            s -= first
            if s > last - first or (s > -0.05 and abs(side) > one.half):
                continue
            at = side - min(s, 0.0) * math.tan(angle)
            wall = one.walls[0 if at * sign > 0.0 else 1]
            leads_in = abs(at) < one.half and s > -_AHEAD
            leads_to_wall = s > -_AT_WALL and abs(at) < wall
            away = math.hypot(min(s, 0.0), side)
            if (leads_in or leads_to_wall) and away < nearest:
                nearest, chosen = away, (one, sign)
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
            if side is None or s < -0.3 or s > at.depth + 0.3:
                least = -0.1 if side is None else 0.5 * at.depth
                side = self._sides[id] = -1.0 if s < least else 1.0
            wide = at.half - 0.06 if s > 0.0 else at.half + 0.2
            if not -_OUT < s < at.depth + _SEEN_BEYOND or abs(off) > wide:
                continue
            far = max(self._farthest.get(id, s) if s > -_LINE_UP else s, s)
            self._farthest[id] = far
            if side > 0.0 or (far > -_IN and s < far - 0.1):  # one that backs out comes, too
                back, its = at.s + _IN, at.depth + _IN - s
                if at.is_in and s > at.s:
                    is_met |= s - at.s < 0.8 + at.depth and its > max(back + slack, 0.0)
                elif s < at.depth + _IN or s - at.depth < -at.s + slack:
                    is_busy = True
                    is_within |= -0.3 < s < at.depth + 0.3
            elif s > at.s and s > -_IN:
                is_close |= s - at.s < _FOLLOW and s < at.depth + 0.2
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
        if now > self._drawn_until and now - self._best_at > 2.0:
            self._is_mine = self._rng.random() < 0.5
            self._drawn_until = now + self._rng.uniform(*_PATIENCE)
        self._find_middle(at, points)
        left = self._off or 0.0
        if abs(left) > _WRONG and self._openings.forget(self._opening):
            self._release()  # a robot was taken for a post
            return ZERO
        at = at._replace(side=at.side - left)
        traffic = self._traffic(at, [(id, s, off - left) for id, s, off in others])
        if not at.is_in:
            self._is_backing, self._best, self._best_at = False, at.s, now
        elif traffic.is_met or now - self._best_at > _STUCK:
            self._is_backing = traffic.is_met or not self._is_backing
            self._best, self._best_at = at.s, now
        elif abs(at.s - self._best) > _PROGRESS:
            self._best, self._best_at = at.s, now
        if traffic.is_met or traffic.is_busy or self._is_backing:
            has_passed = now - self._passed_at < _AGAIN
            self._busy_at = now
            self._clear = self._rng.uniform(*(_AFTER if has_passed else _CLEAR))
            self._clear += _HIDDEN if traffic.is_within else 0.0
        if self._is_backing:
            self.state = "back"
            off = math.remainder(math.atan2(-at.side, -0.4) + math.pi - at.heading, 2.0 * math.pi)
            return self._fastest(Twist(-0.5 * self._speed, min(max(off, -0.3), 0.3)), allows)
        if at.is_in:
            self.state = "in"
            lean = self._lean if at.depth > _DEEP and at.s > -0.15 else 0.0
            return self._fastest(self._drive(at.s + _PURSUIT, lean, at), allows)
        if now - self._busy_at < self._clear or traffic.is_behind:
            return self._give_way(at)
        self._is_lined_up |= at.to_line_up < 0.08 or (abs(at.side) < 0.04 and at.s < -0.4)
        self._is_lined_up &= abs(at.side) < (0.12 if at.s < -0.35 else 0.25 * at.half)
        if not self._is_lined_up:
            self.state = "go"
            return self._drive(-_LINE_UP, 0.0, at)
        if not traffic.is_close or at.s > self._held[1] + _PROGRESS:
            self._held = now, at.s
        elif now - self._held[0] > _HELD:
            self._busy_at, self._clear = now, self._rng.uniform(*_CLEAR) + _HIDDEN
            return self._give_way(at)
        self.state = "wait" if traffic.is_close else "line" if at.s > -_LINE_UP - 0.1 else "go"
        if traffic.is_close:
            return ZERO
        asked = self._drive(at.s + _PURSUIT, 0.0, at)
        return self._fastest(asked, allows) if self.state == "line" else asked

    def _give_way(self, at: _Place) -> Twist:
        """Go aside, and wait there."""
        self._is_lined_up, self._held = False, (-math.inf, -math.inf)
        if abs(at.side) > at.half + _BESIDE or at.s < -_FREE:
            self.state = "wait"
            return ZERO
        if not self._aside or abs(at.side) > 0.15:
            is_off = abs(at.side) > 0.05
            self._aside = math.copysign(1.0, at.side) if is_off else self._aside or -1.0
        self.state = "aside"
        return self._drive(min(at.s, -0.4) - 0.1, self._aside * (at.half + _BESIDE + 0.15), at)

    def _find_middle(self, at: _Place, points: Points) -> None:
        """Measure how far to the left of the axis the middle of the opening is.

        The axis of sightings from afar is off by 1 cm, and by more where a robot was taken for a
        post. Between the posts 1 cm costs half of the speed.
        """
        if not -_LINE_UP - 0.1 < at.s < at.depth + 0.05:
            return
        x, y = points().T
        cos, sin = math.cos(at.heading), math.sin(at.heading)
        along, across = at.s + cos * x - sin * y, at.side + sin * x + cos * y
        is_near = (along > max(at.s - 0.15, -_AT_POST)) & (along < max(at.s, 0.0) + 0.2)
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
        best, found, most = -math.inf, twist, abs(twist.linear)
        for speed in (most, *_SPEEDS):
            one = Twist(math.copysign(min(speed, most), twist.linear), twist.angular)
            allowed = allows(one)
            gain = math.copysign(allowed.linear, allowed.linear * one.linear)
            gain -= _TURN_COST * abs(allowed.angular - one.angular)
            if gain > best:
                best, found = gain, one
        return found

    def _drive(self, s: float, side: float, at: _Place) -> Twist:
        """Towards a place."""
        limits = self._limits
        off = math.remainder(math.atan2(side - at.side, s - at.s) - at.heading, 2.0 * math.pi)
        if s < at.s > -_LINE_UP and abs(at.side) < at.half and abs(off) > 2.0:  # backs out
            off = math.remainder(off - math.pi, 2.0 * math.pi)
            turn = min(max(_GAIN * off, -limits.angular), limits.angular)
            return Twist(-self._speed * max(math.cos(off), 0.0) ** 2, turn)
        turn = min(max(_GAIN * off, -limits.angular), limits.angular)
        return Twist(self._speed * max(math.cos(off), 0.0) ** 2, turn)
