"""Adds the statuses that robots published in a live run to the trace of its world."""

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
    """Statuses as an operator received them; each holds until the next."""

    def __init__(self) -> None:
        self._received: list[tuple[float, Mapping[str, Status]]] = []

    def add(self, time: float, statuses: Mapping[str, Status]) -> None:
        """Add the statuses received at `time` s of the recording; in order of time."""
        self._received.append((time, dict(statuses)))

    def merged_into(self, trace: Trace) -> Trace:
        """The trace with the state, protection, `report` and `words` of the statuses.

        Empty, False and NaN before a robot's first status. The requested command is left out: it
        is some tenths of a second older than the safe command of a sample. `gap`, `scan_age` and
        `bound` are those of the last status.
        """
        if not self._received:
            return trace
        shape = len(trace.t), len(trace.ids)
        known = _blank(shape)
        reports: dict[str, NDArray[Any]] = {}
        words: dict[str, NDArray[Any]] = {}
        for time, statuses in self._received:
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
    """The values of robots before their first status."""
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
