"""Adds the statuses that robots published in a live run to the trace of its world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.messages import Status
from swarmd.sim.trace import WORD, Trace, blank_decisions, enter_decision


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
        known: dict[str, Any] = blank_decisions(shape)
        reports: dict[str, NDArray[Any]] = {}
        words: dict[str, NDArray[Any]] = {}
        for time, statuses in self._received:
            since = int(np.searchsorted(trace.t, time - 1e-9))
            for robot, status in statuses.items():
                if robot not in trace.ids:
                    continue
                place = slice(since, None), trace.ids.index(robot)
                state, reason = status.state.value, status.reason or ""
                enter_decision(known, place, state, reason, status.decision)
                for name, value in status.report.items():
                    if isinstance(value, str):
                        words.setdefault(name, np.full(shape, "", dtype=WORD))[place] = value
                    else:
                        reports.setdefault(name, np.full(shape, np.nan))[place] = float(value)
        return replace(
            trace,
            **known,
            report=dict(sorted(reports.items())),
            words=dict(sorted(words.items())),
        )
