"""What a robot tells of faults that only peers can name: in its status, its log and its memory."""

from __future__ import annotations

import pytest

from swarmd.core.events import PeerFaultsInput
from swarmd.core.kin_message import KinMessage, KinOpinions
from swarmd.core.messages import PeerFault
from swarmd.robot.memory import recall, remember
from swarmd.robot.peer_faults import PeerFaults
from tests.support.robot_harness import RobotHarness

MUTE = PeerFault(robot="r2", kind="mute", by=3, of=4, since=6.0)
SUSPECTED = PeerFault(robot="r3", kind="unheard", by=0, of=3, since=5.0)


def test_a_fault_is_in_the_status_ages_and_is_logged_once() -> None:
    harness = RobotHarness()
    harness.step(PeerFaultsInput((MUTE,)))
    harness.now += 2.0
    harness.step(PeerFaultsInput((MUTE, SUSPECTED)))
    harness.now += 1.5
    status = harness.robot.status(harness.now)
    assert [(one.robot, one.kind, one.since) for one in status.peer_faults] == [
        ("r2", "mute", 7.5),
        ("r3", "unheard", 6.5),
    ]
    assert [event.text for event in status.events if "r2" in event.text] == [
        f"peer r2: {MUTE.text}"
    ]
    assert not any("r3" in event.text for event in status.events)  # it suspects, and knows nothing


def test_a_recalled_robot_knows_them() -> None:
    harness = RobotHarness()
    harness.step(PeerFaultsInput((MUTE,)))
    robot = harness.robot
    other = recall(remember(robot), robot.identity.setup)
    assert other.status(harness.now).peer_faults == (MUTE,)


def test_no_motion_depends_on_them() -> None:
    harness = RobotHarness()
    assert harness.robot.step(PeerFaultsInput((MUTE,)), harness.now) is None


# What kin tells

FIGURE = "8 of 8 looks missed"


def told(
    doubted: tuple[str, ...] = (), straying: tuple[str, ...] = (), fitting: int = 0
) -> KinMessage:
    return KinMessage(1, 0, 0, 0, 0, doubted=doubted, straying=straying, fitting=fitting)


def opinions(
    doubted: tuple[str, ...] = (),
    straying: tuple[str, ...] = (),
    fitting: tuple[str, ...] = (),
    **peers: KinMessage,
) -> KinOpinions:
    return KinOpinions(
        dict.fromkeys(doubted, FIGURE), dict.fromkeys(straying, FIGURE), frozenset(fitting), peers
    )


@pytest.mark.parametrize(
    ("given", "named"),
    [
        pytest.param(opinions(), {}, id="nothing told"),
        pytest.param(opinions(("x",)), {"x": "doubted"}, id="of two robots"),
        pytest.param(
            opinions(("x",), fitting=("b",)), {"x": "doubted"}, id="the third has no opinion"
        ),
        pytest.param(
            opinions(("x",), fitting=("b",), b=told(("x",), fitting=1)),
            {"x": "misfit"},
            id="a third robot agrees",
        ),
        pytest.param(
            opinions(b=told(("x",), fitting=1), c=told(("x",), fitting=1)),
            {"x": "misfit"},
            id="two others agree",
        ),
        pytest.param(opinions(b=told(("x",), fitting=9)), {}, id="one other alone"),
        pytest.param(
            opinions(("x", "y"), fitting=("b",), b=told(("x", "y"), fitting=1)),
            {"x": "doubted", "y": "doubted"},
            id="robots that doubt more than fit do not count",
        ),
        pytest.param(
            opinions(b=told(("x",)), c=told(("x",))),
            {},
            id="robots that fit with none do not count",
        ),
        pytest.param(
            opinions(fitting=("x",), b=told(("x",), fitting=1), c=told(("x",), fitting=1)),
            {},
            id="two others against the own sight",
        ),
        pytest.param(
            opinions(fitting=("b",), x=told(("a", "b"), fitting=0), b=told(("x",), fitting=1)),
            {},
            id="the culprit blames all",
        ),
        pytest.param(opinions(straying=("x",)), {"x": "doubted"}, id="one finds that it strays"),
        pytest.param(
            opinions(straying=("x",), b=told(straying=("x",))), {"x": "strays"}, id="two find it"
        ),
        pytest.param(
            opinions(x=told(straying=("x",)), b=told(straying=("x",))),
            {},
            id="a robot does not count against itself",
        ),
    ],
)
def test_which_faults_follow_from_what_robots_tell_of_sights(
    given: KinOpinions, named: dict[str, str]
) -> None:
    faults = PeerFaults()
    logged = faults.judge(given, 10.0)
    assert {one.robot: one.kind for one in faults.at(10.0)} == named
    assert {one.robot for one in logged} == {r for r, kind in named.items() if kind != "doubted"}


def test_a_fault_by_sights_says_who_tells_it_by_what_figure_and_since_when() -> None:
    faults = PeerFaults()
    given = opinions(("x",), fitting=("b", "c"), b=told(("x",), fitting=1), c=told(fitting=2))
    faults.judge(given, 10.0)
    assert faults.judge(given, 11.0) == ()  # it is logged once
    (fault,) = faults.at(13.0)
    assert (fault.by, fault.of, fault.tellers) == (2, 3, ("b", "self"))
    assert (fault.figure, fault.since) == (FIGURE, 3.0)
    assert FIGURE in fault.text
    assert "2 of 3" in fault.text
    assert faults.at(17.0) == ()  # nobody asks for places any more


def test_a_fault_that_nobody_looked_for_meanwhile_is_new() -> None:
    faults = PeerFaults()
    given = opinions(("x",), fitting=("b",), b=told(("x",), fitting=1))
    assert faults.judge(given, 10.0) != ()
    (again,) = faults.judge(given, 600.0)  # no pattern used kin for ten minutes
    assert (again.robot, again.since) == ("x", 0.0)


def test_faults_by_messages_and_by_sights_stand_side_by_side() -> None:
    faults = PeerFaults()
    faults.take((MUTE,), 10.0)
    faults.judge(opinions(("x",)), 10.0)
    assert {one.robot: one.kind for one in faults.at(10.0)} == {"r2": "mute", "x": "doubted"}
    faults.judge(opinions(), 11.0)
    assert [one.kind for one in faults.at(11.0)] == ["mute"]
