"""Goals of one robot: what is offered, what is run, what ends a run, and who came first."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.msgpack import Decoder, encode
from msgspec.structs import replace

from swarmd.core.bounds import MAX_SECONDS
from swarmd.core.events import ForgetInput, LeaseInput, LeaveInput, RequestInput
from swarmd.core.goal import MAX_UNSIGNED, Goal, GoalRecord, GoalState, GoalStatus, digest_of
from swarmd.core.host_messages import Load, Loaded
from swarmd.core.messages import Code, Latch, Reason, Reply, State, Status
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import EstopRequest, StopRequest
from swarmd.robot.goals import Goals
from swarmd.robot.latches import LatchRecord
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, standing_state


def goal(generation: int = 1, issuer: str = "bob", **fields: Any) -> Goal:
    fields = {"id": f"g{generation}{issuer}", "pattern": "forward", **fields}
    return Goal(generation=generation, issuer=issuer, **fields)


JOINED: dict[str, Any] = {"on_join": "run", "valid": 60.0}


def ready(record: GoalRecord | None = None) -> RobotHarness:
    harness = RobotHarness(patterns=PATTERNS, goals=record)
    harness.advance(0.5)
    return harness


def run(harness: RobotHarness, wanted: Goal, **fields: Any) -> Reply:
    """The reply to a run of a goal."""
    reply = harness.ask(
        "run",
        pattern=wanted.pattern,
        params=wanted.params,
        seconds=wanted.seconds,
        until=wanted.conditions,
        goal=wanted,
        **fields,
    )
    assert reply is not None
    return reply


def in_a_second(harness: RobotHarness) -> dict[str, float]:
    """When a run is to start."""
    return {"tb3-01": harness.now + 1.0}


def told(harness: RobotHarness) -> GoalStatus:
    """The goals in its status."""
    status = harness.status.goal
    assert status is not None
    return status


def test_a_goal_that_is_found_is_offered_and_resume_takes_it() -> None:
    harness = ready()
    harness.find(goal(valid=60.0))
    harness.advance(2.0)
    assert told(harness).state is GoalState.OFFERED
    assert harness.status.state is State.IDLE
    assert harness.twist.is_zero
    harness.applied("resume")
    harness.advance(1.0)
    assert told(harness).state is GoalState.RUNNING
    assert told(harness).reason == ""
    assert harness.twist.linear > 0.0


def test_resume_needs_a_goal_and_the_one_that_was_seen() -> None:
    harness = ready()
    assert harness.refused("resume").refusal is Refusal.NO_GOAL
    harness.find(goal())
    assert harness.refused("resume", digest="00").refusal is Refusal.OVERTAKEN
    harness.applied("resume", digest=told(harness).own.digest)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("fields", "age", "runs"),
    [
        (JOINED, 59.0, True),
        (JOINED, 60.0, False),
        (JOINED, None, False),
        ({"on_join": "run"}, 0.0, False),
        ({**JOINED, "on_join": "offer"}, 0.0, False),
        ({**JOINED, "seconds": 10.0}, 9.0, True),
        ({**JOINED, "seconds": 10.0}, 11.0, False),
        ({**JOINED, "targets": ("r*",)}, 0.0, False),
    ],
)
def test_only_a_young_goal_with_on_join_run_is_run(
    fields: dict[str, Any], age: float | None, runs: bool
) -> None:
    harness = ready()
    harness.find(goal(**fields), age)
    harness.advance(0.5)
    assert (harness.status.state is State.RUNNING) is runs


def test_who_joins_a_run_of_some_seconds_ends_it_with_the_others() -> None:
    harness = ready()
    harness.find(goal(**JOINED, seconds=5.0), 3.0)
    harness.advance(1.5)
    assert harness.status.state is State.RUNNING
    harness.advance(1.0)
    assert standing_state(harness) == (State.IDLE, Reason.FINISHED)
    assert told(harness).state is GoalState.ENDED


def test_a_goal_whose_age_is_told_later_is_run_then() -> None:
    harness = ready(GoalRecord(held=goal(**JOINED), own=goal(**JOINED)))
    assert told(harness).state is GoalState.OFFERED
    harness.find(goal(**JOINED), None)
    assert standing_state(harness)[0] is State.IDLE
    harness.find(goal(**JOINED), 10.0)
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING


@pytest.mark.parametrize("way", ["found", "asked"])
def test_an_age_at_its_bound_keeps_the_status_readable(way: str) -> None:
    """The age of a forged goal would grow beyond what operators decode."""
    harness = ready()
    if way == "found":
        harness.find(goal(), MAX_SECONDS)
    else:
        harness.ask("goal", goal=goal(), age=MAX_SECONDS)
    harness.advance(1.0)
    status = Decoder(Status).decode(encode(harness.status))
    assert status.goal is not None
    assert status.goal.held is not None
    assert status.goal.held.age == MAX_SECONDS


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_after_a_stop_no_found_goal_runs_not_even_after_a_reset(verb: str) -> None:
    harness = ready(GoalRecord(held=goal(**JOINED), own=goal(**JOINED)))
    harness.applied(verb, id="s1")
    harness.find(goal(**JOINED), 1.0)
    harness.find(goal(2, **JOINED), 1.0)
    harness.advance(1.0)
    assert standing_state(harness)[0] in (State.STOPPED, State.ESTOPPED)
    harness.applied("reset", ids=("s1",))
    harness.find(goal(2, **JOINED), 1.0)
    harness.advance(1.0)
    assert harness.status.state is State.IDLE
    assert told(harness).state is GoalState.OFFERED


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_reset_does_not_run_a_goal_whose_age_is_told_after_it(verb: str) -> None:
    harness = ready(GoalRecord(held=goal(**JOINED), own=goal(**JOINED)))
    harness.applied(verb, id="s1")
    harness.applied("reset", ids=("s1",))
    harness.find(goal(**JOINED), 1.0)
    harness.advance(1.0)
    assert standing_state(harness) == (State.IDLE, Reason.RESET)
    again = ready(harness.record)
    again.find(goal(**JOINED), 1.0)
    again.advance(1.0)
    assert again.status.state is State.IDLE, "nor after a restart"


def test_a_robot_that_restarts_while_it_runs_joins_again() -> None:
    harness = ready()
    run(harness, goal(**JOINED))
    harness.step(LeaveInput())
    again = ready(harness.record)
    again.find(goal(**JOINED), 1.0)
    again.advance(0.5)
    assert again.status.state is State.RUNNING


def test_a_robot_that_starts_with_a_latch_loads_nothing() -> None:
    latch = Latch(issuer="anna", scope="swarm")
    harness = RobotHarness(
        patterns=PATTERNS,
        latches=LatchRecord(held={"e1": latch}),
        goals=GoalRecord(held=goal(**JOINED), own=goal(**JOINED)),
    )
    harness.find(goal(**JOINED), 1.0)
    harness.find(goal(2, **JOINED), 1.0)
    harness.advance(0.5)
    assert harness.sent == []


def test_a_greater_goal_ends_the_run_of_a_lesser_one_and_says_which() -> None:
    harness = ready()
    assert run(harness, goal(6)).code is Code.APPLIED
    harness.find(goal(5, "carol"))
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING
    harness.find(goal(7, pattern="finisher"))
    harness.advance(0.5)
    assert standing_state(harness) == (State.STOPPED, Reason.SUPERSEDED)
    assert harness.status.detail == "by goal 7 of bob: finisher"
    assert told(harness).superseded == "goal 7 of bob: finisher"
    assert told(harness).state is GoalState.OFFERED


@pytest.mark.parametrize("is_running", [False, True])
@pytest.mark.parametrize(
    "lesser",
    [goal(5, pattern=None), goal(6, "anna"), goal(6, pattern="arc")],
    ids=["5", "6, anna", "6, of the same operator"],
)
def test_a_goal_that_is_less_than_that_of_a_load_does_not_end_the_load(
    is_running: bool, lesser: Goal
) -> None:
    harness = ready()
    if is_running:
        run(harness, goal(4))
    request = harness.request("run", pattern="forward", goal=goal(6), at=in_a_second(harness))
    harness.send(request)
    harness.find(lesser)
    assert harness.twist.is_zero, "the run of goal 4 has ended"
    assert told(harness).state is (GoalState.OFFERED if lesser.pattern else GoalState.STANDING)
    harness.advance(1.5)
    assert harness.reply_to(request).code is Code.APPLIED
    assert told(harness).held is not None
    assert told(harness).held.goal == goal(6)  # type: ignore[union-attr]
    assert harness.twist.linear > 0.0


def test_a_goal_that_is_greater_than_that_of_a_load_ends_the_load() -> None:
    harness = ready()
    request = harness.request("run", pattern="forward", goal=goal(6), at=in_a_second(harness))
    harness.send(request)
    harness.find(goal(7, pattern=None))
    assert harness.reply_to(request).refusal is Refusal.OVERTAKEN
    harness.advance(1.5)
    assert harness.twist.is_zero


@pytest.mark.parametrize("fields", [{}, JOINED], ids=["offered", "joined"])
def test_a_run_whose_goal_came_from_a_peer_first_is_not_stale(fields: dict[str, Any]) -> None:
    harness = ready()
    run(harness, goal(6))
    seen = harness.epoch
    wanted = goal(7, **fields, params={"speed": 0.1})
    harness.find(wanted)
    harness.advance(0.5)
    assert run(harness, goal(8), epoch=seen).refusal is Refusal.STALE_EPOCH
    assert run(harness, wanted, epoch=seen).code is Code.APPLIED
    assert told(harness).state is GoalState.RUNNING
    assert run(harness, wanted, epoch=seen).refusal is Refusal.STALE_EPOCH


def test_a_run_is_stale_if_more_than_its_goal_came_first() -> None:
    harness = ready()
    run(harness, goal(6))
    seen = harness.epoch
    harness.find(goal(7))
    harness.applied("stop")
    assert run(harness, goal(7), epoch=seen).refusal is Refusal.STALE_EPOCH


def test_a_robot_that_runs_goes_over_to_a_greater_goal_with_on_join_run() -> None:
    harness = ready()
    run(harness, goal(6))
    harness.find(goal(7, "carol", **JOINED, params={"speed": 0.1}))
    harness.advance(1.0)
    assert harness.status.state is State.RUNNING
    assert told(harness).state is GoalState.RUNNING
    assert any("superseded" in event.text for event in harness.status.events)


def test_a_greater_goal_for_other_robots_changes_nothing_here() -> None:
    harness = ready()
    run(harness, goal(6))
    harness.find(goal(7, targets=("r*",)))
    harness.advance(0.5)
    assert told(harness).state is GoalState.RUNNING
    assert harness.robot.goal is not None
    assert harness.robot.goal.goal.generation == 7


def test_a_run_whose_goal_is_not_greater_is_refused_by_name_of_the_issuer() -> None:
    harness = ready()
    harness.find(goal(7, "bob"))
    late = run(harness, goal(7, "alice"))
    assert late.refusal is Refusal.OVERTAKEN
    assert "goal 7 of bob" in late.text
    assert run(harness, goal(7, "bob")).code is Code.APPLIED, "the same goal again"


def test_a_run_whose_goal_is_of_another_run_or_robot_is_refused() -> None:
    harness = ready()
    other = harness.refused("run", pattern="finisher", goal=goal())
    assert other.refusal is Refusal.INVALID_GOAL
    assert run(harness, goal(targets=("r*",))).refusal is Refusal.INVALID_GOAL


def test_a_goal_that_no_datagram_carries_is_refused() -> None:
    harness = ready()
    long = goal(targets=("*", *(f"robot-{number:060}" for number in range(20))))
    assert run(harness, long).refusal is Refusal.INVALID_GOAL
    assert harness.refused("goal", goal=long).refusal is Refusal.INVALID_GOAL


def test_goals_of_one_generation_and_issuer_have_one_order_everywhere() -> None:
    one, other = goal(3, params={"speed": 0.1}), goal(3, params={"speed": 0.2})
    held = []
    for order in ((one, other), (other, one)):
        harness = ready()
        for found in order:
            harness.find(found)
        assert harness.robot.goal is not None
        held.append(harness.robot.goal.digest)
    assert held[0] == held[1]


def test_a_stop_of_all_makes_the_same_standing_goal_in_all_robots() -> None:
    harnesses = [ready(), ready()]
    for harness in harnesses:
        run(harness, goal(6))
        stop = StopRequest(id="s1", operator="alice")
        for _ in range(3):  # an operator repeats it
            harness.step(RequestInput(stop))
            harness.advance(0.1)
        assert told(harness).state is GoalState.STANDING
    held = [harness.robot.goal for harness in harnesses]
    assert held[0] is not None
    assert held[1] is not None
    assert held[0].content == held[1].content
    assert held[0].goal.order == (7, "alice")
    harnesses[0].find(goal(8), None)
    harnesses[0].step(RequestInput(stop))
    assert told(harnesses[0]).held.goal.generation == 8  # type: ignore[union-attr]


@pytest.mark.parametrize("is_relayed", [False, True])
def test_an_estop_of_all_makes_a_standing_goal_as_a_stop_does(is_relayed: bool) -> None:
    harness = ready()
    run(harness, goal(6, **JOINED))
    harness.advance(5.0)
    estop = EstopRequest(id="e1", operator="alice", is_relayed=is_relayed, age=2.0)
    for _ in range(2):
        harness.step(RequestInput(estop))
        harness.advance(0.1)
    harness.applied("reset", ids=("e1",))
    assert told(harness).state is GoalState.STANDING
    assert told(harness).held.goal == goal(7, "alice", id="e1", pattern=None)  # type: ignore[union-attr]
    assert harness.refused("resume").refusal is Refusal.NO_GOAL
    harness.step(RequestInput(replace(estop, is_relayed=True)))
    assert told(harness).held.goal.generation == 7  # type: ignore[union-attr]


def test_an_estop_of_named_robots_makes_no_goal() -> None:
    harness = ready()
    run(harness, goal(6))
    harness.applied("estop", scope="robots")
    assert told(harness).held.goal.generation == 6  # type: ignore[union-attr]


@pytest.mark.parametrize("is_restarted", [False, True])
@pytest.mark.parametrize(("age", "joins"), [(6.0, False), (3.0, True)])
def test_no_goal_that_is_older_than_the_last_reset_is_joined(
    age: float, joins: bool, is_restarted: bool
) -> None:
    harness = ready()
    harness.applied("estop", id="e1", scope="robots")
    harness.advance(1.0)
    harness.applied("reset", ids=("e1",))
    if is_restarted:
        began, harness = harness.now, RobotHarness(patterns=PATTERNS, goals=harness.record)
        harness.advance(began - harness.now)
    harness.advance(5.0)
    harness.find(goal(6, **JOINED), age)
    harness.advance(0.5)
    assert (harness.status.state is State.RUNNING) is joins
    assert told(harness).state is (GoalState.RUNNING if joins else GoalState.OFFERED)


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_restart_does_not_join_a_goal_that_was_offered_after_a_reset(is_restarted: bool) -> None:
    harness = ready()
    harness.applied("estop", id="e1", scope="robots")
    harness.advance(1.0)
    harness.applied("reset", ids=("e1",))
    harness.find(goal(6, **JOINED), 6.0)
    assert told(harness).state is GoalState.OFFERED
    if is_restarted:
        began, harness = harness.now, RobotHarness(patterns=PATTERNS, goals=harness.record)
        harness.advance(began - harness.now)
    harness.find(goal(6, **JOINED), 6.5)
    harness.advance(0.5)
    assert harness.status.state is State.IDLE


def test_a_robot_that_was_reset_while_it_was_idle_joins_no_earlier_goal() -> None:
    harness = ready()
    harness.advance(5.0)
    harness.applied("reset")
    harness.find(goal(6, **JOINED), 3.0)
    harness.advance(0.5)
    assert harness.status.state is State.IDLE


@pytest.mark.parametrize(("age", "joins"), [(1.5, True), (2.0, False), (30.0, False)])
def test_a_robot_joins_no_goal_whose_run_would_be_over(age: float, joins: bool) -> None:
    harness = ready()
    harness.find(goal(6, **JOINED, seconds=2.0), age)
    harness.advance(0.1)
    assert (harness.status.state is State.RUNNING) is joins


@pytest.mark.parametrize("is_reset", [True, False])
def test_a_robot_that_was_reset_while_it_ran_joins_no_earlier_goal(is_reset: bool) -> None:
    """Rule `old_goal` of docs/evidence/motion.md."""
    harness = ready()
    harness.ask("run", pattern="forward", seconds=6.0)
    harness.advance(5.0)
    if is_reset:
        assert harness.applied("reset").text.startswith("running")
    harness.find(goal(6, **JOINED), 3.0)
    harness.advance(2.0)
    assert (harness.status.state is State.RUNNING) is not is_reset
    assert told(harness).state is (GoalState.OFFERED if is_reset else GoalState.RUNNING)


def test_a_trial_delays_a_join_until_its_end() -> None:
    harness = ready()
    harness.is_hung = True
    harness.send(harness.request("reload", pattern="forward"))
    harness.find(goal(6, **JOINED), 1.0)
    harness.is_hung = False
    harness.advance(11.0)
    assert harness.status.state is State.RUNNING


def test_a_join_takes_the_present_code() -> None:
    harness = ready()
    harness.find(goal(6, **JOINED), 1.0)
    assert [one.is_restart for one in harness.sent if isinstance(one, Load)] == [False]


def test_a_goal_is_joined_only_when_what_the_others_hold_is_known() -> None:
    harness = ready()
    run(harness, goal(5))
    seen = harness.epoch
    wanted = goal(6, **JOINED)
    harness.find(wanted, 1.0, may_join=False)
    harness.advance(1.0)
    assert standing_state(harness) == (State.STOPPED, Reason.SUPERSEDED)
    assert told(harness).state is GoalState.OFFERED
    harness.find(wanted, 2.0)
    harness.advance(0.5)
    assert told(harness).state is GoalState.RUNNING
    assert run(harness, wanted, epoch=seen).code is Code.APPLIED


def test_a_goal_that_waits_is_not_joined_after_a_stop_or_a_greater_goal() -> None:
    stopped, overtaken = ready(), ready()
    for harness in (stopped, overtaken):
        harness.find(goal(6, **JOINED), 1.0, may_join=False)
    stopped.applied("stop")
    overtaken.find(goal(7, "alice", pattern=None), 1.0, may_join=False)
    for harness in (stopped, overtaken):
        harness.find(goal(6, **JOINED), 1.5)
        harness.advance(0.5)
        assert harness.status.state is not State.RUNNING


def stop_of_all(harness: RobotHarness, age: float) -> None:
    """A stop of all robots, issued `age` s ago, is handed on to the robot."""
    harness.send(StopRequest(id="s1", operator="alice", age=age))


def generation_of(harness: RobotHarness) -> int:
    held = harness.robot.goal
    assert held is not None
    return held.goal.generation


@pytest.mark.parametrize(("age", "generation"), [(10.0, 7), (60.0, 8)])
def test_a_stop_makes_no_goal_until_the_age_of_the_held_goal_is_known(
    age: float, generation: int
) -> None:
    harness = ready(GoalRecord(held=goal(7), own=goal(7)))
    stop_of_all(harness, 30.0)
    assert generation_of(harness) == 7
    harness.advance(1.0)
    harness.find(goal(7), None)
    assert generation_of(harness) == 7
    harness.find(goal(7), age)
    assert generation_of(harness) == generation


@pytest.mark.parametrize(
    ("found", "age", "generation"),
    [({"generation": 8}, 10.0, 8), ({"generation": 8}, 60.0, 9), ({"pattern": None}, 30.0, 8)],
)
def test_a_stop_of_unknown_order_is_compared_with_the_greater_goal_that_comes(
    found: dict[str, Any], age: float, generation: int
) -> None:
    harness = ready(GoalRecord(held=goal(7), own=goal(7)))
    stop_of_all(harness, 30.0)
    harness.find(
        goal(**{"generation": 8, "id": "s1", **found} if "pattern" in found else found), age
    )
    assert generation_of(harness) == generation


def test_a_stop_that_is_newer_than_the_start_of_the_robot_makes_a_goal_at_once() -> None:
    harness = ready(GoalRecord(held=goal(7), own=goal(7)))
    harness.advance(20.0)
    stop_of_all(harness, 5.0)
    assert generation_of(harness) == 8


def test_a_run_that_began_since_ends_the_doubt_about_a_stop() -> None:
    harness = ready(GoalRecord(held=goal(7), own=goal(7)))
    stop_of_all(harness, 30.0)
    harness.applied("resume")
    harness.find(goal(7), 60.0)
    assert generation_of(harness) == 7
    assert harness.status.state is State.RUNNING


def test_a_stop_that_is_older_than_the_held_goal_makes_none() -> None:
    harness = ready()
    harness.find(goal(7), 2.0)
    harness.step(RequestInput(StopRequest(id="s1", operator="a", age=10.0)))
    assert told(harness).held.goal.generation == 7  # type: ignore[union-attr]


def test_a_copy_of_a_resume_that_found_a_run_starts_none_after_its_end() -> None:
    harness = ready()
    run(harness, goal(6, seconds=1.0))
    resume = harness.request("resume")
    assert harness.answer(resume).code is Code.APPLIED  # it runs already
    harness.advance(1.5)
    assert harness.status.state is State.IDLE
    assert harness.answer(resume).refusal is Refusal.STALE_EPOCH
    harness.advance(0.5)
    assert harness.twist.is_zero


def test_a_copy_of_a_refused_resume_runs_no_goal_that_came_since() -> None:
    harness = ready()
    resume = harness.request("resume")
    assert harness.answer(resume).refusal is Refusal.NO_GOAL
    harness.find(goal(7), 100.0)
    assert harness.answer(resume).refusal is Refusal.STALE_EPOCH
    harness.advance(0.5)
    assert harness.status.state is State.IDLE


def test_a_standing_goal_that_is_found_ends_a_run() -> None:
    harness = ready()
    run(harness, goal(6))
    harness.find(goal(7, "alice", pattern=None))
    harness.advance(0.2)
    assert standing_state(harness) == (State.STOPPED, Reason.SUPERSEDED)
    assert told(harness).state is GoalState.STANDING
    assert harness.refused("resume").refusal is Refusal.NO_GOAL


def test_a_stop_of_named_robots_makes_no_goal_and_is_the_reason_of_the_difference() -> None:
    harness = ready()
    run(harness, goal(6))
    harness.applied("stop", operator="carol")
    assert told(harness).held.goal.generation == 6  # type: ignore[union-attr]
    assert told(harness).state is GoalState.ENDED
    assert "carol" in told(harness).reason
    harness.applied("resume")
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING


def test_set_parameters_are_the_reason_of_a_difference() -> None:
    harness = ready()
    run(harness, goal(6))
    harness.ask("param", params={"speed": 0.1}, operator="carol")
    harness.advance(0.2)
    assert told(harness).state is GoalState.RUNNING
    assert told(harness).reason == "param set by carol: speed"


def test_a_run_ends_when_its_operator_is_not_heard_for_the_lease() -> None:
    harness = ready()
    run(harness, goal(6, lease=2.0))
    for count in range(1, 4):
        harness.advance(1.5)
        harness.robot.step(LeaseInput("g6bob", count), harness.now)
    assert told(harness).lease_left == pytest.approx(2.0)
    harness.advance(1.0)
    harness.robot.step(LeaseInput("g6bob", 3), harness.now)  # an old one again
    harness.robot.step(LeaseInput("other", 9), harness.now)
    assert harness.status.state is State.RUNNING
    harness.advance(1.1)
    assert standing_state(harness) == (State.STOPPED, Reason.LEASE_ENDED)
    assert "bob" in harness.status.detail
    harness.robot.step(LeaseInput("g6bob", 4), harness.now)
    harness.advance(1.0)
    assert harness.twist.is_zero, "a late lease starts nothing"


def test_a_run_with_a_lease_is_resumed_only_while_its_operator_is_heard() -> None:
    harness = ready()
    run(harness, goal(6, lease=2.0))
    harness.applied("stop", operator="carol")
    harness.advance(1.0)
    harness.applied("resume")
    harness.advance(0.5)
    assert told(harness).lease_left == pytest.approx(0.5, abs=0.1)  # resume does not renew it
    harness.advance(1.0)
    assert standing_state(harness) == (State.STOPPED, Reason.LEASE_ENDED)
    assert harness.refused("resume").refusal is Refusal.NO_GOAL
    harness.robot.step(LeaseInput("g6bob", 1), harness.now)
    harness.applied("resume")
    harness.advance(0.5)
    assert told(harness).state is GoalState.RUNNING


def test_a_robot_that_finds_a_goal_with_a_lease_resumes_it_once_the_operator_is_heard() -> None:
    harness = ready(GoalRecord(held=goal(6, lease=2.0), own=goal(6, lease=2.0)))
    assert harness.refused("resume").refusal is Refusal.NO_GOAL
    harness.robot.step(LeaseInput("g6bob", 7), harness.now)
    harness.find(goal(7, lease=2.0))  # its operator is not that of the lease before
    assert harness.refused("resume").refusal is Refusal.NO_GOAL
    harness.robot.step(LeaseInput("g7bob", 1), harness.now)
    harness.applied("resume")
    harness.advance(0.5)
    assert harness.status.state is State.RUNNING


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_second_stop_of_all_keeps_the_goal_before_the_first(verb: str) -> None:
    harness = ready()
    run(harness, goal(3))
    for id in ("s1", "s2"):
        harness.advance(0.5)
        kind = EstopRequest if verb == "estop" else StopRequest
        harness.send(kind(id=id, operator="anna"))
    assert told(harness).held.goal.pattern is None  # type: ignore[union-attr]
    assert told(harness).before == goal(3)


def test_a_reset_ends_the_load_of_a_goal_that_was_found() -> None:
    harness = ready()
    harness.is_hung = True
    harness.find(goal(**JOINED), 1.0)
    harness.applied("reset")
    harness.is_hung = False
    load = next(one for one in harness.sent if isinstance(one, Load))
    harness.host_says(Loaded(load.generation, 20.0, frozenset(), {}))
    harness.advance(1.0)
    assert standing_state(harness)[0] is State.IDLE
    assert told(harness).state is GoalState.ENDED
    harness.find(goal(**JOINED), 2.0)
    harness.advance(1.0)
    assert harness.status.state is State.IDLE


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_robot_joins_no_run_with_a_lease_whose_operator_is_not_heard(is_restarted: bool) -> None:
    wanted = goal(6, **JOINED, lease=5.0)
    harness = ready(GoalRecord(held=wanted, own=wanted) if is_restarted else None)
    harness.find(wanted, 20.0)
    harness.advance(1.0)
    assert harness.status.state is State.IDLE
    assert told(harness).state is GoalState.OFFERED


def test_a_robot_that_joins_a_run_with_a_lease_runs_until_its_operator_is_gone() -> None:
    harness = ready()
    harness.find(goal(6, **JOINED, lease=5.0), 20.0, may_join=False)
    harness.robot.step(LeaseInput("g6bob", 7), harness.now)
    harness.advance(2.0)
    harness.find(goal(6, **JOINED, lease=5.0), 22.0)
    harness.advance(1.0)
    assert harness.status.state is State.RUNNING
    assert told(harness).lease_left == pytest.approx(2.0)  # the join does not renew it
    harness.advance(2.1)
    assert standing_state(harness) == (State.STOPPED, Reason.LEASE_ENDED)


@pytest.mark.parametrize("age", [None, 2.0, 300.0], ids=["unknown", "as the lease", "replayed"])
def test_a_lease_that_is_old_or_may_be_replayed_prolongs_no_run_and_is_told(
    age: float | None,
) -> None:
    """As of an operator of an older version in a secured swarm, or of an attacker."""
    harness = ready()
    run(harness, goal(6, lease=2.0))
    for count in range(1, 4):
        harness.advance(0.6)
        harness.robot.step(LeaseInput("g6bob", count, age), harness.now)
    assert told(harness).lease_left == pytest.approx(0.2, abs=0.1)
    harness.advance(0.5)
    assert standing_state(harness) == (State.STOPPED, Reason.LEASE_ENDED)
    assert "replayed" in harness.status.detail
    assert "replayed" in harness.refused("resume").text
    harness.advance(2.0)
    assert "replayed" not in harness.refused("resume").text


def test_a_lease_counts_from_the_time_at_which_it_was_sent() -> None:
    harness = ready()
    run(harness, goal(6, lease=2.0))
    harness.advance(1.0)
    harness.robot.step(LeaseInput("g6bob", 1, 0.5), harness.now)
    assert told(harness).lease_left == pytest.approx(1.5)
    harness.robot.step(LeaseInput("g6bob", 2, 1.9), harness.now)  # a later one came late
    assert told(harness).lease_left == pytest.approx(1.5)
    harness.advance(1.6)
    assert standing_state(harness) == (State.STOPPED, Reason.LEASE_ENDED)


@pytest.mark.parametrize(
    ("pause", "age", "state"),
    [
        (1.0, 0.0, State.RUNNING),
        (4.9, 0.0, State.RUNNING),
        (5.1, 0.0, State.IDLE),  # later than the lease of 5 s
        (1.0, None, State.IDLE),
        (1.0, 6.0, State.IDLE),
    ],
)
def test_a_robot_that_joins_waits_for_the_operator_for_the_time_of_the_lease(
    pause: float, age: float | None, state: State
) -> None:
    harness = ready()
    harness.find(goal(6, **JOINED, lease=5.0), 20.0)
    harness.advance(pause)
    assert harness.status.state is State.IDLE
    harness.step(LeaseInput("g6bob", 7, age))
    harness.advance(1.0)
    assert harness.status.state is state


def test_a_robot_that_does_not_know_all_goals_joins_by_no_lease() -> None:
    harness = ready()
    harness.find(goal(6, **JOINED, lease=5.0), 20.0, may_join=False)
    harness.step(LeaseInput("g6bob", 7))
    harness.advance(1.0)
    assert harness.status.state is State.IDLE


def test_a_lease_that_comes_after_a_stop_lets_nothing_join() -> None:
    harness = ready()
    harness.find(goal(6, **JOINED, lease=5.0), 20.0)
    harness.applied("stop", operator="carol")
    harness.step(LeaseInput("g6bob", 7))
    harness.advance(1.0)
    assert harness.twist.is_zero


def test_a_restarted_robot_offers_its_goal_and_tells_why_it_had_ended() -> None:
    harness = ready()
    run(harness, goal(6))
    harness.step(LeaveInput())
    again = ready(harness.record)
    assert told(again).state is GoalState.OFFERED
    assert told(again).own.age is None  # type: ignore[union-attr]
    harness = ready()
    run(harness, goal(6))
    harness.applied("stop", operator="carol")
    again = ready(harness.record)
    assert told(again).state is GoalState.ENDED
    assert "carol" in told(again).reason
    again.find(goal(6), 1.0)
    assert told(again).own.age == 1.0  # type: ignore[union-attr]


def test_ages_are_handed_on_and_the_greatest_counts() -> None:
    goals = Goals("r1", (), None, 100.0)
    goals.adopt(goal(), 5.0, 100.0, may_join=False)
    goals.learn_age(3.0, 100.0)
    assert goals.held is not None
    assert goals.held.age(110.0) == 15.0
    goals.learn_age(30.0, 110.0)
    assert goals.held.age(110.0) == 30.0


def test_a_goal_without_a_run_is_offered_or_ends_the_run() -> None:
    harness = ready()
    harness.applied("goal", goal=goal(2, **JOINED))
    assert told(harness).state is GoalState.OFFERED
    harness.applied("resume")
    harness.applied("goal", goal=goal(3, pattern=None))
    assert standing_state(harness) == (State.STOPPED, Reason.SUPERSEDED)
    assert harness.refused("goal", goal=goal(2)).refusal is Refusal.OVERTAKEN


def test_labels_are_kept_and_a_goal_may_target_them() -> None:
    harness = ready()
    harness.find(goal(4, targets=("label:red",)))
    assert told(harness).own is None
    harness.applied("label", labels=("red", "left"))
    assert set(harness.status.labels) == {"red", "left"}
    assert told(harness).state is GoalState.OFFERED
    assert ready(harness.record).status.labels == ("red", "left")
    harness.applied("label", labels=None)
    assert harness.status.labels == ()


def test_a_run_starts_at_its_time() -> None:
    harness = ready()
    at = harness.now + 2.03
    request = harness.request("run", pattern="forward", at={"tb3-01": at}, goal=goal())
    assert harness.send(request) is None
    harness.advance(2.0)
    assert harness.status.state is State.IDLE
    assert harness.twist.is_zero
    harness.advance(0.05)
    assert harness.reply_to(request).code is Code.APPLIED
    assert harness.status.since == pytest.approx(harness.now - at, abs=1e-6)
    assert told(harness).own.age == pytest.approx(2.05, abs=1e-6)  # type: ignore[union-attr]


@pytest.mark.parametrize("verb", ["run", "goal"])
def test_the_age_of_a_goal_counts_the_time_of_its_request(verb: str) -> None:
    harness = ready()
    content = {"pattern": "forward"} if verb == "run" else {}
    assert harness.applied(verb, goal=goal(), age=3.5, **content)
    assert told(harness).own.age == pytest.approx(3.5, abs=0.2)  # type: ignore[union-attr]


def test_a_stop_before_the_time_of_a_run_refuses_it() -> None:
    harness = ready()
    request = harness.request("run", pattern="forward", at={"tb3-01": harness.now + 2.0})
    harness.send(request)
    harness.advance(1.0)
    harness.applied("stop")
    harness.advance(2.0)
    assert harness.reply_to(request).refusal is Refusal.OVERTAKEN
    assert harness.status.state is State.STOPPED


def test_a_peer_that_tells_late_of_a_stop_does_not_refuse_the_run_that_followed_it() -> None:
    """One clock issued the stop and 0.1 s later the run; the peer's message took 0.3 s."""
    harness = ready()
    issued = harness.now
    harness.send(StopRequest(id="s1", operator="anna", clock="desk", issued=100.0))
    assert harness.robot.goal is not None
    of_stop = harness.robot.goal.goal
    assert of_stop.pattern is None
    harness.advance(0.4)
    harness.find(of_stop, harness.now - issued - 0.3)
    age = harness.now - issued - 0.1
    harness.applied("run", pattern="forward", clock="desk", issued=100.1, age=age)


def test_a_stop_that_only_peers_tell_refuses_an_earlier_run() -> None:
    """The control: the robot has not carried out that stop, or holds another goal of its id."""
    harness = ready()
    harness.send(StopRequest(id="s1", operator="anna", clock="desk", issued=100.0))
    assert harness.robot.goal is not None
    of_stop = harness.robot.goal.goal
    harness.advance(0.4)
    for later in (goal(7, pattern=None), replace(of_stop, generation=8)):
        harness.find(later, 0.1)
        run_before = harness.refused("run", pattern="forward", clock="desk", issued=100.1, age=0.3)
        assert run_before.refusal is Refusal.OVERTAKEN


@pytest.mark.parametrize("peers", [1, 2])
def test_a_relay_that_makes_a_stop_older_does_not_hide_it(peers: int) -> None:
    """The stop is 0.3 s old, but its relay states 60 s: a run of 0.8 s ago was issued before it."""
    harness = ready()
    forged = StopRequest(id="s1", operator="anna", clock="desk", issued=100.0, age=60.0)
    harness.send(forged)
    assert harness.robot.goal is not None
    of_stop = harness.robot.goal.goal
    harness.advance(0.3)
    for _ in range(peers):
        harness.find(of_stop, 0.3)
    run_before = harness.refused("run", pattern="forward", clock="lap", issued=7.0, age=0.8)
    assert run_before.refusal is Refusal.OVERTAKEN


def test_a_run_that_comes_too_late_or_too_early_is_refused() -> None:
    harness = ready()
    late = harness.refused("run", pattern="forward", at={"tb3-01": harness.now - 0.6})
    assert late.refusal is Refusal.TOO_LATE
    early = harness.refused("run", pattern="forward", at={"tb3-01": harness.now + 61.0})
    assert early.refusal is Refusal.INVALID_REQUEST
    harness.applied("run", pattern="forward", at={"tb3-01": harness.now - 0.4})


def test_a_pattern_that_loads_until_after_its_time_does_not_start() -> None:
    harness = ready()
    harness.is_hung = True
    request = harness.request("run", pattern="forward", at={"tb3-01": harness.now + 0.1})
    harness.send(request)
    harness.advance(0.8)
    harness.is_hung = False
    load = harness.sent[-1]
    harness.host_answers(load)
    assert harness.reply_to(request).refusal is Refusal.TOO_LATE
    harness.advance(0.5)
    assert harness.twist.is_zero


def test_a_goal_that_peers_run_and_this_robot_cannot_load_is_the_reason() -> None:
    harness = ready()
    wanted = goal(8, pattern="unheard_of")
    harness.is_hung = True
    request = harness.request("run", pattern="unheard_of", goal=wanted)
    harness.send(request)
    harness.find(wanted)
    assert told(harness).state is GoalState.LOADING
    harness.is_hung = False
    harness.host_answers(harness.sent[-1])
    assert harness.reply_to(request).refusal is Refusal.UNKNOWN_PATTERN
    assert told(harness).state is GoalState.ENDED
    assert "unheard_of" in told(harness).reason


def push(harness: RobotHarness, name: str = "pushed") -> None:
    """A pattern is pushed to the robot, and passes its trial."""
    harness.install(name, PATTERNS["forward"])
    harness.applied("reload", pattern=name, keeps_running=True)
    harness.advance(0.5)


def lacking(**fields: Any) -> RobotHarness:
    """A robot that could not join a goal since it had no such pattern."""
    harness = ready()
    harness.find(goal(**{**JOINED, "pattern": "pushed", **fields}))
    harness.advance(0.5)
    assert told(harness).state is GoalState.ENDED
    return harness


def test_a_robot_that_stalled_while_it_started_joins() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.advance(1.5, ticks=False)
    harness.advance(0.5)
    harness.find(goal(**JOINED), 1.0)
    harness.advance(1.0)
    assert harness.status.state is State.RUNNING


def test_a_robot_that_lacked_the_pattern_joins_when_it_comes() -> None:
    harness = lacking()
    push(harness)
    assert harness.status.state is State.RUNNING
    assert told(harness).state is GoalState.RUNNING


def test_a_pattern_that_comes_later_than_the_goal_is_valid_starts_nothing() -> None:
    harness = lacking(valid=5.0)
    harness.advance(5.0)
    push(harness)
    assert harness.status.state is State.IDLE
    assert told(harness).state is GoalState.OFFERED


@pytest.mark.parametrize("verb", ["stop", "estop", "label", "run", "goal"])
def test_a_pattern_that_comes_after_another_event_starts_nothing(verb: str) -> None:
    harness = lacking()
    args: dict[str, dict[str, Any]] = {
        "label": {"labels": ("red",)},
        "run": {"pattern": "absent"},
        "goal": {"goal": goal(2, pattern=None)},
    }
    harness.ask(verb, **args.get(verb, {}))
    harness.ask("reset", ids=tuple(harness.robot.latches))
    push(harness)
    assert harness.status.state is not State.RUNNING
    assert harness.twist.is_zero


def test_a_reload_by_an_operator_joins_no_goal() -> None:
    harness = lacking()
    harness.install("pushed", PATTERNS["forward"])
    harness.applied("reload", pattern="pushed")
    harness.advance(0.5)
    assert standing_state(harness)[0] is State.IDLE


def test_a_goal_that_lacked_its_pattern_is_joined_only_once_more() -> None:
    harness = lacking()
    push(harness, "other")
    assert told(harness).state is GoalState.ENDED
    push(harness)
    assert told(harness).state is GoalState.RUNNING
    harness.applied("stop")
    push(harness)
    assert standing_state(harness) == (State.STOPPED, Reason.OPERATOR)


def test_after_a_stop_no_robot_joins_a_goal_that_no_standing_goal_can_follow() -> None:
    stopped, late = ready(), ready()
    last = goal(MAX_UNSIGNED + 1, **JOINED)
    assert run(stopped, last).code is Code.APPLIED
    stopped.advance(1.0)
    stopped.send(StopRequest(id="s1", operator="anna", targets=None))
    held = stopped.robot.goal
    assert held is not None
    assert held.goal == last
    stopped.find(last, age=1.0)  # of a robot that did not hear the stop
    assert held.issued is None
    assert told(stopped).held.age is None  # type: ignore[union-attr]
    late.find(last, age=held.age(late.now))
    late.advance(2.0)
    assert late.status.state is State.IDLE


def test_goals_of_a_revoked_operator_are_forgotten() -> None:
    harness = ready()
    own, last = goal(3), goal(2**32 - 1, "eve", targets=("r9",))
    assert run(harness, own).code is Code.APPLIED
    harness.find(last)
    assert told(harness).held.goal == last  # type: ignore[union-attr]
    harness.step(ForgetInput((digest_of(last).hex(),)))
    assert told(harness).held.goal == own  # type: ignore[union-attr]
    assert told(harness).state is GoalState.RUNNING
    harness.step(ForgetInput((digest_of(own).hex(),)))
    assert harness.status.goal is None
    assert run(harness, goal(1)).code is Code.APPLIED


def test_the_same_goal_with_another_signature_starts_nothing_after_a_stop_and_a_reset() -> None:
    harness = ready()
    wanted = goal(7, signature=bytes(64), **JOINED)
    run(harness, wanted)
    harness.advance(1.0)
    assert told(harness).state is GoalState.RUNNING
    harness.applied("estop")
    harness.advance(1.0)
    harness.applied("reset", ids=tuple(harness.status.latches))
    for byte in (b"\x00", b"\x01", b"\xff"):  # lesser, or greater, than the one before
        harness.find(goal(7, signature=byte * 64, **JOINED), age=1.0)
        harness.advance(2.0)
        assert harness.status.state is State.IDLE
    assert told(harness).held.goal.signature == bytes(64)  # type: ignore[union-attr]
