"""Recording of a lockstep run: ground truth, decisions and reports of robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.lockstep.shell import RobotShell
from swarmd.sim.trace import ARENA, Trace
from swarmd.sim.world.world import World

_WORD = "U24"


class LockstepRecorder:
    """Builds a trace, one sample at a time."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._index = {robot: row for row, robot in enumerate(world.ids)}
        self._index |= {f"box/{name}": ARENA - 1 - i for i, name in enumerate(world.movable_boxes)}
        self._t: list[float] = []
        self._rows: dict[str, list[NDArray[Any]]] = {}
        self._reports: dict[str, list[tuple[int, int, float]]] = {}
        self._words: dict[str, list[tuple[int, int, str]]] = {}
        self._contacts: list[tuple[float, int, int, float, float]] = []

    def record_contacts(self, now: float) -> None:
        """Record the contacts of the step that ended at `now`."""
        for contact in self._world.contacts():
            pair = self._index[contact.a], self._index.get(contact.b, ARENA)
            self._contacts.append((now, *pair, contact.speed_a, contact.speed_b))

    def record_instant(self, now: float, safe: Array, shells: Sequence[RobotShell | None]) -> None:
        """Record all robots at `now`, with the commands `safe` (n, 3) in force."""
        kept = _blank(len(shells))
        kept["pose"], kept["safe"] = self._world.poses(), safe.copy()
        for row, shell in enumerate(shells):
            if shell is not None:
                _enter(kept, row, shell)
                self._note(shell.robot.report, len(self._t), row)
        self._t.append(now)
        if self._world.movable_boxes:
            kept["box_pose"] = self._world.box_poses()
        for name, values in kept.items():
            self._rows.setdefault(name, []).append(values)

    def trace(self, meta: Mapping[str, Any]) -> Trace:
        """The trace of all samples."""
        world, contacts = self._world, np.array(self._contacts).reshape(-1, 5)
        shape = (len(self._t), len(world.ids))
        rows = {name: np.array(values) for name, values in self._rows.items()}
        return Trace(
            ids=world.ids,
            t=np.array(self._t),
            contact_t=contacts[:, 0],
            contact_pair=contacts[:, 1:3].astype(np.int64),
            contact_speed=contacts[:, 3:],
            platforms=tuple(platform.name for platform in world.platforms),
            footprints={platform.name: platform.footprint for platform in world.platforms},
            meta=dict(meta),
            report={name: _filled(self._reports[name], shape) for name in sorted(self._reports)},
            words={name: _filled_words(self._words[name], shape) for name in sorted(self._words)},
            movable_boxes=tuple(world.movable_boxes),
            box_shapes=world.box_shapes if world.movable_boxes else None,
            **rows,
        )

    def _note(self, report: Mapping[str, Any], record_instant: int, row: int) -> None:
        for name, value in report.items():
            if isinstance(value, str):
                self._words.setdefault(name, []).append((record_instant, row, value))
            else:
                self._reports.setdefault(name, []).append((record_instant, row, float(value)))


def _blank(n: int) -> dict[str, NDArray[Any]]:
    """The values of n robots without a daemon."""
    flags, counts = np.zeros((3, n), dtype=bool), np.zeros((2, n), dtype=np.int64)
    words, numbers = np.full((2, n), "", dtype=_WORD), np.full((2, n), np.nan)
    return {
        "present": flags[0],
        "active": flags[1],
        "recovering": flags[2],
        "decided": counts[0],
        "evaded": counts[1],
        "state": words[0],
        "reason": words[1],
        "gap": numbers[0],
        "scan_age": numbers[1],
        "bound": np.full((n, 3), np.nan),
        "requested": np.zeros((n, 3)),
    }


def _enter(kept: Mapping[str, NDArray[Any]], row: int, shell: RobotShell) -> None:
    """Enter the state of robot `row` and its decisions since the last sample."""
    robot, decision = shell.robot, shell.robot.decision
    kept["present"][row] = True
    kept["state"][row], kept["reason"][row] = robot.state.value, robot.reason or ""
    kept["requested"][row] = (
        decision.requested.linear,
        decision.requested.angular,
        decision.requested.lateral,
    )
    kept["active"][row], kept["recovering"][row] = decision.is_active, decision.is_recovering
    kept["decided"][row], kept["evaded"][row] = shell.decided, shell.evaded
    shell.decided = shell.evaded = 0
    if decision.min_gap is not None:
        kept["gap"][row] = decision.min_gap
    if decision.scan_age is not None:
        kept["scan_age"][row] = decision.scan_age
    if decision.rows:
        kept["bound"][row] = astuple(decision.rows[0])


def _filled(entries: list[tuple[int, int, float]], shape: tuple[int, int]) -> Array:
    values = np.full(shape, np.nan)
    instants, rows, numbers = zip(*entries, strict=True)
    values[list(instants), list(rows)] = numbers
    return values


def _filled_words(entries: list[tuple[int, int, str]], shape: tuple[int, int]) -> NDArray[np.str_]:
    values = np.full(shape, "", dtype=_WORD)
    instants, rows, words = zip(*entries, strict=True)
    values[list(instants), list(rows)] = words
    return values
