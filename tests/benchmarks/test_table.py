"""A budget is held by a ratio to a yardstick, and two commits are compared by ratios."""

from __future__ import annotations

import pytest

from benchmarks import budget
from benchmarks.budget import Ratio
from benchmarks.compare import medians, ratios
from benchmarks.table import Row, markdown

TWICE = Row("work", [2.0, 4.0, 6.0])


def test_the_ratio_is_the_median_of_each_sample_to_its_own_yardstick() -> None:
    assert Ratio(TWICE, [1.0, 4.0, 2.0]).value == 2.0
    assert Ratio(TWICE, [8.0]).value == 0.5
    assert Ratio(Row("memory", [50.0, 60.0, 55.0], unit="MB")).value == 55.0


@pytest.mark.parametrize(
    ("ratio", "excess", "holds"),
    [
        (Ratio(TWICE, [1.0]), 0.0, "yes"),
        (Ratio(TWICE, [0.5]), 1.0, "**no**"),
        (Ratio(TWICE, [2.0]), -0.5, "yes"),
        (Ratio(TWICE, [0.5], has_verdict=False), None, ""),
        (Ratio(Row("other", [9.0]), [1.0]), None, ""),
    ],
)
def test_a_ratio_is_held_against_the_budget_of_its_row(
    ratio: Ratio, excess: float | None, holds: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(budget, "BUDGETS", {"work": 4.0})
    assert ratio.excess == excess
    assert ratio.cells()[budget.HEAD.index("holds")] == holds


def test_the_summary_names_each_budget_that_does_not_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "BUDGETS", {"work": 4.0, "more": 1.0})
    held, missed = Ratio(TWICE, [1.0]), Ratio(Row("more", [1.5]), [1.0])
    assert budget.summary([held]) == "All 1 budgets hold."
    assert "1 of 2" in budget.summary([held, missed])
    assert "more by 50 %" in budget.summary([held, missed])


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
