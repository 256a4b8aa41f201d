"""A swarm in two halves that do not hear each other, for a while or again and again.

The near laptop hears every robot all the time.
"""

from __future__ import annotations

import threading
import time

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR, TRUE, ask, check_all_alive, judge, prepare
from tests.support.processes import wait_until

pytestmark = pytest.mark.integration

ROBOTS = ("r01", "r02", "r03", "r04")
LEFT, RIGHT = ROBOTS[:2], ROBOTS[2:]


def pause(seconds: float) -> None:
    """How long a fault lasts."""
    threading.Event().wait(seconds)


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
    assert patient.poll() is None, "estop --until-all waits until everyone has it"

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
    # A copy that a stall delays counts as later by this delay, so the first one is awaited.
    swarm.await_states(NEAR, "stopped")
    check_all_alive(swarm)
    wait_until(lambda: ask(swarm, "run").counted == set(ROBOTS), "all run again")
    pause(2.0)
    assert set(swarm.states(NEAR).values()) == {"running"}


def test_operators_on_two_sides_of_a_split_get_one_goal_when_it_heals(swarm: FieldSwarm) -> None:
    """Both goals have one generation: the issuer decides, and the other side is told by whom."""
    swarm.field.set_between((FAR, *LEFT), (NEAR, *RIGHT), is_cut=True)
    speeds = {FAR: "speed=0.05", NEAR: "speed=0.1"}
    for host, user in ((FAR, "anna"), (NEAR, "bob")):
        ran = swarm.ctl(host, "run", "drive", "--all", "-p", speeds[host], user=user)
        assert ran.code == 3, ran
    swarm.await_states(FAR, "running", LEFT)
    swarm.await_states(NEAR, "running", RIGHT)

    swarm.field.heal()
    swarm.await_states(NEAR, "stopped", LEFT)
    members = swarm.members(NEAR)
    for robot in LEFT:
        status = members[robot]["status"]
        assert status["reason"] == "superseded", status
        assert "of bob" in status["detail"]
        assert status["goal"]["state"] == "offered"
    assert {members[robot]["status"]["state"] for robot in RIGHT} == {"running"}
    assert swarm.ctl(FAR, "resume", *LEFT, user="anna").code == 0
    members = swarm.members(NEAR)
    goals = [members[robot]["status"]["goal"] for robot in ROBOTS]
    assert {(goal["state"], goal["own"]["goal"]["params"]["speed"]) for goal in goals} == {
        ("running", 0.1)
    }


@pytest.mark.evidence
@pytest.mark.parametrize("seconds", [8.0, 120.0])
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


def test_an_incident_of_one_side_is_kept_by_all_once_a_split_heals(swarm: FieldSwarm) -> None:
    """The right side keeps its own last minute of it, although it hears of it later."""
    prepare(swarm, "idle")
    swarm.field.set_between(LEFT, RIGHT, is_cut=True)
    assert swarm.ctl(NEAR, "incident", "mark", "it shook", "r01").code == 0
    wait_until(lambda: swarm.keepers(NEAR, "it shook") == set(LEFT), "the left side keeps it")
    swarm.field.heal()
    wait_until(lambda: swarm.keepers(NEAR, "it shook") == set(ROBOTS), "all keep it")
