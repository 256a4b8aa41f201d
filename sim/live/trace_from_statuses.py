"""Adds the statuses that robots published in a live run to the trace of its world."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.messages import Status
from swarmd.core.values import Scalar
from swarmd.sim.trace import (
    DECISION_ARRAYS,
    NO_DECISION,
    WORD,
    Trace,
    blank_decisions,
    enter_decision,
)


class StatusLog:
    """Statuses as an operator received them; each holds until the next."""

    def __init__(self) -> None:
        self._received: list[tuple[float, Mapping[str, Status]]] = []
        self._present: list[tuple[float, frozenset[str]]] = []

    def add(self, time: float, statuses: Mapping[str, Status]) -> None:
        """Add the statuses received at `time` s of the recording; in order of time."""
        self._received.append((time, dict(statuses)))

    def add_present(self, time: float, robots: Collection[str]) -> None:
        """Note the robots that have a daemon from `time` s of the recording on; in order of time.

        The first ones count from the beginning.
        """
        self._present.append((time if self._present else 0.0, frozenset(robots)))

    def merged_into(self, trace: Trace) -> Trace:
        """The trace with the state, protection, `report`, `readings` and `words` of the statuses.

        Empty, False and NaN before a robot's first status and without a daemon. The requested
        command is left out: it is some tenths of a second older than the safe command of a sample.
        `gap`, `scan_age` and `bound` are those of the last status.
        """
        if not self._received:
            return trace
        shape = len(trace.t), len(trace.ids)
        known: dict[str, Any] = blank_decisions(shape)
        named: dict[str, dict[str, NDArray[Any]]] = {"report": {}, "words": {}, "readings": {}}
        for time, statuses in self._received:
            since = int(np.searchsorted(trace.t, time - 1e-9))
            for robot, status in statuses.items():
                if robot not in trace.ids:
                    continue
                place = slice(since, None), trace.ids.index(robot)
                state, reason = status.state.value, status.reason or ""
                enter_decision(known, place, state, reason, status.decision)
                _enter_named(named, place, shape, status)
        known |= {kind: dict(sorted(arrays.items())) for kind, arrays in named.items()}
        return replace(trace, **known, **self._presence(trace, known))

    def _presence(self, trace: Trace, known: Mapping[str, Any]) -> dict[str, Any]:
        """The array `present`, if a robot was without a daemon; blanks what it did not report."""
        everyone = frozenset(trace.ids)
        if all(robots >= everyone for _, robots in self._present):
            return {}
        present = np.ones((len(trace.t), len(trace.ids)), dtype=bool)
        for time, robots in self._present:
            since = int(np.searchsorted(trace.t, time - 1e-9))
            present[since:] = [robot in robots for robot in trace.ids]
        for name, blank in zip(DECISION_ARRAYS, NO_DECISION, strict=True):
            known[name][~present] = blank
        for kind in ("report", "words", "readings"):
            for values in known[kind].values():
                values[~present] = "" if kind == "words" else np.nan
        return {"present": present}


def _enter_named(
    named: Mapping[str, dict[str, NDArray[Any]]], place: Any, shape: tuple[int, int], status: Status
) -> None:
    """Enter what a status reports by name; a name that it leaves out has no value any more."""
    for kind, blank in (("report", np.nan), ("words", ""), ("readings", np.nan)):
        for values in named[kind].values():
            values[place] = blank

    def enter(kind: str, name: str, value: Scalar) -> None:
        if isinstance(value, str):
            named["words"].setdefault(name, np.full(shape, "", dtype=WORD))[place] = value
        else:
            named[kind].setdefault(name, np.full(shape, np.nan))[place] = float(value)

    for name, value in status.report.items():
        enter("report", name, value)
    for name, value in status.readings.items():
        enter("readings", name, value)
