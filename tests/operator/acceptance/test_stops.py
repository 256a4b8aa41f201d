"""Part B: stops from made tracks of odometry, with times counted by hand."""

from __future__ import annotations

import math
from dataclasses import replace as fields_replace

import pytest
from msgspec.structs import replace

from swarmd.core.events import Input, LeaseInput, OdometryInput, RequestInput
from swarmd.core.messages import Latch, State, Status
from swarmd.core.values import Odometry, Pose, Twist
from swarmd.core.verbs import StopRequest
from swarmd.operator.acceptance import stops
from swarmd.operator.acceptance.evidence import Evidence, Samples, TimedDecision
from swarmd.operator.acceptance.verdict import Verdict, passed
from swarmd.settings.platforms import load_platform
from tests.support.statuses import status

BURGER = load_platform("burger")  # it brakes with 1 m/s2
SPEED, PERIOD, STOP_AT, LENGTH = 0.1, 0.05, 3.0, 10.0  # m/s, s
STOP = (RequestInput(StopRequest(id="s", operator="o")), STOP_AT)
LATCH = {"x": Latch(issuer="o", scope="robots")}


def evidence(
    late: float,
    braking: float,
    *more: tuple[Input, float],
    gap: float = 0.0,
    robot: Status | None = None,
) -> Evidence:
    """A drive at SPEED that brakes `late` s after STOP_AT; no odometry for `gap` s then."""
    inputs: list[tuple[Input, float]] = []
    way, speed = 0.0, SPEED
    for tick in range(round(LENGTH / PERIOD)):
        at = PERIOD * tick
        if at > STOP_AT + late:
            speed = max(speed - braking * PERIOD, 0.0)
        way += speed * PERIOD
        if not STOP_AT < at < STOP_AT + gap:
            inputs.append((OdometryInput(Odometry(at, Pose(way), Twist(speed))), at))
    return Evidence(BURGER, Samples([*inputs, *more]), robot)


@pytest.mark.parametrize(
    ("late", "braking", "result", "word"),
    [
        (0.1, 1.0, "pass", ""),
        (0.3, 1.0, "pass", ""),
        (1.0, 1.0, "fail", "late"),
        (0.1, 0.05, "fail", "coasts"),
        (99.0, 1.0, "fail", "ignores zero"),
    ],
)
def test_a_base_rests_within_its_bound(late: float, braking: float, result: str, word: str) -> None:
    found = stops.after_stop()(evidence(late, braking, STOP))
    assert (found.result, word in found.reason) == (result, True)
    assert found.bound == "0.60 s"


def test_the_time_to_rest_is_that_of_the_track() -> None:
    found = stops.after_stop()(evidence(0.3, 1.0, STOP))
    assert float(found.values["seconds"]) == pytest.approx(0.35, abs=0.1)
    assert float(found.values["speed"]) == pytest.approx(SPEED, rel=0.01)


def test_without_a_stop_or_a_drive_nothing_is_shown() -> None:
    assert stops.after_stop()(evidence(0.1, 1.0)).result == "not shown"
    still = evidence(-3.0, 99.0, STOP)
    assert stops.after_stop()(still).result == "fail"
    assert "did not drive" in stops.after_stop()(still).reason


def test_an_emergency_stop_must_latch() -> None:
    judge = stops.after_stop(latched=True)
    held = status("r", state=State.ESTOPPED)
    found = judge(evidence(0.1, 1.0, STOP, robot=held))
    assert (found.result, found.values["instance"]) == ("pass", held.instance)
    assert judge(evidence(0.1, 1.0, STOP, robot=status("r", state=State.STOPPED))).result == "fail"
    assert judge(evidence(0.1, 1.0, STOP)).result == "fail"


def test_a_lease_is_counted_from_the_last_word_before_the_silence() -> None:
    before = [(LeaseInput("g", n), 0.5 * n) for n in range(3)]  # the last at 1.0 s
    again = [(LeaseInput("g", 9), 9.0)]
    assert stops.after_silence(evidence(0.1, 1.0, *before, *again)).result == "pass"
    assert stops.after_silence(evidence(1.5, 1.0, *before, *again)).result == "fail"
    assert stops.after_silence(evidence(0.1, 1.0)).result == "not shown"


@pytest.mark.parametrize(("speed", "is_lease"), [(SPEED, True), (0.0, False)])
def test_a_daemon_that_drives_on_without_its_operator_is_told_from_a_base(
    speed: float, is_lease: bool
) -> None:
    heard = [(LeaseInput("g", n), 0.5 * n) for n in range(3)]  # the last at 1.0 s
    track = evidence(2.0, 1.0, *heard)  # it brakes at 5 s
    decisions = [TimedDecision(0.1 * n, Twist(speed), 1.0, 1.0) for n in range(50)]
    samples = fields_replace(track.samples, decisions=decisions)
    found = stops.after_silence(fields_replace(track, samples=samples))
    assert found.result == "fail"
    assert ("run lease did not end the run" in found.reason) is is_lease


@pytest.mark.parametrize(
    ("late", "gap", "result"),
    [(0.5, 4.0, "pass"), (99.0, 4.0, "fail"), (0.5, 0.0, "not shown"), (-2.9, 4.0, "not shown")],
)
def test_the_way_while_no_odometry_came(late: float, gap: float, result: str) -> None:
    found = stops.across_gap("look at the watchdog")(evidence(late, 1.0, gap=gap))
    assert found.result == result
    assert ("look at the watchdog" in found.reason) is (result == "fail")


@pytest.mark.parametrize(
    ("robot", "result"),
    [
        (None, "fail"),
        (status("r", state=State.ESTOPPED), "not shown"),  # the daemon of before
        (replace(status("r", state=State.ESTOPPED), instance="new"), "pass"),
        (replace(status("r", state=State.IDLE), instance="new"), "fail"),
    ],
)
def test_the_latch_must_outlive_a_restart(robot: Status | None, result: str) -> None:
    known: dict[str, Verdict] = {"B2": passed("", instance=status("r").instance)}
    found = stops.latch_after_restart("B2")(Evidence(BURGER, status=robot, earlier=known))
    assert found.result == result


@pytest.mark.parametrize(
    ("robot", "result"),
    [
        (None, "fail"),
        (status("r", state=State.ESTOPPED), "fail"),
        (replace(status("r", state=State.IDLE), latches=LATCH), "fail"),
        (replace(status("r", state=State.IDLE), latches={}), "pass"),
    ],
)
def test_a_reset_clears_state_and_latch(robot: Status | None, result: str) -> None:
    assert stops.is_reset(Evidence(BURGER, status=robot)).result == result


def pressed(at: float, *, released: float = 40.0, told: float = 40.0, on: float = 0.0) -> Verdict:
    """A run of 30 s at 0.1 m/s; the base stands while its button is pressed.

    `told`: when the daemon ends the run since its driver tells it. `on`: m/s after a late release.
    """
    x, inputs, decisions = 0.0, [], []
    for tick in range(900):
        now = 0.05 * tick
        is_commanded = 2.0 < now <= min(32.0, told)
        if is_commanded and not at <= now < released:
            x += 0.05 * 0.1
        x += 0.05 * on if now >= released else 0.0
        inputs.append((OdometryInput(Odometry(now, Pose(x), Twist())), now))
        decisions.append(TimedDecision(now, Twist(0.1 * is_commanded), math.nan, 1.0))
    return stops.own_stop(30.0)(Evidence(BURGER, Samples(inputs, decisions)))


@pytest.mark.parametrize(
    ("button", "result"),
    [
        ({"at": 10.0}, "pass"),
        ({"at": 10.0, "told": 12.0}, "pass"),
        ({"at": 100.0}, "fail"),  # not pressed
        ({"at": 10.0, "released": 20.0}, "fail"),  # it drives on
        ({"at": 10.0, "released": 40.0, "on": 0.1}, "fail"),  # it moves by itself
        ({"at": 0.0}, "not shown"),  # it was pressed all the time
    ],
)
def test_the_own_button_of_a_base(button: dict[str, float], result: str) -> None:
    assert pressed(**button).result == result
