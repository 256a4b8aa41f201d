"""A simulation of voting patterns alone: thousands of runs in minutes.

Each robot's pattern runs in a `PatternExecutor` as on a robot, at its own rate and phase. A
simulated radio delays, loses and repeats their messages. There are no scans, no protection and no
daemons; a run in lockstep has all of them.
"""

from __future__ import annotations

import heapq
import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.core.host_messages import Layers, Load, Loaded, LoadRefused, Step, Stepped
from swarmd.core.values import Array, Inputs, Message, Neighbor, Platform, Value
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.settings.settings import load_platform

Opinions = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Air:
    """The radio: `delay` and `jitter` in s (evenly, both ways), shares lost and received twice."""

    delay: float = 0.02
    jitter: float = 0.01
    loss: float = 0.0
    twice: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Debate:
    """The `opinions` (T, n) and `rounds` (T, n) at times `t` (T,) s; -1 while absent.

    `sent` counts the messages of all robots.
    """

    t: Array
    opinions: Opinions
    rounds: Opinions
    sent: int

    @property
    def agreed_at(self) -> float:
        """The time in s from which all present robots hold one opinion to the end; inf if never."""
        here = self.opinions >= 0
        final = self.opinions[-1][here[-1]]
        if len(final) == 0 or (final != final[0]).any():
            return math.inf
        agrees = ((self.opinions == final[0]) | ~here).all(axis=1)
        broken = np.flatnonzero(~agrees)
        since = int(broken[-1]) + 1 if len(broken) else 0
        return float(self.t[since])

    @property
    def winner(self) -> int | None:
        """The opinion of all at the end; None without one."""
        return int(self.opinions[-1].max()) if math.isfinite(self.agreed_at) else None


@dataclass(slots=True, eq=False)
class _Voter:
    """A robot and its pattern."""

    name: str
    executor: PatternExecutor
    period: float
    inbox: list[tuple[float, Message]] = field(default_factory=list)
    stepped_at: float | None = None
    opinion: int = -1
    round: int = -1


class VotingSim:
    """A swarm of one voting pattern; all hear all. The same seed gives the same debate.

    Robot i steps for the first time at `starts[i]` s plus its phase of a step, and is absent from
    `ends[i]` on. `held` are the initial opinions, random by default; `params` apply to all robots,
    `own` to one robot each.
    """

    def __init__(
        self,
        pattern: str,
        count: int,
        *,
        seed: int,
        params: Mapping[str, Value] | None = None,
        own: Mapping[int, Mapping[str, Value]] | None = None,
        held: Sequence[int] | None = None,
        starts: Sequence[float] | None = None,
        ends: Mapping[int, float] | None = None,
        air: Air = Air(),
    ) -> None:
        self._rng = np.random.default_rng([seed, 0x706172])
        self._air = air
        self._starts = [0.0] * count if starts is None else [float(start) for start in starts]
        self._ends = ends or {}
        self._voters = [
            _load_voter(pattern, f"robot-{row}", layers, seed)
            for row, layers in enumerate(_layers(count, params, own, held))
        ]
        self._changes = sorted((*self._starts, *self._ends.values()))
        self._known: dict[tuple[int, int], tuple[Neighbor, ...]] = {}
        self._queue: list[tuple[float, int, int]] = []
        self._sent = 0
        for row, voter in enumerate(self._voters):
            phase = float(self._rng.uniform(0.0, voter.period))
            heapq.heappush(self._queue, (self._starts[row] + phase, row, 0))

    def run(self, seconds: float, *, until_agreed: float | None = None) -> Debate:
        """The debate over so many seconds, sampled every 0.1 s.

        `until_agreed`: end early when all have agreed for so many seconds.
        """
        times: list[float] = []
        held: list[list[int]] = []
        rounds: list[list[int]] = []
        agreed_since = math.inf
        for tick in range(round(seconds / 0.1) + 1):
            now = 0.1 * tick
            self._advance(now)
            times.append(now)
            held.append([voter.opinion for voter in self._voters])
            rounds.append([voter.round for voter in self._voters])
            is_agreed = len({opinion for opinion in held[-1] if opinion >= 0}) == 1
            agreed_since = min(agreed_since, now) if is_agreed else math.inf
            if until_agreed is not None and now - agreed_since >= until_agreed:
                break
        return Debate(np.array(times), np.array(held), np.array(rounds), self._sent)

    def _advance(self, now: float) -> None:
        while self._queue[0][0] <= now:
            at, row, number = heapq.heappop(self._queue)
            voter = self._voters[row]
            if at >= self._ends.get(row, math.inf):
                voter.opinion = voter.round = -1
                heapq.heappush(self._queue, (math.inf, row, 0))
                continue
            self._step(row, voter, at)
            heapq.heappush(self._queue, (at + voter.period, row, number + 1))

    def _step(self, row: int, voter: _Voter, now: float) -> None:
        arrived = sorted((at for at in voter.inbox if at[0] <= now), key=lambda at: at[0])
        voter.inbox = [at for at in voter.inbox if at[0] > now]
        messages = tuple(Message(m.sender, m.channel, m.value, now - at) for at, m in arrived)
        dt = 0.0 if voter.stepped_at is None else now - voter.stepped_at
        voter.stepped_at = now
        inputs = Inputs(now, dt, neighbors=self._neighbors(row, now), messages=messages)
        stepped = voter.executor.handle(Step(1, inputs))
        assert isinstance(stepped, Stepped), stepped
        voter.opinion = int(stepped.outputs.report["opinion"])
        voter.round = int(stepped.outputs.report.get("round", -1))
        for channel, value in stepped.outputs.messages.items():
            self._sent += 1
            self._send(row, Message(voter.name, channel, value, 0.0), now)

    def _neighbors(self, row: int, now: float) -> tuple[Neighbor, ...]:
        key = (row, bisect_right(self._changes, now))
        if key not in self._known:
            self._known[key] = tuple(
                Neighbor(voter.name, 0.0)
                for other, voter in enumerate(self._voters)
                if other != row and self._is_here(other, now)
            )
        return self._known[key]

    def _is_here(self, row: int, now: float) -> bool:
        return self._starts[row] <= now < self._ends.get(row, math.inf)

    def _send(self, row: int, message: Message, now: float) -> None:
        air, rng = self._air, self._rng
        for other, voter in enumerate(self._voters):
            if other == row or not self._is_here(other, now):
                continue
            if air.loss > 0.0 and rng.random() < air.loss:
                continue
            for _ in range(2 if air.twice > 0.0 and rng.random() < air.twice else 1):
                due = now + air.delay + air.jitter * float(rng.uniform(-1.0, 1.0))
                voter.inbox.append((due, message))


def _layers(
    count: int,
    params: Mapping[str, Value] | None,
    own: Mapping[int, Mapping[str, Value]] | None,
    held: Sequence[int] | None,
) -> list[Layers]:
    layers: list[Layers] = []
    for row in range(count):
        initial: Mapping[str, Value] = {} if held is None else {"initial": int(held[row])}
        mine = {} if own is None else own.get(row, {})
        layers.append((("debate", {**(params or {}), **initial, **mine}),))
    return layers


def _load_voter(pattern: str, name: str, layers: Layers, seed: int) -> _Voter:
    loader, platform = _loader_and_platform()
    executor = PatternExecutor(loader)
    loaded = executor.handle(Load(1, pattern, layers, name, platform, seed))
    if isinstance(loaded, LoadRefused):
        raise ConfigError(loaded.text)
    assert isinstance(loaded, Loaded)
    return _Voter(name, executor, 1.0 / loaded.rate)


@lru_cache(maxsize=1)
def _loader_and_platform() -> tuple[PatternLoader, Platform]:
    """Shared by all debates; reading them takes longer than most debates."""
    origins = pattern_names(None)
    loader = PatternLoader({name: (o.value, o.is_file) for name, o in origins.items()})
    return loader, load_platform("burger")
