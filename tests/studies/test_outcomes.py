"""Every pattern reaches its outcomes: one short run in the suite, several in `make evidence`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from studies.outcomes import outcome
from studies.outcomes.catalog import MODULES
from studies.outcomes.outcome import Outcome, at_least, at_most


def missed(outcomes: Sequence[Outcome]) -> list[str]:
    return [f"{o.what}: {o.shown}; expected {o.wanted}" for o in outcomes if not o.is_reached]


@pytest.mark.parametrize(
    "pattern",
    [
        pytest.param(name, marks=[pytest.mark.evidence] * getattr(module, "IS_LONG", False))
        for name, module in MODULES.items()
    ],
)
def test_one_run_reaches_every_outcome(pattern: str) -> None:
    """In its short form. IS_LONG: two seconds of processor time and more, or run by another test;
    tests/patterns has its rules, and tests/sim/lockstep/test_matrix.py runs it in a swarm."""
    outcomes = MODULES[pattern].outcomes((1,), **getattr(MODULES[pattern], "SHORT_FORM", {}))
    assert len(outcomes) >= 2
    assert missed(outcomes) == []


@pytest.mark.evidence
@pytest.mark.parametrize("pattern", MODULES)
def test_three_runs_reach_every_outcome(pattern: str) -> None:
    assert missed(MODULES[pattern].outcomes((0, 1, 2))) == []


@pytest.mark.parametrize("value", [0.2, float("nan")])
def test_a_value_beyond_the_bound_is_not_reached(value: float) -> None:
    assert not at_most("x", "y", 0.1, [0.0, value], "z").is_reached
    assert not at_least("x", "y", 0.1, [-value], "z").is_reached
    assert not at_most("x", "y", 0.1, [], "z").is_reached


def test_kept_outcomes_are_in_a_file_and_in_the_table_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outcome, "PATTERNS", tmp_path)
    page = tmp_path / "levy_walk" / "page.md"
    page.parent.mkdir()
    page.write_text("before\n<!-- results: study -->\n\nold\n\n<!-- end of results -->\nafter\n")
    outcome.keep("levy_walk", 20, [at_most("levy_walk", "gap", 1.0, [0.5], "ours")])
    before, marker, *table, _, after = page.read_text().split("\n")[:-1]
    assert (before, marker, after) == ("before", "<!-- results: study -->", "after")
    assert "\n".join(table).strip() == outcome.kept_outcomes()["levy_walk"].table
