"""Offsets between the clocks of robots, from exchanges of datagrams. Pure.

A robot notes when it sent a query and when the answer came, and the answer has the peer's time.
The peer's clock then showed that time between the two moments, so that the offset lies within half
of the round trip around its middle (Cristian, Probabilistic clock synchronization, Distributed
Computing 3, 1989), however unequal the two ways were. Such intervals are what Marzullo's
algorithm intersects (Marzullo, Owicki 1983). Of several exchanges the one with the shortest round
trip counts (the clock filter of NTP, RFC 5905, section 10).

We fit a line through the kept exchanges, since clocks drift, and bound its error. NTP intersects
intervals of many servers at one moment; here the past is known as a whole, and the clocks of two
robots differ by a line. An exchange that the line contradicts shows that they do not, and enters
the bound with the whole contradiction.
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
    """The time on one clock by that on another: t + offset + drift * (t - at), in s.

    `times`: of the kept exchanges; `bounds`: how far the line is off there at most. `excess`: by
    how much it contradicts an exchange, 0 if it does not.
    """

    at: float
    offset: float
    drift: float
    times: Array
    bounds: Array
    excess: float

    def forward(self, time: float) -> float:
        """The time on the other clock."""
        return time + self.offset + self.drift * (time - self.at)

    def backward(self, time: float) -> float:
        """The time on this clock when the other shows `time`."""
        return self.at + (time - self.at - self.offset) / (1.0 + self.drift)

    def error(self, time: float) -> float:
        """The bound of the error of `forward` at `time`, in s.

        The error is a line, too, and bounded at each exchange: between two of them it is at most
        what lies between their bounds; far from all it grows by MAX_DRIFT.
        """
        away = np.abs(time - self.times)
        alone = self.bounds + (MAX_DRIFT + abs(self.drift)) * away
        apart = self.times[None, :] - self.times[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.abs(time - self.times[:, None]) / np.abs(apart)
            rest = np.abs(self.times[None, :] - time) / np.abs(apart)
            both = rest * self.bounds[:, None] + share * self.bounds[None, :]
        both[~np.isfinite(both)] = np.inf
        return float(min(alone.min(), both.min())) + self.excess


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
    # The prior keeps two exchanges within seconds from showing a drift that no clock has.
    drift = slope / (float((weights * spread**2).sum()) + MAX_DRIFT**-2)
    drift = min(max(drift, -MAX_DRIFT), MAX_DRIFT)
    misses = np.abs(offsets - offset - drift * spread)
    excess = max(float((misses - halves).max()), 0.0)
    return ClockLine(at, offset, drift, times, halves + misses, excess)


def _shortest(times: Array, round_trips: Array) -> NDArray[np.intp]:
    """The places of the exchanges with the shortest round trip of each window of time.

    The first and the last exchange are kept, too: beyond them the error grows.
    """
    order = np.argsort(times, kind="stable")
    count = min(-(-len(order) // A_WINDOW), MAX_WINDOWS)
    best = [one[np.argmin(round_trips[one])] for one in np.array_split(order, count)]
    return np.unique([order[0], *best, order[-1]])


@dataclass(frozen=True, slots=True)
class Alignment:
    """The time on the reference clock: `begins` + `rate` * (t - `begin`), off by at most `error`.

    In s, for the times of a recording on the clock. `via`: the clocks in between, from the
    reference on.
    """

    begin: float
    begins: float
    rate: float
    error: float
    via: tuple[str, ...]

    def to_reference(self, time: float) -> float:
        """The time on the reference clock."""
        return self.begins + self.rate * (time - self.begin)

    @property
    def offset(self) -> float:
        """What this clock is ahead of the reference at the beginning of its recording, in s."""
        return self.begin - self.begins

    @property
    def drift(self) -> float:
        """By how much this clock is faster than the reference, as a share."""
        return 1.0 / self.rate - 1.0


def align(
    exchanges: Iterable[Exchange], spans: Mapping[str, tuple[float, float]], reference: str
) -> dict[str, Alignment]:
    """Alignments to the reference clock, by clock, along the path with the smallest error.

    `spans`: first and last time of the recordings on each clock, in s. A clock in `spans` without a
    path to the reference is left out of the answer.
    """
    lines = _lines(exchanges)
    near: dict[str, list[str]] = defaultdict(list)
    for one, other in lines:
        near[one].append(other)
        near[other].append(one)
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
    """The line from the lower to the higher clock of each pair, by both directions of queries."""
    found: dict[tuple[str, str], list[tuple[float, float, float]]] = defaultdict(list)
    for one in exchanges:
        if one.own == one.peer or one.returned < one.sent:
            continue
        middle, trip = (one.sent + one.returned) / 2.0, one.returned - one.sent
        if one.own < one.peer:
            found[one.own, one.peer].append((middle, one.answered - middle, trip))
        else:
            found[one.peer, one.own].append((one.answered, middle - one.answered, trip))
    return {pair: fit_line(*np.array(rows).T) for pair, rows in found.items()}


def _along(
    path: tuple[str, ...], lines: Mapping[tuple[str, str], ClockLine], span: tuple[float, float]
) -> Alignment:
    """Follow a path back to its first clock, at both ends of a span."""
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
