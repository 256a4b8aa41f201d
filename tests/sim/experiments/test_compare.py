"""A comparison finds a difference that is there, and none that is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.sim.experiments.compare import (
    Difference,
    Side,
    compare,
    corrected,
    document,
    sides,
)
from swarmd.sim.experiments.manifest import manifest_of
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import plan_of
from swarmd.sim.experiments.statistics import Interval
from swarmd.sim.experiments.store import Row, open_store
from tests.sim.conftest import write_duo

SPEED = "groups.all.parameters.speed"


def side(
    values: dict[int, float | None], metric: str = "minimum_gap", *, lost: tuple[int, ...] = ()
) -> Side:
    """One side whose metric has these values by seed; the runs of seeds `lost` have failed."""
    plan = Plan("x", tuple(values), (Variant("", {}, {"duration": 60.0}),))
    runs = [run for run in plan.runs if run.seed not in lost]
    rows = [Row(run, {metric: values[run.seed]}, 0.1) for run in runs]
    return Side("x", Results(Path("x"), plan, rows, {}, (metric,)), "")


def of(values: Array, first: int = 0) -> dict[int, float | None]:
    return {first + seed: float(value) for seed, value in enumerate(values)}


def only(a: Side, b: Side) -> Difference:
    (found,) = compare(a, b)
    return found


def test_a_planted_difference_is_found_and_a_null_one_is_not() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(1.0, 0.2, 20), rng.normal(1.3, 0.2, 20)
    planted, null = only(side(of(a)), side(of(b, 20))), only(side(of(a)), side(of(a[::-1], 20)))
    assert planted.differs
    assert planted.difference == pytest.approx(b.mean() - a.mean())
    assert not planted.is_paired
    assert not null.differs
    assert null.conclusion == "no difference shown"


def test_pairs_show_what_the_scatter_of_seeds_hides() -> None:
    """The same worlds, a little better in each: invisible without the pairing."""
    rng = np.random.default_rng(5)
    worlds = rng.normal(5.0, 2.0, 20)
    better = worlds + rng.normal(0.2, 0.1, 20)
    assert only(side(of(worlds)), side(of(better))).differs
    assert not only(side(of(worlds)), side(of(better, 100))).differs


def test_pairs_go_by_seed_not_by_place() -> None:
    values = {3: 1.0, 1: 5.0, 2: 3.0}
    shifted = {1: 5.5, 2: 3.5, 3: 1.5}
    found = only(side(dict(values)), side(dict(shifted)))
    assert found.interval is not None
    assert (found.interval.low, found.interval.high) == pytest.approx((0.5, 0.5))


@pytest.mark.parametrize(
    ("a", "b", "n", "difference", "conclusion"),
    [
        # A failed run drops its counterpart of the same seed, and so does one without a value.
        (side({1: 1.0, 2: 2.0}), side({1: 1.0, 2: None}), (1, 1), 0.0, "too few runs"),
        (side(of(np.arange(3.0)), lost=(0,)), side(of(np.arange(3.0)), lost=(1,)), (1, 1), 0.0,
         "too few runs"),
        (side({0: 1.0, 1: 2.0, 2: 9.0}), side({0: 2.0, 1: 3.0, 2: None}), (2, 2), 1.0,
         "B is better, not after Holm"),
        (side({0: 1.0, 1: 2.0, 2: 9.0}), side({5: 2.0, 6: None}), (3, 1), -2.0, "too few runs"),
        (side({0: None}), side({0: None}), (0, 0), None, "-"),
    ],
)  # fmt: skip
def test_values_without_a_counterpart_are_left_out(
    a: Side, b: Side, n: tuple[int, int], difference: float | None, conclusion: str
) -> None:
    found = only(a, b)
    assert (found.n_a, found.n_b, found.difference, found.conclusion) == (
        *n,
        difference,
        conclusion,
    )


@pytest.mark.parametrize(
    ("metric", "shift", "better", "conclusion"),
    [
        ("hardest_contact", 1.0, "a", "A is better"),
        ("hardest_contact", -1.0, "b", "B is better"),
        ("minimum_gap", 1.0, "b", "B is better"),
        ("path_length", 1.0, None, "differs"),
        ("unheard_of", 1.0, None, "differs"),
    ],
)
def test_the_better_side_is_named_where_the_metric_has_one(
    metric: str, shift: float, better: str | None, conclusion: str
) -> None:
    values = np.linspace(1.0, 2.0, 8)
    found = only(side(of(values), metric), side(of(values + shift), metric))
    assert found.differs
    assert (found.better, found.conclusion) == (better, conclusion)


def test_what_chance_would_find_is_reported() -> None:
    found = compare(side(of(np.arange(8.0))), side(of(np.arange(8.0) + 1.0)))
    plain = document(side({0: 1.0}), side({0: 1.0}), found)
    assert plain["differ_by_chance"] == 0.05
    assert plain["metrics"]["minimum_gap"]["interval"] == (1.0, 1.0)
    assert plain["metrics"]["minimum_gap"]["differs"] is True


def test_an_unknown_metric_is_one_line() -> None:
    with pytest.raises(ConfigError, match="'minimum_gap'"):
        compare(side({0: 1.0}), side({0: 1.0}), ["minimum_gop"])


@pytest.fixture(scope="module")
def conducted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`one` and `two:points` without a sweep, `swept` and `other` with one, `empty` unfinished."""
    folder = tmp_path_factory.mktemp("conducted")
    duo = write_duo(folder)
    for name, speeds in (
        ("one", []), ("two:points", []), ("empty", []),
        ("swept", [0.1, 0.2]), ("again", [0.1, 0.2]), ("other", [0.1, 0.3]),
    ):  # fmt: skip
        plan = plan_of(duo, (0, 1), {}, {SPEED: speeds} if speeds else {})
        manifest = manifest_of(plan, traces=False, command=[])
        with open_store(folder / name, manifest, ("minimum_gap",)) as store:
            for run in store.missing if name != "empty" else ():
                store.add(run, {"minimum_gap": 1.0}, 0.1)
    return folder


@pytest.fixture
def folders(conducted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folders of `conducted` are in the current one."""
    monkeypatch.chdir(conducted)


@pytest.mark.parametrize(
    ("a", "b", "pairs"),
    [
        ("one", "two:points", [("one", "two:points")]),
        ("swept:speed=0.1", "one", [("swept:speed=0.1", "one")]),
        ("swept:speed=0.1", "swept:speed=0.2", [("swept:speed=0.1", "swept:speed=0.2")]),
        ("swept", "again", [("swept:speed=0.1", "again:speed=0.1"),
                            ("swept:speed=0.2", "again:speed=0.2")]),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("folders")
def test_sides_are_folders_or_variants(a: str, b: str, pairs: list[tuple[str, str]]) -> None:
    assert [(left.label, right.label) for left, right in sides(a, b)] == pairs


@pytest.mark.parametrize(
    ("a", "b", "fault"),
    [
        ("swept", "one", "swept:speed=0.1"),
        ("one", "swept", "swept:speed=0.1"),
        ("swept", "other", "variants"),
        ("swept:speed=0.11", "one", "'speed=0.1'"),
        ("one", "empty", "empty: "),
        ("one", "nowhere", "nowhere: "),
        ("one:x", "one", "one: no variant 'x'"),
    ],
)
@pytest.mark.usefixtures("folders")
def test_sides_that_cannot_be_are_one_line(a: str, b: str, fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        sides(a, b)
    assert fault in str(caught.value)


def test_times_that_some_runs_never_reached_count_up_to_the_end() -> None:
    never: dict[int, float | None] = {0: 10.0, 1: None, 2: 12.0}
    found = only(side(never, "gather_time"), side(of(np.array([9.0, 8.0, 7.0])), "gather_time"))
    assert (found.never_a, found.never_b, found.horizon) == (1, 0, 60.0)
    assert found.mean_a == pytest.approx(82.0 / 3.0)
    assert found.mean_b == 8.0
    assert found.difference == pytest.approx(8.0 - 82.0 / 3.0)
    assert found.conclusion.endswith("up to 60 s; never: 1 of 3, 0 of 3")


def test_runs_that_never_reached_an_event_are_counted_among_the_compared_runs() -> None:
    never: dict[int, float | None] = {0: 10.0, 1: None, 2: None}
    b = side(of(np.array([9.0, 8.0, 7.0])), "gather_time", lost=(2,))
    found = only(side(never, "gather_time"), b)
    assert (found.n_a, found.never_a) == (2, 1)


def test_an_event_that_no_run_reached_shows_no_difference() -> None:
    never: dict[int, float | None] = {0: None, 1: None, 2: None}
    found = only(side(never, "gather_time"), side(never, "gather_time"))
    assert (found.p, found.difference, found.differs) == (None, 0.0, False)


def test_a_finding_of_many_metrics_must_hold_after_the_correction() -> None:
    one = Difference("x", "", 9, 9, 0.0, 1.0, 1.0, Interval(0.1, 2.0), p=0.02)
    (alone,) = corrected([one])
    assert alone.holds
    found = corrected([one, *[replace(one, p=0.5)] * 3])
    assert [some.p_holm for some in found] == [0.08, 1.0, 1.0, 1.0]
    assert found[0].differs
    assert not found[0].holds
    assert "Holm" in found[0].conclusion
