"""Leader following: a chain of robots, each at a time headway behind the robot before it.

Source: the constant time headway of Ioannou and Chien, "Autonomous intelligent cruise control",
IEEE Trans. Vehicular Technology 42, 1993: a robot aims at the gap standstill + headway x speed.
With a lag of the speed, speeds pass on along the chain by 1 / (headway lag s^2 + headway s + 1),
which amplifies no frequency where headway >= 2 lag: string stability (Ploeg, van de Wouw and
Nijmeijer, "Lp string stability of cascaded systems", IEEE Trans. Control Systems Technology 22,
2014).

Ours: behind the leader the robots follow in the order of their ids. Each robot follows the robot
that is next before it in this order among the robots that it senses. So the chain closes within
`lease` when a robot is lost. A robot that senses no earlier robot leads. The leader's id passes
down the chain by messages.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from swarmd.api import (
    Context,
    Inputs,
    Lease,
    Outputs,
    Params,
    Pattern,
    Recovery,
    Scalar,
    SharePeriod,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    of_threshold,
)

_CHANNEL = "leader"
_MAX_ID = 64  # characters of a robot's id


class _Predecessor(NamedTuple):
    """The robot before this robot in the chain, as sensed."""

    id: str
    distance: float  # m
    bearing: float  # rad


class LeaderFollowingParams(Params, frozen=True, kw_only=True):
    """The leader and its way, the gaps and the times."""

    speed: TopSpeed
    turn: TopTurn
    leader: Annotated[
        str,
        about("id of the leader; empty: the lowest id", source="ours: none without any choice"),
    ] = ""
    pace: Annotated[
        float,
        about(
            "the leader's share of `speed`, so that followers can catch up",
            ge=0.0,
            le=1.0,
            source="ours",
        ),
    ] = 0.5
    curve: Annotated[
        float,
        about("the leader's turn rate", ge=-4.0, le=4.0, unit="rad/s", source="ours: straight"),
    ] = 0.0
    standstill: Annotated[
        float,
        about(
            "gap to the robot before at rest, from axle to axle",
            ge=0.05,
            le=20.0,
            unit="m",
            source="Ioannou and Chien 1993; the value: the protection threshold",
            derived=of_threshold(1.0),
        ),
    ]
    headway: Annotated[
        float,
        about(
            "further gap for each m/s; string stable from twice the lag on",
            ge=0.05,
            le=60.0,
            unit="s",
            source="Ioannou and Chien 1993; the value: five lags",
        ),
    ] = 1.5
    lag: Annotated[
        float,
        about(
            "time constant of the speed, of the robot and its sensors together",
            ge=0.0,
            le=10.0,
            unit="s",
            source="Ploeg et al. 2014, tau; the value: ours",
        ),
    ] = 0.3
    lease: Lease = 2.0
    share_period: SharePeriod = 0.5
    recovery: Recovery = False


class LeaderFollowing(Pattern[LeaderFollowingParams]):
    """Follows the last sensed robot before it in the chain; leads without such a robot."""

    group = "move together"
    params_type = LeaderFollowingParams
    report_units = {"speed": "m/s"}  # noqa: RUF012 - a Mapping, as in the base
    needs = frozenset({"neighbors.distance", "neighbors.bearing"})
    channels = {_CHANNEL: str}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: LeaderFollowingParams, context: Context) -> None:
        super().__init__(params, context)
        self._sensed_at: dict[str, float] = {}  # s, by id of a robot before this robot
        self._leader = ""
        self._lost = ""
        self._speed = 0.0  # m/s, commanded
        self._share_at = 0.0
        self._started_at: float | None = None

    def step(self, inputs: Inputs) -> Outputs:
        """Follow the robot before this robot at a time headway, or lead; pass on the leader's id.

        The chain is in the order of ids behind the leader.
        """
        now = inputs.now
        params = self.params
        self._started_at = now if self._started_at is None else self._started_at
        predecessor = self._predecessor(inputs)
        if predecessor is not None:
            before_id = predecessor.id
            aim, turn = self._following(predecessor)
            self._adopt(inputs, before_id)
        elif self._sensed_at:
            # An earlier robot of the chain was sensed within `lease`: drive on at the same speed.
            before_id = max(self._sensed_at, key=self._chain_order)  # the last before this robot
            aim = self._speed
            turn = 0.0
        else:
            before_id = ""
            aim, turn = self._leading(now - self._started_at)
        # The lag is a first-order low-pass filter; without a lag the speed is the aim.
        gain = min(1.0, inputs.dt / params.lag) if params.lag > 0.0 else 1.0
        aim = max(-params.speed, min(params.speed, aim))
        self._speed += gain * (aim - self._speed)
        twist = Twist(self._speed, max(-params.turn, min(params.turn, turn)))
        report: dict[str, Scalar] = {
            "leader": self._leader,
            "before": before_id,
            "lost": self._lost,
            "speed": self._speed,
        }
        if not self._leader or now < self._share_at:
            return Outputs(twist, report=report)
        self._share_at = now + params.share_period
        return Outputs(twist, {_CHANNEL: self._leader}, report)

    def _following(self, predecessor: _Predecessor) -> tuple[float, float]:
        """The speed in m/s at which the gap is right, and the turn rate, not yet limited.

        The right gap is `standstill` plus the way in `headway` s at this speed.
        """
        aim = (predecessor.distance - self.params.standstill) / self.params.headway
        must_turn_first = abs(predecessor.bearing) > 0.5 * math.pi
        return (0.0 if must_turn_first else aim), 2.0 * predecessor.bearing  # 2 rad/s for each rad

    def _leading(self, run_time: float) -> tuple[float, float]:
        """The speed in m/s and the turn rate of a leader; takes the lead if another robot had it.

        `run_time`: s since the start. A robot stands at first: others may not be sensed yet.
        """
        if run_time < self.params.lease:
            return 0.0, 0.0
        if self._leader != self.context.robot:
            self._lost = self._leader
            self._leader = self.context.robot
        return self.params.pace * self.params.speed, self.params.curve

    def _predecessor(self, inputs: Inputs) -> _Predecessor | None:
        """The last sensed robot before this robot in the chain; None if none is sensed now.

        Also sets `_sensed_at`: the robots before this robot that were sensed within `lease`.
        """
        own_order = self._chain_order(self.context.robot)
        predecessor = None
        for neighbor in inputs.neighbors:
            order = self._chain_order(neighbor.id)
            if neighbor.distance is None or neighbor.bearing is None or order >= own_order:
                continue
            self._sensed_at[neighbor.id] = inputs.now
            if predecessor is None or order > self._chain_order(predecessor.id):
                predecessor = _Predecessor(neighbor.id, neighbor.distance, neighbor.bearing)
        oldest = inputs.now - self.params.lease
        self._sensed_at = {
            name: sensed_at for name, sensed_at in self._sensed_at.items() if sensed_at >= oldest
        }
        return predecessor

    def _chain_order(self, name: str) -> tuple[bool, str]:
        """The sort key of a robot in the chain: first the leader, then the other robots by id."""
        return name != self.params.leader, name

    def _adopt(self, inputs: Inputs, before: str) -> None:
        """Take the leader's id from the messages of the robot `before`."""
        for message in inputs.messages:
            name = message.value
            if message.channel != _CHANNEL or message.sender != before:
                continue
            if isinstance(name, str) and 0 < len(name) <= _MAX_ID and name != self._leader:
                self._lost = self._leader
                self._leader = name
