"""Commands of the robot's own system, such as ROS: their operator, their age, and their audit."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.clock import TICK
from swarmd.core.events import DriverInput
from swarmd.core.messages import Code, Reply, State
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import AuditEntry, Request, StopRequest
from swarmd.daemon.audit import Audit
from swarmd.daemon.driver_commands import MAX_COMMAND_AGE, DriverCommands
from swarmd.daemon.requests import RequestServer
from swarmd.driver_api.command_source import DeclaredRun, DriverCommand
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.keys.roster import Role
from tests.support.fake_services import fake_services
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import idle

FORWARD = DeclaredRun("forward", {}, None, ())
SOURCE = "ROS service /r/swarmd/run/go"


class Rig:
    """The commands of a driver to a robot in simulated time."""

    def __init__(self, harness: RobotHarness, roles: dict[str, Role] | None = None) -> None:
        self.harness = harness
        self.requests: list[Request] = []
        self.entries: list[AuditEntry] = []
        self.lines: list[str] = []
        audit = Audit(self.lines.append, self.entries.append)
        self._server = RequestServer(
            harness.robot.id, self._on_request, audit, fake_services(), drops=DropCounter()
        )
        roster = SimpleNamespace(generation=3, role_of=(roles or {}).get)
        identity: Any = None if roles is None else SimpleNamespace(roster=roster)
        self.commands = DriverCommands(
            harness.robot, self._server, lambda: identity, clock=lambda: harness.now
        )

    def _on_request(self, request: Request) -> None:
        self.requests.append(request)
        reply = self.harness.send(request)
        assert reply is not None
        self._server.reply(reply)

    def replies(self, verb: Any, **fields: Any) -> list[Reply]:
        """The replies to a command so far."""
        replies: list[Reply] = []
        run = FORWARD if verb == "run" else None
        given: dict[str, Any] = {"operator": "ros", "source": SOURCE, "age": 0.1, "run": run}
        self.commands.take(DriverCommand(verb=verb, **{**given, **fields}), replies.append)
        return replies

    def reply(self, verb: Any, **fields: Any) -> Reply:
        (reply,) = self.replies(verb, **fields)
        return reply

    def advance(self, seconds: float) -> None:
        """Let time pass; as in a daemon, the epoch is noted at each tick."""
        for _ in range(round(seconds / TICK)):
            self.harness.advance(TICK)
            self.commands.note_epoch(self.harness.now)


def test_a_run_is_that_of_an_operator_for_this_robot() -> None:
    rig = Rig(idle())
    rig.advance(5.0)
    assert rig.reply("run").code is Code.APPLIED
    assert rig.harness.status.state is State.RUNNING
    (entry,) = rig.entries
    assert (entry.operator, entry.source, entry.verb) == ("ros", SOURCE, "run")
    assert (entry.what, entry.result, entry.targets) == ("run forward to 1 robot", "applied", 1)


def test_the_answer_to_a_run_says_that_the_base_is_lost() -> None:
    rig = Rig(idle())
    rig.advance(5.0)
    rig.harness.step(DriverInput(False, "no scan and no odometry"))
    reply = rig.reply("run")
    assert (reply.code, reply.text) == (
        Code.APPLIED,
        "runs forward; held: driver_lost: no scan and no odometry",
    )
    rig.harness.step(DriverInput(True, "there"))
    rig.advance(3.0)
    assert rig.reply("run").text == "runs forward"


@pytest.mark.parametrize("verb", ["run", "reset"])
@pytest.mark.parametrize("age", [None, MAX_COMMAND_AGE + 0.1], ids=["an unknown age", "too old"])
def test_no_command_without_a_short_age_starts_motion(verb: str, age: float | None) -> None:
    rig = Rig(idle())
    rig.advance(5.0)
    reply = rig.reply(verb, age=age, doubt="frozen")
    assert (reply.code, reply.refusal) == (Code.REFUSED, Refusal.TOO_LATE)
    assert not rig.requests
    assert rig.entries[-1].result == "refused (too_late)"


@pytest.mark.parametrize("age", [None, 0.0, 1e6])
@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_counts_at_any_age(verb: str, age: float | None) -> None:
    rig = Rig(idle())
    rig.advance(5.0)
    rig.reply("run")
    rig.replies(verb, age=age)
    assert rig.harness.status.state is (State.STOPPED if verb == "stop" else State.ESTOPPED)


def test_the_answer_to_a_stop_begins_with_the_state_that_results() -> None:
    rig = Rig(idle())
    rig.advance(5.0)
    assert rig.reply("stop").text.startswith("stopped: commanded zero")
    assert rig.reply("estop", reason="smoke").text.startswith("estopped: commanded zero")
    assert rig.reply("stop").text.startswith("estopped: ")  # an emergency stop holds
    (latch,) = rig.harness.robot.latches.values()
    assert (latch.issuer, latch.reason) == ("ros", "smoke")


def test_the_answer_to_a_refused_stop_has_the_state_and_the_reason() -> None:
    rig = Rig(idle(), {"ros": Role.OPERATOR})
    refused = rig.reply("stop", operator="ROS")
    assert refused.refusal is Refusal.NOT_PERMITTED
    assert refused.text.startswith("idle: not_permitted: ROS is no operator of roster 3")


def test_a_stop_ends_a_run_that_was_issued_before_it_and_no_later_one() -> None:
    rig = Rig(idle())
    rig.advance(5.0)
    rig.replies("stop", age=None)
    assert rig.reply("run", age=0.5).refusal is Refusal.STALE_EPOCH
    rig.advance(0.6)
    assert rig.reply("run", age=0.5).code is Code.APPLIED


def test_a_run_that_was_issued_before_a_change_is_refused() -> None:
    """The run waited 1 s: the robot then had the epoch before the operator's stop."""
    rig = Rig(idle())
    rig.advance(5.0)
    rig.reply("run")
    rig.advance(2.0)
    rig.harness.ask("stop")
    rig.advance(0.5)
    late = rig.reply("run", age=1.0)
    assert late.refusal is Refusal.STALE_EPOCH
    assert rig.harness.status.state is State.STOPPED
    rig.advance(0.6)
    assert rig.reply("run", age=1.0).code is Code.APPLIED


def test_a_stop_ends_a_run_that_was_called_before_it() -> None:
    """docs/evidence/motion.md: a run by a ROS service counts from the age that is known of it."""
    rig = Rig(idle())
    rig.advance(5.0)
    assert rig.reply("run", age=2.0).code is Code.APPLIED
    rig.advance(0.1)
    earlier = StopRequest(id="s1", operator="bob", age=2.5)
    assert rig.harness.answer(earlier).refusal is Refusal.OVERTAKEN
    assert rig.harness.answer(StopRequest(id="s2", operator="bob", age=1.5)).code is Code.APPLIED
    assert rig.harness.status.state is State.STOPPED


def test_a_change_since_the_last_tick_counts_too() -> None:
    rig = Rig(idle())
    rig.advance(5.0)
    rig.reply("run")
    rig.advance(2.0)
    rig.harness.ask("stop")
    assert rig.reply("run", age=0.05).refusal is Refusal.STALE_EPOCH


def test_a_reset_leaves_the_emergency_stops_of_others() -> None:
    rig = Rig(idle())
    rig.advance(5.0)
    rig.replies("estop")
    (own,) = rig.harness.robot.latches.values()
    assert (own.issuer, own.scope) == ("ros", "robots")
    rig.advance(2.0)
    assert rig.reply("reset").code is Code.APPLIED
    rig.harness.ask("estop", scope="swarm")
    rig.replies("estop")
    rig.advance(2.0)
    refused = rig.reply("reset")
    assert refused.refusal is Refusal.ESTOPPED
    assert [latch.issuer for latch in rig.harness.robot.latches.values()] != ["ros"]
    assert len(rig.harness.robot.latches) == 1
    rig.advance(2.0)
    assert rig.reply("run").refusal is Refusal.ESTOPPED
    assert rig.reply("reset", resets_others=True).code is Code.APPLIED
    assert rig.harness.status.state is State.IDLE


@pytest.mark.parametrize("verb", ["run", "estop"])
@pytest.mark.parametrize(
    "roles", [{"ros": Role.VIEWER}, {"ros": Role.ROBOT}, {"anna": Role.OPERATOR}]
)
def test_only_an_operator_commands(verb: str, roles: dict[str, Role]) -> None:
    rig = Rig(idle(), roles)
    reply = rig.reply(verb)
    assert (reply.code, reply.refusal) == (Code.REFUSED, Refusal.NOT_PERMITTED)
    assert "ros" in reply.text
    assert not rig.requests
    assert rig.entries[-1].result == "refused (not_permitted)"
    assert rig.harness.status.state is State.IDLE


def test_an_operator_of_the_roster_commands() -> None:
    rig = Rig(idle(), {"ros": Role.OPERATOR})
    rig.advance(5.0)
    assert rig.reply("run").code is Code.APPLIED


async def test_a_stop_is_answered_once_the_base_rests() -> None:
    rig = Rig(idle())
    rig.advance(5.0)
    rig.reply("run")
    rig.advance(2.0)
    replies = rig.replies("stop")
    assert not replies  # the odometry does not show the base at rest yet
    assert rig.harness.status.state is State.STOPPED
    async with asyncio.timeout(30.0):
        while not replies:
            rig.advance(0.1)
            await asyncio.sleep(0.01)
    (reply,) = replies
    assert (reply.code, reply.is_moving) == (Code.APPLIED, False)
    assert len(rig.requests) > 2
    assert [entry.verb for entry in rig.entries] == ["run", "stop"]  # the copies are one request


async def test_the_copies_of_an_emergency_stop_do_not_undo_a_reset() -> None:
    rig = Rig(idle())
    rig.advance(5.0)
    rig.reply("run")
    rig.advance(2.0)
    replies = rig.replies("estop")
    assert not replies  # the base still moves
    rig.harness.ask("reset", ids=tuple(rig.harness.robot.latches))
    async with asyncio.timeout(30.0):
        while not replies:
            rig.advance(0.1)
            await asyncio.sleep(0.01)
    assert replies[0].refusal is Refusal.OVERTAKEN
    assert rig.harness.status.state is State.IDLE
