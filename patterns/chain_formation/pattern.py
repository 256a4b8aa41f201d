"""Chain formation: robots form a chain from a nest to a goal that is not seen from there.

Source: Nouyan, Gross, Bonani, Mondada and Dorigo, "Teamwork in self-organized robot colonies", IEEE
Trans. Evolutionary Computation 13, 2009, with the chains of Nouyan, Campo and Dorigo, "Path
formation in a robot swarm", Swarm Intelligence 2, 2008: an explorer moves along a chain to its
tail, and there joins the chain at the rate `join`. The robot at the tail leaves the chain at the
rate `leave`, unless that robot sees the goal, and goes back to the nest. Members keep their
distance and align.

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

_CHANNEL, _WALK = "chain", "walk"
_MAX_HOPS, _GOAL = 10_000, -1
_NEAR, _FAR = 0.8, 1.3  # of the distance: explorers join from here, and pass a member up to here
_LANE, _SLACK = 0.6, 0.2  # of the distance: explorers keep right, and members rest within
_KEEP = 1.2  # of the sight: a member that has seen the goal sees it up to here
Vector = tuple[float, float]


class _Member(NamedTuple):
    hops: int  # to the nest; _GOAL: the robot is the goal
    before: str  # id of the next robot on the way to the nest
    leads: bool  # its chain has the goal in sight
    at: float


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
        self._own: _Member | None = None  # as a member
        self._by = ""  # the member that an explorer is at, or on its way to
        self._is_homeward = self._starts = False
        self._side, self._share_at = 1.0, 0.0

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """The search."""
        speed, clearance = self.params.speed, self.params.clearance
        return {
            _WALK: self.context.make("random_walk", part=_WALK, speed=speed, clearance=clearance)
        }

    def step(self, inputs: Inputs) -> Outputs:
        """The command of the state, and the message of a member."""
        now, params = inputs.now, self.params
        self._hear(inputs)
        state: str = params.role
        if params.role != "robot":
            twist = ZERO
            hops = 0 if params.role == "nest" else _GOAL
            self._own = _Member(hops, "", self._leads(), now)
        elif inputs.scan is None:
            return Outputs()
        elif self._own is not None:
            twist = self._hold(inputs, self._own)
            state = "home" if self._own is None else "chain"
        elif self._places:
            twist = self._explore(inputs)
            moving = "home" if self._is_homeward else "explore"
            state = "chain" if self._own is not None else "rest" if twist == ZERO else moving
        else:
            self._by, self._is_homeward = "", False
            twist, state = self.step_part(_WALK, inputs).twist or ZERO, "search"
        own, sent = self._own, dict[str, Value]()
        if own is not None and now >= self._share_at:
            self._share_at = now + params.share_period
            sent[_CHANNEL] = [own.hops, own.before, own.leads]
        report: dict[str, Scalar] = {"state": state, "hops": _GOAL, "leads": False}
        if own is not None:
            report.update(hops=own.hops, leads=own.leads)
        return Outputs(twist, sent, report)

    def _hear(self, inputs: Inputs) -> None:
        """Keep the latest messages of members, and the places of the members that are sensed."""
        now = inputs.now
        for message in inputs.messages:
            match (message.channel == _CHANNEL) and message.value:
                case [int(hops), str(before), bool(leads)] if _GOAL <= hops < _MAX_HOPS:
                    at = now - message.age
                    self._heard[message.sender] = _Member(int(hops), before[:64], leads, at)
        since = now - self.params.lease
        self._heard = {name: member for name, member in self._heard.items() if member.at >= since}
        self._goal, self._places = math.inf, {}
        for neighbor in inputs.neighbors:
            member = self._heard.get(neighbor.id)
            distance, bearing = neighbor.distance, neighbor.bearing
            if member is None or distance is None or bearing is None:
                continue
            if member.hops == _GOAL:
                self._goal = min(self._goal, distance)
                continue
            self._places[neighbor.id] = distance * math.cos(bearing), distance * math.sin(bearing)

    def _after(self, name: str) -> list[str]:
        """The sensed members that name `name` as the member before them."""
        return sorted(member for member in self._places if self._heard[member].before == name)

    def _leads(self) -> bool:
        """Whether this robot sees the goal, or a member behind it leads to the goal."""
        keep = _KEEP if self._own is not None and self._own.leads else 1.0
        return self._goal <= keep * self.params.sight or any(
            self._heard[name].leads for name in self._after(self.context.robot)
        )

    def _hold(self, inputs: Inputs, own: _Member) -> Twist:
        """The command of a member: keep the place in the chain, or leave the chain (zero)."""
        params = self.params
        robot = self.context.robot
        before = self._places.get(own.before)
        near = _NEAR * params.distance
        leads = self._leads()
        is_tail = not self._after(robot)
        # If two near members are behind the same member, one leaves. The member that stays leads to
        # the goal, else has a chain behind it, else has the lower id.
        is_double = any(
            (not self._heard[name].leads, not self._after(name), name) < (not leads, is_tail, robot)
            and math.hypot(*self._places[name]) < near
            for name in self._after(own.before)
        )
        is_loose = is_tail and not leads
        is_over = is_loose and float(self.context.rng.random()) < params.leave * inputs.dt
        if before is None or is_double or is_over:
            self._own = None
            self._by = own.before
            self._is_homeward = True
            return ZERO
        self._own = _Member(self._heard[own.before].hops + 1, own.before, leads, inputs.now)
        if leads:
            return ZERO
        x, y = self._beyond(own.before)
        if math.hypot(x, y) <= _SLACK * params.distance:
            x = y = 0.0
        if self._own.hops == 1:
            x, y = x + params.sweep * before[1], y - params.sweep * before[0]
        if not (x or y):
            return ZERO
        return drive_along(x, y, speed=params.speed, turn=params.turn)

    def _beyond(self, name: str) -> Vector:
        """The place `distance` m behind the member `name`, in line with the member before it."""
        x, y = self._places[name]
        far_x, far_y = self._places.get(self._heard[name].before, (2.0 * x, 2.0 * y))
        way = math.hypot(x - far_x, y - far_y) or 1.0
        share = self.params.distance / way
        return x + share * (x - far_x), y + share * (y - far_y)

    def _explore(self, inputs: Inputs) -> Twist:
        """The command of an explorer: along the chain to its tail, or home to the nest.

        At the tail, or at the nest if a new chain may start, the robot may join. At the tail of a
        chain that leads to the goal the robot rests.
        """
        params, places = self.params, self._places
        if self._by not in places:
            self._by = min(places, key=lambda name: math.hypot(*places[name]))
            self._starts = False
        by, is_near = self._by, math.hypot(*places[self._by]) <= _FAR * params.distance
        if is_near:
            self._by = self._next(by)
        is_end = is_near and self._by == by  # of a chain, or the nest, where another may start
        if is_end and self._heard[by].leads and not self._starts and not self._is_homeward:
            return ZERO
        nearest = min(math.hypot(*place) for place in places.values())
        may_join = is_end and not self._is_homeward and nearest >= _NEAR * params.distance
        if may_join and float(self.context.rng.random()) < params.join * inputs.dt:
            self._own = _Member(self._heard[by].hops + 1, by, False, inputs.now)
            return ZERO
        x, y = places[self._by]
        away = math.hypot(x, y) or 1.0
        if is_end and self._starts:  # around the nest
            pull = (away - params.distance) / params.distance
            x, y = pull * x / away + self._side * y / away, pull * y / away - self._side * x / away
        elif is_end:
            x, y = self._beyond(self._by)
        else:
            lane = _LANE * params.distance / away
            x, y = x + lane * y, y - lane * x
        length = math.hypot(x, y)
        share = min(1.0, 4.0 * length) / length if length > 1e-6 else 0.0
        x, y = share * x, share * y
        return NearPoints(()).steer(x, y, params.speed, params.turn, spacing=0.0, brake=1.0)

    def _next(self, by: str) -> str:
        """The member to go to from `by`.

        1. At the nest, on arrival: a chain that leads to the goal if there is one. Else any chain,
           or seldom none, which starts a chain: long chains find the goal.
        2. At the nest with a chain to start, or without a member to go to: `by` itself.
        3. Homeward: the member before. Else the member after, and at a tail `by` itself.
        """
        here, after = self._heard[by], self._after(by)
        if here.hops == 0:
            leading = [name for name in after if self._heard[name].leads]
            if self._is_homeward or leading or not self._starts:
                self._is_homeward = False
                choices = leading or [*after, *after, ""]
                chosen = choices[int(self.context.rng.integers(len(choices)))]
                self._starts = not chosen
                self._side = float(self.context.rng.choice((-1.0, 1.0)))
                return chosen or by
            return by
        if self._is_homeward:
            return here.before if here.before in self._places else by
        return after[0] if after else by
