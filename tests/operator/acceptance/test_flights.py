"""The rows of a drone, and their judges, from made flights with figures counted by hand."""

from __future__ import annotations

import re

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.events import (
    Input,
    LeaseInput,
    OdometryInput,
    ReadingsInput,
    RequestInput,
    ScanInput,
)
from swarmd.core.values import Odometry, Pose, Scan, Twist
from swarmd.core.verbs import StopRequest
from swarmd.operator.acceptance import at_rest, flights, stops
from swarmd.operator.acceptance.evidence import Evidence, Samples
from swarmd.operator.acceptance.step import End, Step
from swarmd.operator.acceptance.steps import steps_of
from swarmd.operator.acceptance.verdict import Result, Verdict
from swarmd.settings.platforms import load_platform, platform_names

CRAZYFLIE = load_platform("crazyflie")  # at 0.5 m
STEPS = {step.id: step for step in steps_of(CRAZYFLIE)}
SPEED, PERIOD = 0.1, 0.05  # m/s, s
UP, STOP_AT, DOWN = 2.0, 6.5, 12.0  # s: at its height, the stop, the begin of the landing
RATE = 0.3  # m/s of the landing
LENGTH = 16.0  # s
STOP = (RequestInput(StopRequest(id="s", operator="o")), STOP_AT)
WALL = 1.8  # m


def flight(
    *more: tuple[Input, float],
    late: float = 0.1,
    drift: float = 0.005,
    height: float = 0.5,
    lands: bool = True,
    scale: float = 1.0,
    speed: float = SPEED,
) -> Evidence:
    """A flight ahead that ends `late` s after STOP_AT; the drone drifts to its left in the air."""
    inputs: list[tuple[Input, float]] = []
    x = y = 0.0
    for tick in range(round(LENGTH / PERIOD)):
        at = PERIOD * tick
        now = min(height, 0.25 * at) if at < DOWN else max(height - RATE * (at - DOWN), 0.0)
        now = height if at >= DOWN and not lands else now
        x += PERIOD * (speed if UP <= at < STOP_AT + late else 0.0)
        y += PERIOD * (drift if now > 0.02 else 0.0)
        pose = Pose(scale * x, scale * y)
        inputs.append((OdometryInput(Odometry(at, pose, Twist())), at))
        inputs.append((ReadingsInput({"battery": 0.7, "height": now}), at))
        ranges = np.array((WALL - x, np.inf, np.inf, np.inf))
        scan = Scan(tick, at, ranges, CRAZYFLIE.scan.bearings, 0.05, 2.0)
        inputs.append((ScanInput(scan), at))
    return Evidence(CRAZYFLIE, Samples([*inputs, *more]))


def shown(verdict: Verdict, result: str, word: str) -> bool:
    return (verdict.result, word in verdict.reason) == (result, True)


@pytest.mark.parametrize(
    ("fields", "result", "word"),
    [
        ({}, "pass", "lands"),
        ({"drift": 0.02}, "pass", "lands"),
        ({"late": 1.5}, "fail", "late"),
        ({"late": 99.0}, "fail", "ignores zero"),
        ({"lands": False}, "fail", "in the air"),
        ({"speed": 0.0, "drift": 0.0}, "fail", "take off"),
    ],
)
def test_a_drone_hovers_after_a_stop_and_lands(
    fields: dict[str, float], result: str, word: str
) -> None:
    judge = flights.lands(stops.after_stop())
    assert shown(judge(flight(STOP, **fields)), result, word)  # type: ignore[arg-type]


@pytest.mark.parametrize("late", [0.1, 0.4])
def test_the_time_to_rest_of_a_drone_that_drifts_is_that_of_its_flight(late: float) -> None:
    # 0.5 s, and 0.1 m/s by 0.7 m/s2.
    found = stops.after_stop()(flight(STOP, late=late, drift=0.01))
    assert found.bound == "0.64 s"
    assert float(found.values["seconds"]) == pytest.approx(late, abs=0.12)


def test_a_drone_that_tells_no_height_is_not_said_to_land() -> None:
    whole = flight(STOP)
    inputs = [one for one in whole.samples.inputs if not isinstance(one[0], ReadingsInput)]
    found = flights.lands(stops.after_stop())(Evidence(CRAZYFLIE, Samples(inputs)))
    assert found.result is Result.FAIL


def test_a_drone_that_lands_at_once_does_not_hover() -> None:
    whole = flight(speed=0.0)
    early = [one for one in whole.samples.inputs if not 3.0 < one[1] < DOWN]
    late = [(one, at if at < DOWN else at - 9.0) for one, at in early]
    assert flights.hovers(Evidence(CRAZYFLIE, Samples(late))).result is Result.FAIL


def test_a_drone_that_nobody_watches_is_judged_by_its_last_lease() -> None:
    leases = [(LeaseInput("run", n), 0.5 * n) for n in range(9)]  # the last at 4 s: 2.6 s before
    found = flights.lands(stops.after_silence)(flight(*leases))
    assert shown(found, "pass", "lands")
    assert float(found.values["seconds"]) == pytest.approx(2.6, abs=0.12)


@pytest.mark.parametrize(
    ("fields", "result", "word"),
    [
        ({}, "pass", "hovers"),
        ({"height": 0.62}, "fail", "scan_plane"),
        ({"height": 0.3}, "fail", "describe"),
        ({"drift": 0.05}, "fail", "drifts"),
    ],
)
def test_a_hover_is_judged_by_height_and_drift(
    fields: dict[str, float], result: str, word: str
) -> None:
    found = flights.hovers(flight(speed=0.0, **fields))  # type: ignore[arg-type]
    assert shown(found, result, word)


def test_the_figures_of_a_hover_are_those_of_the_flight() -> None:
    found = flights.hovers(flight(speed=0.0, drift=0.02))
    assert found.figure == "0.00 m off its height, 0.020 m/s"


def test_a_wrong_scale_of_the_estimate_is_found_by_the_range_ahead() -> None:
    assert flights.scale(flight(drift=0.0)).result is Result.PASS
    found = flights.scale(flight(scale=1.1, drift=0.0))
    assert shown(found, "fail", "Flow deck")
    assert found.figure.endswith("1.100")


@pytest.mark.parametrize("fields", [{"speed": 0.0}, {"speed": 0.3}])
def test_a_way_that_the_range_does_not_show_gives_no_scale(fields: dict[str, float]) -> None:
    """It hardly flew, or flew farther than to the wall."""
    whole = flight(**fields)  # type: ignore[arg-type]
    beyond = [
        (ScanInput(replace(one.scan, ranges=np.full(4, np.inf))), at)
        if isinstance(one, ScanInput) and one.scan.ranges[0] < 1.0
        else (one, at)
        for one, at in whole.samples.inputs
    ]
    found = flights.scale(Evidence(CRAZYFLIE, Samples(beyond)))
    assert shown(found, "not shown", "wall")


def test_a_drone_without_a_word_of_its_battery_fails() -> None:
    assert at_rest.battery(flight()).figure == "70%"
    assert at_rest.battery(Evidence(CRAZYFLIE)).result is Result.FAIL


# The rows


def test_drones_are_told_by_their_height() -> None:
    drones = [name for name in platform_names() if load_platform(name).is_drone]
    assert drones == ["crazyflie"]


def words_of(step: Step) -> str:
    motion = "" if step.motion is None else step.motion.text
    return f"{step.name} {step.why} {step.prepare} {step.question} {motion}"


def test_no_row_of_a_drone_speaks_of_wheels() -> None:
    texts = {id: words_of(step) for id, step in STEPS.items()}
    assert not [id for id, text in texts.items() if re.search("wheel|block|lidar is", text)]
    for id, step in STEPS.items():
        if step.motion is not None:
            assert "takes off to 0.50 m" in texts[id]
            assert "free" in step.question or id[0] == "D"
            assert step.motion.is_lifted is False


def test_nothing_flies_before_the_drone_has_obeyed_a_stop() -> None:
    first, *others = [step for step in STEPS.values() if step.motion is not None]
    assert first.motion is not None
    assert (first.id, first.motion.end, first.needs) == ("B1", End.STOP, ())
    assert all("B1" in step.needs for step in others)


def test_what_is_not_asked_of_a_drone_is_a_row_that_says_why() -> None:
    rows = [step for step in STEPS.values() if step.name.endswith(": not asked")]
    assert [step.id for step in rows] == ["A5", "C4", "D4"]
    for step in rows:
        assert not step.is_asked
        assert step.judge(Evidence(CRAZYFLIE)).result is Result.NOT_SHOWN


def test_ids_of_a_drone_are_counted_by_part() -> None:
    for part, count in {"A": 16, "B": 8, "C": 4, "D": 4}.items():
        own = [id for id in STEPS if id.startswith(part)]
        assert own == [f"{part}{number}" for number in range(1, count + 1)]
