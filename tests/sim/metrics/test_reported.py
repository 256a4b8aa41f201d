"""What patterns report and sensors read, as metrics."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.metrics.catalog import check_has_value, measure, metric_of
from swarmd.sim.trace import Trace
from tests.sim.metrics.runs import run

NAN = np.nan
VALUES = np.array([[1.0, 3.0, 9.0], [2.0, NAN, 9.0], [3.0, 5.0, 9.0], [5.0, 7.0, 9.0]])
STATES = np.array([["drive", "", "wait"]] * 3 + [["wait", "drive", "wait"]], dtype="U24")


@pytest.fixture
def trace() -> Trace:
    """Four instants; the third robot is never present."""
    present = np.array([[True, True, False]] * 4)
    report, words = {"value": VALUES, "part.max": VALUES}, {"state": STATES}
    readings = {"battery": VALUES / 10.0}
    return run(np.zeros((4, 3, 3)), present=present, report=report, words=words, readings=readings)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("report:value.mean_start", 2.0),
        ("report:value.end", 6.0),
        ("report:value.mean_end", 6.0),
        ("report:value.max_end", 7.0),
        ("report:value.sum_max", 12.0),
        ("report:value.std_end", 1.0),
        ("report:value.median_min", 2.0),
        ("report:value.mean_mean", 3.5),
        ("report:value", 5.0),  # of the last half
        ("report:value.max", 6.0),
        ("report:part.max.max_end", 7.0),
        ("report:state=wait.end", 0.5),
        ("report:state=wait.sum_end", 1.0),
        ("report:state=wait.start", 0.0),
        ("report:state=never.end", 0.0),
        ("report:speed", None),
        ("report:value=wait", None),
        ("reading:battery.min_end", 0.5),
        ("reading:battery", 0.5),
        ("reading:value", None),
        ("report:battery", None),
    ],
)
def test_a_reported_value_is_taken_over_robots_then_over_time(
    trace: Trace, name: str, value: float | None
) -> None:
    assert measure(trace, [name]) == {name: value}


def test_its_series_is_over_the_robots_alone(trace: Trace) -> None:
    series = metric_of("report:value.min_end").series
    assert series is not None
    np.testing.assert_array_equal(series(trace), [1.0, 2.0, 3.0, 5.0])


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("report:state=wait", "share"),
        ("report:state=wait.max_end", ""),
        ("report:state=wait.sum", "robots"),
        ("report:delivered", ""),  # a pattern's own number
        ("reading:delivered.sum_end", "items"),
        ("reading:held", "items"),
        ("reading:food_distance", "m"),
        ("reading:food_bearing", "rad"),
        ("reading:food", ""),
    ],
)
def test_shares_counts_and_readings_of_items_have_a_unit(name: str, unit: str) -> None:
    assert metric_of(name).unit == unit


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("report:valu", "'value'"),
        ("report:value.meen_end", "'value.mean_end'"),
        ("report:sate=wait", "'state'"),
        ("report:state=wiat", "'wait'"),
        ("report:state=wait.sum_mex", "'wait.sum_max'"),
        ("report:state", "state=drive, state=wait"),
        ("reading:batery", "'battery'"),
        ("reading:battery.meen_end", "'battery.mean_end'"),
    ],
)
def test_what_no_robot_reports_is_named_with_the_nearest(
    trace: Trace, name: str, nearest: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        check_has_value(metric_of(name), trace)
    assert str(caught.value).endswith((f"{nearest}?", nearest))


@pytest.mark.parametrize(
    "name",
    ["report:value.mean_end", "report:state=wait", "report:part.max.sum", "reading:battery.min"],
)
def test_what_robots_report_is_no_fault(trace: Trace, name: str) -> None:
    check_has_value(metric_of(name), trace)


@pytest.mark.parametrize(
    "name", ["report:", "report:=wait", "report:state=", "reading:", "reading:battery=full"]
)
def test_a_name_without_key_or_text_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="KEY"):
        metric_of(name)
