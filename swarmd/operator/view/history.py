"""The plotted values of a swarm over time, and the last minutes of a living swarm."""

from __future__ import annotations

import math
import time
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from swarmd.core.values import Array
from swarmd.operator.view.source import DETAIL_KEYS, Source, json_of, pack_frame

SPAN = 300.0
PERIOD = 1.0
"""Seconds that are kept of a living swarm, and between two moments."""
SAMPLES = 300
"""Moments of a recorded run."""
STEP = 0.5
"""Seconds between the two places from which the speed in a recorded run follows."""
SURVEY_TIME = 0.01
"""Seconds of each tenth of a second in which the values of a recorded run are computed."""
MAX_KEYS = 40
"""Reports and readings that are plotted; robots may report any number of them."""

_JITTER = 0.01  # s by which a moment may be early or late
_COMMON_VALUES = 3  # `clusters`, `speed` and `active`, which all swarms have

Measured = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment of a swarm, as pages saw it."""

    time: float  # s
    values: Measured  # the plotted values
    frame: bytes
    rows: bytes  # compressed JSON

    @property
    def text(self) -> str:
        """The message of rows."""
        return zlib.decompress(self.rows).decode()


class History:
    """The moments of a living swarm within SPAN, one each PERIOD."""

    def __init__(self, source: Source, clock: Callable[[], float] = time.monotonic) -> None:
        self._source = source
        self._clock = clock
        self._moments: deque[Moment] = deque(maxlen=round(SPAN / PERIOD))
        self._before: tuple[float, Array] | None = None
        self._count = 0

    def advance(self, sequence: int) -> None:
        """Keep the present moment if it is due; `sequence`: the number of the pages' frame."""
        now = self._clock()
        if self._moments and now - self._moments[-1].time < PERIOD - _JITTER:
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
        """The last moment until a time, else the oldest; None without moments."""
        if not self._moments:
            return None
        until = [moment for moment in self._moments if moment.time <= time + _JITTER]
        return until[-1] if until else self._moments[0]

    def since(self, known: int) -> tuple[int, Mapping[str, Any] | None]:
        """The number of all moments so far, and a message of those after number `known`."""
        new = min(self._count - known, len(self._moments))
        if new <= 0:
            return self._count, None
        return self._count, plots_of([*self._moments][-new:], self._count - new)


class Survey:
    """The plotted values of a recorded run, computed in small steps."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._run = ""
        self._moments: list[Moment] = []
        self._before = 0  # moments of earlier runs
        self._left: Iterator[float] = iter(())

    def advance(self, sequence: int) -> None:
        """Compute the values of further moments for SURVEY_TIME; start again for another run."""
        del sequence
        ends = time.monotonic() + SURVEY_TIME
        while self._advance() and time.monotonic() < ends:
            pass

    def at(self, time: float) -> None:
        """None: a recorded run is played, not looked back at."""

    def _advance(self) -> bool:
        """Compute the values of one moment; False if no moment is left."""
        playback = self._source.playback
        assert playback is not None
        if playback.run != self._run:
            self._before += len(self._moments)
            self._run = playback.run
            self._moments = []
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
        """As `History.since`; a page that knows only another run gets all moments."""
        count = self._before + len(self._moments)
        if known == count:
            return count, None
        first = known - self._before if self._before < known < count else 0
        return count, plots_of(self._moments[first:], first)


def plots_of(moments: Sequence[Moment], first: int) -> Mapping[str, Any]:
    """The message `plots` for pages: the values of moments from number `first` on.

    Contains the times, and for each name a value at each time (None without a value).
    """
    known = dict.fromkeys(key for moment in reversed(moments) for key in moment.values)
    # The common values first, then the latest reports and readings: robots may rename them often.
    keys = sorted(known, key=lambda key: ":" in key)[: _COMMON_VALUES + MAX_KEYS]
    return {
        "kind": "plots",
        "first": first,
        "times": [round(moment.time, 2) for moment in moments],
        "values": {key: [_rounded(moment.values.get(key)) for moment in moments] for key in keys},
    }


def measured(
    places: Array,
    before: Array,
    seconds: float,
    rows: Mapping[str, Mapping[str, Any]],
    link: float | None,
) -> dict[str, float]:
    """The values of the whole swarm that are plotted at a moment, by name.

    `places`: rows (k, 4) of robot index, x, y in m, yaw in rad. `before`: the same, `seconds`
    earlier. `rows`: by robot the values of its last status. The values, without unknown values:

    - `clusters`: the number of chains of robots, each within `link` m of the next (single linkage);
      left out if `link` is None.
    - `speed`: the mean over robots in m/s, from their places.
    - `active`: the share of running robots on which protection acts: it changes the command of the
      pattern, or steers the robot around or away from obstacles.
    - each report and reading, as `report:NAME` or `readings:NAME`: the mean of numbers; of words
      the share of the most frequent word.
    """
    values: dict[str, float] = {}
    if link is not None and len(places):
        values["clusters"] = float(_clusters(places[:, 1:3], link))
    common, rows_now, rows_before = np.intersect1d(places[:, 0], before[:, 0], return_indices=True)
    if len(common) and seconds > 0.0:
        moved = places[rows_now, 1:3] - before[rows_before, 1:3]
        values["speed"] = float(np.linalg.norm(moved, axis=1).mean()) / seconds
    alive = [row for row in rows.values() if row.get("presence", "alive") == "alive"]
    running = [row for row in alive if row.get("state") == "running"]
    if running:
        # `clear`: protection passes the command unchanged.
        active_count = sum(row.get("protection", "") not in ("", "clear") for row in running)
        values["active"] = active_count / len(running)
    values |= _reported(rows.values())
    return {name: value for name, value in values.items() if math.isfinite(value)}


def _reported(rows: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """The plotted value of each report and reading by name; at most MAX_KEYS names.

    The value is the mean of numbers. If a robot reports a word, numbers of other robots are left
    out, and the value is the share of the most frequent word.
    """
    by_name: dict[str, list[Any]] = {}
    for row in rows:
        for kind in ("report", "readings"):
            for key, value in row.get(kind, {}).items():
                by_name.setdefault(f"{kind}:{key}", []).append(value)
    plotted: dict[str, float] = {}
    for name, values in [*by_name.items()][:MAX_KEYS]:
        words = [value for value in values if isinstance(value, str | bool)]
        if words:
            plotted[name] = max(Counter(words).values()) / len(words)
        else:
            plotted[name] = sum(values) / len(values)
    return plotted


def _packed(source: Source, rows: Mapping[str, Mapping[str, Any]]) -> bytes:
    """The message `rows` with the ages of all robots, compressed."""
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
