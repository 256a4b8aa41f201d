"""Every pattern reaches its outcomes: one short run in the suite, several in `make evidence`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from studies.outcomes import outcome
from studies.outcomes.catalog import MODULES
from studies.outcomes.line_formation import SHORT
from studies.outcomes.outcome import Outcome, at_least, at_most

SHORT_FORM: Mapping[str, Mapping[str, Any]] = {
    "attraction": {"duration": 40.0},
    "best_of_n": {"has_hard": False},
    "chain_formation": {"has_more": False},
    "collective_perception": {"shares": (0.66,), "has_bodies": False},
    "cooperative_transport": {"shapes": ((0.5, 0.5),), "duration": 80.0},
    "cross_inhibition": {"has_bounds": False},
    "circle_formation": {"settings": (SHORT,)},
    "discussed_dispersion": {"seconds": 46.0},
    "foraging": {"sizes": (1, 4), "duration": 120.0},
    "levy_walk": {"has_slow": False},
    "leader_following": {"has_bodies": False},
    "line_formation": {"settings": (SHORT,)},
    "lloyd_coverage": {"duration": 80.0},
    "one_bit_aggregation": {"duration": 120.0},
    "hexagonal_lattice": {"has_more": False},
    "patrol": {"numbers": (1, 4), "has_bodies": False},
    "random_walk": {"duration": 40.0},
    "shepherding": {"sizes": (4, 8), "has_loose": False},
    "shelter_choice": {"robots": 8, "seconds": 240.0, "has_controls": False},
    "vicsek_alignment": {"has_sizes": False},
    "flocking": {"duration": 30.0},
    "voter_model": {"has_times": False},  # a mean time needs a hundred debates
}

RUNS = {"majority_rule": 20, "voter_model": 25}
"""Debates of each kind: their bounds are in standard errors of as many."""


def missed(outcomes: Sequence[Outcome]) -> list[str]:
    return [f"{o.what}: {o.shown}; expected {o.wanted}" for o in outcomes if not o.is_reached]


# test_paper.py, test_paper_exp2.py, tests/sim/lockstep/test_order.py and
# tests/patterns/test_policy.py run these four.
ELSEWHERE = {"attraction", "discussed_dispersion", "policy", "voter_model"}
# Two to seventeen seconds of processor time each; tests/patterns has their rules, and
# tests/sim/lockstep/test_matrix.py runs each of them in a swarm.
LONG = {
    "best_of_n",
    "circle_formation",
    "collective_perception",
    "cooperative_transport",
    "cross_inhibition",
    "cue_aggregation",
    "foraging",
    "hexagonal_lattice",
    "levy_walk",
    "lloyd_coverage",
    "majority_rule",
    "one_bit_aggregation",
    "phototaxis",
    "response_threshold",
    "shepherding",
    "source_seeking",
    "vicsek_alignment",
}


@pytest.mark.parametrize(
    "pattern",
    [pytest.param(p, marks=[pytest.mark.evidence] * (p in ELSEWHERE | LONG)) for p in MODULES],
)
def test_one_run_reaches_every_outcome(pattern: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if pattern in RUNS:
        monkeypatch.setattr(MODULES[pattern], "RUNS", RUNS[pattern])
    outcomes = MODULES[pattern].outcomes((1,), **SHORT_FORM.get(pattern, {}))
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
    monkeypatch.setattr(outcome, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(outcome, "PAGES", tmp_path)
    page = tmp_path / "levy_walk.md"
    page.write_text("before\n<!-- results: study -->\n\nold\n\n<!-- end of results -->\nafter\n")
    outcome.keep("levy_walk", 20, [at_most("levy_walk", "gap", 1.0, [0.5], "ours")])
    before, marker, *table, _, after = page.read_text().split("\n")[:-1]
    assert (before, marker, after) == ("before", "<!-- results: study -->", "after")
    assert "\n".join(table).strip() == outcome.kept_outcomes()["levy_walk"].table
