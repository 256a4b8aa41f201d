"""Experiment 2 of docs/paper.md in short, the mission that does the same, and its judgement."""

from __future__ import annotations

import math

import numpy as np
import pytest

from studies.paper_exp2 import late_rows
from swarmd.core.values import Array
from swarmd.patterns.discussed_dispersion.metrics import TOLERANCE, Joining, joined, judged
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.lidar_ranges import lidar_ranges
from swarmd.sim.trace import Trace
from tests.support.traces import trace_of

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]  # on a busy machine
MISSION = "discuss_then_disperse"


def simulated(seed: int, **changes: object) -> Trace:
    some = {key.replace("__", "."): value for key, value in changes.items()}
    results = simulate("paper_exp2", [seed], set=some)
    return results.traces[results.runs[0].id]


@pytest.mark.parametrize("opinion", [pytest.param(0, marks=pytest.mark.evidence), 1])
def test_the_swarm_keeps_the_agreed_distance(opinion: int) -> None:
    trace = simulated(7, duration=45.0, groups__first__parameters__initial=opinion)
    course = judged(trace)
    assert course.opinion == opinion
    assert course.moved <= 0.02
    assert course.is_kept
    assert course.least >= course.wanted - TOLERANCE
    assert course.is_standing
    assert course.contacts == 0


@pytest.mark.parametrize("seed", [1, pytest.param(3, marks=pytest.mark.evidence)])
def test_the_mission_and_the_pattern_behave_alike(seed: int) -> None:
    one = simulated(seed, duration=22.0)
    other = simulated(seed, duration=22.0, groups__first__pattern=MISSION)
    assert (one.report["opinion"] == other.report["opinion"]).all()
    assert (one.report["distance"] == other.report["distance"]).all()
    assert (one.words["phase"] == other.words["phase"]).all()
    assert np.array_equal(one.pose, other.pose)
    assert set(one.words["phase"].ravel()) == {"discuss", "disperse"}
    assert np.ptp(one.pose[..., :2], axis=0).max() > 0.1


TIMES = np.arange(0.0, 80.05, 0.1)


def made(places: Array, opinion: Array) -> Trace:
    """Two robots that face along x, at places (T, 2, 2)."""
    pose = np.concatenate((places, np.zeros((len(TIMES), 2, 1))), axis=2)
    return trace_of(
        pose, platform="waffle_pi", t=TIMES, meta={"arena": "10x8"}, report={"opinion": opinion}
    )


def spread(distance: float, at: float) -> Array:
    """Two robots whose axles are 0.9 m apart until the time `at`, and then `distance` m."""
    places = np.zeros((len(TIMES), 2, 2))
    places[:, 1, 0] = np.where(at - 1e-6 > TIMES, 0.9, distance)
    return places


OPINION = np.ones((len(TIMES), 2))


def test_a_range_is_from_the_lidar_to_the_nearest_body_or_wall() -> None:
    trace = made(spread(2.0, 0.0), OPINION)
    # The lidar is 0.064 m behind the axle; the body reaches from -0.197 m to 0.086 m.
    np.testing.assert_allclose(lidar_ranges(trace)[0], [2.0 - 0.197 + 0.064, 2.0 - 0.064 - 0.086])
    at_wall = spread(2.0, 0.0) + np.array([-4.5, 0.0])
    np.testing.assert_allclose(lidar_ranges(made(at_wall, OPINION))[0, 0], 5.0 - 4.564)


def test_a_kept_distance_has_a_start() -> None:
    course = judged(made(spread(1.5, 25.0), OPINION))
    assert course.opinion == 1
    assert course.wanted == pytest.approx(1.0)
    assert course.moved == 0.0
    assert course.kept_since == pytest.approx(25.0)
    assert course.least == pytest.approx(1.5 - 0.064 - 0.086)
    assert course.is_kept
    assert course.is_standing


def test_too_near_too_early_and_too_late_are_found() -> None:
    assert math.isinf(judged(made(spread(1.1, 25.0), OPINION)).kept_since)
    assert judged(made(spread(1.5, 19.0), OPINION)).moved == pytest.approx(0.6)
    late = judged(made(spread(1.5, 50.0), OPINION))
    assert not late.is_kept
    assert not late.is_standing


def test_an_opinion_that_changes_after_20_s_is_no_agreement() -> None:
    opinion = OPINION.copy()
    opinion[TIMES > 60.0, 1] = 0.0
    assert judged(made(spread(1.5, 25.0), opinion)).opinion == -1
    opinion = OPINION.copy()
    opinion[TIMES < 19.0, 1] = 0.0
    assert judged(made(spread(1.5, 25.0), opinion)).opinion == 1


def test_a_late_robot_adopts_or_changes_the_opinion() -> None:
    opinion = OPINION.copy()
    opinion[TIMES < 54.95, 1] = 2.0
    found = joined(made(spread(1.5, 25.0), opinion))
    assert found.adopted == pytest.approx(5.0)
    assert not found.is_swayed
    opinion[TIMES > 70.0, 0] = 2.0
    assert joined(made(spread(1.5, 25.0), opinion)).is_swayed


def test_the_table_of_late_robots_counts_those_that_adopt_and_ranges_that_are_kept() -> None:
    found = [
        Joining(adopted=4.0, is_swayed=False, stirred=0.1, least=0.98, contacts=0),
        Joining(adopted=math.inf, is_swayed=True, stirred=0.3, least=0.9, contacts=2),
        Joining(adopted=1.0, is_swayed=False, stirred=0.2, least=1.2, contacts=0),
    ]
    values = dict(late_rows(found))
    assert values["it adopts the opinion of the seven"] == "2/3"
    assert values["one of the seven changes its opinion"] == "1/3"
    assert values["every range kept in the last 20 s"] == "2/3"  # 1.0 m less 3 cm
    assert values["contacts"] == "2"
