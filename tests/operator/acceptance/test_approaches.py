"""Part D: the distance that is left, from made decisions and from a simulated drive to a box."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.events import OdometryInput
from swarmd.core.values import Array, Odometry, Pose, Twist
from swarmd.operator.acceptance import approaches
from swarmd.operator.acceptance.dialogue import Phase
from swarmd.operator.acceptance.evidence import Evidence, Samples, TimedDecision
from swarmd.operator.acceptance.steps import steps_of
from swarmd.operator.acceptance.verdict import Result, passed
from swarmd.settings.platforms import load_platform
from tests.operator.acceptance import test_faults as faults
from tests.operator.acceptance.bench import Bench
from tests.support.statuses import status

BURGER = load_platform("burger")
BOX = {"size": [6.0, 3.0], "boxes": [{"name": "box", "at": [1.2, 0.0], "size": [0.3, 0.3]}]}
BOX_AHEAD = 2.15  # m, the middle of a box of which the front is 2 m ahead
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
        ((1.0, 0.01), 0.1, (), "fail"),  # the noise of a range
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


# A box that is pushed


class PushedBox(Bench):
    """The person pushes the box from 2 m ahead at `push` m/s, until it is at the robot."""

    push = 0.0
    arrived: Array | None = None  # the twist of the robot when the box was there
    _box, _last = BOX_AHEAD, 0.0

    def _on_step(self, now: float) -> None:
        super()._on_step(now)
        if self.dialogue.phase is Phase.MOVING and self.arrived is None:
            self._box -= self.push * (now - self._last)
            try:
                self.sim.world.place("box", (self._box, 0.0, 0.0))
            except SwarmError:  # it would overlap the robot
                self.arrived = self.sim.world.twists()[0]
        self._last = now


@pytest.mark.parametrize(
    ("push", "coasts", "result", "word"),
    [
        (0.3, False, "pass", "did not touch"),  # as fast as protection assumes others
        (0.3, True, "fail", "touched at speed"),
        (1.4, False, "not shown", "push slower"),  # walking speed: a scan each 0.2 s is too late
    ],
)
def test_a_box_that_is_pushed(push: float, coasts: bool, result: str, word: str) -> None:
    arena = {**boxes((BOX_AHEAD, 0.0, 0.3, 0.3)), "size": [7.0, 3.0]}
    arena["boxes"][0] |= {"name": "box", "mass": 2.0}
    PushedBox.push = push
    known = {"B1": passed(""), "C2": passed("")}
    fault = faults.faulty(base="weak_brakes", linear=0.05) if coasts else {}
    bench = PushedBox(BURGER, [STEPS["D11"]], arena=arena, verdicts=known, **fault).run()
    found = bench.verdicts["D11"]
    assert (found.result, word in found.reason) == (result, True), found
    assert bench.arrived is not None
    assert bool(bench.arrived[0] > 0.02) is (result != "pass")


# A robot without a barrier


@pytest.mark.parametrize("name", ["thymio", "epuck2"])
def test_a_robot_without_a_barrier_is_not_said_to_touch_what_it_cannot_measure(name: str) -> None:
    """It evades at full speed, which the question says, and 1 to 5 mm from the box."""
    steps = {step.id: step for step in steps_of(load_platform(name))}
    known = {"B1": passed(""), "C2": passed("")}
    for id, arena, word in (
        ("D7", boxes((1.35, 0.0, 0.3, 0.3)), "without a barrier"),
        ("D12", boxes((1.0, 0.39, 4.0, 0.1)), "showed no obstacle within its 0."),
    ):
        bench = Bench(load_platform(name), [steps[id]], arena=arena, verdicts=known).run()
        found = bench.verdicts[id]
        assert (found.result, word in found.reason) == (Result.NOT_SHOWN, True), found


def test_the_speed_at_which_a_robot_evades_is_announced() -> None:
    thymio = load_platform("thymio")
    (slow,) = [step for step in steps_of(thymio) if step.id == "D1"]
    assert slow.motion is not None
    assert (slow.motion.speed, slow.motion.turn) == (0.12, 1.0)  # its limits
    bench = Bench(
        thymio,
        [slow],
        arena=boxes((1.35, 0.0, 0.3, 0.3)),
        verdicts={"B1": passed(""), "C2": passed("")},
    ).run()
    speeds = [one.twist.linear for _, one in bench.kept["D1"].odometry]
    assert max(map(abs, speeds)) > 0.05  # of 0.036 m/s that are asked for
    assert bench.farthest["D1"] <= slow.motion.reach
    walks = {step.id: step for step in steps_of(BURGER)}["D1"].motion
    assert walks is not None
    assert walks.speed == pytest.approx(0.3 * 0.22)
