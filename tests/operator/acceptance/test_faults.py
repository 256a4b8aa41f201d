"""The table of faults: each is found by the step that should find it, with its cause in the line.

The wanted steps and words are written by hand. A simulated Burger has one fault at a time; its
daemon has the platform's own file. Faults of nodes, networks and several daemons are in
test_at_rest.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from dataclasses import replace as replace_fields
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.values import Array, Scan
from swarmd.operator.acceptance.step import Step
from swarmd.operator.acceptance.steps import steps_of
from swarmd.operator.acceptance.verdict import Result, passed
from swarmd.settings.platforms import load_platform
from tests.operator.acceptance.bench import HALL, ROOM, Bench

FILE = load_platform("burger")
BURGER = replace_fields(FILE, provides=FILE.provides | {"reading:battery"})
REST = 10.0  # s, in place of a minute
STEPS = [replace_fields(step, seconds=min(step.seconds, REST)) for step in steps_of(BURGER)]
FEWER = {"C2": {"floor": 2.0, "repeats": 1}}
"""Parameters of a shorter calibration."""
OUTSIDE = ("A1", "A2", "A3", "A4", "A5", "C8")
"""Steps that need a network, a machine or a person's file."""
TILT, TILT_HEIGHT = math.radians(5.0), 0.18  # rad, m: the floor is seen at 2.06 m


@dataclass(frozen=True)
class Row:
    """A fault: `step` finds it, with `words` in its line; `also`: other steps that may fail.

    `is_alone`: the steps before it in its part are left out.
    """

    step: str
    words: str
    bench: dict[str, Any] = field(default_factory=dict)
    make: Callable[[], dict[str, Any]] = dict
    also: tuple[str, ...] = ()
    is_alone: bool = False


def turned(scan: Scan) -> Scan:
    return replace(scan, ranges=np.roll(scan.ranges, 90))


def of_two(scan: Scan) -> Scan:
    """Each second scan is that of another lidar."""
    return turned(scan) if scan.seq % 2 else scan


def tilted(towards: float) -> Callable[[Scan], Scan]:
    """A lidar that is lowered by TILT to `towards` degrees: there its rays meet the floor."""
    noise = np.random.default_rng(7)

    def seen(scan: Scan) -> Scan:
        lowered = math.tan(TILT) * np.cos(scan.bearings - math.radians(towards))
        floor = TILT_HEIGHT / np.maximum(lowered, 1e-3) + noise.normal(0.0, 0.02, len(lowered))
        ranges = np.minimum(np.where(scan.ranges > 0.0, scan.ranges, np.inf), floor)
        return replace(scan, ranges=np.where(ranges > scan.range_max, np.inf, ranges))

    return seen


def joined() -> dict[str, Any]:
    """Two lidars as one scan: the rays behind are those of the scan before."""
    before: Array | None = None

    def seen(scan: Scan) -> Scan:
        nonlocal before
        last = scan.ranges if before is None else before
        before = scan.ranges.copy()
        behind = np.cos(scan.bearings) < 0.0
        return replace(scan, ranges=np.where(behind, last, scan.ranges))

    return {"scan_fault": seen}


def half_rate() -> dict[str, Any]:
    return {"scan_fault": lambda scan: None if scan.seq % 2 else scan}


def faulty(**fault: Any) -> dict[str, Any]:
    """A fault of the table in `sim/world/faults.py`."""
    return {"faults": (fault,)}


ROWS = {
    "brakes 30 % weaker": Row("C3", "brakes", faulty(base="weak_brakes", linear=0.7, angular=2.1)),
    "command delay 200 ms": Row("C4", "later", faulty(base="late", seconds=0.17)),
    "lidar mirrored": Row("A13", "mirrored", faulty(scan="mirrored"), also=("A15",)),
    "lidar turned": Row("A12", "turned by 90", faulty(scan="turned"), also=("A13", "A14", "A15")),
    "stamps 3 s old": Row("A8", "older", faulty(scan="stamps", seconds=-3.0)),
    "stamps 3 s new": Row("A8", "newer", faulty(scan="stamps", seconds=3.0)),
    "scans at half rate": Row("A7", "rarely", make=half_rate),
    "8 % of scans lost": Row("A7", "lost", faulty(scan="lost", share=0.08)),
    "two lidars on one topic": Row("A7", "two sensors", {"scan_fault": of_two}),
    "odometry in bursts": Row("A10", "bursts", {"odometry_burst": 0.5}),
    "own mast in the scan": Row("A9", "inside", faulty(scan="mast")),
    "odometry scale 10 % off": Row(
        "C6", "scale", faulty(odometry="scale", factor=1.1), also=("C5",)
    ),
    "watchdog off": Row("B7", "drove on", {"has_watchdog": False}, also=("B8",)),
    "stop button without effect": Row("B9", "button", {"has_button": False}, is_alone=True),
    "base that ignores zero": Row("B1", "ignores zero", faulty(base="ignores_zero")),
    "base that coasts": Row("B1", "coasts", faulty(base="coasts", deceleration=0.05)),
    "dead zone": Row("C1", "dead zone", faulty(base="dead_zone", speed=0.05)),
    "lidar tilted ahead": Row(
        "C9", "tilted", {"scan_fault": tilted(0.0), "arena": HALL}, is_alone=True
    ),
    "lidar tilted to the left": Row(
        "C9", "tilted", {"scan_fault": tilted(90.0), "arena": HALL}, is_alone=True
    ),
    "lidar tilted backwards": Row(
        "C9", "tilted", {"scan_fault": tilted(180.0), "arena": HALL}, is_alone=True
    ),
    "battery of another robot": Row(
        "A16", "battery of tb3-02", {"reading": 0.80123, "charges": {"tb3-02": 0.80123}}
    ),
    "two lidars joined, one late": Row("C10", "joined", make=joined),
    "no battery message": Row("A11", "battery", {"reading": None}),
}
"""The faults of issue 69 that a base and a lidar can have by themselves."""


def shorter(step: Step) -> Step:
    """The step with fewer drives."""
    if step.motion is None or step.id not in FEWER:
        return step
    return replace_fields(step, motion=step.motion._replace(params=FEWER[step.id]))


def part_of(step: str, last: str = "", *, is_alone: bool = False, **bench: Any) -> Bench:
    """The part of a step, up to the step `last`; what it needs of other parts has passed.

    `is_alone`: only the step `last`, and B1 has passed.
    """
    part = [one for one in STEPS if one.id[0] == step[0]]
    ids = [one.id for one in part]
    own = part[: ids.index(last) + 1] if last else part
    own = [one for one in own if one.id not in OUTSIDE]
    own = [one for one in own if one.id == last] if is_alone else own
    known = {"B1": passed("")} if step[0] != "B" or is_alone else {}
    bench = {"arena": HALL if step[0] == "B" else ROOM, **bench}
    steps = [shorter(one) for one in own] if last else own
    return Bench(BURGER, steps, verdicts=known, **bench).run()


@pytest.mark.short_rows(5)
@pytest.mark.parametrize("fault", ROWS)
def test_each_fault_is_found_by_its_step_with_its_cause(fault: str) -> None:
    row = ROWS[fault]
    last = row.also[-1] if row.also and row.also[-1][0] == row.step[0] else row.step
    last = max(row.step, last, key=[one.id for one in STEPS].index)
    given = {"reading": 0.8, **row.bench, **row.make()}
    bench = part_of(row.step, last, is_alone=row.is_alone, **given)
    found = bench.verdicts[row.step]
    assert found.result is Result.FAIL, found
    assert row.words in found.reason
    failures = {name for name, one in bench.verdicts.items() if one.result is Result.FAIL}
    assert failures <= {row.step, *row.also}
    check_bounds(bench)


@pytest.mark.parametrize("part", ["A", "B", "C"])
def test_a_sound_robot_passes_all(part: str) -> None:
    bench = part_of(part, reading=0.8, charges={"tb3-02": 0.7})
    results = {name: one for name, one in bench.verdicts.items() if name[0] == part}
    assert len(results) >= 7
    left = {name: one for name, one in results.items() if one.result is not Result.PASS}
    assert left.keys() == ({"C9"} if part == "C" else set()), left  # walls are near
    check_bounds(bench)


def test_a_sound_robot_in_a_hall_shows_no_tilt() -> None:
    found = part_of("C9", "C9", is_alone=True, arena=HALL).verdicts["C9"]
    assert found.result is Result.PASS, found


def test_a_tilt_does_not_show_between_near_walls() -> None:
    found = part_of("C9", "C9", is_alone=True, scan_fault=tilted(0.0)).verdicts["C9"]
    assert (found.result, "2.4 m" in found.reason) == (Result.NOT_SHOWN, True)


def check_bounds(bench: Bench) -> None:
    """No step on the floor moved the base farther than announced, by the true poses."""
    for step in bench.dialogue.steps:
        if step.motion is not None and not step.motion.is_lifted:
            assert bench.farthest.get(step.id, 0.0) <= step.motion.reach
