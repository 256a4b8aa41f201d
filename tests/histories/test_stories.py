"""Histories that once broke a rule, in their shortest form."""

from __future__ import annotations

from dataclasses import replace

import pytest

from swarmd.core.messages import State
from tests.histories.history import HistoryStep, replay, step

LEFT, RIGHT = ("r1", "r2", "anna"), ("r3", "r4", "bob")
JOIN = {"on_join": "run", "valid": 60.0}


def test_a_stop_that_comes_after_a_reset_is_not_applied_by_a_robot_that_joins() -> None:
    replay(
        2,
        [
            step(0.0, "run", by="anna", **JOIN),
            step(0.5, "stop", by="bob"),
            step(0.05, "reset", by="anna", targets=("r1", "r3")),
            step(0.05, "undo", by="anna"),
        ],
        seed=100,
    )


def test_a_named_stop_holds_robots_that_joined_the_run_of_the_other_side() -> None:
    history = replay(
        4,
        [
            step(0.0, "estop", by="anna"),
            step(1.0, "split", groups=(LEFT, RIGHT)),
            step(0.1, "reset", by="anna"),
            step(1.0, "run", by="anna", **JOIN),
            step(0.1, "reset", by="bob"),
            step(3.0, "heal"),
            step(1.0, "stop", by="bob", targets=("r3", "r4")),
        ],
    )
    states = {name: one.robot.state for name, one in history.swarm.robots.items()}
    assert State.RUNNING not in (states["r3"], states["r4"])


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_new_robot_does_not_join_a_run_that_all_were_stopped_from(verb: str) -> None:
    history = replay(
        3,
        [
            step(0.0, "run", by="anna", on_join="run", valid=600.0),
            step(2.0, verb, by="anna"),
            step(2.0, "reset", by="anna"),
            step(80.0, "boot", robot="r4"),
        ],
    )
    assert not history.swarm.robots["r4"].robot.is_running


def test_robots_that_obeyed_an_estop_join_no_older_run_when_a_split_heals() -> None:
    history = replay(
        4,
        [
            step(0.0, "split", groups=(LEFT, RIGHT)),
            step(0.5, "run", by="anna", **JOIN),
            step(3.0, "estop", by="bob"),
            step(3.0, "reset", by="bob"),
            step(5.0, "heal"),
        ],
    )
    robots = history.swarm.robots
    assert not any(robots[name].robot.is_running for name in ("r3", "r4"))


def test_a_robot_that_restarts_joins_no_run_from_before_an_estop_of_all() -> None:
    replay(
        3,
        [
            step(0.0, "run", by="bob", **JOIN),
            step(2.0, "kill", robot="r2"),
            step(0.5, "estop", by="anna"),
            step(5.0, "reset", by="anna"),
            step(1.0, "start", robot="r2"),
        ],
    )


def test_a_run_that_is_refused_leaves_a_robot_open_for_an_earlier_stop() -> None:
    history = replay(
        2,
        [
            step(0.0, "run", by="anna"),
            step(2.0, "cut", senders=("bob",), receivers=("r1",)),
            step(0.0, "cut", senders=("r2",), receivers=("r1",)),
            step(0.5, "stop", by="bob", targets=("r1", "r2")),
            step(1.0, "run", by="anna", targets=("r1",), pattern="missing", has_goal=False),
            step(1.0, "heal"),
        ],
    )
    assert not history.swarm.robots["r1"].robot.is_running


def test_a_daemon_that_restarts_ends_no_run_by_an_old_stop() -> None:
    history = replay(
        4,
        [
            step(0.0, "run", by="anna"),
            step(2.0, "stop", by="anna"),
            step(2.0, "run", by="anna"),
            step(2.0, "start", robot="r1"),
            step(15.0, "heal"),
        ],
    )
    robots = history.swarm.robots.values()
    assert sum(one.robot.is_running for one in robots) == 3


def test_a_robot_that_thaws_ends_no_run_of_others() -> None:
    history = replay(
        4,
        [
            step(0.0, "run", by="anna"),
            step(2.0, "freeze", robot="r1"),
            step(1.0, "stop", by="anna"),
            step(5.0, "run", by="anna"),
            step(12.0, "thaw", robot="r1"),
        ],
    )
    robots = history.swarm.robots
    assert all(robots[name].robot.is_running for name in ("r2", "r3", "r4"))


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_robot_that_starts_is_not_held_by_a_stop_that_was_reset(verb: str) -> None:
    history = replay(
        3,
        [
            step(0.0, verb, by="anna"),
            step(4.0, "reset", by="anna"),
            step(1.0, "boot", robot="r4"),
            step(10.0, "heal"),
        ],
    )
    assert history.swarm.robots["r4"].robot.state is State.IDLE


def test_a_stop_is_handed_on_for_its_minute_alone() -> None:
    """In a line, each robot hears its neighbours only."""
    names = tuple(f"r{number + 1}" for number in range(5))
    cuts = [
        step(0.0, "cut", senders=(one,), receivers=(other,))
        for at, one in enumerate(("anna", *names))
        for other_at, other in enumerate(("anna", *names))
        if abs(at - other_at) > 1
    ]
    steps: list[HistoryStep] = [*cuts, step(0.0, "stop", by="anna"), step(300.0, "heal")]
    replay(5, steps)


def test_a_busy_computer_wins_its_own_id() -> None:
    history = replay(2, [step(0.0, "boot", robot="r3", tick=0.2), step(10.0, "heal")])
    assert history.swarm.robots["r3"].is_settled


def test_the_age_of_a_goal_counts_from_its_request() -> None:
    """The links are slow: the request takes two seconds.

    The clock of a robot is known to the way of its answer, 1.2 s at most: the goal may seem older.
    """
    history = replay(
        2,
        [step(0.0, "disturb", delay=1.0), step(0.0, "run", by="anna", **JOIN), step(8.0, "heal")],
    )
    swarm = history.swarm
    for one in swarm.robots.values():
        held = one.robot.goal
        assert held is not None
        assert held.issued is not None
        assert 0.0 <= swarm.issued[held.goal.id] - held.issued <= 1.3


@pytest.mark.parametrize(
    ("first", "pause", "is_running"),
    [("stop", 2.5, True), ("stop", 0.3, False), ("run", 0.1, False), ("run", 1.5, False)],
)
def test_a_stop_that_may_be_later_than_a_run_ends_it(
    first: str, pause: float, is_running: bool
) -> None:
    """Both have long ways, so that a stop seems later and a run earlier, by 0.6 s for each way."""
    orders = {"run": step(0.0, "run", by="anna"), "stop": step(0.0, "stop", by="bob")}
    begin = orders.pop(first)
    [end] = orders.values()
    history = replay(
        2,
        [
            step(0.0, "run", by="anna"),
            step(4.0, "disturb", delay=0.5),
            step(0.0, "cut", senders=("bob",), receivers=("r1", "r2")),
            replace(begin, gap=0.5),
            replace(end, gap=pause),
            step(2.8, "split", groups=()),
            step(6.0, "heal"),
        ],
    )
    for one in history.swarm.robots.values():
        assert one.robot.is_running == is_running


def test_a_robot_of_a_secured_swarm_that_restarts_after_a_stop_causes_no_storm() -> None:
    """Its peers hand the stop on, which it has heard in its earlier life."""
    replay(4, [step(0.0, "stop", by="anna"), step(4.0, "start", robot="r1")], seed=2)


def test_a_robot_that_something_fast_comes_to_twice_goes_on_with_its_run() -> None:
    history = replay(
        2,
        [
            step(0.0, "run", by="anna"),
            step(1.0, "ram", robot="r1"),
            step(8.0, "heal"),
        ],
    )
    robot = history.swarm.robots["r1"].robot
    assert robot.status(history.swarm.now).findings[0].startswith("2 things came at")
    assert robot.is_running


@pytest.mark.parametrize("targets", [(), ("r1",)])
@pytest.mark.parametrize("verb", ["stop", "estop"])
@pytest.mark.parametrize("seed", [1, 2], ids=["insecure", "secured"])
def test_a_stop_of_a_zenoh_program_leaves_what_a_datagram_leaves(
    verb: str, targets: tuple[str, ...], seed: int
) -> None:
    """The same acks, and events in the same order with the same audit line."""
    traces = []
    for name, words in (("program_stop", {"verb": verb}), (verb, {})):
        history = replay(
            2,
            [
                step(0.0, "run", by="anna", has_goal=False),
                step(2.0, name, by="bob", targets=targets, **words),
                step(3.0, "heal"),
            ],
            seed=seed,
        )
        swarm, outcome = history.swarm, history.operators["bob"].done[-1].outcome
        assert outcome is not None
        acks = [
            (robot, reply.code, reply.text.partition(";")[0])  # its odometry is of the last repeat
            for robot, reply in sorted(outcome.replies.items())
        ]
        robots = [one.robot.status(swarm.now) for one in swarm.robots.values()]
        events = [[event.text for event in robot.events] for robot in robots]
        traces.append((acks, events, [(robot.state, len(robot.latches)) for robot in robots]))
    assert traces[0] == traces[1]
    assert any("by bob from ('10.0.1.2', 5000): applied" in text for text in traces[0][1][0])


def test_a_daemon_that_restarts_drives_by_a_still_pose_again() -> None:
    replay(
        2,
        [
            step(0.0, "run", by="anna", **JOIN),
            step(0.05, "freeze_pose", robot="r2", seconds=60.0),
            step(5.0, "start", robot="r2"),
            step(14.0, "undo", by="anna"),
        ],
        seed=371,
    )


@pytest.mark.parametrize("stop", ["stop", "program_stop"])
@pytest.mark.parametrize("after", [0.05, 2.0])
def test_a_robot_that_was_resumed_and_restarts_may_go_on(stop: str, after: float) -> None:
    replay(
        2,
        [
            step(0.0, "run", by="anna", **JOIN),
            step(after, stop, by="bob", targets=("r2",)),
            step(1.0, "resume", by="bob"),
            step(2.0, "start", robot="r2"),
            step(9.0, "heal"),
        ],
        seed=5774,
    )


def test_a_robot_that_was_stopped_and_restarts_stands() -> None:
    history = replay(
        2,
        [
            step(0.0, "run", by="anna", **JOIN),
            step(2.0, "stop", by="bob", targets=("r2",)),
            step(2.0, "start", robot="r2"),
            step(9.0, "heal"),
        ],
    )
    assert not history.swarm.robots["r2"].robot.is_running
