"""The short form of the study of the fence: fixed seeds, no crossing."""

from __future__ import annotations

import pytest

from studies.safety import fence
from studies.safety.fence import MODES, PLATFORMS, measure, table
from swarmd.protection.fence import Fence


@pytest.mark.parametrize(
    ("platform", "mode", "seed", "is_outside"),
    [
        (PLATFORMS[3], MODES[2], 4, False),
        (PLATFORMS[1], MODES[2], 5, True),
        pytest.param(PLATFORMS[0], MODES[0], 3, False, marks=pytest.mark.evidence),
    ],
)
def test_no_robot_crosses_its_fence(platform: str, mode: str, seed: int, is_outside: bool) -> None:
    result = measure((platform, mode, seed, 20.0, is_outside))
    assert result.crossings == 0
    assert result.worst < 0.005
    assert result.moving > 0.0
    assert f"| {platform} | {mode} |" in table([result])


def test_the_judge_sees_crossings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Fence, "limit", lambda self, requested, *_, **__: requested)
    assert measure((PLATFORMS[3], "barrier", 4, 10.0, False)).crossings > 0
    assert fence.main(["--robot-hours", "0", "--jobs", "1"]) == 0
