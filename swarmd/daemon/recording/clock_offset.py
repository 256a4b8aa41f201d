"""Estimates offsets between the clocks of robots from exchanges of datagrams. Pure.

A robot notes the times at which it sent a query and received the answer. The answer has the peer's
time, which the peer's clock showed between these two moments. So the offset is known from the
middle of the round trip, to within half of the round trip, however unequal the delays of query and
answer were (Cristian, Probabilistic clock synchronization, Distributed Computing 3, 1989). Of
several exchanges in a window of time, the exchange with the shortest round trip is kept (the clock
filter of NTP, RFC 5905, section 10).

Since clocks drift, the offset changes with time. We fit a line (offset over time) through the kept
exchanges of two robots, and bound the error of the line. If an exchange contradicts the line, the
whole contradiction is added to the bound. NTP instead intersects the intervals of many servers at
one moment (Marzullo, Owicki 1983); here all exchanges of a run are known afterwards.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array

MAX_DRIFT = 500e-6
"""The largest relative rate of two clocks: crystals within 100 ppm each, and slewing by NTP."""
A_WINDOW = 8
"""Exchanges of which the one with the shortest round trip is kept, as in RFC 5905."""
MAX_WINDOWS = 64
MIN_ROUND_TRIP = 1e-6
"""Seconds; no exchange is believed to be better."""


class Exchange(NamedTuple):
    """A query that was sent at `sent` and whose answer returned at `returned`, in s on clock `own`.

    Between these times clock `peer` showed `answered` (s).
    """

    own: str
    peer: str
    sent: float
    answered: float
    returned: float


@dataclass(frozen=True, slots=True, eq=False)
class ClockLine:
    """A line between two clocks: t s on the first is t + offset + drift (t - at) on the second."""

    at: float
    offset: float
    drift: float
    times: Array  # of the kept exchanges, on the first clock
    bounds: Array  # the largest error of the line at each of `times`, in s
    excess: float  # the largest contradiction between the line and an exchange, in s; 0 if none

    def forward(self, time: float) -> float:
        """The time on the second clock when the first clock shows `time`."""
        return time + self.offset + self.drift * (time - self.at)

    def backward(self, time: float) -> float:
        """The time on the first clock when the second clock shows `time`."""
        return self.at + (time - self.at - self.offset) / (1.0 + self.drift)

    def error(self, time: float) -> float:
        """The largest possible error of `forward(time)` in s.

        `bounds` limits the error at the times of the exchanges. From these times the limits are
        carried over to `time` in two ways, and the least limit counts:

        1. From each exchange: its bound grows by MAX_DRIFT + |drift| per second, the fastest change
           of the error.
        2. From each pair of exchanges: the error is a linear function of time, so the bounds of
           both exchanges are interpolated or extrapolated to `time`.
        """
        # 1. One exchange.
        away = np.abs(time - self.times)
        by_one_exchange = self.bounds + (MAX_DRIFT + abs(self.drift)) * away
        # 2. Two exchanges: `apart` (k, k) is the time between them. A pair at one time gives no
        # bound: its division by zero gives inf or NaN.
        apart = self.times[None, :] - self.times[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.abs(time - self.times[:, None]) / np.abs(apart)
            rest = np.abs(self.times[None, :] - time) / np.abs(apart)
            by_two_exchanges = rest * self.bounds[:, None] + share * self.bounds[None, :]
        by_two_exchanges[~np.isfinite(by_two_exchanges)] = np.inf
        return float(min(by_one_exchange.min(), by_two_exchanges.min())) + self.excess


def fit_line(times: Array, offsets: Array, round_trips: Array) -> ClockLine:
    """The line through offsets that were measured at `times` with these round trips, all in s."""
    kept = _shortest(times, round_trips)
    times = times[kept]
    offsets = offsets[kept]
    halves = np.maximum(round_trips[kept], MIN_ROUND_TRIP) / 2.0
    weights = 1.0 / halves**2
    at = float(np.average(times, weights=weights))
    offset = float(np.average(offsets, weights=weights))
    spread = times - at
    slope = float((weights * spread * (offsets - offset)).sum())
    # The prior on the drift: two exchanges within seconds would else give an impossible drift.
    drift = slope / (float((weights * spread**2).sum()) + MAX_DRIFT**-2)
    drift = min(max(drift, -MAX_DRIFT), MAX_DRIFT)
    misses = np.abs(offsets - offset - drift * spread)
    excess = max(float((misses - halves).max()), 0.0)
    return ClockLine(at, offset, drift, times, halves + misses, excess)


def _shortest(times: Array, round_trips: Array) -> NDArray[np.intp]:
    """The indices of the exchanges with the shortest round trip in each window of time.

    The first and the last exchange are added, since the error of a line grows outside of them.
    """
    order = np.argsort(times, kind="stable")
    count = min(-(-len(order) // A_WINDOW), MAX_WINDOWS)
    best = [window[np.argmin(round_trips[window])] for window in np.array_split(order, count)]
    return np.unique([order[0], *best, order[-1]])


@dataclass(frozen=True, slots=True)
class Alignment:
    """A line to the reference clock: time t of this clock (s) is begins + rate (t - begin)."""

    begin: float  # the first time of the recordings, in s on this clock
    begins: float  # `begin` in s on the reference clock
    rate: float
    error: float  # the largest error within the recordings, in s
    via: tuple[str, ...]  # the clocks in between, from the reference on

    def to_reference(self, time: float) -> float:
        """The time on the reference clock."""
        return self.begins + self.rate * (time - self.begin)

    @property
    def offset(self) -> float:
        """The lead of this clock over the reference clock at `begin`, in s."""
        return self.begin - self.begins

    @property
    def drift(self) -> float:
        """The excess rate of this clock over the reference clock, as a share."""
        return 1.0 / self.rate - 1.0


def align(
    exchanges: Iterable[Exchange], spans: Mapping[str, tuple[float, float]], reference: str
) -> dict[str, Alignment]:
    """Alignments of clocks to the clock `reference`, by clock.

    Two clocks that exchanged queries have a line (offset and drift) between them, with a bound of
    its error. A clock is aligned along the path of lines with the least sum of these bounds
    (Dijkstra's algorithm). `spans`: by clock, first and last time of its recordings in s. A clock
    without a path to the reference is left out.
    """
    lines = _lines(exchanges)  # by pair of clocks in sorted order
    neighbors: dict[str, list[str]] = defaultdict(list)
    for first, second in lines:
        neighbors[first].append(second)
        neighbors[second].append(first)
    # Candidates (sum of bounds in s, path from the reference); the least is popped first.
    candidates: list[tuple[float, tuple[str, ...]]] = [(0.0, (reference,))]
    paths: dict[str, tuple[str, ...]] = {}  # by clock: the best path, which is final
    while candidates:
        path_error, path = heapq.heappop(candidates)
        clock = path[-1]
        if clock in paths:
            continue
        paths[clock] = path
        for neighbor in neighbors[clock]:
            if neighbor not in paths:
                error = path_error + _largest_error(lines[_pair(clock, neighbor)])
                heapq.heappush(candidates, (error, (*path, neighbor)))
    return {
        clock: _along(paths[clock], lines, span) for clock, span in spans.items() if clock in paths
    }


def _pair(a: str, b: str) -> tuple[str, str]:
    """Two clocks in sorted order, by which lines are found."""
    return min(a, b), max(a, b)


def _largest_error(line: ClockLine) -> float:
    """The larger bound of a line's error at its first and its last exchange, in s."""
    return max(line.error(float(line.times.min())), line.error(float(line.times.max())))


def _lines(exchanges: Iterable[Exchange]) -> dict[tuple[str, str], ClockLine]:
    """The line from the first to the second clock, by pair of clock ids in sorted order.

    A line is fitted through the exchanges of both directions. Exchanges of a clock with itself are
    left out, and exchanges whose answer came before the query was sent.
    """
    measured: dict[tuple[str, str], list[tuple[float, float, float]]] = defaultdict(list)
    for exchange in exchanges:
        if exchange.own == exchange.peer or exchange.returned < exchange.sent:
            continue
        middle = (exchange.sent + exchange.returned) / 2.0
        trip = exchange.returned - exchange.sent
        # (time on the first clock of the pair, lead of the second clock, round trip)
        if exchange.own < exchange.peer:
            measured[exchange.own, exchange.peer].append((middle, exchange.answered - middle, trip))
        else:
            measured[exchange.peer, exchange.own].append(
                (exchange.answered, middle - exchange.answered, trip)
            )
    return {pair: fit_line(*np.array(rows).T) for pair, rows in measured.items()}


def _along(
    path: tuple[str, ...], lines: Mapping[tuple[str, str], ClockLine], span: tuple[float, float]
) -> Alignment:
    """The alignment along a path, from both ends of `span` back to the first clock."""
    ends = list(span)
    errors = [0.0, 0.0]
    rate = 1.0
    for clock, next_clock in pairwise(reversed(path)):
        line = lines[_pair(clock, next_clock)]
        is_forward = clock < next_clock  # a line leads from the first clock in order to the second
        rate *= 1.0 + line.drift if is_forward else 1.0 / (1.0 + line.drift)
        for k, time in enumerate(ends):
            ends[k] = line.forward(time) if is_forward else line.backward(time)
            errors[k] += line.error(time if is_forward else ends[k])
    return Alignment(span[0], ends[0], rate, max(errors), path[1:-1])
