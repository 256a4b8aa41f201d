"""The states in which robots lose their last link."""

from __future__ import annotations

import numpy as np
import pytest

from studies.paper_states import counts_of, shares, state_figure, state_rows
from swarmd.sim.trace import WORD, Trace
from tests.support.traces import trace_of

pytestmark = pytest.mark.long


def leaving(away: list[float], states: list[str]) -> Trace:
    """A robot that stands settled, and another `away` m from it, in `states`, every 0.1 s."""
    pose = np.zeros((len(away), 2, 3))
    pose[:, 1, 0] = away
    words = np.full((len(away), 2), "settled", dtype=WORD)
    words[:, 1] = states
    return trace_of(pose, words={"state": words})


def test_both_robots_of_a_pair_lose_their_last_link() -> None:
    away = [0.9] * 10 + [1.1] * 30
    states = ["lead"] * 8 + ["search"] * 32
    counts = counts_of([leaving(away, states)])
    assert {state: some.tolist() for state, some in counts.items()} == {
        "settled": [40.0, 1.0, 1.0],
        "lead": [8.0, 0.0, 1.0],
        "search": [32.0, 1.0, 0.0],
    }
    assert shares(counts)["lead"].tolist() == [0.1, 0.0, 0.5]


@pytest.mark.parametrize("back_after", [1, 10])
def test_a_link_that_returns_within_a_second_was_not_lost(back_after: int) -> None:
    away = [0.9] * 10 + [1.1] * back_after + [0.9] * 30
    counts = counts_of([leaving(away, ["roll"] * len(away))])
    assert sum(some[1] for some in counts.values()) == 0.0


def test_a_table_and_a_figure_have_states_of_which_nothing_is_known() -> None:
    away = [0.9] * 10 + [1.1] * 30
    by_row = {
        "new": counts_of([leaving(away, ["dance"] * 40)]),
        "old": counts_of([leaving(away, [""] * 10 + ["search"] * 30)]),
    }
    head, new, old = state_rows(by_row, {"new": 1, "old": 2})
    assert head[2:] == ["search", "settled", "dance"]
    assert new[1:] == ["2.0", "0% / 0% / 0%", "50% / 50% / 50%", "50% / 50% / 50%"]
    assert old[1] == "1.0"
    bars = state_figure(by_row).axes[0].containers
    assert [bar.get_label() for bar in bars] == head[2:]
    ends = [patch.get_x() + patch.get_width() for patch in bars[-1]]
    np.testing.assert_allclose(ends, 100.0)
