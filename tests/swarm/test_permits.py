"""Keys with permits against daemons: each door, and an answer that says what the key may."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any, Literal

import pytest

from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import RequestError
from swarmd.core.goal import Goal
from swarmd.core.messages import Code, Reply, State
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import (
    AUDIT,
    AnyRequest,
    AuditQuery,
    AuditReply,
    DriveRequest,
    GoalRequest,
    MarkRequest,
    ParamRequest,
    PushRequest,
    ResetRequest,
    RunRequest,
)
from swarmd.link.keys.roster import KeyPermit
from swarmd.operator.session.operator import Operator
from swarmd.operator.verbs.drive.ask import Hand, take
from tests.support.processes import wait_until
from tests.support.secured_swarm import RUNNING, SecuredSwarm
from tests.support.swarmctl import STALLED

pytestmark = pytest.mark.integration

HOUR = int(time.time()) + 3600


def permit(*may: str, **fields: Any) -> KeyPermit:
    return KeyPermit(role="some", key=bytes(64), may=may, **{"until": HOUR, **fields})


PERMITS = {
    "agent": permit("stop"),
    "driver": permit("stop r1", "drive", robots="r1", speed=0.04),
    "pupil": permit("stop r1", "run drive", "param drive.speed", robots="r1", longest=60.0),
}


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredSwarm]:
    with contextlib.ExitStack() as left:
        folder = tmp_path_factory.mktemp("permits")
        yield SecuredSwarm(folder, left, permits=PERMITS).start()


@pytest.fixture
def calm(swarm: SecuredSwarm) -> SecuredSwarm:
    swarm.calm()
    return swarm


def replies(
    operator: Operator, kind: type[AnyRequest], *names: str, **fields: Any
) -> dict[str, Reply]:
    """The replies of all named robots; asked again while a busy machine refuses or loses some."""
    found: dict[str, Reply] = {}

    def is_answered() -> bool:
        view = operator.members()
        outcome = operator.request(kind, view.epochs(names), **fields)
        found.update(
            (name, reply)
            for name, reply in outcome.replies.items()
            if not STALLED.search(reply.text) and reply.refusal is not Refusal.STALE_EPOCH
        )
        return found.keys() == {*names}

    wait_until(is_answered, f"{names} answer {kind.__name__}")
    return found


def stop_replies(operator: Operator, verb: Literal["stop", "estop"]) -> dict[str, Reply]:
    """The replies of both robots to a stop of all; asked again while one is missing or moves."""
    found: dict[str, Reply] = {}

    def is_answered() -> bool:
        outcome = operator.send_stop(verb)
        found.update(outcome.replies)
        return {*found} >= {*RUNNING} and not outcome.failed

    wait_until(is_answered, f"both robots answer {verb}")
    return found


def is_denied(reply: Reply) -> bool:
    return (reply.code, reply.refusal) == (Code.REFUSED, Refusal.NOT_PERMITTED)


def held_goal(swarm: SecuredSwarm, robot: str) -> str:
    """The digest of the greatest goal that the robot knows; empty without one."""
    goal = swarm.status(robot).goal
    return "" if goal is None or goal.held is None else goal.held.digest


def test_an_agent_that_may_only_stop(calm: SecuredSwarm) -> None:
    with calm.operator("agent") as agent:
        goal = Goal(generation=9, issuer="agent", id="g", pattern="drive")
        stand = Goal(generation=9, issuer="agent", id="g")
        asked: tuple[tuple[type[AnyRequest], dict[str, Any]], ...] = (
            (RunRequest, {"pattern": "drive"}),
            (RunRequest, {"pattern": "drive", "goal": goal}),
            (GoalRequest, {"goal": stand}),
            (ResetRequest, {}),
            (PushRequest, {"content": b"c"}),
            (MarkRequest, {"words": "help", "incident": "0123456789ab"}),
        )
        for kind, fields in asked:
            reply = replies(agent, kind, "r1", **fields)["r1"]
            assert is_denied(reply), (kind, reply)
            assert "may stop" in reply.text
        assert all(map(is_denied, stop_replies(agent, "estop").values()))
        assert calm.status("r1").state is not State.ESTOPPED

        stopped = stop_replies(agent, "stop")
        assert {reply.code for reply in stopped.values()} == {Code.APPLIED}
        for robot in RUNNING:
            status = calm.status(robot)
            assert (status.state, "agent" in status.detail) == (State.STOPPED, True)


def test_a_pupil_runs_and_stops_her_own_robot_alone(calm: SecuredSwarm) -> None:
    before = [held_goal(calm, robot) for robot in RUNNING]
    with calm.operator("pupil") as pupil:
        answered = replies(pupil, RunRequest, "r1", "r2", pattern="drive", params={"speed": 0.05})
        assert is_denied(answered["r2"])
        assert answered["r1"].code is Code.APPLIED
        assert is_denied(replies(pupil, ParamRequest, "r1", params={"turn": 0.1})["r1"])
        assert is_denied(replies(pupil, RunRequest, "r1", pattern="random_walk")["r1"])
        long = replies(pupil, RunRequest, "r1", pattern="drive", seconds=61.0)["r1"]
        assert is_denied(long)

        # A stop of all: r1 stops, r2 says why it does not, and no goal to stand spreads to r2.
        stopped = stop_replies(pupil, "stop")
        assert stopped["r1"].code is Code.APPLIED
        assert is_denied(stopped["r2"])
        assert "may stop r1" in stopped["r2"].text
        assert calm.status("r1").state is State.STOPPED
        assert [held_goal(calm, robot) for robot in RUNNING] == before


def test_a_permit_to_drive_asks_its_own_robot_for_its_speed_at_most(calm: SecuredSwarm) -> None:
    """By signed commands; a stop ends the hand. These robots have no lidar, so none moves."""
    with calm.operator("driver") as driver, contextlib.ExitStack() as left:
        hands: list[Hand] = []
        asked: list[float] = []

        def is_driven() -> bool:
            """A busy machine may refuse a late request, or lose a hand."""
            if not hands or hands[-1].is_over:
                with contextlib.suppress(RequestError):
                    hands.append(left.enter_context(contextlib.closing(take_r1(driver))))
                return False
            hands[-1].move(0.2, seconds=2.0)
            status = calm.status("r1")
            asked[:] = [status.decision.requested_linear]
            return status.driven_by == "driver" and status.decision.requested_linear > 0.0

        def take_r1(operator: Operator) -> Hand:
            return take(operator, operator.members(), "r1")

        wait_until(is_driven, "a hand moves r1")
        assert asked == [pytest.approx(0.04)]
        denied = replies(driver, DriveRequest, "r2")["r2"]
        assert is_denied(denied)
        stop_replies(driver, "stop")
        wait_until(lambda: hands[-1].is_over, "the hand hears that it is over")
        wait_until(lambda: calm.status("r1").driven_by == "", "r1 is driven by nobody")
        hands[-1].close()
        stands = lambda: calm.status("r1").decision.requested_linear == 0.0  # noqa: E731
        wait_until(stands, "nothing is asked of r1")


def test_the_audit_log_names_the_permit(calm: SecuredSwarm) -> None:
    with calm.operator("agent") as agent:
        replies(agent, RunRequest, "r1", pattern="drive")
    calm.anna.members()
    answer = calm.anna.ask("r1", AUDIT.name, encode(AuditQuery()), timeout=20.0)
    assert answer is not None
    entries = Decoder(AuditReply)(answer).entries
    assert ("agent", "some", "run") in {(e.operator, e.permit, e.verb) for e in entries}
    assert {e.permit for e in entries if e.operator == "anna"} <= {""}
