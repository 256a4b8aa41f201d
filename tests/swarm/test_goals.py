"""Goals among real daemons: who joins late, restarts, or comes back from an emergency stop."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.clock import boottime
from swarmd.core.goal import Goal, GoalState, GoalStatus
from swarmd.core.messages import Code, State, Status
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import ResumeRequest, RunRequest
from swarmd.link.stops.stop_relay import LAST_INTERVAL
from tests.support.processes import wait_until
from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


def run_goal(swarm: Swarm, generation: int, *robots: str, **fields: Any) -> Goal:
    """Run a goal by request on some robots."""
    goal = Goal(generation=generation, issuer="bob", id=f"g{generation}", pattern="drive", **fields)
    epochs = {name: swarm.status(name).epoch for name in robots}
    swarm.operator.members()
    outcome = swarm.operator.request(RunRequest, epochs, pattern="drive", goal=goal)
    assert {reply.code for reply in outcome.replies.values()} == {Code.APPLIED}, outcome
    return goal


def goals_of(status: Status) -> GoalStatus:
    return status.goal or GoalStatus()


def await_goal(swarm: Swarm, robot: str, state: GoalState) -> Status:
    return swarm.await_status(robot, state, lambda one: goals_of(one).state is state)


def test_late_joiners_and_restarted_robots_are_offered_the_goal_and_resume_takes_it(
    swarm: Swarm,
) -> None:
    first, late = swarm.body("r1"), swarm.body("r2")
    daemon = swarm.start("r1", first)
    swarm.await_status("r1", "sensing", lambda one: one.decision.scan_age is not None)
    goal = run_goal(swarm, 1, "r1")
    swarm.start("r2", late)
    offered = await_goal(swarm, "r2", GoalState.OFFERED)
    assert offered.state is State.IDLE
    daemon.process.terminate()
    daemon.process.wait()
    swarm.start("r1", first)
    again = await_goal(swarm, "r1", GoalState.OFFERED)
    assert again.state is State.IDLE
    swarm.await_status("r2", "sensing", lambda one: one.decision.scan_age is not None)
    swarm.operator.members()
    epochs = {"r2": swarm.status("r2").epoch}
    assert swarm.operator.request(ResumeRequest, epochs).replies["r2"].code is Code.APPLIED
    assert goals_of(await_goal(swarm, "r2", GoalState.RUNNING)).own.goal == goal  # type: ignore[union-attr]


def test_a_goal_with_on_join_run_is_joined_until_an_emergency_stop(swarm: Swarm) -> None:
    swarm.start("r1", swarm.body("r1"))
    swarm.await_status("r1", "sensing", lambda one: one.decision.scan_age is not None)
    run_goal(swarm, 4, "r1", on_join="run", valid=600.0)
    swarm.start("r2", swarm.body("r2"))
    await_goal(swarm, "r2", GoalState.RUNNING)
    found = {(one["verb"], one["operator"], one["from"]) for one in swarm.audit("r2")}
    assert ("goal", "bob", "a peer") in found
    older = Goal(generation=3, issuer="carol", id="g3", pattern="drive")
    swarm.operator.members()
    epochs = {"r2": swarm.status("r2").epoch}
    outcome = swarm.operator.request(RunRequest, epochs, pattern="drive", goal=older)
    assert outcome.replies["r2"].refusal is Refusal.OVERTAKEN
    assert "goal 4 of bob" in outcome.replies["r2"].text

    assert swarm.ctl("estop").code == 0
    swarm.start("r3", swarm.body("r3"))
    swarm.await_state("r3", State.ESTOPPED)
    await_goal(swarm, "r3", GoalState.STANDING)
    assert swarm.ctl("reset", "--all", "--yes").code == 0
    for robot in ("r1", "r2", "r3"):
        swarm.await_state(robot, State.IDLE)
    swarm.start("r4", swarm.body("r4"))
    await_goal(swarm, "r4", GoalState.STANDING)
    for robot in ("r1", "r2", "r3", "r4"):
        status = swarm.status(robot)
        assert (status.state, goals_of(status).state) == (State.IDLE, GoalState.STANDING)


def test_a_daemon_that_restarts_does_not_end_the_run_that_followed_a_stop(swarm: Swarm) -> None:
    """Robots hand the stop on for a minute; the robot that restarts knows the age of no goal."""
    bodies = {robot: swarm.body(robot) for robot in ("r1", "r2", "r3")}
    daemons = {robot: swarm.start(robot, body) for robot, body in bodies.items()}
    swarm.run_drive("--all")
    assert swarm.ctl("stop", "--all").code == 0
    swarm.run_drive("r1", "r2", "r3")
    daemons["r3"].kill()
    swarm.start("r3", bodies["r3"])
    began = boottime()
    wait_until(lambda: boottime() - began > 1.5 * LAST_INTERVAL, "each robot would have repeated")
    for robot in ("r1", "r2"):
        status = swarm.status(robot)
        assert status.state is State.RUNNING
        assert goals_of(status).state is GoalState.RUNNING
    assert swarm.status("r3").state is not State.RUNNING
