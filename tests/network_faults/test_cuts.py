"""Robots that hear each other in part: splits, one-way links, flapping, a line, and a frozen one.

The near laptop hears every robot all the time, and only looks.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR, TRUE, VERBS, Judged, judge, prepare
from tests.support.processes import wait_until

pytestmark = [pytest.mark.integration, pytest.mark.evidence]

ROBOTS = ("r01", "r02", "r03", "r04", "r05", "r06")
LEFT, RIGHT = ROBOTS[:3], ROBOTS[3:]


def ask(swarm: FieldSwarm, verb: str, *targets: str) -> Judged:
    """The far laptop's answer to a verb; AssertionError unless it is true."""
    words = VERBS[verb]
    if targets:
        words = tuple(word for word in words if word != "--all") + targets
    swarm.moved()
    judged = judge(swarm, verb, swarm.ctl(FAR, *words, "-o", "json"), targets)
    assert judged.verdict == TRUE, judged
    return judged


def check_all_alive(swarm: FieldSwarm) -> None:
    """The far laptop sees every robot by itself, and no daemon has ended."""
    wait_until(lambda: swarm.states(FAR).keys() == set(ROBOTS), "all robots are seen again")
    assert all(swarm.is_alive(robot) for robot in ROBOTS)


def pause(seconds: float) -> None:
    """How long a fault lasts."""
    threading.Event().wait(seconds)


# Splits


@pytest.mark.parametrize(
    "seconds",
    [
        5.0,
        pytest.param(30.0, marks=pytest.mark.evidence),
        pytest.param(90.0, marks=pytest.mark.evidence),
    ],
)
def test_a_latch_of_one_side_crosses_when_a_split_heals(swarm: FieldSwarm, seconds: float) -> None:
    """The far laptop is on the left side; the near one commands the right side."""
    prepare(swarm, "running")
    began = time.monotonic()
    swarm.field.set_between((FAR, *LEFT), RIGHT, is_cut=True)
    judged = ask(swarm, "estop")
    assert (judged.answer.code, judged.counted, judged.named) == (3, set(LEFT), set(RIGHT))
    patient = swarm.begin(FAR, "estop", "--until-all", "-o", "json")
    assert swarm.ctl(NEAR, "run", "drive", *RIGHT).code == 0
    swarm.await_moving(*RIGHT)
    pause(began + seconds - time.monotonic())
    judged = ask(swarm, "estop")
    assert (judged.counted, judged.named) == (set(LEFT), set(RIGHT))
    assert patient.process.poll() is None, "estop --until-all waits until everyone has it"

    swarm.field.heal()
    judged = judge(swarm, "estop", patient.finish())
    assert (judged.verdict, judged.answer.code, judged.counted) == (TRUE, 0, set(ROBOTS)), judged
    swarm.await_states(NEAR, "estopped")
    swarm.moved()
    check_all_alive(swarm)
    assert ask(swarm, "reset").counted == set(ROBOTS)
    assert swarm.moved() == set()


def test_a_stop_of_one_side_does_not_cross_to_robots_that_were_run_again(
    swarm: FieldSwarm,
) -> None:
    """Who has answered the stop of the left side, and who was run since, are left alone."""
    prepare(swarm, "running")
    swarm.field.set_between((FAR, *LEFT), RIGHT, is_cut=True)
    judged = ask(swarm, "stop")
    assert (judged.answer.code, judged.counted, judged.named) == (3, set(LEFT), set(RIGHT))
    swarm.field.heal()
    check_all_alive(swarm)
    assert ask(swarm, "run").counted == set(ROBOTS)
    pause(2.0)
    assert set(swarm.states(NEAR).values()) == {"running"}


# Links of one direction


@pytest.mark.parametrize("is_mute", [True, False], ids=["mute", "deaf"])
def test_one_robot_is_cut_off_in_one_direction(swarm: FieldSwarm, is_mute: bool) -> None:
    prepare(swarm, "running")
    others = {*ROBOTS[1:], FAR}
    for other in others:
        pair = ("r01", other) if is_mute else (other, "r01")
        swarm.field.set(source=pair[0], target=pair[1], is_cut=True)
    judged = ask(swarm, "estop")
    assert judged.counted >= set(ROBOTS[1:])
    assert ("r01" in judged.named) == (judged.answer.code == 3)
    if is_mute:  # it hears everything
        swarm.await_states(NEAR, "estopped")
    swarm.field.heal()
    swarm.await_states(NEAR, "estopped")
    check_all_alive(swarm)


# Flapping


@pytest.mark.parametrize("seconds", [15.0, pytest.param(120.0, marks=pytest.mark.evidence)])
def test_answers_are_true_while_the_radio_flaps(swarm: FieldSwarm, seconds: float) -> None:
    """Two seconds of connection, two of none, between both halves."""
    prepare(swarm, "running")
    is_over = threading.Event()
    lock = threading.Lock()

    def flap() -> None:
        is_cut = False
        while not is_over.wait(2.0):
            is_cut = not is_cut
            with lock:
                swarm.field.set_between((FAR, *LEFT), RIGHT, is_cut=is_cut)

    flapping = threading.Thread(target=flap)
    flapping.start()
    answers = []
    try:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            for verb in ("estop", "reset", "members", "run", "stop"):
                answers.append((verb, ask(swarm, verb)))
        ask(swarm, "estop")
    finally:
        is_over.set()
        flapping.join()
    for verb, judged in answers:
        print(verb, judged.answer.code, len(judged.counted), f"{judged.answer.seconds:.1f} s")
    swarm.field.heal()
    swarm.await_states(NEAR, "estopped")
    check_all_alive(swarm)


# A line


def line(swarm: FieldSwarm, *hops: Iterable[str]) -> None:
    """Each group hears itself and the groups beside it."""
    for number, some in enumerate(hops):
        for others in hops[number + 2 :]:
            swarm.field.set_between(some, others, is_cut=True)


def test_a_line_is_known_and_stopped_to_its_end(swarm: FieldSwarm) -> None:
    """The far laptop hears two robots, these two more, and those the last two."""
    prepare(swarm, "running")
    line(swarm, (FAR,), ROBOTS[:2], ROBOTS[2:4], ROBOTS[4:])
    judged = ask(swarm, "members")
    assert judged.answer.json["members"], judged
    assert {one["robot"] for one in judged.answer.json["members"]} >= set(ROBOTS[:4])
    judged = ask(swarm, "stop", "r03")
    swarm.await_states(NEAR, "stopped", ["r03"])
    judged = ask(swarm, "estop", "r04")
    swarm.await_states(NEAR, "estopped", ["r04"])
    assert swarm.states(NEAR)["r01"] == "running"
    judged = ask(swarm, "estop")
    assert judged.counted >= set(ROBOTS[:2])
    swarm.await_states(NEAR, "estopped")
    swarm.field.heal()
    check_all_alive(swarm)
    assert ask(swarm, "reset").counted == set(ROBOTS)


# Processes


def test_a_frozen_robot_is_named_and_latched_when_it_thaws(swarm: FieldSwarm) -> None:
    prepare(swarm, "running")
    swarm.daemons["r01"].freeze()
    judged = ask(swarm, "estop")
    assert (judged.answer.code, judged.named) == (3, {"r01"}), judged
    swarm.daemons["r01"].thaw()
    swarm.await_states(NEAR, "estopped")
    swarm.moved()
    check_all_alive(swarm)
    assert swarm.moved() == set()


def test_a_robot_that_starts_with_an_empty_disk_takes_the_latch_over(swarm: FieldSwarm) -> None:
    prepare(swarm, "estopped")
    swarm.daemons["r01"].kill()
    swarm.moved()
    swarm.start(["r01"], state="empty")
    swarm.await_states(NEAR, "estopped")
    assert swarm.moved() == set()
    judged = ask(swarm, "reset")
    assert (judged.answer.code, judged.counted) == (0, set(ROBOTS)), judged


def test_a_robot_that_is_killed_while_estopped_is_estopped_again(swarm: FieldSwarm) -> None:
    prepare(swarm, "estopped")
    for robot in ROBOTS:
        swarm.daemons[robot].kill()
    swarm.start(["r01"])
    swarm.await_states(NEAR, "estopped", ["r01"])
    swarm.start(ROBOTS[1:])
    swarm.await_states(NEAR, "estopped")
