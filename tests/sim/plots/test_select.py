"""Which metrics and which runs are worth a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.store import Row
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.plots.select import (
    OVER_TIME,
    RUN_BY_RUN,
    metrics_over_time,
    primary_metric,
    smoothing_of,
    stem_of,
    typical_first,
    worst_first,
)

NAN = float("nan")


def results(**columns: tuple[float | None, ...]) -> Results:
    count = len(next(iter(columns.values())))
    plan = Plan("x", tuple(range(count)), (Variant("", {}),))
    rows = [
        Row(run, {name: values[k] for name, values in columns.items()}, 0.1)
        for k, run in enumerate(plan.runs)
    ]
    return Results(Path("x"), plan, rows, {}, tuple(columns))


def test_the_usual_metrics_exist_and_those_over_time_have_a_series() -> None:
    assert set(RUN_BY_RUN) <= set(METRICS)
    assert [stem_of(name) for name in metrics_over_time(OVER_TIME)] == [
        stem_of(name) for name in OVER_TIME
    ]


@pytest.mark.parametrize(
    ("metric", "stem"),
    [
        ("mean_distance_to_centroid_30s", "mean_distance_to_centroid"),
        ("one_cluster_at_end", "one_cluster"),
        ("mean_speed_late_share", "mean_speed_share"),
        ("minimum_gap", "minimum_gap"),
    ],
)
def test_a_series_has_no_moment_in_its_name(metric: str, stem: str) -> None:
    assert stem_of(metric) == stem


def test_one_series_is_drawn_once_and_what_has_none_not_at_all() -> None:
    names = ["mean_distance_to_centroid_30s", "gather_time", "mean_distance_to_centroid_late"]
    assert metrics_over_time([*names, "of another version"]) == ["mean_distance_to_centroid_30s"]


def test_only_what_flickers_is_smoothed() -> None:
    smoothed = {stem_of(name) for name in METRICS if smoothing_of(name)}
    assert smoothed == {"mean_speed", "mean_speed_share", "protection_duty", "command_alteration"}


def test_the_chief_metric_tells_the_runs_apart() -> None:
    found = results(consensus_share=(1.0, 1.0), mean_distance_to_centroid_late=(0.5, 0.6))
    assert primary_metric(found, None) == "mean_distance_to_centroid_late"
    assert primary_metric(found, ["consensus_share"]) == "consensus_share"
    assert primary_metric(
        results(consensus_share=(None, None), robot_contacts=(0.0, 0.0)), None
    ) == ("robot_contacts")
    assert primary_metric(results(consensus_share=(None, None)), None) is None
    assert primary_metric(found, ["minimum_gap"]) is None


def test_the_typical_run_is_nearest_to_the_median_and_the_first_of_several() -> None:
    assert typical_first(np.array([9.0, 1.0, NAN, 2.0, 2.0])) == [3, 4, 1, 0, 2]
    assert typical_first(np.array([NAN, NAN])) == [0, 1]


@pytest.mark.parametrize(
    ("metric", "order", "word"),
    [
        ("robot_contacts", [3, 0, 1, 2], "worst"),  # less is better
        ("minimum_gap", [1, 0, 3, 2], "worst"),
        ("mean_distance_to_centroid_late", [3, 1, 0], "least typical"),
        ("of_another_version", [3, 1, 0], "least typical"),
    ],
)
def test_the_worst_run_is_so_by_the_metrics_own_direction(
    metric: str, order: list[int], word: str
) -> None:
    assert worst_first(np.array([2.0, 1.0, NAN, 9.0]), metric) == (order, word)


def test_without_values_no_run_is_the_least_typical() -> None:
    assert worst_first(np.array([NAN]), "gather_time") == ([], "least typical")
