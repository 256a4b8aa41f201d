"""The verdict beside a budget, and the ratios of two commits."""

from __future__ import annotations

import pytest

from benchmarks.compare import medians, ratios
from benchmarks.table import Row, markdown


@pytest.mark.parametrize(
    ("row", "verdict"),
    [
        (Row("a", [1e-3, 2e-3, 1e-3], "p50 1.3 ms"), "yes"),
        (Row("a", [1e-3, 2e-3, 1e-3], "p50 1.3 ms, p99 1.5 ms"), "**no: p99 1.5 ms**"),
        (Row("a", [59.0], ">= 60 x", unit="x"), "**no: >= 60 x**"),
        (Row("a", [61.0], ">= 60 x", unit="x"), "yes"),
        (Row("a", [94.0], "95 MB", unit="MB"), "yes"),
        (Row("a", [1e-3], "p50 1.5 x, p99 10 ms"), ""),  # times another row: not judged
        (Row("a", [1e-3]), ""),
        (Row("a", [], "p50 1 ms"), ""),
    ],
)
def test_a_row_says_which_bounds_it_misses(row: Row, verdict: str) -> None:
    assert row.cells()[2] == verdict


def test_a_budget_that_cannot_be_read_is_an_error() -> None:
    with pytest.raises(ValueError, match="soon"):
        Row("a", [1.0], "soon").cells()


def test_medians_are_read_back_from_printed_tables() -> None:
    head = ("what", "budget", "p50", "p99")
    table = markdown([head, ("one", "", "1.5 ms", "2 ms"), ("two", "", "-", "-")])
    more = markdown([("what", "p50"), ("three", "0.5 x"), ("four", "12 us")])
    found = medians(f"### title\n\n{table}\n\ntext\n{more}\n")
    assert found == pytest.approx({"one": 1.5e-3, "three": 0.5, "four": 12e-6})


def test_ratios_come_with_an_interval_over_the_rounds() -> None:
    old = [{"a": 2.0, "gone": 1.0}, {"a": 4.0, "gone": 1.0}]
    same = [{"a": 1.0}, {"a": 2.0}]
    assert ratios({"old": old, "new": same}) == [("a", "4", "2", "0.50", "0.50 to 0.50")]
    low, high = ratios({"old": old, "new": [{"a": 1.0}, {"a": 4.0}]})[0][-1].split(" to ")
    assert float(low) < 0.5 < 1.0 < float(high)
