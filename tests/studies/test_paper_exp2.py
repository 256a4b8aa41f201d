"""The claims of docs/paper.md, experiment 2, in short; and the mission that does the same."""

from __future__ import annotations

import numpy as np
import pytest

from studies.paper_exp2 import TOLERANCE, judged
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.trace import Trace

pytestmark = pytest.mark.timeout(600)  # of a machine that has much else to do
MISSION = "discuss_then_disperse"


def trace_of(seed: int, **changes: object) -> Trace:
    some = {key.replace("__", "."): value for key, value in changes.items()}
    results = simulate("paper_exp2", [seed], set=some)
    return results.traces[results.runs[0].id]


@pytest.mark.parametrize("opinion", [0, 1])
def test_the_swarm_keeps_the_distance_that_it_has_agreed_on(opinion: int) -> None:
    trace = trace_of(7, duration=45.0, groups__first__parameters__initial=opinion)
    course = judged(trace)
    assert course.opinion == opinion
    assert course.moved <= 0.02
    assert course.is_kept
    assert course.least >= course.wanted - TOLERANCE
    assert course.is_standing
    assert course.touches == 0


@pytest.mark.parametrize("seed", [1, 3])
def test_the_mission_and_the_pattern_behave_alike(seed: int) -> None:
    one = trace_of(seed, duration=30.0)
    other = trace_of(seed, duration=30.0, groups__first__pattern=MISSION)
    assert (one.report["opinion"] == other.report["opinion"]).all()
    assert (one.report["distance"] == other.report["distance"]).all()
    assert (one.words["phase"] == other.words["phase"]).all()
    assert np.array_equal(one.pose, other.pose)
    assert np.ptp(one.pose[..., :2], axis=0).max() > 0.1
