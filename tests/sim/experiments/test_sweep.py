"""The tables of a sweep state each variant, the effect of each key, and how the keys add up."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.store import Row
from swarmd.sim.experiments.sweep import (
    MARK,
    factors,
    first_and_others,
    interaction_row,
    marginal_rows,
    variants_document,
    variants_table,
)
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.report.tables import differences_tables

GAP, TIME = METRICS["minimum_gap"], METRICS["gather_time"]
SWEEP: dict[str, list[float]] = {
    "groups.a.count": [5, 8],
    "groups.a.parameters.range": [1.0, 2.0, 3.0],
}
N = 12


def results(gap: Callable[[float, float, float], float], never: tuple[int, ...] = ()) -> Results:
    """A sweep whose gap is `gap(count, range, noise of the seed and run)`."""
    rng = np.random.default_rng(1)
    variants = tuple(
        Variant(f"count={a},range={b:g}", dict(zip(SWEEP, (a, b), strict=True)), {"duration": 60.0})
        for a in SWEEP["groups.a.count"]
        for b in SWEEP["groups.a.parameters.range"]
    )
    plan = Plan("x", tuple(range(N)), variants, sweep=SWEEP)
    worlds = rng.normal(0.0, 1.0, N)  # common to all variants
    rows = []
    for run in plan.runs:
        a, b = run.variant.values.values()
        noise = worlds[run.seed] + float(rng.normal(0.0, 0.1))
        time = None if run.seed in never else 10.0 + run.seed
        rows.append(Row(run, {"minimum_gap": gap(a, b, noise), "gather_time": time}, 0.1))
    return Results(Path("x"), plan, rows, {}, ("minimum_gap", "gather_time"))


def added(a: float, b: float, noise: float) -> float:
    return a + 2.0 * b + noise


def test_marginals_are_the_means_of_all_runs_with_a_value() -> None:
    (one,) = factors(results(lambda a, b, noise: a + 2.0 * b), [GAP])
    found: list[object] = [(part.key, part.value, part.mean) for part in one.marginals]
    assert found == [
        ("count", "5", pytest.approx(9.0)),
        ("count", "8", pytest.approx(12.0)),
        ("range", "1.0", pytest.approx(8.5)),
        ("range", "2.0", pytest.approx(10.5)),
        ("range", "3.0", pytest.approx(12.5)),
    ]
    assert one.n == N
    assert len(marginal_rows(one)) == 5


def test_keys_that_add_up_have_no_interaction_and_others_have_one() -> None:
    (sums,) = factors(results(added), [GAP])
    assert sums.p is not None
    assert sums.p > 0.05
    assert interaction_row(sums)[-1] == "none shown"
    (product,) = factors(results(lambda a, b, noise: 0.1 * a * b + noise), [GAP])
    assert product.p is not None
    assert product.p < 1e-6
    assert product.largest in {"count=5,range=1.0", "count=5,range=3.0", "count=8,range=1.0",
                               "count=8,range=3.0"}  # fmt: skip
    assert abs(product.deviation) == pytest.approx(0.15, abs=0.05)
    assert interaction_row(product)[-1] == "shown"


def test_a_seed_without_a_value_in_one_variant_counts_in_none() -> None:
    (one,) = factors(
        results(lambda a, b, noise: np.nan if noise < -1.0 and b == 2.0 else added(a, b, noise)),
        [GAP],
    )
    assert 0 < one.n < N


def test_other_sweeps_have_no_factors() -> None:
    found = results(added)
    assert factors(Results(Path("x"), Plan("x", (0,), ()), [], {}, ()), [GAP]) == []
    assert len(factors(found, [GAP, TIME])) == 2


def test_all_variants_are_in_one_table_with_a_mark_for_what_differs() -> None:
    found = results(added, never=(0, 1, 2))
    header, rows = variants_table(found, [GAP, TIME])
    assert header == ("VARIANT", "minimum_gap [m]", "gather_time [s]")
    assert [row[0] for row in rows] == list(found.variants)
    assert MARK not in rows[0][1]
    assert all(MARK in row[1] for row in rows[1:])
    assert all(row[2] == f"{(9 * 10 + sum(range(3, 12)) + 180) / 12:.4g} (3 of 12 never)"
               for row in rows)  # fmt: skip


def test_the_correction_is_for_the_whole_table() -> None:
    found = results(added)
    every = [one for some in first_and_others(found, [GAP, TIME]) for one in some]
    known = [one for one in every if one.p is not None]
    least = min(known, key=lambda one: one.p or 0.0)
    assert least.p_holm == pytest.approx(len(known) * (least.p or 0.0))
    document = variants_document(found, [GAP])
    assert list(document) == list(found.variants[1:])


def test_a_report_has_the_tables_of_a_sweep() -> None:
    text = differences_tables(results(added), [GAP])
    assert text.index("VARIANT") < text.index("OF ALL WITH") < text.index("INTERACTION")
    assert text.count("<h3>B: ") == 5
