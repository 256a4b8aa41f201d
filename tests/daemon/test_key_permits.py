"""Each door by which a request reaches a robot, and what others tell of a name with a permit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.codec import encode
from swarmd.core.events import GoalInput, LatchesInput
from swarmd.core.goal import Goal
from swarmd.core.incident import Incident, IncidentKind, mark_part
from swarmd.core.messages import Code, Epoch, Latch, Reply
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import AuditEntry, Request, ResetRequest, RunRequest, StopRequest
from swarmd.daemon import incidents
from swarmd.daemon.audit import Audit
from swarmd.daemon.driver_commands import permission_fault
from swarmd.daemon.goal_service import GoalService
from swarmd.daemon.key_permits import KeyPermits
from swarmd.daemon.requests import RequestServer
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.datagram import Stop
from swarmd.link.keys.content_signature import Purpose, sign
from swarmd.link.keys.key_permit import PresentRun
from swarmd.link.keys.private_keys import load_private_key
from swarmd.link.keys.roster import KeyPermit
from swarmd.operator.session.session import sign_goal
from tests.daemon.test_requests import RecordingQuery
from tests.link.keyring import Keyring
from tests.support.fake_services import fake_services
from tests.support.keys import SwarmKeys

NOW = 1_800_000_000
EPOCH = Epoch("0123456789ab", 1)
PUPIL = KeyPermit(
    role="pupils",
    key=bytes(64),
    may=("stop r1", "run attraction"),
    robots="r1",
    until=NOW + 60,
)


class Rig:
    """The request server of `robot`, whose roster has the operator `anna` and the name `pupil`."""

    def __init__(self, robot: str = "r1") -> None:
        keyring = Keyring(("r1", "r2"), operators=("anna",), permits={"pupil": PUPIL})
        self.keyring = keyring
        self.permits = KeyPermits(
            robot,
            lambda: keyring.identity(robot),
            lambda: PresentRun("attraction"),
            wall=lambda: NOW,
        )
        self.handed: list[Request] = []
        self.entries: list[AuditEntry] = []
        audit = Audit(lambda line: None, self.entries.append, role_of=self.permits.role_of)
        self.server = RequestServer(
            robot,
            self.handed.append,
            audit,
            fake_services(),
            drops=DropCounter(),
            is_secured=True,
            judge=self.permits.judge,
        )
        self.replies: list[Reply] = []

    def by_zenoh(self, request: Request, asker: str = "pupil") -> RecordingQuery:
        query: Any = RecordingQuery(encode(request), asker)
        self.server.handle(request.verb, query)
        self.replies += query.replies
        made: RecordingQuery = query
        return made

    def by_own_system(self, request: Request) -> None:
        """As a command of ROS, for which `driver_options` name `pupil`."""
        self.server.take(replace(request, operator="pupil"), "ROS service", self.replies.append)


def run(pattern: str = "attraction", operator: str = "pupil", **fields: Any) -> RunRequest:
    targets: dict[str, Epoch | None] = {"r1": EPOCH, "r2": EPOCH}
    return RunRequest(id="run-1", operator=operator, targets=targets, pattern=pattern, **fields)


Door = Callable[[Rig, Request], object]


@pytest.mark.parametrize("door", [Rig.by_zenoh, Rig.by_own_system])
def test_a_run_comes_through_each_door_as_the_permit_permits_it(door: Door) -> None:
    rig = Rig()
    door(rig, run("flocking", operator="anna"))  # the name that a request states is not believed
    assert rig.handed == []
    (reply,) = rig.replies
    assert (reply.code, reply.refusal) == (Code.REFUSED, Refusal.NOT_PERMITTED)
    assert "pupil may not run flocking" in reply.text
    assert "run attraction" in reply.text

    door(rig, replace(run(), id="run-2"))
    (handed,) = rig.handed
    assert isinstance(handed, RunRequest)
    assert handed.seconds == 60.0


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_that_came_as_a_datagram_is_judged_once_more(verb: Any) -> None:
    for robot, wanted in (("r1", 1 if verb == "stop" else 0), ("r2", 0)):
        rig = Rig(robot)
        rig.server.stop(Stop(id="s", verb=verb, operator="pupil"), "10.0.0.5", rig.replies.append)
        assert len(rig.handed) == wanted
        assert len(rig.replies) == 1 - wanted


def test_a_refused_stop_is_audited_and_does_not_end_one_that_waits() -> None:
    rig = Rig("r2")
    stop = Stop(id="s", verb="stop", operator="pupil")
    verdict = rig.permits.judge_stop(stop, None)
    rig.server.deny_stop(stop, "10.0.0.5", verdict.refusal, rig.replies.append)
    assert [(e.operator, e.permit, e.verb) for e in rig.entries] == [("pupil", "pupils", "stop")]
    (reply,) = rig.replies
    assert reply.refusal is Refusal.NOT_PERMITTED

    waiting: list[Reply] = []
    rig.server.stop(replace(stop, operator="anna", id="a"), "10.0.0.6", waiting.append)
    rig.server.deny_stop(replace(stop, id="a"), "10.0.0.5", "no", rig.replies.append)
    assert len(rig.replies) == 1
    rig.server.reply(Reply(id="a", robot="r2", code=Code.APPLIED, text=""))
    assert len(waiting) == 1


def test_a_request_with_the_id_of_one_that_waits_does_not_get_its_reply() -> None:
    rig = Rig()
    of_anna = rig.by_zenoh(run("flocking", operator="anna"), asker="anna")
    of_pupil = rig.by_zenoh(run())
    assert of_pupil.is_dropped
    rig.server.reply(Reply(id="run-1", robot="r1", code=Code.APPLIED, text=""))
    assert [reply.code for reply in of_anna.replies] == [Code.APPLIED]
    assert [entry.operator for entry in rig.entries] == ["anna"]


def spread_by(issuer: str, age: float | None) -> tuple[GoalInput, LatchesInput]:
    """What a stop and an emergency stop of all robots leave on a robot that carried them out."""
    goal = Goal(generation=4, issuer=issuer, id="stop-1")
    latch = Latch(issuer=issuer, scope="swarm", age=age)
    return GoalInput(goal, age, may_join=False), LatchesInput({"estop-1": latch})


@pytest.mark.parametrize(
    ("issuer", "age", "is_taken"),
    [
        ("pupil", 9.0, False),  # issued after the roster without its permit, on a robot without it
        ("pupil by mcp", 9.0, False),
        ("pupil", 11.0, True),  # issued before: a stop is not undone by a roster
        ("pupil", None, True),
        ("anna", 9.0, True),
        ("bob", 9.0, True),
    ],
)
def test_what_spreads_of_a_stop_after_its_permit_does_not_count(
    issuer: str, age: float | None, is_taken: bool
) -> None:
    now = [100.0]
    keyring = Keyring(("r1",), operators=("anna", "bob"), permits={"pupil": PUPIL})
    permits = KeyPermits(
        "r1", lambda: keyring.identity("r1"), lambda: None, wall=lambda: NOW, clock=lambda: now[0]
    )
    keyring.renew(remove=("pupil", "bob"))
    permits.take_roster()
    now[0] += 10.0
    for input in spread_by(issuer, age):
        assert permits.judge_input(input) == (input if is_taken else None)


@pytest.mark.parametrize(
    ("wall", "is_taken"), [(NOW, True), (NOW + 64.0, True), (NOW + 66.0, False), (0.0, True)]
)
def test_what_spreads_of_a_stop_of_an_expired_permit_does_not_count(
    wall: float, is_taken: bool
) -> None:
    """The stop is 5 s old, and the permit lasts until NOW + 60."""
    keyring = Keyring(("r1",), permits={"pupil": PUPIL})
    permits = KeyPermits("r1", lambda: keyring.identity("r1"), lambda: None, wall=lambda: wall)
    for input in spread_by("pupil", 5.0):
        assert permits.judge_input(input) == (input if is_taken else None)


def test_the_latches_of_others_count_beside_one_that_does_not() -> None:
    keyring = Keyring(("r1",), operators=("anna",), permits={"pupil": PUPIL})
    permits = KeyPermits(
        "r1", lambda: keyring.identity("r1"), lambda: None, wall=lambda: NOW + 99.0
    )
    of_pupil = Latch(issuer="pupil", scope="swarm", age=1.0)
    of_anna = Latch(issuer="anna", scope="swarm", age=1.0)
    judged = permits.judge_input(LatchesInput({"a": of_pupil, "b": of_anna}))
    assert judged == LatchesInput({"b": of_anna})


def test_a_name_that_was_promoted_is_judged_no_more() -> None:
    rig = Rig()
    rig.keyring.roster = replace(
        rig.keyring.roster, permits={}, operators={"anna": bytes(64), "pupil": bytes(64)}
    )
    rig.permits.take_roster()
    rig.by_zenoh(run("flocking"))
    assert len(rig.handed) == 1


@pytest.mark.parametrize("door", [Rig.by_zenoh, Rig.by_own_system])
def test_a_revoked_permit_is_no_key_without_bounds(door: Door) -> None:
    """The links of the roster before stay open for a moment, in which answers are sent."""
    rig = Rig()
    rig.keyring.renew(remove=("pupil",))
    rig.permits.take_roster()
    asked = (
        run(),
        replace(run("flocking"), id="run-2"),
        StopRequest(id="s", operator="pupil"),
        ResetRequest(id="r", operator="pupil", targets={"r1": EPOCH}),
    )
    for request in asked:
        rig.replies.clear()
        door(rig, request)
        assert rig.handed == []
        (reply,) = rig.replies
        assert (reply.code, reply.refusal) == (Code.REFUSED, Refusal.NOT_PERMITTED)
        assert "pupil has no permit any more" in reply.text


def test_the_names_of_operators_and_of_relays_are_not_judged() -> None:
    rig = Rig()
    for operator in ("anna", "someone"):
        request = StopRequest(id=operator, operator=operator)
        assert rig.permits.judge(request) is request
    assert rig.permits.role_of("anna") == ""
    assert rig.permits.role_of("pupil by mcp") == "pupils"


def test_a_command_of_the_own_system_may_name_a_key_with_a_permit() -> None:
    keyring = Keyring(("r1",), operators=("anna",), viewers=("v",), permits={"pupil": PUPIL})
    identity = keyring.identity("r1")
    faults = {name: permission_fault(name, identity) for name in ("anna", "pupil", "v", "x", "r1")}
    assert {name for name, fault in faults.items() if not fault} == {"anna", "pupil"}


def test_what_a_permit_signs_is_no_goal_and_no_mark(tmp_path: Path) -> None:
    """A peer may hand on a goal or incident that the key of a permit has signed."""
    forever = replace(PUPIL, may=("stop", "run", "param"), until=2**33)
    keys = SwarmKeys(tmp_path, "lab", ["r1"], operators=["anna"], permits={"pupil": forever})
    goals = GoalService(tmp_path / "state", lambda: keys["r1"], lambda text: None)
    for issuer, is_valid in (("anna", True), ("pupil", False)):
        goal = Goal(generation=3, issuer=issuer, id="g", pattern="attraction")
        assert goals.check(sign_goal(goal, keys[issuer]), boottime()) is is_valid

        text = f"{issuer}: help"
        part = mark_part("0123456789ab", issuer, text, 0.0)
        signature = sign(load_private_key(keys[issuer].key), Purpose.MARK, part)
        mark = Incident(
            id="0123456789ab",
            robot="r1",
            kind=IncidentKind.MARK,
            text=text,
            by="r1",
            operator=issuer,
            marked=0.0,
            signature=signature,
        )
        assert incidents._marked_by(mark, keys["r1"]) == (issuer if is_valid else "")
