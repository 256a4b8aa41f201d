"""Estimates offsets between the clocks of robots from exchanges of datagrams. Pure.

A robot notes the times at which it sent a query and received the answer; the answer has the peer's
time. The peer's clock showed that time between these two moments. So the offset lies within half
the round trip around the middle (Cristian, Probabilistic clock synchronization, Distributed
Computing 3, 1989), however unequal the delays of query and answer were. Marzullo's algorithm
intersects such intervals (Marzullo, Owicki 1983). Of several exchanges in a window of time, the
exchange with the shortest round trip is kept (the clock filter of NTP, RFC 5905, section 10).

Since clocks drift, we fit a line through the kept exchanges and bound the error of the line. We
deviate from NTP, which intersects intervals of many servers at one moment: here all exchanges are
known afterwards, and the clocks of two robots differ by a line. If an exchange contradicts the
line, the whole contradiction is added to the bound.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
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
    """A query at `sent` and its answer at `returned`, in s on clock `own`.

    In between, clock `peer` showed `answered`.
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
        """The bound of the error of `forward` at `time`, in s.

        The error is a line in time, too, and is bounded at each exchange. Between two exchanges the
        bound is interpolated. Outside all exchanges the bound grows with MAX_DRIFT.
        """
        away = np.abs(time - self.times)
        by_one_exchange = self.bounds + (MAX_DRIFT + abs(self.drift)) * away
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
    times, offsets = times[kept], offsets[kept]
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

    The first and the last exchange are kept, too, since the error grows outside of them.
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
    """Alignments to the reference clock, by clock, along the path with the least error (Dijkstra).

    `spans`: first and last time of the recordings on each clock, in s. A clock without a path of
    exchanges to the reference is left out of the result.
    """
    lines = _lines(exchanges)
    near: dict[str, list[str]] = defaultdict(list)
    for lower, higher in lines:
        near[lower].append(higher)
        near[higher].append(lower)
    paths: dict[str, tuple[str, ...]] = {}
    heap: list[tuple[float, tuple[str, ...]]] = [(0.0, (reference,))]
    done: set[str] = set()
    while heap:
        error, path = heapq.heappop(heap)
        if path[-1] in done:
            continue
        done.add(path[-1])
        paths[path[-1]] = path
        for clock in near[path[-1]]:
            if clock not in done:
                line = lines[min(clock, path[-1]), max(clock, path[-1])]
                more = max(line.error(float(end)) for end in (line.times.min(), line.times.max()))
                heapq.heappush(heap, (error + more, (*path, clock)))
    return {
        clock: _along(paths[clock], lines, span) for clock, span in spans.items() if clock in paths
    }


def _lines(exchanges: Iterable[Exchange]) -> dict[tuple[str, str], ClockLine]:
    """By pair of clock ids in sorted order: the line from the first to the second clock.

    Queries in both directions count.
    """
    measured: dict[tuple[str, str], list[tuple[float, float, float]]] = defaultdict(list)
    for exchange in exchanges:
        if exchange.own == exchange.peer or exchange.returned < exchange.sent:
            continue
        middle, trip = (exchange.sent + exchange.returned) / 2.0, exchange.returned - exchange.sent
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
    ends, errors = list(span), [0.0, 0.0]
    rate = 1.0
    for after, before in zip(path[::-1], path[-2::-1], strict=False):
        line = lines[min(after, before), max(after, before)]
        is_forward = after < before
        rate *= 1.0 + line.drift if is_forward else 1.0 / (1.0 + line.drift)
        for k, time in enumerate(ends):
            ends[k] = line.forward(time) if is_forward else line.backward(time)
            errors[k] += line.error(time if is_forward else ends[k])
    return Alignment(span[0], ends[0], rate, max(errors), path[1:-1])
