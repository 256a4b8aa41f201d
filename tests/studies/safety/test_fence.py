"""The short form of the study of the fence: fixed seeds, no crossing."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies import keeper
from studies.safety import fence
from studies.safety.fence import GROWTH, MODES, PLATFORMS, Record, Run, perform, table
from swarmd.robot.protection.fence.fence import Fence

pytestmark = pytest.mark.long


@pytest.mark.parametrize(
    ("platform", "mode", "seed", "is_outside"),
    [
        (PLATFORMS[3], MODES[2], 4, False),
        (PLATFORMS[1], MODES[2], 5, True),
        pytest.param(PLATFORMS[0], MODES[0], 3, False, marks=pytest.mark.evidence),
        pytest.param(PLATFORMS[3], MODES[0], 6, True, marks=pytest.mark.evidence),
    ],
)
def test_no_robot_crosses_its_fence(platform: str, mode: str, seed: int, is_outside: bool) -> None:
    run = Run(platform, mode, seed, 20.0, is_outside, is_exact=is_outside)
    found = perform(run).found
    assert found.crossings == 0
    assert found.worst < GROWTH
    assert found.moving > 0.0
    assert f"| {platform} | {mode} |" in table([Record(run, found)])


@pytest.mark.parametrize("is_outside", [False, True])
def test_the_judge_sees_crossings(monkeypatch: pytest.MonkeyPatch, is_outside: bool) -> None:
    monkeypatch.setattr(Fence, "limit", lambda self, requested, *_, **__: requested)
    assert perform(Run(PLATFORMS[3], "barrier", 4, 10.0, is_outside)).found.crossings > 0


def test_a_run_with_a_record_of_the_same_sources_is_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--robot-hours", "0.001", "--duration", "2", "--jobs", "1", "--out", str(tmp_path)]
    monkeypatch.setattr(keeper, "code_of", lambda perform: "these")
    assert fence.main(words) == 0
    record = (tmp_path / "fence.jsonl").read_bytes()
    assert record.count(b"\n") == 1
    assert fence.main(words) == 0
    assert (tmp_path / "fence.jsonl").read_bytes() == record
    assert "0.00 robot-hours, 0 crossings" in capsys.readouterr().out
    monkeypatch.setattr(keeper, "code_of", lambda perform: "other")
    assert fence.main(words) == 0
    assert (tmp_path / "fence.jsonl").read_bytes().count(b"\n") == 2
