"""Part A: findings, the base, and recordings of a robot that rests."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace as replace_struct

from swarmd.core.events import DriverInput, Input, OdometryInput, ReadingsInput, ScanInput
from swarmd.core.finding import Finding, unknown, warning
from swarmd.core.messages import Reason
from swarmd.core.values import Odometry, Pose, Scan, Twist
from swarmd.operator.acceptance import at_rest
from swarmd.operator.acceptance.evidence import Evidence, Samples
from swarmd.operator.acceptance.verdict import Result, passed
from swarmd.operator.texts import doctor
from swarmd.settings.platforms import load_platform
from tests.support.statuses import status

FILE = load_platform("burger")
BURGER = replace(FILE, provides=FILE.provides | {"reading:battery"})
SPEC = BURGER.scan
LINK = at_rest.findings_on("heard here")


def evidence(*inputs: tuple[Input, float], **fields: object) -> Evidence:
    return Evidence(BURGER, Samples(inputs), **fields)  # type: ignore[arg-type]


def scan(at: float, *, stamp: float | None = None, near: dict[int, float] | None = None) -> Scan:
    """A scan of a round room of 2 m, with other ranges at some degrees."""
    ranges = 2.0 + 0.01 * np.sin(np.arange(360.0) + 7.0 * at)
    for degree, distance in (near or {}).items():
        ranges[degree % 360] = distance
    return Scan(round(100 * at), at if stamp is None else stamp, ranges, SPEC.bearings, 0.12, 3.5)


def odometry(at: float, *, stamp: float | None = None, x: float = 0.0) -> OdometryInput:
    return OdometryInput(Odometry(at if stamp is None else stamp, Pose(x, 0.0, 0.0), Twist()))


def at_rest_for(seconds: float, *, lag: float = 0.0) -> list[tuple[Input, float]]:
    """Scans at 5 Hz and odometry at 20 Hz; stamps of scans are `lag` s older."""
    inputs: list[tuple[Input, float]] = [(DriverInput(True, "base"), 0.0)]
    for tick in range(round(20 * seconds)):
        at = 100.0 + 0.05 * tick
        inputs.append((odometry(at), at))
        if tick % 4 == 0:
            inputs.append((ScanInput(scan(at, stamp=at - 0.2 - lag)), at))
    return inputs


def test_multicast_that_is_filtered_is_named_with_its_remedy() -> None:
    (finding,) = [doctor._heard_here(("seed",), "field")]
    found = LINK(evidence(findings=(finding,)))
    assert found.result is Result.FAIL
    assert "multicast is filtered" in found.reason
    assert LINK(evidence(findings=(doctor._heard_here(("multicast",), "field"),))).result == "pass"


@pytest.mark.parametrize(
    ("before", "after", "result"),
    [(1.0, 1.0, "pass"), (9.0, 1.0, "pass"), (1.0, 9.0, "pass"), (9.0, 9.0, "fail")],
)
def test_a_load_fails_if_it_lasts(before: float, after: float, result: str) -> None:
    looks = [
        [warning("load", f"load {load}", "top", is_due=load > 6.0), Finding("memory", True, "x")]
        for load in (before, after)
    ]
    found = at_rest.findings_on("load", "memory")(evidence(findings=at_rest.lasting(*looks)))
    assert found.result == result
    full = [warning("memory", "full", "end programs")]
    assert at_rest.lasting([Finding("memory", True, "x")], full) == full


def test_two_daemons_of_one_name_are_named() -> None:
    duplicate = status("r", reason=Reason.DUPLICATE_ID, detail="r at 10.0.0.7")
    found = at_rest.findings_on("version")(evidence(status=duplicate))
    assert found.result is Result.FAIL
    assert "two daemons" in found.reason
    assert "10.0.0.7" in found.reason


def test_a_finding_without_a_remedy_ends_with_its_text() -> None:
    found = LINK(evidence(findings=(Finding("heard here", False, "deaf"),)))
    assert found.reason == "heard here: deaf"
    found = LINK(evidence(findings=(Finding("heard here", False, "deaf", "listen"),)))
    assert found.reason == "heard here: deaf; listen"


@pytest.mark.parametrize(
    ("findings", "result"),
    [
        ((), Result.NOT_SHOWN),
        ((Finding("other", False, "bad"),), Result.NOT_SHOWN),
        ((unknown("heard here", "no idea"),), Result.NOT_SHOWN),
        ((Finding("heard here", True, "by multicast"),), Result.PASS),
        ((warning("heard here", "late", "wait"), Finding("heard here", True, "x")), Result.FAIL),
        ((Finding("heard here", False, "deaf"),), Result.FAIL),
    ],
)
def test_a_warning_fails_and_what_is_not_known_is_not_shown(
    findings: tuple[Finding, ...], result: Result
) -> None:
    assert LINK(evidence(findings=findings)).result is result


@pytest.mark.parametrize(
    ("state", "word"),
    [
        (DriverInput(True, "someone else drives: /cmd_vel", Reason.BASE_CONFLICT), "two_bases"),
        (DriverInput(True, "two nodes publish /scan", Reason.SCAN_CONFLICT), "two_scan_sources"),
        (DriverInput(False, "QoS of /scan: a reliable reader, a best effort writer"), "QoS"),
    ],
)
def test_a_conflict_of_the_base_is_found_even_if_it_ends(state: DriverInput, word: str) -> None:
    well = DriverInput(True, "base")
    assert at_rest.base(evidence((well, 0.0))).result is Result.PASS
    found = at_rest.base(evidence((well, 0.0), (state, 1.0), (well, 2.0)))
    assert found.result is Result.FAIL
    assert word in found.reason
    assert at_rest.base(evidence()).result is Result.NOT_SHOWN


def test_topics_without_messages_fail_with_the_words_of_the_driver() -> None:
    state = DriverInput(False, "no scan: QoS differs")
    for judge in (at_rest.scan_rate, at_rest.odometry_at_rest):
        found = judge(evidence((state, 0.0)))
        assert found.result is Result.FAIL
        assert "QoS differs" in found.reason


def test_a_robot_at_rest_passes() -> None:
    one = evidence(*at_rest_for(20.0))
    for judge in (at_rest.scan_rate, at_rest.stamps, at_rest.lidar, at_rest.odometry_at_rest):
        assert judge(one).result is Result.PASS, judge(one)


@pytest.mark.parametrize("lag", [3.0, -3.0, 40.0])
def test_stamps_of_two_clocks_are_told_apart_by_their_distance(lag: float) -> None:
    found = at_rest.stamps(evidence(*at_rest_for(20.0, lag=lag)))
    assert found.result is Result.FAIL
    assert float(found.values["apart"]) == pytest.approx(lag + 0.2)


def test_a_clock_that_is_off_the_computers_clock_fails_and_another_zero_does_not() -> None:
    inputs = at_rest_for(20.0)
    base = Samples(tuple(inputs))
    for wall, result in ((0.0, "pass"), (1541.0, "fail"), (1.7e9, "pass")):
        found = at_rest.stamps(Evidence(BURGER, replace(base, wall=wall)))
        assert found.result == result, wall


@pytest.mark.parametrize("kind", [OdometryInput, ScanInput])
def test_stamps_that_go_back_fail(kind: type[Input]) -> None:
    inputs = [
        (
            odometry(at, stamp=at - 50.0)
            if isinstance(one, OdometryInput)
            else ScanInput(scan(at, stamp=at - 50.0))
        )
        if isinstance(one, kind) and at > 110.0
        else one
        for one, at in at_rest_for(20.0)
    ]
    found = at_rest.stamps(evidence(*zip(inputs, [at for _, at in at_rest_for(20.0)], strict=True)))
    assert found.result is Result.FAIL
    assert "back" in found.reason


def test_scans_that_come_later_than_a_robot_may_bear_fail() -> None:
    """A lidar of 10 Hz holds the robot by 0.2 s beyond its delay."""
    fast = replace(BURGER, scan=replace(SPEC, rate=10.0))
    found = at_rest.stamps(replace(evidence(*at_rest_for(20.0, lag=0.25)), platform=fast))
    assert found.result is Result.FAIL
    assert "late_scan" in found.reason


def test_one_long_pause_of_scans_fails_by_itself() -> None:
    inputs = [(one, at) for one, at in at_rest_for(200.0) if not 110.0 < at < 111.1]
    found = at_rest.scan_rate(evidence(*inputs))
    assert (found.result, "paused" in found.reason) == (Result.FAIL, True)


def test_a_pause_of_scans_and_of_odometry_fails() -> None:
    inputs = [(one, at) for one, at in at_rest_for(30.0) if not 110.0 < at < 111.5]
    for judge in (at_rest.scan_rate, at_rest.odometry_at_rest):
        assert judge(evidence(*inputs)).result is Result.FAIL


def second_lidar(at: float, seq: int) -> ScanInput:
    """A scan of a lidar at another place on the robot."""
    one = scan(at, stamp=at - 0.2)
    return ScanInput(replace_struct(one, seq=seq, ranges=one.ranges[::-1] * 0.8 + 0.1))


@pytest.mark.parametrize("apart", [0.05, 0.1, 0.01])
@pytest.mark.parametrize("rays", [360, 180])
def test_two_lidars_on_one_topic_are_named(apart: float, rays: int) -> None:
    """Whatever their phase is, and with equal or other numbers of rays."""
    inputs = at_rest_for(30.0)
    for one, at in list(inputs):
        if isinstance(one, ScanInput):
            other = second_lidar(at + apart, 0).scan
            half = replace_struct(other, ranges=other.ranges[:rays], bearings=other.bearings[:rays])
            inputs.append((ScanInput(half), at + apart))
    inputs.sort(key=lambda pair: pair[1])
    found = at_rest.scan_rate(evidence(*inputs))
    assert found.result is Result.FAIL
    assert "two sensors" in found.reason


def test_one_lidar_by_two_nodes_comes_too_often() -> None:
    inputs = at_rest_for(30.0)
    again = [(one, at + 0.1) for one, at in inputs if isinstance(one, ScanInput)]
    found = at_rest.scan_rate(evidence(*sorted([*inputs, *again], key=lambda pair: pair[1])))
    assert (found.result, "two nodes" in found.reason) == (Result.FAIL, True)


def in_bursts(inputs: list[tuple[Input, float]], kind: type, period: float) -> list[Any]:
    """The inputs, of which those of a kind come each `period` s."""
    late = [
        (one, period * math.ceil(at / period - 1e-9)) if isinstance(one, kind) else (one, at)
        for one, at in inputs
    ]
    return sorted(late, key=lambda pair: pair[1])


@pytest.mark.parametrize("period", [0.45, 1.0])
def test_odometry_in_bursts_is_named_and_no_clock_is_blamed(period: float) -> None:
    """Each reading arrives, with its own stamp: the newest is up to `period` s old."""
    found = evidence(*in_bursts(at_rest_for(30.0), OdometryInput, period))
    verdict = at_rest.odometry_at_rest(found)
    assert (verdict.result, "bursts" in verdict.reason) == (Result.FAIL, True)
    assert "clock" not in at_rest.stamps(found).reason.replace("one clock", "")


def test_scans_in_bursts_are_named() -> None:
    found = at_rest.scan_rate(evidence(*in_bursts(at_rest_for(60.0), ScanInput, 1.0)))
    assert (found.result, "bursts" in found.reason) == (Result.FAIL, True)


@pytest.mark.parametrize("count", [2, 400])
def test_a_base_that_repeats_its_reading_fails(count: int) -> None:
    """Found by a division by zero: the period of its stamps is 0."""
    readings = [(odometry(0.05 * n, stamp=0.05 * (n // count)), 0.05 * n) for n in range(200)]
    found = at_rest.odometry_at_rest(evidence(*readings))
    assert found.result is (Result.FAIL if count == 400 else Result.PASS)
    assert ("repeats" in found.reason) is (count == 400)


def test_odometry_that_drifts_at_rest_fails() -> None:
    drifts = [(odometry(0.05 * n, x=0.0005 * n), 0.05 * n) for n in range(100)]
    found = at_rest.odometry_at_rest(evidence(*drifts))
    assert found.result is Result.FAIL
    assert "drifts" in found.reason


@pytest.mark.parametrize(
    ("readings", "result"),
    [
        ([{"battery": 0.7}], "pass"),
        ([], "fail"),
        ([{"battery": math.nan}], "fail"),
        ([{"battery": 12.1}], "fail"),
    ],
)
def test_the_battery(readings: list[dict[str, float]], result: str) -> None:
    inputs = [(ReadingsInput(one), 0.0) for one in readings]
    assert at_rest.battery(evidence(*inputs)).result == result
    without = replace(evidence(*inputs), platform=FILE)
    assert at_rest.battery(without).result is Result.NOT_SHOWN


@pytest.mark.parametrize(
    ("own", "others", "result"),
    [
        ([0.62113, 0.62345], {"tb3-02": 0.62345, "tb3-03": 0.9}, "fail"),
        ([0.62113, 0.62345], {"tb3-02": 0.62347}, "pass"),
        ([0.62113], {}, "not shown"),
        ([], {"tb3-02": 0.5}, "not shown"),
        ([math.nan], {"tb3-02": 0.5}, "not shown"),
        ([1.0], {"tb3-02": 1.0}, "not shown"),  # both are full
        ([0.62], {"tb3-02": 0.62}, "not shown"),  # whole percents
    ],
)
def test_the_battery_of_another_robot(
    own: list[float], others: dict[str, float], result: str
) -> None:
    inputs = [(ReadingsInput({"battery": one}), 0.0) for one in own]
    found = at_rest.own_battery(evidence(*inputs, charges=others))
    assert found.result == result
    assert result != "fail" or "tb3-02" in found.reason


def hand_at(degree: int) -> Evidence:
    """Ten seconds of scans in which a hand comes after 3 s, with an arm behind it."""
    arm = {degree + n: 0.3 for n in range(-4, 5)} | {degree + n: 0.7 for n in range(5, 20)}
    inputs = [(ScanInput(scan(0.2 * n, near=arm if n >= 15 else None)), 0.2 * n) for n in range(50)]
    return replace(evidence(*inputs), earlier={"A12": passed("")})


@pytest.mark.parametrize(
    ("wanted", "seen", "word"),
    [
        (0.0, 0, ""),
        (90.0, 75, ""),
        (180.0, 178, ""),
        (-90.0, 260, ""),
        (90.0, -90, "mirrored"),
        (-90.0, 90, "mirrored"),
        (90.0, 180, "turned by 90"),
        (0.0, -90, "turned by -90"),
    ],
)
def test_a_hand_shows_how_the_lidar_is_mounted(wanted: float, seen: int, word: str) -> None:
    found = at_rest.hand(wanted, "A12")(hand_at(seen))
    assert found.result is (Result.FAIL if word else Result.PASS)
    assert word in found.reason


def test_a_hand_that_is_not_seen_fails() -> None:
    inputs = [(ScanInput(scan(0.2 * n)), 0.2 * n) for n in range(50)]
    assert at_rest.hand(0.0)(evidence(*inputs)).result is Result.FAIL
    assert at_rest.hand(0.0)(evidence()).result is Result.FAIL
