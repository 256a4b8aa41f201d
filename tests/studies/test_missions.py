"""What the study of missions counts in a run."""

from __future__ import annotations

import numpy as np
import pytest

from studies.missions import is_lost, patrolling
from swarmd.sim.trace import WORD, Trace
from tests.support.traces import trace_of


def chain(targets: list[float], lost: list[str]) -> Trace:
    """Four robots at the last of two instants; the first was removed before."""
    pose = np.zeros((2, 4, 3))
    pose[1, 0] = np.nan
    words = np.full((2, 4), "", dtype=WORD)
    words[1] = lost
    report = {"target": np.array([[np.nan] * 4, targets])}
    return trace_of(pose, report=report, words={"lost": words})


@pytest.mark.parametrize(
    ("targets", "share"), [([np.nan, 1.0, np.nan, np.nan], 1 / 3), ([0.0, 0.0, 2.0, 3.0], 1.0)]
)
def test_present_robots_with_a_target_patrol(targets: list[float], share: float) -> None:
    assert patrolling(chain(targets, [""] * 4)) == pytest.approx(share)


def test_one_robot_that_lost_its_leader_is_enough() -> None:
    assert not is_lost(chain([np.nan] * 4, [""] * 4))
    assert is_lost(chain([np.nan] * 4, ["", "", "tb3-01", ""]))
