"""The playback of recorded runs: the present run, its time, and its speed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

MIN_SPEED = 0.01
MAX_SPEED = 100.0


class Playback:
    """The control of a page that plays a recorded run: time, speed and choice; shared by all pages.

    `run`: the name of the run that plays. `duration`: the length of this run in s. `choose`: reads
    the run of a name and calls `load`, which may take a second. If the run cannot be read, `choose`
    raises SwarmError, and the former run stays.
    """

    def __init__(
        self,
        runs: Sequence[str],
        choose: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.runs = runs
        self.run = ""
        self.choose = choose
        self.duration = 0.0
        self.is_playing = True
        self.speed = 1.0
        self._clock = clock
        self._offset = 0.0
        self._since = clock()
        self._looked: float | None = None

    def load(self, run: str, duration: float) -> None:
        """Begin another run; playing and speed stay as they are."""
        self.run = run
        self.duration = duration
        self._offset = 0.0
        self._since = self._clock()

    @property
    def time(self) -> float:
        """Seconds into the run; it stays at the end of the run."""
        if self._looked is not None:
            return self._looked
        rate = self.speed if self.is_playing else 0.0
        return min(self._offset + rate * (self._clock() - self._since), self.duration)

    def play(self, *, is_playing: bool, speed: float) -> None:
        """Play or pause; a run at its end plays from its start. ValueError for a wrong speed."""
        _check(speed)
        now = self.time
        self._offset = 0.0 if is_playing and now >= self.duration else now
        self._since = self._clock()
        self.is_playing = is_playing
        self.speed = min(max(speed, MIN_SPEED), MAX_SPEED)

    def seek(self, time: float) -> None:
        """Go to a time in s, within the run. ValueError for NaN and infinity."""
        _check(time)
        self._offset = min(max(time, 0.0), self.duration)
        self._since = self._clock()

    @contextmanager
    def looking_at(self, time: float) -> Iterator[None]:
        """Another `time` within the `with` block, such as a sample of the whole run."""
        self._looked = time
        try:
            yield
        finally:
            self._looked = None

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "run": self.run,
            "duration": self.duration,
            "is_playing": self.is_playing and self.time < self.duration,
            "speed": self.speed,
        }


def _check(value: float) -> None:
    if not math.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
