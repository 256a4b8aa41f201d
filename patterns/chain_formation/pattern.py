"""Chain formation: robots form a chain from a nest to a goal that is not seen from there.

Source: Nouyan, Gross, Bonani, Mondada and Dorigo, "Teamwork in self-organized robot colonies", IEEE
Trans. Evolutionary Computation 13, 2009, with the chains of Nouyan, Campo and Dorigo, "Path
formation in a robot swarm", Swarm Intelligence 2, 2008. An explorer moves along a chain to the
chain's tail, and joins there at the rate `join`. The robot at the tail leaves the chain at the rate
`leave`, unless the robot sees the goal, and goes back to the nest. Members keep their distance and
align.

Ours: members send their number of hops to the nest and the id of the member before them. In the
source three colours show the direction instead. Nest and goal are robots that stand. Members also
send whether their chain leads to the goal. Explorers at the nest choose such a chain, and rest at
its tail.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple

from swarmd.api import (
    ZERO,
    CombinedPattern,
    Context,
    Inputs,
    Lease,
    NearPoints,
    Outputs,
    Params,
    Pattern,
    Scalar,
    SharePeriod,
    TopSpeed,
    TopTurn,
    Twist,
    Value,
    WalkClearance,
    about,
    drive_along,
    of_threshold,
)

_CHANNEL = "chain"
_WALK = "walk"
_MAX_HOPS = 10_000
# The hops that the goal sends, and that a robot without a place in a chain reports.
_GOAL = -1
_NO_HOPS = -1
# In multiples of the distance of members: a member that is nearer than _MIN_GAP is too near, and
# an explorer that is within _ARRIVAL of a member is at the member.
_MIN_GAP = 0.8
_ARRIVAL = 1.3
# In multiples of the same distance: explorers drive _LANE to the right of the chain, and a member
# within _SLACK of its place rests.
_LANE = 0.6
_SLACK = 0.2
# m to the target from which on an explorer drives at full speed.
_FULL_SPEED_M = 0.25
# In multiples of `sight`: a member that has seen the goal counts it as seen up to this distance.
_SIGHT_HYSTERESIS = 1.2
Vector = tuple[float, float]


class _Member(NamedTuple):
    hops: int  # to the nest; _GOAL: the robot is the goal
    before: str  # id of the next robot on the way to the nest
    leads: bool  # its chain has the goal in sight
    heard_at: float  # time of the message


class ChainFormationParams(Params, frozen=True, kw_only=True):
    """The role, the distances, the rates and the speeds."""

    role: Annotated[
        Literal["robot", "nest", "goal"],
        about("nest and goal stand, and are the ends of the chain", source="ours"),
    ] = "robot"
    distance: Annotated[
        float,
        about(
            "distance of two members, from axle to axle",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ours: 1.6 times the protection threshold, to let explorers pass",
            derived=of_threshold(1.6),
        ),
    ]
    sight: Annotated[
        float,
        about(
            "a member sees the goal within",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ours: 1.25 times the distance of members",
            derived=of_threshold(2.0),
        ),
    ]
    join: Annotated[
        float,
        about(
            "rate at which an explorer joins at the tail of a chain",
            ge=0.0,
            le=10.0,
            unit="1/s",
            source="Nouyan et al. 2008, P_e-c; the value: ours",
        ),
    ] = 0.2
    leave: Annotated[
        float,
        about(
            "rate at which the tail of a chain leaves it; 0: chains stay",
            ge=0.0,
            le=10.0,
            unit="1/s",
            source="Nouyan et al. 2008, P_c-e; the value: ours",
        ),
    ] = 0.02
    sweep: Annotated[
        float,
        about(
            "rate at which a chain that does not lead to the goal turns about the nest",
            ge=0.0,
            le=1.0,
            unit="rad/s",
            source="Nouyan et al. 2008: chains that align, 0, or move; the value: ours",
        ),
    ] = 0.03
    speed: TopSpeed
    turn: TopTurn
    clearance: WalkClearance
    share_period: SharePeriod = 0.5
    lease: Lease = 2.5


class ChainFormation(CombinedPattern[ChainFormationParams]):
    """Searches the nest or a chain, explores a chain to its tail and joins there for a while."""

    group = "formation"
    params_type = ChainFormationParams
    needs = frozenset({"scan", "neighbors.distance", "neighbors.bearing"})
    channels = {_CHANNEL: list}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: ChainFormationParams, context: Context) -> None:
        super().__init__(params, context)
        self._heard: dict[str, _Member] = {}
        self._places: dict[str, Vector] = {}  # of members that are heard and sensed
        self._membership: _Member | None = None  # None: not a member of a chain
        self._waypoint = ""  # id of the member that an explorer is at, or drives to
        self._is_homeward = False  # drives back to the nest
        self._starts_chain = False  # circles the nest, to start a new chain
        self._turn_sign = 1.0  # of the circle around the nest; 1: clockwise
        self._share_at = 0.0

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """The search."""
        speed = self.params.speed
        clearance = self.params.clearance
        return {
            _WALK: self.context.make("random_walk", part=_WALK, speed=speed, clearance=clearance)
        }

    def step(self, inputs: Inputs) -> Outputs:
        """Drive by the robot's state; a member of a chain also sends its message.

        Nothing is sent or commanded without a scan, except by nest and goal.
        """
        now = inputs.now
        params = self.params
        self._hear(inputs)
        if inputs.scan is None and params.role == "robot":
            return Outputs()
        twist, state = self._command(inputs)
        member = self._membership
        messages = dict[str, Value]()
        if member is not None and now >= self._share_at:
            self._share_at = now + params.share_period
            messages[_CHANNEL] = [member.hops, member.before, member.leads]
        report: dict[str, Scalar] = {"state": state, "hops": _NO_HOPS, "leads": False}
        if member is not None:
            report.update(hops=member.hops, leads=member.leads)
        return Outputs(twist, messages, report)

    def _command(self, inputs: Inputs) -> tuple[Twist, str]:
        """The command, and the state to report; sets the membership of the robot in a chain.

        Nest and goal stand. A member holds its place, or leaves its chain. A robot that senses a
        member explores, or joins a chain. Any other robot searches by a random walk.
        """
        params = self.params
        if params.role != "robot":
            hops = 0 if params.role == "nest" else _GOAL
            self._membership = _Member(hops, "", self._leads(), inputs.now)
            return ZERO, params.role
        if self._membership is not None:
            twist = self._hold(inputs, self._membership)
            has_left = self._membership is None
            return twist, "home" if has_left else "chain"
        if not self._places:
            self._waypoint = ""
            self._is_homeward = False
            return self.step_part(_WALK, inputs).twist or ZERO, "search"
        twist = self._explore(inputs)
        has_joined = self._membership is not None
        if has_joined:
            return twist, "chain"
        if twist == ZERO:
            return twist, "rest"
        return twist, "home" if self._is_homeward else "explore"

    def _hear(self, inputs: Inputs) -> None:
        """Keep the latest messages of members, and the places of the members that are sensed.

        Sets `_heard`, `_places` and `_goal_distance` (m; inf if the goal is not sensed).
        """
        now = inputs.now
        for message in inputs.messages:
            match (message.channel == _CHANNEL) and message.value:  # False matches no case
                case [int(hops), str(before), bool(leads)] if _GOAL <= hops < _MAX_HOPS:
                    heard_at = now - message.age  # `hops` _GOAL: the sender is the goal
                    self._heard[message.sender] = _Member(int(hops), before[:64], leads, heard_at)
        oldest = now - self.params.lease
        self._heard = {
            name: member for name, member in self._heard.items() if member.heard_at >= oldest
        }
        self._goal_distance = math.inf
        self._places = {}
        for neighbor in inputs.neighbors:
            member = self._heard.get(neighbor.id)
            distance = neighbor.distance
            bearing = neighbor.bearing
            if member is None or distance is None or bearing is None:
                continue
            if member.hops == _GOAL:
                self._goal_distance = min(self._goal_distance, distance)
                continue
            self._places[neighbor.id] = distance * math.cos(bearing), distance * math.sin(bearing)

    def _after(self, name: str) -> list[str]:
        """The ids of the sensed members that send `name` as the id of the member before them."""
        return sorted(member for member in self._places if self._heard[member].before == name)

    def _leads(self) -> bool:
        """Whether this robot sees the goal, or a member behind it leads to the goal."""
        has_led = self._membership is not None and self._membership.leads
        hysteresis = _SIGHT_HYSTERESIS if has_led else 1.0
        return self._goal_distance <= hysteresis * self.params.sight or any(
            self._heard[name].leads for name in self._after(self.context.robot)
        )

    def _hold(self, inputs: Inputs, member: _Member) -> Twist:
        """The command that keeps this robot's place in its chain; zero if the robot leaves it.

        `member`: the robot's own membership. To leave, the robot sets `_membership` to None, and
        drives home. A robot leaves if the member before it is lost, and if `_must_yield`. The tail
        of a chain that does not lead to the goal leaves at the rate `leave`.
        """
        before_place = self._places.get(member.before)  # m, in the base frame
        leads = self._leads()
        is_tail = not self._after(self.context.robot)  # no member is behind this robot
        may_leave = is_tail and not leads
        # The rate `leave` in 1/s gives a probability for each step.
        leaves = may_leave and float(self.context.rng.random()) < self.params.leave * inputs.dt
        if before_place is None or leaves or self._must_yield(member, leads, is_tail):
            self._membership = None
            self._waypoint = member.before
            self._is_homeward = True
            return ZERO
        hops = self._heard[member.before].hops + 1
        self._membership = _Member(hops, member.before, leads, inputs.now)
        if leads:  # a chain that leads to the goal stands
            return ZERO
        return self._keep_place(member.before, before_place, is_first=hops == 1)

    def _must_yield(self, member: _Member, leads: bool, is_tail: bool) -> bool:
        """True if this robot must leave its place in the chain to a rival of higher rank.

        A rival is near, and follows the same member (`before`) as this robot. The criteria of the
        rank, the first that differs decides: a member whose chain leads to the goal ranks above a
        member without; a member that another member follows ranks above a tail; a lower id ranks
        above a higher id.

        Of this robot: `member` is its membership, `leads`: its chain leads to the goal, `is_tail`:
        no member follows it.
        """
        own_rank = (not leads, is_tail, self.context.robot)
        return any(
            (not self._heard[rival].leads, not self._after(rival), rival) < own_rank
            and math.hypot(*self._places[rival]) < _MIN_GAP * self.params.distance
            for rival in self._after(member.before)
        )

    def _keep_place(self, before: str, before_place: Vector, *, is_first: bool) -> Twist:
        """The command that keeps the place behind the member `before`, at `before_place` in m.

        The first member of a chain (`is_first`) also drives around the nest, at right angles to the
        direction of the nest, and the chain turns with this member.
        """
        params = self.params
        place_x, place_y = self._place_after(before)  # m, the place to keep
        is_at_place = math.hypot(place_x, place_y) <= _SLACK * params.distance
        # The velocity in m/s: 1 m/s for each m to the place, and `sweep` in rad/s about the nest.
        x, y = (0.0, 0.0) if is_at_place else (place_x, place_y)
        if is_first:
            nest_x, nest_y = before_place
            x = x + params.sweep * nest_y
            y = y - params.sweep * nest_x
        if not (x or y):
            return ZERO
        return drive_along(x, y, speed=params.speed, turn=params.turn)

    def _place_after(self, name: str) -> Vector:
        """The next place of the chain: `distance` m from the member `name`, away from the nest.

        The place is in m in the base frame, on the far side of `name` as seen from the member
        before `name` (towards the nest). If that member is not sensed: on the far side of `name` as
        seen from this robot.
        """
        x, y = self._places[name]
        before_x, before_y = self._places.get(self._heard[name].before, (2.0 * x, 2.0 * y))
        spacing = math.hypot(x - before_x, y - before_y) or 1.0
        scale = self.params.distance / spacing
        return x + scale * (x - before_x), y + scale * (y - before_y)

    def _explore(self, inputs: Inputs) -> Twist:
        """The command of an explorer: along a chain to its tail, or home to the nest.

        The waypoint is the member that the robot drives to. At a tail, or at the nest if the robot
        starts a new chain, the robot joins at the rate `join`: the command is zero, and
        `_membership` is set. At the tail of a chain that leads to the goal the robot rests, with
        the command zero. A robot on the way home neither joins nor rests.
        """
        params = self.params
        places = self._places
        if self._waypoint not in places:
            self._waypoint = min(places, key=lambda name: math.hypot(*places[name]))
            self._starts_chain = False
        waypoint = self._waypoint
        has_arrived = math.hypot(*places[waypoint]) <= _ARRIVAL * params.distance
        if has_arrived:
            self._waypoint = self._next_waypoint(waypoint)
        # No member comes next: at a tail, or at the nest if the robot starts a chain.
        is_at_end = has_arrived and self._waypoint == waypoint
        if is_at_end and not self._is_homeward:
            member = self._heard[waypoint]
            if member.leads and not self._starts_chain:
                return ZERO
            nearest_m = min(math.hypot(*place) for place in places.values())
            may_join = nearest_m >= _MIN_GAP * params.distance  # else two members are at one place
            if may_join and float(self.context.rng.random()) < params.join * inputs.dt:
                self._membership = _Member(member.hops + 1, waypoint, False, inputs.now)
                return ZERO
        x, y = self._way(is_at_end=is_at_end)
        # `steer` takes the length of a vector for the share of the speed.
        length = math.hypot(x, y)
        speed_share = min(1.0, length / _FULL_SPEED_M)
        scale = speed_share / length if length > 1e-6 else 0.0
        no_obstacles = NearPoints(())
        return no_obstacles.steer(
            scale * x, scale * y, params.speed, params.turn, spacing=0.0, brake=1.0
        )

    def _way(self, *, is_at_end: bool) -> Vector:
        """The vector in m in the base frame along which an explorer drives.

        On the way (not `is_at_end`) the vector leads to the waypoint, to the right of the chain, so
        that robots that come back can pass. At the end of the way the robot circles the nest if it
        starts a chain. Otherwise the vector leads to the next place of the chain.
        """
        distance = self.params.distance
        x, y = self._places[self._waypoint]
        range_m = math.hypot(x, y) or 1.0
        if is_at_end and not self._starts_chain:
            return self._place_after(self._waypoint)
        if not is_at_end:
            lane = _LANE * distance / range_m
            return x + lane * y, y - lane * x
        # Along the tangent of the circle, corrected by the error of the distance.
        sign = self._turn_sign
        error = (range_m - distance) / distance
        return (
            error * x / range_m + sign * y / range_m,
            error * y / range_m - sign * x / range_m,
        )

    def _next_waypoint(self, reached: str) -> str:
        """Choose the member to drive to next from the member `reached`; `reached` without any.

        At the nest an arriving robot draws a chain, from those that lead to the goal if there are
        any. Otherwise the robot draws from all chains or, less often, draws no chain: it then
        starts a chain (`_starts_chain`), and circles the nest in a random direction (`_turn_sign`).

        At any other member: the member before `reached` on the way home, the member after `reached`
        on the way out.
        """
        member = self._heard[reached]
        after = self._after(reached)
        if member.hops == 0:
            leading = [name for name in after if self._heard[name].leads]
            if self._is_homeward or leading or not self._starts_chain:
                self._is_homeward = False
                choices = leading or [*after, *after, ""]  # each chain twice as often as none
                chosen = choices[int(self.context.rng.integers(len(choices)))]
                self._starts_chain = not chosen
                self._turn_sign = float(self.context.rng.choice((-1.0, 1.0)))
                return chosen or reached
            return reached
        if self._is_homeward:
            return member.before if member.before in self._places else reached
        return after[0] if after else reached
