"""Part D: the distance that is left, from made decisions and from a simulated drive to a box."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from swarmd.acceptance import approaches
from swarmd.acceptance.evidence import Evidence, Samples, TimedDecision
from swarmd.acceptance.steps import steps_of
from swarmd.acceptance.verdict import Result, passed
from swarmd.core.events import OdometryInput
from swarmd.core.values import Odometry, Pose, Twist
from swarmd.settings.platforms import load_platform
from tests.acceptance.bench import Bench
from tests.support.statuses import status

BURGER = load_platform("burger")
BOX = {"size": [6.0, 3.0], "boxes": [{"name": "box", "at": [1.2, 0.0], "size": [0.3, 0.3]}]}
STEPS = {step.id: step for step in steps_of(BURGER)}


def evidence(*gaps: float, speed: float = 0.0, findings: tuple[str, ...] = ()) -> Evidence:
    """Decisions a tenth of a second apart, with odometry at a steady speed."""
    decisions = [TimedDecision(0.1 * n, Twist(), gap, 1.0) for n, gap in enumerate(gaps)]
    inputs = [
        (OdometryInput(Odometry(0.1 * n, Pose(0.1 * n * speed), Twist(speed))), 0.1 * n)
        for n in range(len(gaps))
    ]
    return Evidence(BURGER, Samples(inputs, decisions), status("r", findings=findings))


@pytest.mark.parametrize(
    ("gaps", "speed", "findings", "result"),
    [
        ((1.0, 0.3, 0.1), 0.0, (), "pass"),
        ((1.0, 0.3, math.nan), 0.1, (), "pass"),
        ((1.0, 0.0), 0.1, (), "fail"),
        ((1.0, 0.0), 0.01, (), "pass"),  # the claim permits a touch below 2 cm/s
        ((1.0, 0.3), 0.0, ("the brakes are weak",), "fail"),
        ((1.0, 0.9), 0.0, (), "not shown"),
        ((math.nan,), 0.0, (), "not shown"),
        ((), 0.0, (), "not shown"),
    ],
)
def test_the_distance_left(
    gaps: tuple[float, ...], speed: float, findings: tuple[str, ...], result: str
) -> None:
    found = approaches.distance_left(evidence(*gaps, speed=speed, findings=findings))
    assert found.result == result, found
    assert all(finding in found.reason for finding in findings)


def test_a_way_that_is_not_made_fails() -> None:
    made = evidence(*[0.2] * 130, speed=0.1)
    assert approaches.passage(1.2)(made).result is Result.PASS
    assert approaches.passage(2.0)(made).result is Result.FAIL
    assert approaches.passage(0.0)(replace(made, samples=Samples())).result is Result.NOT_SHOWN


def boxes(*places: tuple[float, float, float, float]) -> dict[str, Any]:
    """A hall with boxes: x and y of the middle, and the sides, in m."""
    made = [
        {"name": f"box{number}", "at": [x, y], "size": [length, width]}
        for number, (x, y, length, width) in enumerate(places)
    ]
    return {"size": [6.0, 3.0], "boxes": made}


@pytest.mark.parametrize(
    ("id", "arena"),
    [
        ("D2", boxes((1.04, 0.6, 0.3, 0.3))),
        ("D6", boxes((1.04, -0.6, 0.3, 0.3))),
        ("D10", boxes((0.3, 0.55, 0.3, 0.3))),
        ("D12", boxes((1.0, 0.39, 4.0, 0.1))),
        ("D13", boxes((0.75, 0.499, 0.3, 0.3), (0.75, -0.499, 0.3, 0.3))),
    ],
)
def test_a_sound_robot_passes_beside_and_between_boxes(id: str, arena: dict[str, Any]) -> None:
    known = {"B1": passed(""), "C2": passed("")}
    bench = Bench(BURGER, [STEPS[id]], arena=arena, verdicts=known).run()
    assert bench.verdicts[id].result is Result.PASS, bench.verdicts[id]


def test_a_drive_to_a_box_ends_before_it_and_within_its_bound() -> None:
    own = [STEPS["D1"], STEPS["D7"]]
    known = {"B1": passed(""), "C2": passed("")}
    bench = Bench(BURGER, own, arena=BOX, verdicts=known).run()
    for step in own:
        found = bench.verdicts[step.id]
        assert found.result is Result.PASS, found
        assert 0.0 < float(found.values["gap"]) < 0.5
        assert step.motion is not None
        assert bench.farthest[step.id] <= step.motion.reach
