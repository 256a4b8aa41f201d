"""What robots said of themselves in a live run, brought into the trace that the world recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray

from swarmd.core.messages import Status
from swarmd.sim.trace import Trace

_WORD = "U24"


class StatusLog:
    """Statuses as an operator heard them, each from its time on until the next."""

    def __init__(self) -> None:
        self._heard: list[tuple[float, Mapping[str, Status]]] = []

    def hear(self, time: float, statuses: Mapping[str, Status]) -> None:
        """At `time` s of the recording these robots said how they stand; in order of time."""
        self._heard.append((time, dict(statuses)))

    def merged_into(self, trace: Trace) -> Trace:
        """The trace with what a status tells of state, protection, `report` and `words`.

        Empty, False and NaN before a robot's first word. A wish is not among them: one that is
        some tenths of a second old cannot be held against the command of an instant. `gap`,
        `scan_age` and `bound` are those of the moment of the last word.
        """
        if not self._heard:
            return trace
        shape = len(trace.t), len(trace.ids)
        known = _blank(shape)
        reports: dict[str, NDArray[Any]] = {}
        words: dict[str, NDArray[Any]] = {}
        for time, statuses in self._heard:
            since = int(np.searchsorted(trace.t, time - 1e-9))
            for robot, status in statuses.items():
                if robot not in trace.ids:
                    continue
                place = slice(since, None), trace.ids.index(robot)
                _enter(known, place, status)
                for name, value in status.report.items():
                    if isinstance(value, str):
                        words.setdefault(name, np.full(shape, "", dtype=_WORD))[place] = value
                    else:
                        reports.setdefault(name, np.full(shape, np.nan))[place] = float(value)
        return replace(
            trace,
            **known,
            report=dict(sorted(reports.items())),
            words=dict(sorted(words.items())),
        )


def _blank(shape: tuple[int, int]) -> dict[str, Any]:
    """What is known of robots that have said nothing yet."""
    return {
        "state": np.full(shape, "", dtype=_WORD),
        "reason": np.full(shape, "", dtype=_WORD),
        "active": np.zeros(shape, dtype=bool),
        "recovering": np.zeros(shape, dtype=bool),
        "gap": np.full(shape, np.nan),
        "scan_age": np.full(shape, np.nan),
        "bound": np.full((*shape, 3), np.nan),
    }


def _enter(known: Mapping[str, Any], place: tuple[slice, int], status: Status) -> None:
    decision = status.decision
    known["state"][place], known["reason"][place] = status.state.value, status.reason or ""
    known["active"][place], known["recovering"][place] = decision.is_active, decision.is_recovering
    known["gap"][place] = np.nan if decision.min_gap is None else decision.min_gap
    known["scan_age"][place] = np.nan if decision.scan_age is None else decision.scan_age
    known["bound"][place] = astuple(decision.rows[0]) if decision.rows else np.nan
