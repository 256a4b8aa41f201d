"""Every judge on samples that no sound robot gives: a verdict, and no pass of what they lack."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.events import (
    DriverInput,
    Input,
    LeaseInput,
    OdometryInput,
    ReadingsInput,
    RequestInput,
    ScanInput,
)
from swarmd.core.values import Odometry, Platform, Pose, Scan, Twist
from swarmd.core.verbs import StopRequest
from swarmd.operator.acceptance.evidence import Evidence, Samples, TimedDecision
from swarmd.operator.acceptance.steps import steps_of
from swarmd.operator.acceptance.verdict import Result, Verdict, passed
from swarmd.operator.calibration.figures import DONE, Figure
from swarmd.settings.platforms import load_platform
from tests.support.statuses import status

Timed = tuple[Input, float]
PLATFORMS = ("burger", "crazyflie")
SCANS, ODOMETRY = {"A7", "A8", "A9"}, {"A8", "A10", "B1", "B2", "B5", "B6", "B7", "B8", "C1"}
"""Steps that judge scans, and odometry."""
LACKING = {
    "nothing": SCANS | ODOMETRY,
    "one of each": SCANS | ODOMETRY,
    "two": SCANS | ODOMETRY,
    "all at one time": {"A7", "B1", "B5"},
    "all at one time with one stamp": {"A7", "A8", "A10", "B1", "B5"},
    "one stamp": {"A8", "A10"},
    "one reading": {"A8", "A10", "B1"},
    "stamps that go back": {"A8"},
    "stamps without number": ODOMETRY,
    "endless stamps": {"A8", "A10"},
    "great stamps": {"A8", "A10"},
    "no scan": SCANS,
    "no odometry": ODOMETRY,
    "scans of 0": {"A9"},
    "scans without rays": {"A9"},
    "a pose of nan": ODOMETRY,
    "a base that stands": {"B1", "B5", "C1"},
}
"""By the fault: steps that must not pass, since what they judge is not there."""


def sound(platform: Platform) -> list[Timed]:
    """A drive ahead at 0.1 m/s from 2 s to 5 s, with a stop at 5 s."""
    bearings = platform.scan.bearings
    inputs: list[Timed] = [(DriverInput(True, "base"), 0.0)]
    for tick in range(160):
        at = 0.05 * tick
        x = 0.1 * min(max(at - 2.0, 0.0), 3.0)
        inputs.append((OdometryInput(Odometry(at, Pose(x), Twist(0.1))), at))
        inputs.append((LeaseInput("g", tick), at))
        if tick % 4 == 0:
            ranges = 1.0 - x + 0.01 * np.sin(bearings + at)
            ranges = np.minimum(ranges, platform.scan.range_max)
            scan = Scan(tick, at - 0.1, ranges, bearings, 0.05, platform.scan.range_max)
            inputs.append((ScanInput(scan), at))
            inputs.append((ReadingsInput({"battery": 0.7, "height": 0.4}), at))
        if tick == 100:
            request = StopRequest(id="1", operator="o", targets={})
            inputs.append((RequestInput(request), at))
    return inputs


def stamped(change: Callable[[int, float], float]) -> Callable[[list[Timed]], list[Timed]]:
    """Inputs whose stamps are changed, by their number."""

    def changed(inputs: list[Timed]) -> list[Timed]:
        found: list[Timed] = []
        for number, (one, at) in enumerate(inputs):
            if isinstance(one, OdometryInput):
                odometry = one.odometry
                stamp = change(number, odometry.stamp)
                one = OdometryInput(Odometry(stamp, odometry.pose, odometry.twist))
            elif isinstance(one, ScanInput):
                one = ScanInput(replace(one.scan, stamp=change(number, one.scan.stamp)))
            found.append((one, at))
        return found

    return changed


def ranged(value: float) -> Callable[[list[Timed]], list[Timed]]:
    """Scans in which each ray has this value."""

    def changed(inputs: list[Timed]) -> list[Timed]:
        return [
            (ScanInput(replace(one.scan, ranges=np.full_like(one.scan.ranges, value))), at)
            if isinstance(one, ScanInput)
            else (one, at)
            for one, at in inputs
        ]

    return changed


def placed(pose: Pose) -> Callable[[list[Timed]], list[Timed]]:
    """Odometry that always tells this pose."""

    def changed(inputs: list[Timed]) -> list[Timed]:
        return [
            (OdometryInput(Odometry(one.odometry.stamp, pose, Twist())), at)
            if isinstance(one, OdometryInput)
            else (one, at)
            for one, at in inputs
        ]

    return changed


def without_rays(inputs: list[Timed]) -> list[Timed]:
    empty = np.array([])
    return [
        (ScanInput(replace(one.scan, ranges=empty, bearings=empty)), at)
        if isinstance(one, ScanInput)
        else (one, at)
        for one, at in inputs
    ]


def first_of_each(inputs: list[Timed]) -> list[Timed]:
    kinds = {type(one): (one, at) for one, at in reversed(inputs)}
    return list(kinds.values())


ODD: dict[str, Callable[[list[Timed]], Sequence[Timed]]] = {
    "nothing": lambda inputs: [],
    "one of each": first_of_each,
    "two": lambda inputs: inputs[:6],
    "all at one time": lambda inputs: [(one, 3.0) for one, _ in inputs],
    "all at one time with one stamp": lambda inputs: stamped(lambda *_: 3.0)(
        [(one, 3.0) for one, _ in inputs]
    ),
    "one stamp": stamped(lambda number, stamp: 3.0),
    "one reading": lambda inputs: placed(Pose())(stamped(lambda number, stamp: 3.0)(inputs)),
    "each reading three times": stamped(lambda number, stamp: 0.15 * (stamp // 0.15)),
    "each input twice": lambda inputs: [one for one in inputs for _ in range(2)],
    "stamps that go back": stamped(lambda number, stamp: -stamp),
    "stamps to and fro": stamped(lambda number, stamp: stamp - 0.2 * (number % 2)),
    "times that go back": lambda inputs: [(one, -at) for one, at in inputs],
    "stamps without number": stamped(lambda number, stamp: math.nan),
    "one stamp without number": stamped(lambda n, stamp: math.nan if n == 30 else stamp),
    "endless stamps": stamped(lambda number, stamp: math.inf),
    "great stamps": stamped(lambda number, stamp: 1e18),
    "no scan": lambda inputs: [one for one in inputs if not isinstance(one[0], ScanInput)],
    "no odometry": lambda inputs: [one for one in inputs if not isinstance(one[0], OdometryInput)],
    "scans of nan": ranged(math.nan),
    "scans of inf": ranged(math.inf),
    "scans of -inf": ranged(-math.inf),
    "scans of 0": ranged(0.0),
    "scans without rays": without_rays,
    "a pose of nan": placed(Pose(math.nan, 0.0, 0.0)),
    "a pose far off": placed(Pose(1e300, 1e300, 0.0)),
    "a base that stands": placed(Pose()),
}


def evidence(platform: Platform, inputs: Sequence[Timed], decisions: int = 20) -> Evidence:
    """Evidence of these inputs, with a calibration whose figures are no numbers."""
    numbers = Figure(math.nan, math.nan, 8, 1.0).text
    figures = {name: numbers for name in ("braking_linear", "margin", "scan_delay")}
    earlier = {id: passed("", **figures) for id in ("A12", "B2", "C2")}
    report = {"state": DONE, **figures}
    return Evidence(
        platform,
        Samples(inputs, [TimedDecision(3.0, Twist(0.1), 0.5, 1.0)] * decisions),
        replace(status("r"), report=report),
        earlier=earlier,
    )


def verdicts(platform: Platform, one: Evidence) -> dict[str, Verdict]:
    return {step.id: step.judge(one) for step in steps_of(platform)}


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize("platform", PLATFORMS)
def test_every_judge_gives_a_verdict_on_odd_samples(platform: str, name: str) -> None:
    file = load_platform(platform)
    found = verdicts(file, evidence(file, ODD[name](sound(file))))
    assert all(isinstance(one, Verdict) for one in found.values())
    figures = "".join(one.figure for one in found.values() if one.result is Result.PASS)
    assert "nan" not in figures
    passes = {id for id, one in found.items() if one.result is Result.PASS}
    assert not passes & LACKING.get(name, set())


def test_a_sound_drive_passes_what_reads_it() -> None:
    """Else the test above shows nothing."""
    burger = load_platform("burger")
    found = verdicts(burger, evidence(burger, sound(burger)))
    assert found["B1"].result is found["A7"].result is found["A8"].result is Result.PASS, found
