"""Recording of a lockstep run: ground truth, decisions and reports of robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.behaviour import RULES, rules_of_decision
from swarmd.sim.lockstep.shell import RobotShell
from swarmd.sim.trace import (
    NO_DECISION,
    WORD,
    Trace,
    TraceBuilder,
    blank_decisions,
    decision_values,
)
from swarmd.sim.world.world import World

_Reports = dict[tuple[str, str], list[tuple[int, int, float | str]]]
Kept = tuple[NDArray[np.intp], dict[str, NDArray[Any]], _Reports, frozenset[str]]
"""Records of the robots of one process: their rows, then arrays by column of _COLUMNS, reports, and
the rules that no array tells (`rules_of_decision`).

Reports by kind and name are entries (sample, row, value)."""


class LockstepRecorder:
    """Builds a trace, one sample at a time."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._builder = TraceBuilder(
            world.ids,
            world.platforms,
            {},
            movable_boxes=world.loose,
            box_shapes=world.loose_shapes,
        )
        self._samples = 0
        self._latest: list[tuple[Any, ...]] = []  # of `_values`, instant by instant
        self._blocks: dict[str, list[NDArray[Any]]] = {name: [] for name in _COLUMNS}
        self._reports: _Reports = {}
        self._rules: set[str] = set()

    def record_contacts(self, now: float) -> None:
        """Record the contacts of the step that ended at `now`."""
        for contact in self._world.contacts():
            self._builder.add_contact(now, *astuple(contact))

    def record_instant(self, now: float, safe: Array, shells: Sequence[RobotShell | None]) -> None:
        """Record all robots at `now`, with the commands `safe` (n, 3) in force."""
        world = self._world
        self._builder.add(now, world.poses(), safe, world.loose_poses())
        for row, shell in enumerate(shells):
            if shell is not None and (report := shell.robot.report):
                self._note("report", report, row)
            if shell is not None and (readings := shell.robot.readings):
                self._note("readings", readings, row)
            if shell is not None:
                self._rules.update(rules_of_decision(shell.robot.decision))
        self._samples += 1
        self._latest.extend(map(_values, shells))
        if len(self._latest) >= _BLOCK:
            self._end_block()

    def _end_block(self) -> None:
        # A whole column at once: a single value costs in numpy as much as ten in a list.
        columns = zip(*self._latest, strict=True)
        for (name, kind), values in zip(_COLUMNS.items(), columns, strict=False):
            column = np.array(values, dtype=kind)
            self._blocks[name].append(column.reshape(-1, len(self._world.ids), *column.shape[1:]))
        self._latest = []

    def kept(self, rows: NDArray[np.intp]) -> Kept:
        """The records of the robots `rows`, for `trace`."""
        self._end_block()
        columns = {name: np.concatenate(blocks)[:, rows] for name, blocks in self._blocks.items()}
        return rows, columns, self._reports, frozenset(self._rules)

    def trace(self, meta: Mapping[str, Any], kept: Sequence[Kept]) -> Trace:
        """The trace of all samples; `kept`: the records of all processes, which cover all rows."""
        shape = (self._samples, len(self._world.ids))
        known: dict[str, Any] = {"report": {}, "words": {}, "readings": {}}
        reports: _Reports = {}
        rules: set[str] = set()
        for own, columns, some, acting in kept:
            rules |= acting
            for name, values in columns.items():
                if name not in known:
                    known[name] = np.empty(shape + values.shape[2:], values.dtype)
                known[name][:, own] = values
            for key, entries in some.items():
                reports.setdefault(key, []).extend(entries)
        for (kind, name), entries in sorted(reports.items()):
            samples, rows, items = zip(*entries, strict=True)
            blank = np.full(shape, "", dtype=WORD) if kind == "words" else np.full(shape, np.nan)
            blank[list(samples), list(rows)] = items
            known[kind][name] = blank
        about = {**meta, RULES: sorted(rules)}
        return replace(self._builder.trace(**about), **known)

    def _note(self, kind: str, values: Mapping[str, Any], row: int) -> None:
        for name, value in values.items():
            key = ("words" if isinstance(value, str) else kind, name)
            item = value if isinstance(value, str) else float(value)
            self._reports.setdefault(key, []).append((self._samples, row, item))


_BLOCK = 1000  # tuples of `_values` that become arrays at once
_COLUMNS: Mapping[str, Any] = MappingProxyType(
    {
        "present": bool,
        "decided": np.int64,
        "evaded": np.int64,
        "requested": np.float64,
        **{name: values.dtype for name, values in blank_decisions((0,)).items()},
    }
)
"""The columns of a sample, each with its type."""


def _values(shell: RobotShell | None) -> tuple[Any, ...]:
    """A robot's state and its decisions since the last sample, in the order of _COLUMNS."""
    if shell is None:
        return _ABSENT
    robot = shell.robot
    decision = shell.robot.decision
    decided = shell.decided
    evaded = shell.evaded
    shell.decided = 0
    shell.evaded = 0
    values = decision_values(robot.state, robot.reason or "", decision)
    return True, decided, evaded, astuple(decision.requested), *values


_ABSENT = (False, 0, 0, (0.0, 0.0, 0.0), *NO_DECISION)
