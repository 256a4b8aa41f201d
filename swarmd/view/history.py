"""What a page plots over time, and the last minutes of a living swarm, at which pages look back."""

from __future__ import annotations

import math
import time
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from swarmd.core.values import Array
from swarmd.view.source import DETAIL_KEYS, Source, json_of, pack_frame

SPAN, PERIOD = 300.0, 1.0
"""Seconds that are kept of a living swarm, and between two moments."""
SAMPLES = 300
"""Moments of a recorded run."""
STEP = 0.5
"""Seconds between the two places from which the speed in a recorded run follows."""
SURVEY_TIME = 0.01
"""Seconds of each tenth of a second in which the values of a recorded run are computed."""
MAX_KEYS = 40
"""Reports and readings that are plotted; robots may report any number of them."""

Measured = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Moment:
    """`frame` and `rows` as they went to pages then; `rows` is compressed JSON."""

    time: float
    values: Measured
    frame: bytes
    rows: bytes

    @property
    def text(self) -> str:
        """The message of rows."""
        return zlib.decompress(self.rows).decode()


class History:
    """The moments of a living swarm within SPAN, each PERIOD."""

    def __init__(self, source: Source, clock: Callable[[], float] = time.monotonic) -> None:
        self._source, self._clock = source, clock
        self._moments: deque[Moment] = deque(maxlen=round(SPAN / PERIOD))
        self._before: tuple[float, Array] | None = None
        self._count = 0

    def advance(self, sequence: int) -> None:
        """Keep the present moment if it is due; pages have the frame `sequence` now."""
        now = self._clock()
        if self._moments and now - self._moments[-1].time < PERIOD - 0.01:
            return
        source = self._source
        at, places = source.frame()
        rows = source.rows()
        passed, earlier = (now, places) if self._before is None else self._before
        values = measured(places, earlier, now - passed, rows, source.link)
        self._before = now, places
        frame = pack_frame(sequence, at, places)
        self._moments.append(Moment(now, values, frame, _packed(source, rows)))
        self._count += 1

    def at(self, time: float) -> Moment | None:
        """The last moment until a time, else the oldest; None without any."""
        older = [one for one in self._moments if one.time <= time + 0.01]
        return older[-1] if older else self._moments[0] if self._moments else None

    def since(self, known: int) -> tuple[int, Mapping[str, Any] | None]:
        """The number of moments ever, and a message of those that a page does not know yet."""
        new = min(self._count - known, len(self._moments))
        if new <= 0:
            return self._count, None
        return self._count, plots_of([*self._moments][-new:], self._count - new)


class Survey:
    """The values that are plotted of a recorded run, computed little by little."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._run = ""
        self._moments: list[Moment] = []
        self._before = 0  # moments of earlier runs
        self._left: Iterator[float] = iter(())

    def advance(self, sequence: int) -> None:
        """Compute the values of some more moments; those of another run begin anew."""
        del sequence
        ends = time.monotonic() + SURVEY_TIME
        while self._advance() and time.monotonic() < ends:
            pass

    def at(self, time: float) -> None:
        """A recorded run is played instead."""

    def _advance(self) -> bool:
        """Compute the values of one more moment; False if there are none left."""
        playback = self._source.playback
        assert playback is not None
        if playback.run != self._run:
            self._before += len(self._moments)
            self._run, self._moments = playback.run, []
            self._left = iter(np.linspace(0.0, playback.duration, SAMPLES).tolist())
        now = next(self._left, None)
        if now is None:
            return False
        before = max(now - STEP, 0.0)
        with playback.looking_at(before):
            _, earlier = self._source.frame()
        with playback.looking_at(now):
            _, places = self._source.frame()
            rows = self._source.rows()
        values = measured(places, earlier, now - before, rows, self._source.link)
        self._moments.append(Moment(now, values, b"", b""))
        return True

    def since(self, known: int) -> tuple[int, Mapping[str, Any] | None]:
        """As `History.since`; a page that knows another run alone gets all anew."""
        count = self._before + len(self._moments)
        if known == count:
            return count, None
        first = known - self._before if self._before < known < count else 0
        return count, plots_of(self._moments[first:], first)


def plots_of(moments: Sequence[Moment], first: int) -> Mapping[str, Any]:
    """Moments from number `first` on as a message: times, and by name a value for each or None."""
    known = dict.fromkeys(key for one in reversed(moments) for key in one.values)
    # The three of all swarms, then the latest: a robot may give other names each second.
    keys = sorted(known, key=lambda key: ":" in key)[: 3 + MAX_KEYS]
    return {
        "kind": "plots",
        "first": first,
        "times": [round(one.time, 2) for one in moments],
        "values": {key: [_rounded(one.values.get(key)) for one in moments] for key in keys},
    }


def measured(
    places: Array,
    before: Array,
    seconds: float,
    rows: Mapping[str, Mapping[str, Any]],
    link: float | None,
) -> dict[str, float]:
    """What is plotted at a moment.

    `places` and `before`, `seconds` earlier, are rows (k, 4) of index, x, y in m, yaw. `clusters`:
    chains of robots, each within `link` m of the next (single linkage); not without `link`.
    `speed`: mean over robots in m/s, from their places. `active`: the share of running robots whose
    command protection changes. Of each report and reading the mean of numbers; of words the share
    of the most frequent.
    """
    values: dict[str, float] = {}
    if link is not None and len(places):
        values["clusters"] = float(_clusters(places[:, 1:3], link))
    both, now, then = np.intersect1d(places[:, 0], before[:, 0], return_indices=True)
    if len(both) and seconds > 0.0:
        ways = np.linalg.norm(places[now, 1:3] - before[then, 1:3], axis=1)
        values["speed"] = float(ways.mean()) / seconds
    alive = [row for row in rows.values() if row.get("presence", "alive") == "alive"]
    running = [row for row in alive if row.get("state") == "running"]
    if running:
        active = sum(row.get("protection", "") not in ("", "clear") for row in running)
        values["active"] = active / len(running)
    given: dict[str, list[Any]] = {}
    for row in rows.values():
        for kind in ("report", "readings"):
            for key, value in row.get(kind, {}).items():
                given.setdefault(f"{kind}:{key}", []).append(value)
    for key, found in [*given.items()][:MAX_KEYS]:
        words = [one for one in found if isinstance(one, str | bool)]
        if words:
            values[key] = max(Counter(words).values()) / len(words)
        else:
            values[key] = sum(found) / len(found)
    return {key: value for key, value in values.items() if math.isfinite(value)}


def _packed(source: Source, rows: Mapping[str, Mapping[str, Any]]) -> bytes:
    """The message of rows with the ages of all robots, compressed."""
    hidden = DETAIL_KEYS | {"age"}
    short = {name: {k: v for k, v in row.items() if k not in hidden} for name, row in rows.items()}
    ages = [rows.get(robot.name, {}).get("age", 0.0) for robot in source.robots]
    text = json_of({"kind": "rows", "rows": short, "ages": ages})
    return zlib.compress(text.encode(), 1)


def _clusters(places: Array, link: float) -> int:
    """The number of chains of places (k, 2), each within `link` m of the next."""
    near = np.linalg.norm(places[:, None] - places[None], axis=2) <= link
    left = np.ones(len(places), dtype=bool)
    count = 0
    while left.any():
        count += 1
        reached = np.zeros(len(places), dtype=bool)
        reached[left.argmax()] = True
        while (grown := near[reached].any(axis=0) & left & ~reached).any():
            reached |= grown
        left &= ~reached
    return count


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")
