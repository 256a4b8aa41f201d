"""Figures of the voting patterns: each group of debates has its own results."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import pytest

from studies import keeper, voting
from studies.debates import Motion, Result


def test_each_group_has_the_results_of_its_own_debates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held: list[tuple[str, int, int]] = []

    def hold(motion: Motion) -> Result:
        held.append((motion.pattern, motion.count, motion.seed))
        return Result(
            float(motion.seed), motion.held[0] if motion.held else None, 1.0, motion.count
        )

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(voting, "hold_debate", hold)
    monkeypatch.setattr(keeper, "code_of", lambda perform: "a")
    groups: dict[str, voting.Group] = {
        "ones": ("voter_model", 3, {}, [1, 1, 1]),
        "zeros": ("voter_model", 3, {}, [0, 0, 0]),
        "own": ("majority_rule", 5, {"windows": "sliding"}, None),
    }
    found = voting.hold(groups, Namespace(runs=2, jobs=1))
    assert [result.winner for result in found["ones"]] == [1, 1]
    assert [result.winner for result in found["zeros"]] == [0, 0]
    assert [result.sent for result in found["own"]] == [5, 5]
    assert [result.agreed_at for result in found["own"]] == [10_000.0, 10_001.0]
    more = voting.hold(groups, Namespace(runs=3, jobs=1))
    assert {key: results[:2] for key, results in more.items()} == found
    assert len(held) == 9
