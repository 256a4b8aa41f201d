"""Right of way: robots pass a door or a corridor one direction at a time, without a message.

A robot remembers the openings in walls that its scans show (openings.py). If the command that the
pattern requests leads into a wall, the robot drives to the nearest opening in that wall. The robot
waits beside an opening while other robots come out of the opening. When two robots meet within an
opening, the robot that is deeper in goes on and the other robot backs out, and gives way for a
random time. In a corridor the robot keeps away from the wall whose rays are older.

The result replaces the command that the pattern requested. Avoidance, recovery and protection
treat the result as a requested command.

A kernel (see `core/kernels.py`), since each request passes it.
"""

from __future__ import annotations

import math
from random import Random
from typing import Any

from msgspec import Struct
from msgspec.structs import astuple, replace

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import PI, TURN
from swarmd.core.avoided import Avoided, WayState
from swarmd.core.buffers import view
from swarmd.core.cython_shadow import (
    INFINITY,
    Doubles,
    atan2,
    copysign,
    cos,
    fabs,
    hypot,
    remainder,
    sin,
    tan,
)
from swarmd.core.odometry_trail import ANEW, OdometryTrail
from swarmd.core.values import ZERO, Limits, Odometry, Scan, Twist
from swarmd.robot.protection.decision import Clearance, DecisionContext
from swarmd.robot.steering.openings import SIGHTINGS, Opening, Openings, gap_middle
from swarmd.robot.steering.recovery import Allows, Points
from swarmd.robot.steering.tracks import ScanReturns, Surroundings, Track, speed_of
from swarmd.robot.steering.way_settings import WaySettings

_way = WaySettings()
# m/s that are tried for a slower command; protection lets a robot creep at the last
_SPEEDS = (0.14, 0.1, 0.07, 0.04)
# A track comes from the side of the robot, or from the other side of the opening.
_THIS_SIDE = -1.0
_OTHER_SIDE = 1.0

# A tuple: the hash of a member of an Enum is a call of Python.
_SETTLED = (WayState.IN, WayState.BACK, WayState.WAIT, WayState.LINE)


class _Place(Struct, frozen=True, gc=False):
    """The pose of the robot in the frame of an opening, and the size of the opening."""

    along: float  # m from the begin of the opening along its axis; negative before the opening
    aside: float  # m to the left of the axis
    heading: float  # rad from the axis
    depth: float  # m of the opening along its axis
    half_width: float  # m, of the opening

    @property
    def is_in(self) -> bool:
        """True if others must wait for the robot."""
        if abs(self.aside) >= self.half_width + _way.in_beside:
            return False
        is_on_axis = abs(self.aside) < _way.aligned_share * self.half_width
        is_aligned = abs(self.heading) < _way.aligned and is_on_axis
        return self.along > -_way.in_anyhow or (self.along > -_way.in_before and is_aligned)

    @property
    def leaves_free(self) -> bool:
        """True if others can pass the robot."""
        return abs(self.aside) > self.half_width + _way.beside or self.along < -_way.free

    @property
    def to_line_up(self) -> float:
        """The distance in m to the place at which a robot lines up."""
        return math.hypot(self.along + _way.line_up, self.aside)


class _PlacedTrack(Struct, frozen=True, gc=False):
    """Another moving object in the frame of an opening."""

    id: int
    along: float  # m from the begin of the opening along its axis
    aside: float  # m to the left of the axis


class _Traffic(Struct, frozen=True, gc=False):
    """What the other robots before and in an opening do."""

    is_busy: bool = False  # a robot comes out
    is_behind: bool = False  # another robot that wants to pass is nearer: this robot is behind
    is_met: bool = False  # this robot is in the opening; a robot comes towards it from deeper in
    is_close: bool = False  # another robot that goes in is close ahead
    is_queued: bool = False  # a robot that has not come out waits on the side of this robot


@cython.cclass
class RightOfWay:
    """Replaces the requested command of a robot before an opening. Times are in s, by argument."""

    state: WayState  # WayState
    _linear_limit: float  # m/s
    _angular_limit: float  # rad/s
    _lead: float  # s of a requested turn that are looked ahead
    _rng: Random
    _openings: Openings
    # Of the last command: the tracks in the base frame, and the pose of the base.
    _surroundings: Surroundings
    _x: float  # the pose by odometry at the last command
    _y: float
    _yaw: float
    _trail: OdometryTrail
    _passed_at: float
    _speed: float  # m/s; the fastest speed requested so far, as in recovery
    _opening: Opening | None  # the chosen one; None: requests pass
    _sign: float  # 1 or -1: the way through, along the angle of the opening or opposite
    _chosen_at: float  # when the opening was chosen
    _wanted_yaw: float  # rad, the direction of the request in the frame of the odometry
    # By the id of a track. `_sides`: _THIS_SIDE or _OTHER_SIDE, from which the track came.
    # `_farthest`: its farthest place in m along the axis. `_seen_since`: in s.
    _sides: dict[int, Any]
    _farthest: dict[int, float]
    _seen_since: dict[int, float]
    # By the id of a track that came out: s, when the robot last saw the track in the opening.
    # Dropped when the robot sees the track elsewhere.
    _within_at: dict[int, float]
    _came_out: set[int]  # ids of the tracks that have come out to this side
    _progress_along: float  # m along the axis: where the robot last made progress
    _progress_at: float  # s, when this was
    _is_backing: bool
    _busy_at: float  # when traffic last made the robot give way
    _keep_clear_for: float  # s after `_busy_at` in which the robot still gives way
    _waiting_side: float  # 1 left or -1 right of the axis; 0: not chosen
    _is_lined_up: bool
    # m to the left: the middle measured between the posts less that of the sightings; None before.
    _middle_offset: float | None
    _lean: float  # m to the left of the axis at which the robot drives in a corridor

    def __init__(
        self, clearance: Clearance, limits: Limits, seed: str, returns: ScanReturns | None = None
    ) -> None:
        """`seed` seeds the random choices. `returns`: what tracks share; None: its own."""
        self._linear_limit = limits.linear
        self._angular_limit = limits.angular
        lead = limits.linear / limits.angular if limits.angular > 0.0 else _way.lead
        self._lead = min(max(lead, _way.least_lead), _way.most_lead)
        self._rng = Random(f"way {seed}")
        self._openings = Openings(clearance.body, returns)
        self._trail = OdometryTrail()
        self._passed_at = -INFINITY
        self.reset()

    def reset(self) -> None:
        """Forget the request; keep all openings that the robot knows."""
        self._speed = _way.unknown_speed_share * self._linear_limit
        self._release()

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading. If it begins the trail anew, all openings are forgotten."""
        if self._trail.take(odometry) == ANEW:
            self._openings.clear()
            self._release()

    def _release(self) -> None:
        """Drop the chosen opening: requests pass until another opening is on the way."""
        self._opening = None
        self._middle_offset = None
        self.state = WayState.NONE
        self._wanted_yaw = 0.0
        self._keep_clear_for = 0.0
        self._waiting_side = 0.0
        self._sides = {}
        self._farthest = {}
        self._seen_since = {}
        self._within_at = {}
        self._came_out = set()
        self._progress_along = -INFINITY
        self._progress_at = -INFINITY
        self._busy_at = -INFINITY
        self._is_backing = False
        self._is_lined_up = False
        self._lean = 0.0

    @property
    def is_settled(self) -> bool:
        """True in the states in which avoidance and recovery leave the command as it is."""
        return self.state in _SETTLED

    def passed(self, context: DecisionContext) -> Avoided | None:
        """The opening because of which the request is replaced; None while no opening is."""
        opening: Opening | None = self._opening
        odometry = context.odometry
        if self.state is WayState.NONE or opening is None or odometry is None:
            return None
        trail: OdometryTrail = self._trail
        trail.set_pose(trail.latest + (context.odometry_age or 0.0))
        x = opening.x - trail.x
        y = opening.y - trail.y
        bearing = remainder(atan2(y, x) - trail.yaw, TURN)
        return Avoided(bearing, math.hypot(x, y), self.state)

    def observe(self, scan: Scan, offset: tuple[float, float], context: DecisionContext) -> None:
        """Take in a conditioned scan; `offset`: m, the place of the sensor in the base frame.

        Sets `_lean`.
        """
        odometry = context.odometry
        self._lean = 0.0
        if self._opening is not None and scan.ages is not None:
            self._lean = _way.lean * _older_to_the_right(view(scan.ages), view(scan.bearings))
        # Read with each scan: the tracker takes in the scan next.
        tracks: tuple[Track, ...] = () if self._surroundings is None else self._surroundings.tracks
        if odometry is None or context.odometry_age is None:
            return
        self.on_odometry(odometry)
        if abs(odometry.twist.angular) > _way.turning:
            return
        scan_age = (scan.newest_age or 0.0) + context.scan_delay
        pose = self._trail.pose_at(self._trail.latest + context.odometry_age - scan_age)
        c = cos(self._yaw)
        s = sin(self._yaw)
        track: Track
        placed: list[Any] = []
        for track in tracks:
            x, y = _moved(track.x, track.y, self._x, self._y, c, s)
            placed.append((x, y, track.radius))
        self._openings.observe(scan, offset, pose, context.now, tuple(placed), self._opening)

    def command(
        self,
        requested: Twist,
        context: DecisionContext,
        surroundings: Surroundings,
        safe_for: Allows,
        points: Points,
    ) -> Twist:
        """The command that replaces `requested`; `requested` itself if no opening is on the way.

        Args:
            requested: the command of the pattern.
            context: the time and the odometry.
            surroundings: the tracks (other moving objects) in the base frame.
            safe_for: gives the command that protection would make of any command.
            points: gives the returns of the scan, (n, 2) in m in the base frame.
        """
        odometry = context.odometry
        odometry_age = context.odometry_age
        now = context.now
        if odometry is None or odometry_age is None:
            return requested
        self.on_odometry(odometry)

        # 1. The pose of the base, and the direction of the request.
        trail: OdometryTrail = self._trail
        trail.set_pose(trail.latest + odometry_age)
        base_x = trail.x
        base_y = trail.y
        yaw = trail.yaw
        self._surroundings = surroundings
        self._x = base_x
        self._y = base_y
        self._yaw = yaw
        linear = requested.linear
        angular = requested.angular
        lateral = requested.lateral
        if linear == 0.0 and angular == 0.0 and lateral == 0.0:
            self._release()
            return requested
        # m/s, the fastest that was requested so far.
        self._speed = max(self._speed, speed_of(linear, lateral))
        self._wanted_yaw = self._requested_yaw(linear, angular, lateral, yaw)

        # 2. Chooses an opening, if none is chosen, and places the robot in its frame.
        if self._opening is None:
            self._choose(base_x, base_y, now)
        opening: Opening | None = self._opening
        if opening is None:
            return requested
        along, aside = opening.to_local(base_x, base_y, self._sign)
        begin, end = opening.ends(self._sign)
        depth = end - begin
        along -= begin
        yaw_off = yaw - opening.angle - (0.0 if self._sign > 0.0 else math.pi)
        heading = remainder(yaw_off, TURN)

        # 3. Drops the opening once it is passed, far away, not on the way, or after `give_up` s.
        tracks: tuple[Track, ...] = surroundings.tracks
        is_passed = along > depth + _way.beyond
        if is_passed and tracks:
            self._passed_at = now  # others are near: next time this robot lets them pass longer
        cos_to_request = cos(self._wanted_yaw - opening.angle) * self._sign
        is_too_long = now - self._chosen_at > _way.give_up
        if is_passed or along < -_way.too_far or cos_to_request < _way.leads_away or is_too_long:
            self._release()
            return requested

        # 4. Places the tracks that persist in the frame of the opening. New tracks may be walls.
        c = cos(yaw)
        s = sin(yaw)
        track: Track
        others = []
        seen_since = {}
        for track in tracks:
            id = track.id
            since = self._seen_since.get(id, now)
            seen_since[id] = since
            if now - since >= _way.persists:
                x, y = _moved(track.x, track.y, base_x, base_y, c, s)
                x, y = opening.to_local(x, y, self._sign)
                others.append(_PlacedTrack(id, x - begin, y))
        self._seen_since = seen_since
        for by_track in (self._sides, self._farthest):
            for id in by_track.keys() - seen_since.keys():
                del by_track[id]
        self._came_out &= seen_since.keys()
        place = _Place(along, aside, heading, depth, opening.half)
        return self._decide_state(place, others, now, safe_for, points)

    def _requested_yaw(self, linear: float, angular: float, lateral: float, yaw: float) -> float:
        """The direction of a request (m/s, rad/s) in rad in the frame of the odometry.

        `yaw` in rad is that of the robot. A request to drive backwards counts as one without that
        speed. A request to turn on the spot does not say how far the robot wants to turn. So the
        direction of the last request stays in force if that direction lies on the side of the turn,
        or straight behind the robot.
        """
        bearing = atan2(lateral + self._lead * angular, max(linear, 0.0))
        if fabs(bearing) > _way.sideways and lateral == 0.0:
            bearing_before = remainder(self._wanted_yaw - yaw, TURN)
            if bearing_before * bearing > 0.0 and fabs(bearing_before) > _way.sideways:
                bearing = bearing_before
            elif PI - fabs(bearing_before) < _way.reversed:
                bearing = copysign(PI, bearing)
        return yaw + bearing

    def _choose(self, x: float, y: float, now: float) -> None:
        """Choose the nearest opening through which the request leads, or into whose wall it leads.

        Sets `_opening` and `_sign` (the direction through the opening), and resets what belongs to
        another opening. Nothing changes if no opening is on the way. `x`, `y`: the place in m of
        the base in the frame of the odometry.
        """
        opening: Opening
        nearest = INFINITY
        chosen = None
        for opening in self._openings.known:
            # 1. Skips an opening that was seen too rarely, or whose wall the request leads along.
            angle = remainder(self._wanted_yaw - opening.angle, TURN)
            if opening.hits < SIGHTINGS or fabs(fabs(angle) - 0.5 * PI) < _way.along_wall:
                continue

            # 2. Skips an opening that the robot has passed, or beside which the robot is.
            sign = 1.0 if fabs(angle) < 0.5 * PI else -1.0
            along, aside = opening.to_local(x, y, sign)
            begin, end = opening.ends(sign)
            along -= begin
            if along > end - begin or (along > -_way.in_anyhow and fabs(aside) > opening.half):
                continue

            # 3. Does the request lead into the opening or its wall? `meets_aside`: m to the left of
            # the axis where the request meets the begin of the opening, or where the robot is if it
            # is beyond the begin. (tan is the same for the opposite way through.)
            meets_aside = aside - min(along, 0.0) * tan(angle)
            wall_length = opening.left if meets_aside * sign > 0.0 else opening.right
            leads_in = fabs(meets_aside) < opening.half and along > -_way.max_ahead
            leads_to_wall = along > -_way.wall_distance and fabs(meets_aside) < wall_length
            distance = hypot(min(along, 0.0), aside)
            if (leads_in or leads_to_wall) and distance < nearest:
                nearest = distance
                chosen = (opening, sign)
        if chosen is None:
            return

        # 4. Begins with the chosen opening.
        wanted_yaw = self._wanted_yaw
        self._release()
        self._wanted_yaw = wanted_yaw
        self._chosen_at = now
        self._opening, self._sign = chosen
        if now - self._passed_at < _way.recently:
            self._busy_at = now
            self._keep_clear_for = self._rng.uniform(_way.least_passed, _way.most_passed)

    def _judge_traffic(self, place: _Place, others: list[_PlacedTrack], now: float) -> _Traffic:
        """What the other robots before and in the opening do.

        Stores in `_sides` from which side each track came, in `_farthest` how far each track came,
        in `_within_at` which tracks are in the opening, and in `_came_out` which have left it.

        `place`: the place of this robot in the frame of the opening. `others`: the tracks (other
        moving objects) in the same frame. `now`: s.
        """
        is_busy = False
        is_behind = False
        is_met = False
        is_close = False
        is_queued = False
        for id, along, aside in map(astuple, others):
            # 1. The side from which the track came. The side stays while the track is within or
            # near the opening.
            came_from = self._sides.get(id)
            is_within = -_way.threshold < along < place.depth + _way.threshold
            if not is_within:
                self._within_at.pop(id, None)
                if came_from == _OTHER_SIDE and along < 0.0:
                    self._came_out.add(id)
            is_near = abs(aside) < _way.queue_far and -_way.queue_far < along < -_way.queue_near
            is_queued |= is_near and id not in self._came_out
            if came_from is None or not is_within:
                border = _way.first_seen_in if came_from is None else 0.5 * place.depth
                came_from = self._sides[id] = _THIS_SIDE if along < border else _OTHER_SIDE

            # 2. Skips a track that is neither before nor in the opening.
            max_aside = place.half_width + (-_way.narrower if along > -_way.in_wall else _way.wider)
            if not -_way.before < along < place.depth + _way.after or abs(aside) > max_aside:
                continue
            # How far it came; forgotten once it is back more than `line_up` before the opening.
            farthest = max(self._farthest.get(id, along) if along > -_way.line_up else along, along)
            self._farthest[id] = farthest

            # 3. What the track does.
            backs_out = farthest > -_way.in_before and along < farthest - _way.backs_out
            is_ahead = along > place.along
            if came_from == _OTHER_SIDE or backs_out:
                # The track comes out. Compares the m that each robot would have to back out.
                own_way = place.along + _way.in_before
                other_way = place.depth + _way.in_before - along
                is_in_or_through = along < place.depth + _way.in_before
                if place.is_in and is_ahead:
                    meets = along - place.along < _way.meeting + place.depth
                    is_met |= meets and other_way > max(own_way, 0.0)
                elif is_in_or_through or along - place.depth < -place.along:
                    is_busy = True  # the track is in or through the opening, or nearer to it
                    if is_within:
                        self._within_at[id] = now
            elif is_ahead and along > -_way.in_before:  # the track goes in ahead of the robot
                is_close |= (
                    along - place.along < _way.follow and along < place.depth + _way.follow_beyond
                )
            elif hypot(along + _way.line_up, aside) < place.to_line_up:
                is_behind = True  # the track is nearer to the place to line up
        return _Traffic(is_busy, is_behind, is_met, is_close, is_queued)

    def _decide_state(
        self,
        place: _Place,
        others: list[_PlacedTrack],
        now: float,
        safe_for: Allows,
        points: Points,
    ) -> Twist:
        """The command at a place before or in the chosen opening; sets `state`.

        ZERO if the opening turns out to be wrong; then it is forgotten, and none is chosen.

        Args:
            place: the place of this robot in the frame of the opening.
            others: the tracks (other moving objects) in the same frame.
            now: s.
            safe_for: gives the command that protection would make of any command.
            points: gives the returns of the scan in the base frame.
        """
        # 1. Corrects all places by the measured middle of the opening.
        self._find_middle(place, points)
        middle_offset = self._middle_offset or 0.0
        if abs(middle_offset) > _way.wrong_by and self._openings.forget(self._opening):
            self._release()  # the sightings took a robot for a post
            return ZERO
        place = replace(place, aside=place.aside - middle_offset)
        others = [_PlacedTrack(o.id, o.along, o.aside - middle_offset) for o in others]

        # 2. Judges the traffic. The time to keep clear counts from the last decision with traffic,
        # and is random, so that two robots do not enter together. Then the state.
        traffic = self._judge_traffic(place, others, now)
        self._update_progress(place, traffic, now)
        if traffic.is_met or traffic.is_busy or self._is_backing:
            has_passed = now - self._passed_at < _way.recently
            self._busy_at = now
            if has_passed:
                self._keep_clear_for = self._rng.uniform(_way.least_passed, _way.most_passed)
            else:
                self._keep_clear_for = self._rng.uniform(_way.least_clear, _way.most_clear)
        self.state = self._next_state(place, traffic, now)
        return self._request(place, safe_for)

    def _update_progress(self, place: _Place, traffic: _Traffic, now: float) -> None:
        """Set `_is_backing`, and store where and when the robot last made progress."""
        is_stuck = now - max(self._progress_at, self._chosen_at) > _way.stuck
        has_moved = abs(place.along - self._progress_along) > _way.progress
        if not place.is_in:
            self._is_backing = False
        elif traffic.is_met:
            self._is_backing = True
        elif is_stuck:  # tries the other way
            self._is_backing = not self._is_backing
        elif not has_moved:
            return
        self._progress_along = place.along
        self._progress_at = now

    def _next_state(self, place: _Place, traffic: _Traffic, now: float) -> WayState:
        """The state by the first of eight rules whose condition is true.

        The state before does not count. What the rules remember does, and is updated: whether the
        robot is lined up (on the axis before the opening).
        """
        # Rule 1: a robot in an opening that meets a robot coming towards it backs out until it has
        # left the opening. A robot that made no progress for `stuck` s reverses its direction.
        if self._is_backing:
            return WayState.BACK

        # Rule 2: a robot in an opening that does not back out passes the opening.
        if place.is_in:
            return WayState.IN

        # Rules 3 and 4: the robot must give way
        # a) while a robot comes out, and for a random time after that;
        # b) while another robot that wants to pass is nearer to the opening;
        # c) while a robot that was last seen in the opening may still be there;
        # d) for `lets_pass` s after a passage, while a robot that has not come out of the opening
        #    waits on its side.
        hidden_for = _way.hidden + self._keep_clear_for
        self._within_at = {id: at for id, at in self._within_at.items() if now - at < hidden_for}
        lets_pass = traffic.is_queued and now - self._passed_at < _way.lets_pass
        keeps_clear = now - self._busy_at < self._keep_clear_for
        if keeps_clear or traffic.is_behind or self._within_at or lets_pass:
            return self._giving_way(place)

        # Rule 5: the robot is not lined up. It becomes lined up at a place `line_up` m before the
        # opening, or on the axis farther away, and stays lined up while it is near the axis.
        is_on_axis = abs(place.aside) < _way.on_axis and place.along < -_way.on_axis_far
        self._is_lined_up |= place.to_line_up < _way.at_line_up or is_on_axis
        most_off_axis = (
            _way.off_axis
            if place.along < -_way.off_axis_near
            else _way.off_axis_share * place.half_width
        )
        self._is_lined_up &= abs(place.aside) < most_off_axis
        if not self._is_lined_up:
            return WayState.GO

        # Rule 6: another robot that goes in is close ahead.
        if traffic.is_close:
            return WayState.WAIT

        # Rules 7 and 8: the robot has reached the place `line_up` m before the opening, or not yet.
        is_at_line_up = place.along > -_way.line_up - _way.nearly_lined_up
        return WayState.LINE if is_at_line_up else WayState.APPROACH

    def _giving_way(self, place: _Place) -> WayState:
        """Rule 3 where others can pass the robot: it stands. Rule 4 elsewhere: it clears the way.

        The robot counts as not lined up from now on.
        """
        self._is_lined_up = False
        return WayState.WAIT if place.leaves_free else WayState.ASIDE

    def _request(self, place: _Place, safe_for: Allows) -> Twist:
        """The command of the present state at a place in the frame of the opening.

        `safe_for` gives the command that protection would make of any command.
        """
        state = self.state
        if state is WayState.BACK:  # turns the rear to a place on the axis behind, and drives there
            behind = atan2(-place.aside, -_way.back_aim) + PI - place.heading
            behind = remainder(behind, TURN)
            turn = min(max(behind, -_way.back_turn), _way.back_turn)
            if fabs(behind) > 0.5 * PI:  # it faces the way out: backwards would lead farther in
                way_out = self._drive(place.along - _way.back_aim, 0.0, place)
                return self._fastest(way_out, safe_for)
            return self._fastest(Twist(-_way.back_share * self._speed, turn), safe_for)
        if state is WayState.IN or state is WayState.LINE:
            is_in_corridor = place.depth > _way.deep and place.along > -_way.lean_from
            leans = is_in_corridor and state is WayState.IN
            most = _way.aligned_share * place.half_width
            lean = min(max(self._lean, -most), most) if leans else 0.0
            return self._fastest(self._drive(place.along + _way.pursuit, lean, place), safe_for)
        if state is WayState.APPROACH:
            return self._drive(place.along + _way.pursuit, 0.0, place)
        if state is WayState.GO:
            return self._drive(-_way.line_up, 0.0, place)
        if state is WayState.ASIDE:  # to the side of the axis on which the robot is, else right
            # A chosen side stays until the robot is clearly on the other side.
            least_aside = _way.keeps_side if self._waiting_side else _way.has_side
            if abs(place.aside) > least_aside:
                self._waiting_side = copysign(1.0, place.aside)
            elif not self._waiting_side:
                self._waiting_side = -1.0
            along = min(place.along, -_way.aside_far) - _way.aside_step
            aside = self._waiting_side * (place.half_width + _way.beside + _way.farther_beside)
            return self._drive(along, aside, place)
        # A robot that waits faces the place where it will line up.
        bearing = atan2(-place.aside, -_way.line_up - place.along) - place.heading
        error = remainder(bearing, TURN)
        if not place.leaves_free or fabs(error) < _way.faces:
            return ZERO
        return Twist(0.0, min(max(_way.gain * error, -_way.facing), _way.facing))

    def _find_middle(self, place: _Place, points: Points) -> None:
        """Measure `_middle_offset`, the m to the left of the axis at which the middle is.

        The middle lies between two neighbouring returns whose gap is as wide as the opening. The
        axis of sightings from afar is off by 1 cm, and by more where a sighting took a robot for a
        post. With 1 cm off the middle, protection allows half of the speed between the posts.
        """
        if not -_way.line_up - _way.nearly_lined_up < place.along < place.depth + _way.past_posts:
            return
        offset = self._middle_offset
        # Returns count beside the robot and shortly ahead, but only near the opening.
        from_m = max(place.along - _way.posts_behind, -_way.at_post)
        to_m = min(max(place.along, 0.0) + _way.posts_ahead, place.depth + _way.at_post)
        measured = gap_middle(
            points(),
            (place.along, place.aside, place.heading),
            (from_m, to_m),
            (2.0 * place.half_width, _way.same_width),
            (offset or 0.0, place.half_width + _way.at_post),
        )
        if measured is None:
            return
        self._middle_offset = (
            measured if offset is None else offset + _way.weight * (measured - offset)
        )

    def _fastest(self, twist: Twist, safe_for: Allows) -> Twist:
        """The command `twist`, slowed to the speed for which protection allows the fastest motion.

        For a fast command protection may choose a slow turn aside; for a slow command it lets the
        robot creep. So several speeds are tried.
        """
        fastest = abs(twist.linear)
        best_value = -INFINITY
        best = twist
        for speed in (fastest, *_SPEEDS):
            candidate = Twist(math.copysign(min(speed, fastest), twist.linear), twist.angular)
            allowed = safe_for(candidate)
            # m/s in the direction of the candidate; negative if protection reverses the motion.
            value = math.copysign(allowed.linear, allowed.linear * candidate.linear)
            value -= _way.turn_cost * abs(allowed.angular - candidate.angular)
            if value > best_value:
                best_value = value
                best = candidate
        return best

    def _drive(self, goal_along: float, goal_aside: float, place: _Place) -> Twist:
        """The command that drives from `place` to a goal, both in the frame of the opening.

        `goal_along` and `goal_aside` in m: the goal along the axis, and to the left of the axis. A
        robot near or in the opening drives backwards to a goal behind it.
        """
        bearing = math.atan2(goal_aside - place.aside, goal_along - place.along) - place.heading
        yaw_error = math.remainder(bearing, TURN)
        speed = self._speed
        is_near = place.along > -_way.line_up and abs(place.aside) < place.half_width
        is_goal_behind = goal_along < place.along and abs(yaw_error) > _way.backs_to
        if is_near and is_goal_behind:
            yaw_error = math.remainder(yaw_error - math.pi, TURN)
            speed = -speed
        turn = min(max(_way.gain * yaw_error, -self._angular_limit), self._angular_limit)
        return Twist(speed * math.pow(max(math.cos(yaw_error), 0.0), 2.0), turn)


def _older_to_the_right(ages: Doubles, bearings: Doubles) -> float:
    """The s by which the rays to the right are older, on average, than those to the left.

    `ages` in s and `bearings` in rad, (n,) each, of a conditioned scan. 0 if one side has no ray.
    """
    left = 0
    right = 0
    left_sum = 0.0
    right_sum = 0.0
    for i in range(len(bearings)):
        bearing = remainder(bearings[i], TURN)  # a driver may give 0 to TURN
        if fabs(bearing - _way.abeam) < _way.abeam_width:
            left += 1
            left_sum += ages[i]
        elif fabs(bearing + _way.abeam) < _way.abeam_width:
            right += 1
            right_sum += ages[i]
    if left == 0 or right == 0:
        return 0.0
    return right_sum / right - left_sum / left


def _moved(
    x: float, y: float, base_x: float, base_y: float, c: float, s: float
) -> tuple[cython.double, cython.double]:
    """A place in m in the frame of the odometry; `x`, `y`: in the base frame.

    `base_x`, `base_y` in m and the cosine `c` and sine `s` of the yaw: the pose of the base.
    """
    return base_x + c * x - s * y, base_y + s * x + c * y
