"""Part C: figures of a calibration against the platform file."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace

from swarmd.core.finding import Finding
from swarmd.core.messages import DecisionSummary, DelayFigure, ScanDelaySummary
from swarmd.operator.acceptance import calibrated
from swarmd.operator.acceptance.evidence import Evidence
from swarmd.operator.acceptance.verdict import Verdict, passed
from swarmd.operator.calibration.figures import DONE, REFUSED, Figure
from swarmd.settings.platforms import load_platform
from tests.support.statuses import status

BURGER = load_platform("burger")


def judged(judge: object, **figures: Figure) -> Verdict:
    values = {name: figure.text for name, figure in figures.items()}
    evidence = Evidence(BURGER, earlier={"C2": passed("", **values)})
    return judge(evidence)  # type: ignore[operator,no-any-return]


@pytest.mark.parametrize(
    ("value", "spread", "result"),
    [
        (1.0, 0.02, "pass"),
        (0.86, 0.004, "pass"),
        (0.84, 0.001, "fail"),
        (0.7, 0.2, "fail"),
        (1.0, 0.2, "not shown"),  # two deviations below 0.85
    ],
)
def test_brakes_must_be_85_percent_of_the_files(value: float, spread: float, result: str) -> None:
    """The share SOUND of docs/evidence/sensing.md."""
    judge = calibrated.brakes("C2", "braking_linear", "braking_lateral")
    assert judged(judge, braking_linear=Figure(value, spread, 8, 1.0)).result == result


@pytest.mark.parametrize(
    ("value", "spread", "result"),
    [
        (1.0, 0.01, "pass"),
        (0.96, 0.1, "pass"),
        (1.1, 0.01, "fail"),
        (0.9, 0.02, "fail"),
        (1.08, 0.03, "not shown"),
    ],
)
def test_scales_must_be_within_five_percent(value: float, spread: float, result: str) -> None:
    judge = calibrated.scales("C2", "odometry_linear", cause="the wheels")
    found = judged(judge, odometry_linear=Figure(value, spread, 8, 1.0))
    assert found.result == result
    assert (result == "fail") == ("the wheels" in found.reason)


@pytest.mark.parametrize(("value", "result"), [(0.03, "pass"), (0.05, "fail")])
def test_the_margin_must_cover_the_response(value: float, result: str) -> None:
    assert judged(calibrated.margin("C2"), margin=Figure(value, 0.0, 8, 0.03)).result == result


@pytest.mark.parametrize(
    ("stamped", "turned", "result"),
    [
        (0.1, Figure(0.13, 0.01, 45, 0.1), "pass"),  # a Burger has 5 scans a second
        (0.1, Figure(0.15, 0.01, 45, 0.1), "fail"),
        (0.2, Figure(0.15, 0.01, 45, 0.1), "fail"),
        (0.1, Figure(assumed=0.1, why="a round room"), "not shown"),
        (None, Figure(0.1, 0.01, 45, 0.1), "not shown"),
    ],
)
def test_stamps_and_turns_must_agree_within_a_fifth_of_a_scan_period(
    stamped: float | None, turned: Figure, result: str
) -> None:
    by_stamps = DelayFigure(method="stamps", delay=stamped, text="two clocks")
    by_turns = DelayFigure(method="turns", delay=0.9)
    figures = by_turns, by_stamps
    summary = ScanDelaySummary(declared=0.1, added=0.0, bound=0.4, figures=figures)
    found = calibrated.ages("C2")(
        Evidence(
            BURGER,
            status=replace(status("r"), scan_delay=summary),
            earlier={"C2": passed("", scan_delay=turned.text)},
        )
    )
    assert found.result == result
    assert ("two clocks" in found.reason) is (stamped is None)


def test_one_wrong_figure_fails_and_is_named_alone() -> None:
    judge = calibrated.brakes("C2", "braking_linear", "braking_angular")
    found = judged(
        judge,
        braking_linear=Figure(1.0, 0.0, 8, 1.0),
        braking_angular=Figure(1.0, 0.0, 8, 3.0),
    )
    assert "braking_angular" in found.figure
    assert "braking_linear" not in found.figure


def test_a_figure_that_is_not_measured_is_not_shown_with_its_reason() -> None:
    found = judged(calibrated.scan_delay("C2"), scan_delay=Figure(why="a round room"))
    assert (found.result, found.reason) == ("not shown", "a round room")


@pytest.mark.parametrize(
    ("report", "duty", "share", "result"),
    [
        ({"state": DONE, "speed_linear": "1 0 8 1"}, 0.0, 1.0, "pass"),
        ({"state": DONE, "speed_linear": "1 0 8 1"}, 0.1, 1.0, "not shown"),
        ({"state": DONE, "speed_linear": "1 0 8 1"}, 0.1, 0.7, "pass"),
        ({"state": REFUSED, "why": "the floor is not free"}, 0.0, 1.0, "not shown"),
        ({"state": REFUSED, "why": "it does not move steadily"}, 0.0, 1.0, "fail"),
        ({}, 0.0, 1.0, "fail"),
    ],
)
def test_a_calibration_counts_if_it_ended_and_nothing_limited_it(
    report: dict[str, str], duty: float, share: float, result: str
) -> None:
    decision = DecisionSummary(duty=duty, speed_share=share)
    ended = replace(status("r"), report=report, decision=decision)
    found = calibrated.calibration(Evidence(BURGER, status=ended))
    assert found.result == result
    assert report.get("why", "") in found.reason
    is_slowed = result == "pass" and share < 1.0
    assert ("slows" in str(found.values.get("speed_linear"))) is is_slowed


def test_a_figure_that_scatters_names_what_repeats_it_and_the_load() -> None:
    load = Finding("load", False, "load 9.0 on 2 cores", "find it")
    report = {"state": DONE, "braking_linear": Figure(1.0, 0.2, 8, 1.0).text}
    ended = replace(status("r"), report=report)
    c2 = calibrated.calibration(Evidence(BURGER, status=ended, findings=(load,)))
    judge = calibrated.brakes("C2", "braking_linear")
    found = judge(Evidence(BURGER, earlier={"C2": c2}))
    assert found.result == "not shown"
    assert "--only C2" in found.reason
    assert "load 9.0 on 2 cores" in found.reason


@pytest.mark.parametrize(
    "figure",
    [
        Figure(math.nan, 0.01, 8, 1.0),
        Figure(1.0, math.nan, 8, 1.0),
        Figure(1.0, math.inf, 8, 1.0),
        Figure(math.inf, 0.0, 8, 1.0),
        Figure(0.0, 0.0, 0, 1.0),
        Figure(1.0, 0.0, 8, math.nan),
    ],
)
def test_a_figure_that_is_no_number_is_no_pass(figure: Figure) -> None:
    for judge, name in (
        (calibrated.brakes("C2", "braking_linear"), "braking_linear"),
        (calibrated.margin("C2"), "margin"),
        (calibrated.scales("C2", "odometry_linear", cause="c"), "odometry_linear"),
        (calibrated.scan_delay("C2"), "scan_delay"),
    ):
        if math.isfinite(figure.value) and math.isfinite(figure.spread):
            figure = figure._replace(value=9.0 if name in ("margin", "scan_delay") else 0.0)
        found = judged(judge, **{name: figure})
        assert found.result != "pass", (name, found)


def test_without_an_answer_a_calibration_is_not_shown() -> None:
    assert calibrated.calibration(Evidence(BURGER)).result == "not shown"
