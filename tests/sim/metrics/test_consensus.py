"""Agreement of runs whose opinions are known."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.sim.metrics import consensus
from swarmd.sim.trace import Trace
from tests.sim.metrics.runs import run

NONE = float("nan")


def votes(*rows: tuple[float, ...], present: object = None) -> Trace:
    """An instant a row, 0.1 s apart."""
    opinion = np.array(rows)
    there = None if present is None else np.array(present)
    return run(np.zeros((*opinion.shape, 3)), report={"opinion": opinion}, present=there)


@pytest.mark.parametrize(
    ("rows", "time", "opinion", "share"),
    [
        (((0, 1, 1), (1, 1, 1), (1, 1, 0), (1, 1, 1), (1, 1, 1)), 0.3, 1.0, 1.0),
        (((1, 1, 1), (1, 1, 1), (1, 2, 1)), None, None, 2.0 / 3.0),
        (((0, 0), (0, 0), (2, 2), (2, 2)), 0.2, 2.0, 1.0),  # the swarm changes its opinion
        (((0, 0), (0, 0)), 0.0, 0.0, 1.0),
        (((3.0,),), 0.0, 3.0, 1.0),
    ],
)
def test_consensus_lasts_to_the_end(
    rows: tuple[tuple[float, ...], ...], time: float | None, opinion: float | None,
    share: float,
) -> None:  # fmt: skip
    trace = votes(*rows)
    assert consensus.consensus_time(trace) == (None if time is None else pytest.approx(time))
    assert consensus.consensus_opinion(trace) == opinion
    assert consensus.consensus_share(trace) == pytest.approx(share)


def test_shares_are_of_the_most_common_opinion() -> None:
    shares = consensus.consensus_shares(votes((0, 1, 2, 2), (0, 0, 2, 2), (0, 0, 0, 0)))
    assert shares is not None
    assert shares.tolist() == [0.5, 0.5, 1.0]


def test_a_robot_without_an_opinion_does_not_agree() -> None:
    trace = votes((NONE, NONE), (1, NONE), (1, 1))
    assert consensus.consensus_time(trace) == pytest.approx(0.2)
    shares = consensus.consensus_shares(trace)
    assert shares is not None
    assert shares.tolist() == [0.0, 0.5, 1.0]


def test_only_present_robots_vote() -> None:
    present = [[True, True, False], [True, True, True], [True, False, True]]
    trace = votes((1, 1, 0), (1, 1, 0), (1, 0, 1), present=present)
    assert consensus.consensus_time(trace) == pytest.approx(0.2)
    shares = consensus.consensus_shares(trace)
    assert shares is not None
    np.testing.assert_allclose(shares, [1.0, 2.0 / 3.0, 1.0])


def test_an_empty_swarm_agrees_on_nothing() -> None:
    trace = votes((1, 1), (1, 1), present=[[True, True], [False, False]])
    assert consensus.consensus_time(trace) is None
    assert consensus.consensus_share(trace) is None


def test_without_opinions_there_is_no_number() -> None:
    for trace in (run(np.zeros((3, 2, 3))), votes((NONE, NONE))):
        assert consensus.consensus_shares(trace) is None
        assert consensus.consensus_share(trace) is None
        assert consensus.consensus_time(trace) is None
