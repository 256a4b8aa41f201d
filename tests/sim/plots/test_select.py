"""Which metrics and which runs are worth a picture."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.store import Row
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.plots.select import (
    MAX_EVENTS,
    OVER_TIME,
    RUN_BY_RUN,
    Quantity,
    events_of,
    facets_of,
    metrics_over_time,
    primary_metric,
    smoothing_of,
    stem_of,
    typical_first,
    worst_first,
)
from tests.sim.plots.runs import walk

NAN = float("nan")


def results(**columns: tuple[float | None, ...]) -> Results:
    count = len(next(iter(columns.values())))
    plan = Plan("x", tuple(range(count)), (Variant("", {}, {}),))
    rows = [
        Row(run, {name: values[k] for name, values in columns.items()}, 0.1)
        for k, run in enumerate(plan.runs)
    ]
    return Results(Path("x"), plan, rows, {}, tuple(columns))


def test_the_usual_metrics_exist_and_those_over_time_have_a_series() -> None:
    assert set(RUN_BY_RUN) <= set(METRICS)
    drawn = metrics_over_time([METRICS[name] for name in OVER_TIME])
    assert [stem_of(one.name) for one in drawn] == [stem_of(name) for name in OVER_TIME]


@pytest.mark.parametrize(
    ("metric", "stem"),
    [
        ("mean_distance_to_centroid_30s", "mean_distance_to_centroid"),
        ("one_cluster_at_end", "one_cluster"),
        ("mean_speed_late_share", "mean_speed_share"),
        ("minimum_gap", "minimum_gap"),
    ],
)
def test_the_name_of_a_series_has_no_time(metric: str, stem: str) -> None:
    assert stem_of(metric) == stem


def test_each_series_is_drawn_once() -> None:
    names = ["mean_distance_to_centroid_30s", "hold_share", "mean_distance_to_centroid_late"]
    drawn = metrics_over_time([METRICS[name] for name in names])
    assert [one.name for one in drawn] == ["mean_distance_to_centroid_30s"]


def test_only_what_flickers_is_smoothed() -> None:
    smoothed = {stem_of(name) for name in METRICS if smoothing_of(name)}
    assert smoothed == {"mean_speed", "mean_speed_share", "protection_duty", "command_alteration"}


def test_the_primary_metric_differs_between_runs() -> None:
    found = results(consensus_share=(1.0, 1.0), mean_distance_to_centroid_late=(0.5, 0.6))
    share = METRICS["consensus_share"]
    assert primary_metric(found, None) is METRICS["mean_distance_to_centroid_late"]
    assert primary_metric(found, [share]) is share
    without = results(consensus_share=(None, None), robot_contacts=(0.0, 0.0))
    assert primary_metric(without, None) is METRICS["robot_contacts"]
    assert primary_metric(results(consensus_share=(None, None)), None) is None
    assert primary_metric(found, [METRICS["minimum_gap"]]) is None


def test_the_typical_run_is_nearest_to_the_median_and_the_first_of_several() -> None:
    assert typical_first(np.array([9.0, 1.0, NAN, 2.0, 2.0])) == [3, 4, 1, 0, 2]
    assert typical_first(np.array([NAN, NAN])) == [0, 1]


@pytest.mark.parametrize(
    ("metric", "order", "word"),
    [
        ("robot_contacts", [3, 0, 1, 2], "worst"),  # less is better
        ("minimum_gap", [1, 0, 3, 2], "worst"),
        ("mean_distance_to_centroid_late", [3, 1, 0], "least typical"),
    ],
)
def test_the_worst_run_is_so_by_the_metrics_own_direction(
    metric: str, order: list[int], word: str
) -> None:
    better = METRICS[metric].better
    assert worst_first(np.array([2.0, 1.0, NAN, 9.0]), better) == (order, word)
    assert worst_first(np.array([NAN]), better) == ([0] if word == "worst" else [], word)


def event(at: float, action: str, *robots: str, pattern: str = "") -> dict[str, Any]:
    return {"at": at, "action": action, "robots": list(robots), "pattern": pattern}


def test_events_name_action_pattern_and_robots() -> None:
    events = [
        event(0.0, "run", "tb3-00", "tb3-01", "tb3-02", pattern="attraction"),
        event(0.4, "kill", "tb3-01"),
        event(0.8, "join", "tb3-00", "tb3-01"),
        event(1.2, "run", "tb3-00", "tb3-01", "tb3-02", pattern="random_walk"),
        event(1.6, "place"),
    ]
    assert events_of(walk(3, meta={"events": events})) == (
        (0.4, "kill tb3-01"),
        (0.8, "join 2 robots"),
        (1.2, "run random_walk"),
        (1.6, "place"),
    )


def test_close_events_share_a_label() -> None:
    events = [event(1.0, "join", "tb3-00"), event(1.02, "run", "tb3-00"), event(1.03, "place")]
    events.append(event(1.04, "place"))
    assert events_of(walk(3, meta={"events": events})) == ((1.0, "join tb3-00, run tb3-00, place"),)


def test_too_many_events_are_left_out() -> None:
    events = [event(0.1 * k, "place") for k in range(1, MAX_EVENTS + 2)]
    assert events_of(walk(3, meta={"events": events})) == ()
    assert len(events_of(walk(3, meta={"events": events[1:]}))) == MAX_EVENTS
    assert events_of(walk(3)) == ()


def swept(**sweep: list[Any]) -> Plan:
    """A plan of one swept key, or of several."""
    keys = {f"groups.a.parameters.{key}": values for key, values in sweep.items()}
    groups = {"groups": {"a": {"pattern": "attraction"}}}
    variants = tuple(
        Variant(str(values), dict(zip(keys, values, strict=True)), groups)
        for values in product(*keys.values())
    )
    return Plan("x", (0,), variants, sweep=keys)


def test_a_swept_number_is_on_an_axis_with_the_unit_of_its_pattern() -> None:
    found = list(facets_of(swept(range=[1.0, 3.0]), None, "x").values())
    assert [one.label for one in found] == ["1.0", "3.0"]
    assert {one.axis for one in found} == {"range [m]"}
    named = facets_of(swept(range=[1.0]), None, "x", {"range": "lidar range [cm]"})
    assert {one.axis for one in named.values()} == {"lidar range [cm]"}


def test_variants_of_two_keys_name_each_with_its_unit() -> None:
    plan = swept(range=[1.0], spacing=[0.6])
    (one,) = facets_of(plan, None, "x").values()
    assert (one.label, one.axis) == ("range=1.0 m, spacing=0.6 m", "")
    (one,) = facets_of(plan, "range", "x").values()
    assert (one.panel, one.label, one.axis) == ("range=1.0 m", "0.6", "spacing [m]")


@pytest.mark.parametrize(
    ("text", "name", "unit"), [("a b [m/s]", "a b", "m/s"), ("a", "a", ""), ("a []", "a", "")]
)
def test_a_label_has_a_name_and_a_unit(text: str, name: str, unit: str) -> None:
    assert Quantity.parse(text) == Quantity(name, unit)
