"""Requests that read well and must not be done: refused or counted, and the robot drives on."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest
import zenoh
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder, encode
from swarmd.core.keys import build
from swarmd.core.messages import Code, Latch, Reply, Request, State, Status
from swarmd.network.session import MAX_WIRE
from swarmd.robot.latches import HELD
from tests.support.processes import CAP, wait_until

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

COUNTED = "counted"
SILENT = "silent"  # the request is for others
ESTOPS = 300


@dataclass(slots=True)
class Case:
    """A request on the key of a verb; `answer` is a part of the refusal, or one of the above."""

    verb: str
    answer: str
    args: Mapping[str, Any] = field(default_factory=dict)
    quotes: bool = True
    changes: Mapping[str, Any] = field(default_factory=dict)


CHANGED = "robot changed since you looked, by anna@"
CASES = (
    Case("run", COUNTED, changes={"verb": "stop"}),
    Case("stop", COUNTED, changes={"verb": "estop"}),
    Case("run", COUNTED, changes={"verb": "fly"}),
    *(
        Case(verb, COUNTED, changes={"targets": None})
        for verb in ("run", "reset", "reload", "param", "forget")
    ),
    Case("run", COUNTED, changes={"operator": ""}),
    Case("run", COUNTED, changes={"id": "x" * 64}),
    Case("run", COUNTED, args={"pattern": "drive", "params": {"speed": float("nan")}}),
    Case("run", COUNTED, args={"pattern": "drive", "seconds": float("inf")}),
    Case("run", COUNTED, changes={"targets": {"r" * 64: None}}),
    Case("stop", SILENT, changes={"targets": {"r" * 64: None}}),
    *(
        Case(verb, SILENT, changes={"targets": {"r9": None}})
        for verb in ("run", "stop", "estop", "reset", "reload", "param", "forget")
    ),
    *(Case(verb, CHANGED, quotes=False) for verb in ("run", "reset", "reload")),
    Case("param", CHANGED, args={"set": {"speed": 0.3}}, quotes=False),
    Case("run", CHANGED, changes={"targets": {"r1": None}}),
    Case("run", "run wants a pattern by name", args={"pattern": 5}),
    Case("run", "run wants a pattern by name", args={"params": {}}),
    Case("run", "run wants a pattern by name", args={"pattern": "drive", "params": ["a"]}),
    Case("run", "seconds is 0", args={"pattern": "drive", "seconds": 0}),
    Case("run", "seconds is -1.5", args={"pattern": "drive", "seconds": -1.5}),
    Case("run", "seconds is True", args={"pattern": "drive", "seconds": True}),
    Case("run", "seconds is 'x'", args={"pattern": "drive", "seconds": "x"}),
    Case("param", "param set wants values by name", args={"set": {}}),
    Case("param", "param set wants values by name", args={"set": "speed"}),
    Case("reset", "reset wants a list of ids", args={"ids": "all"}),
    Case("reload", "reload wants a pattern by name", args={"pattern": 5}),
    Case("reload", "reload wants a pattern by name", args={"pattern": "drive", "run": "yes"}),
    Case("forget", "r2 is alive", args={"name": "r2"}),
)


def ask(swarm: Swarm, *requests: Request, verb: str = "") -> list[Reply]:
    """What is answered to these, all asked at once, on the key of their verb or the one given."""
    replies: list[Reply] = []
    decode, done = Decoder(Reply), threading.Semaphore(0)

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            replies.append(decode(reply.ok.payload.to_bytes()))

    for request in requests:
        name = verb or request.verb
        swarm.session.get(
            build(swarm.name, "r1", "safety" if name == "estop" else "control", name),
            zenoh.handlers.Callback(on_reply, done.release),
            payload=encode(request),
            timeout=CAP,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
    assert all(done.acquire(timeout=CAP) for _ in requests)
    return replies


def drops(status: Status) -> int:
    """Of what the network says; a loaded machine also leaves out what a newer sample overtook."""
    counts = status.health.dropped
    return sum(count for kind, count in counts.items() if not kind.startswith("driver/"))


def test_wrong_requests_are_refused_or_counted_and_the_robot_drives_on(swarm: Swarm) -> None:
    body = swarm.body("r1")
    swarm.start("r1", body)
    swarm.start("r2")
    old = swarm.status("r1").epoch
    swarm.run_drive("r1")
    moving = body.wait_stepped()
    before = swarm.status("r1")

    for number, case in enumerate(CASES):
        dropped = drops(swarm.status("r1"))
        request = Request(
            id=f"case{number}",
            operator="eve@x",
            verb=case.verb,
            targets={"r1": before.epoch if case.quotes else old},
            args={"pattern": "drive", "params": {}} if not case.args else dict(case.args),
        )
        replies = ask(swarm, replace(request, **case.changes), verb=case.verb)
        counted = drops(swarm.status("r1")) - dropped
        if case.answer in (COUNTED, SILENT):
            assert (replies, counted) == ([], int(case.answer is COUNTED)), case
        else:
            assert [reply.code for reply in replies] == [Code.REFUSED], (case, replies)
            assert case.answer in replies[0].text, (case, replies)
            assert counted == 0, case
    after = swarm.status("r1")
    assert (after.state, after.epoch, after.generation) == (
        State.RUNNING,
        before.epoch,
        before.generation,
    )
    body.wait_moving(boottime())
    assert body.ran_since(moving)


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_is_taken_however_oddly_it_is_put(swarm: Swarm, verb: str) -> None:
    body = swarm.body("r1")
    swarm.start("r1", body)
    swarm.run_drive("r1")
    body.wait_moving()
    odd = Request(id="x" * 200, operator="", verb=verb, args={"reason": float("nan")})
    (reply,) = ask(swarm, odd)
    assert reply.code is Code.APPLIED
    stopped = boottime()
    body.wait_zero(stopped)
    assert not body.moved_since(stopped)


def test_a_run_that_is_replayed_is_carried_out_once(swarm: Swarm) -> None:
    swarm.start("r1")
    seen = swarm.status("r1").epoch
    request = Request(
        id="run1",
        operator="eve@x",
        verb="run",
        targets={"r1": seen},
        args={"pattern": "drive", "params": {}},
    )
    replies = ask(swarm, *[request] * 100)
    assert [reply.code for reply in replies].count(Code.APPLIED) == 1
    assert {reply.code for reply in replies} <= {Code.APPLIED, Code.REFUSED}
    ran = swarm.status("r1")
    assert (ran.generation, ran.epoch.revision) == (1, seen.revision + 1)
    later = ask(swarm, *[replace(request, id="run2")] * 100)
    assert {reply.code for reply in later} == {Code.REFUSED}
    assert swarm.status("r1").epoch == ran.epoch


def test_a_flood_of_estops_is_held_within_bounds_and_can_be_reset(swarm: Swarm) -> None:
    body = swarm.body("r1")
    daemon = swarm.start("r1", body)
    swarm.start("r2")
    swarm.run_drive("r1")
    body.wait_moving()
    estops = [Request(id=f"e{k}", operator="eve@x", verb="estop") for k in range(ESTOPS)]
    began = time.monotonic()
    replies = ask(swarm, *estops)
    print(f"{ESTOPS} stops acked after {time.monotonic() - began:.2f} s")
    assert [reply.code for reply in replies].count(Code.APPLIED) >= HELD
    stopped = boottime()
    held = swarm.status("r1").latches
    assert len(held) == HELD + 1  # and one for all the others
    swarm.await_state("r2", State.ESTOPPED)
    assert not body.moved_since(stopped)

    daemon.kill()
    swarm.start("r1", body)
    assert swarm.status("r1").latches == held
    wait_until(lambda: swarm.ctl("reset", "--all").code == 0, "both are reset")
    assert {swarm.status(robot).state for robot in ("r1", "r2")} == {State.IDLE}
    assert not body.moved_since(stopped)


def test_a_message_too_large_for_any_reader_harms_nobody(swarm: Swarm) -> None:
    body = swarm.body("r1")
    swarm.start("r1", body)
    swarm.run_drive("r1")
    moving = body.wait_stepped()
    before = swarm.status("r1")
    estop = build(swarm.name, "r1", "safety", "estop")
    for size in (MAX_WIRE - 1000, MAX_WIRE, 8 * MAX_WIRE):
        swarm.session.put(estop, bytes(size), congestion_control=zenoh.CongestionControl.BLOCK)
    assert swarm.ctl("members").code == 0
    after = swarm.status("r1")
    assert (after.state, after.epoch) == (State.RUNNING, before.epoch)
    body.wait_moving(boottime())
    assert body.ran_since(moving)
    print(after.health.dropped)


def test_latches_that_are_told_of_others_or_of_single_robots_hold_nobody(swarm: Swarm) -> None:
    """Of a status, only swarm-wide latches are taken over, and only on the speaker's own key."""
    swarm.start("r1")
    spoken = swarm.status("r1")
    single = {"e1": Latch(issuer="eve@x", scope="robots")}
    everyone = {"e2": Latch(issuer="eve@x", scope="swarm")}
    ghost = replace(spoken, robot="ghost", instance="0123456789ab")
    before = drops(spoken)
    for key, status in (
        ("ghost", replace(ghost, latches=single)),
        ("other", replace(ghost, latches=everyone)),
        ("r1", replace(spoken, latches=everyone)),
    ):
        swarm.session.put(build(swarm.name, key, "state", "status"), encode(status))
    wait_until(lambda: drops(swarm.status("r1")) > before + 1, "the liars are counted")
    assert swarm.status("r1").state is State.IDLE
