"""The catalog: names, numbers, and what must not change a number."""

from __future__ import annotations

import importlib
import math
import pkgutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.errors import ConfigError
from swarmd.sim import metrics
from swarmd.sim.metrics import catalog
from swarmd.sim.metrics.catalog import METRICS, measure
from swarmd.sim.trace import Trace
from tests.sim.metrics.runs import full_run, run
from tests.support.examples import examples

ON_A_GRID = ("covered_area",)  # counted in squares, which do not turn with the robots


def moved(trace: Trace, shift: tuple[float, float], turn: float) -> Trace:
    """The same run seen from elsewhere."""
    cos, sin = math.cos(turn), math.sin(turn)
    pose = trace.pose.copy()
    pose[..., 0] = cos * trace.pose[..., 0] - sin * trace.pose[..., 1] + shift[0]
    pose[..., 1] = sin * trace.pose[..., 0] + cos * trace.pose[..., 1] + shift[1]
    pose[..., 2] += turn
    return replace(trace, pose=pose)


def shuffled(trace: Trace, order: list[int]) -> Trace:
    """The same run, its robots in another order."""
    place = np.argsort(order)
    parts = (
        *("pose", "safe", "requested", "state", "reason", "active", "decided", "evaded", "present"),
        *("gap", "scan_age", "bound", "recovering"),
    )
    return replace(
        trace,
        ids=tuple(trace.ids[i] for i in order),
        platforms=tuple(trace.platforms[i] for i in order),
        contact_pair=place[trace.contact_pair],
        report={name: values[:, order] for name, values in trace.report.items()},
        **{part: getattr(trace, part)[:, order] for part in parts},
    )


def assert_alike(one: dict[str, float | None], other: dict[str, float | None]) -> None:
    for name, value in one.items():
        tolerance = 0.15 if name in ON_A_GRID else 1e-6
        alike = None if value is None else pytest.approx(value, rel=tolerance, abs=1e-9)
        assert other[name] == alike, name


@given(
    seed=st.integers(0, 10_000),
    shift=st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)),
    turn=st.floats(-3.0, 3.0),
)
@settings(deadline=None, max_examples=examples(25))
def test_numbers_do_not_depend_on_where_the_world_is(
    seed: int, shift: tuple[float, float], turn: float
) -> None:
    trace = full_run(seed)
    assert_alike(measure(trace), measure(moved(trace, shift, turn)))


@given(seed=st.integers(0, 10_000), order=st.permutations(list(range(6))))
@settings(deadline=None, max_examples=examples(25))
def test_numbers_do_not_depend_on_the_order_of_robots(seed: int, order: list[int]) -> None:
    trace = full_run(seed)
    assert_alike(measure(trace), measure(shuffled(trace, order)))


def test_a_trace_without_its_optional_parts_gives_what_it_can() -> None:
    bare = run(np.zeros((5, 2, 3)), meta={}, platforms=("jackal", "jackal"))
    numbers = measure(bare)
    assert numbers["mean_distance_to_centroid_end"] == 0.0
    assert numbers["robot_contacts"] == 0.0
    for name in ("one_cluster_at_end", "consensus_time", "protection_duty", "command_alteration"):
        assert numbers[name] is None
        assert METRICS[name].series is None or catalog.series(bare, name) is None


def test_without_present_robots_only_counts_and_contacts_have_values() -> None:
    trace = full_run(1)
    numbers = measure(replace(trace, present=np.zeros_like(trace.present)))
    known = {name for name, value in numbers.items() if value is not None}
    bodies = {"robot_contacts", "arena_contacts", "hardest_contact", "minimum_gap", "covered_area"}
    counts = {"clusters_end", "largest_cluster", "largest_cluster_peak"}
    ones = {"one_cluster_at_end", "time_in_one_cluster_late"}
    assert known == bodies | counts | ones
    assert all(numbers[name] == 0.0 for name in counts | ones | {"covered_area"})


def test_runs_are_not_changed_by_being_measured() -> None:
    trace, again = full_run(2), full_run(2)
    measure(trace)
    np.testing.assert_array_equal(trace.pose, again.pose)
    assert measure(trace) == measure(again)


def test_each_metric_is_listed_once() -> None:
    modules = [
        importlib.import_module(f"swarmd.sim.metrics.{module.name}")
        for module in pkgutil.iter_modules(metrics.__path__)
        if module.name != "catalog"
    ]
    listed = sorted(one.name for module in modules for one in getattr(module, "METRICS", ()))
    assert sorted(METRICS) == listed  # each once
    assert all(name.isidentifier() and name == name.lower() for name in listed)
    assert all(one.meaning and one.source for one in METRICS.values())


@pytest.mark.integration
def test_listing_metrics_does_not_import_scipy() -> None:
    code = "import sys; import swarmd.sim.metrics.catalog, swarmd.sim.experiments.statistics;"
    code += "sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("instants", [0, 1, 2, 12])
@pytest.mark.parametrize("n", [1, 2, 6, 50])
def test_short_runs_and_lone_robots_break_nothing(n: int, instants: int) -> None:
    for seed in range(3):
        trace = full_run(seed, n, instants)
        trace = replace(trace, meta={**trace.meta, "arena": "9x9,box:1:1:0.5:0.5,pole:-1:1:0.1"})
        for name, value in measure(trace).items():
            assert value is None or math.isfinite(value), name
        for name, metric in METRICS.items():
            if metric.series is not None and (values := catalog.series(trace, name)) is not None:
                assert values.shape == trace.t.shape, name
                assert values.dtype == np.float64, name
            else:
                assert metric.series is None or instants == 0, name


def test_named_metrics_are_measured_in_their_order() -> None:
    trace = full_run(0)
    assert list(measure(trace, ["minimum_gap", "path_length"])) == ["minimum_gap", "path_length"]
    for ask in (lambda name: measure(trace, [name]), lambda name: catalog.series(trace, name)):
        with pytest.raises(ConfigError, match="minimum_gap"):
            ask("minimum_gab")
    with pytest.raises(ConfigError, match="robot_contacts"):  # it has no series
        catalog.series(trace, "robot_contacts")
