"""Hop gradient: the robots elect a leader, and each counts its hops to the leader.

Source: leader election by flooding the best id, in O(diameter) rounds (FloodMax: Lynch, Distributed
Algorithms, 1996, 4.1); hop counts by adding one to the least of the neighbours (distributed
Bellman-Ford; on robots the gradient of the Kilobots: Rubenstein, Cornejo and Nagpal, Science 345,
2014).

Ours: the leader sends a count that rises, and all other robots pass on the highest count that they
have received. A leader whose count no longer rises counts as dead. So the swarm elects a new leader
when the leader dies, and no hop count of a dead leader circulates for ever.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

from swarmd.api import (
    Context,
    Inputs,
    Lease,
    Message,
    Outputs,
    Params,
    Pattern,
    Recovery,
    Scalar,
    SharePeriod,
    Value,
    about,
)

_CHANNEL = "hops"
# Counts and hops are below this.
_MAX_COUNT = 1 << 40
_MAX_HOPS = 10_000
_MAX_LEADERS = 1000  # whose counts are remembered: a neighbour may name any


class _Leader(NamedTuple):
    """A candidate; the least is the best."""

    rank: int
    id: str


class _Heard(NamedTuple):
    leader: _Leader
    hops: int
    at: float


class HopGradientParams(Params, frozen=True, kw_only=True):
    """The source of the gradient, and the times."""

    source: Annotated[
        Literal["elected", "here", "elsewhere"],
        about(
            "elected: the robot with the lowest id; here: this robot; elsewhere: another robot",
            source="ours: elected without any choice",
        ),
    ] = "elected"
    share_period: SharePeriod = 0.5
    expiry: Lease = 5.0
    lease: Annotated[
        float,
        about(
            "a leader whose count stands still for longer is deposed",
            ge=0.2,
            le=600.0,
            unit="s",
            source="ours: 10 messages",
        ),
    ] = 5.0
    recovery: Recovery = False

    def __post_init__(self) -> None:
        """Check that both times are longer than the time between messages."""
        if min(self.expiry, self.lease) <= self.share_period:
            raise ValueError(f"share_period is {self.share_period:g} s, expiry or lease no longer")


class HopGradient(Pattern[HopGradientParams]):
    """Sends its leader, its hops to the leader and the leader's count; stands."""

    group = "decide"
    params_type = HopGradientParams
    needs = frozenset[str]()
    channels = {_CHANNEL: list}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: HopGradientParams, context: Context) -> None:
        super().__init__(params, context)
        self._heard: dict[str, _Heard] = {}  # by neighbour
        self._counts: dict[_Leader, tuple[int, float]] = {}  # highest count, and when it rose
        self._count = 0
        self._share_at = 0.0
        self._place: tuple[_Leader, int] | None = None

    def step(self, inputs: Inputs) -> Outputs:
        """Take in what was heard; choose a leader and count the hops when a message is due."""
        for message in inputs.messages:
            self._hear(message, inputs.now - message.age)
        self._place = self._choose(inputs.now)
        report: dict[str, Scalar] = {"hops": -1, "leader": ""}
        if self._place is not None:
            report = {"hops": self._place[1], "leader": self._place[0].id}
        if inputs.now < self._share_at:
            return Outputs(report=report)
        self._share_at = inputs.now + self.params.share_period
        self._count += 1
        return Outputs(messages=self._share(), report=report)

    def _hear(self, message: Message, at: float) -> None:
        read = _read(message)
        if read is None or message.sender == self.context.robot:
            return
        leader, hops, count = read
        if leader.id == self.context.robot:
            self._count = max(self._count, count + 1)  # others may know a count before a restart
            self._heard.pop(message.sender, None)  # the sender's hops lead to this robot
            return
        self._heard[message.sender] = _Heard(leader, hops, at)
        known = self._counts.get(leader)
        if known is None or count > known[0]:
            self._counts[leader] = count, at
            if len(self._counts) > _MAX_LEADERS:
                self._forget()

    def _forget(self) -> None:
        """Forget the half of the leaders whose counts rose longest ago, but none of a neighbour."""
        by_rise = sorted(self._counts, key=lambda leader: self._counts[leader][1])
        kept = {heard.leader for heard in self._heard.values()} | {*by_rise[_MAX_LEADERS // 2 :]}
        self._counts = {leader: count for leader, count in self._counts.items() if leader in kept}

    def _choose(self, now: float) -> tuple[_Leader, int] | None:
        """The best living leader, and the hops to this leader; None without a source."""
        params = self.params
        ways: list[tuple[_Leader, int]] = [
            (heard.leader, heard.hops + 1)
            for heard in self._heard.values()
            if now - heard.at <= params.expiry
            and now - self._counts[heard.leader][1] <= params.lease
            and heard.hops < _MAX_HOPS
        ]
        if params.source != "elsewhere":
            ways.append((self._self(), 0))
        return min(ways, default=None)

    def _self(self) -> _Leader:
        return _Leader(0 if self.params.source == "here" else 1, self.context.robot)

    def _share(self) -> dict[str, Value]:
        if self._place is None:
            return {}
        leader, hops = self._place
        count = self._count if leader == self._self() and not hops else self._counts[leader][0]
        return {_CHANNEL: [leader.rank, leader.id, hops, count]}


def _read(message: Message) -> tuple[_Leader, int, int] | None:
    """The leader, hops and count of a message; None for anything else."""
    value = message.value
    if message.channel != _CHANNEL or not isinstance(value, list) or len(value) != 4:
        return None
    rank, name, hops, count = value
    if rank not in (0, 1) or not isinstance(rank, int) or not isinstance(name, str):
        return None
    if not isinstance(hops, int) or not 0 <= hops < _MAX_HOPS:
        return None
    if not isinstance(count, int) or not 0 <= count < _MAX_COUNT:
        return None
    return _Leader(rank, name), hops, count
