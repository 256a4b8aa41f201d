"""Requests that read well and must not be done: refused or counted, and the robot drives on."""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import msgpack
import pytest
import zenoh
from msgspec import to_builtins
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder, encode
from swarmd.core.keys import CONTROL, build
from swarmd.core.messages import Code, Latch, Reply, State, Status
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import Request, RunRequest
from swarmd.link.carriers.session import MAX_WIRE
from swarmd.link.datagram import Latches, Stop
from swarmd.robot.latches import MAX_HELD
from tests.support.processes import CAP, wait_until

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


@dataclass(slots=True)
class Case:
    """A request on the key of a verb, and the expected refusal; `drops`: whether it is counted."""

    verb: str
    answer: Refusal | None
    fields: Mapping[str, Any] = field(default_factory=dict)
    quotes: bool = True
    drops: bool = False


VALID: Mapping[str, Mapping[str, Any]] = {
    "run": {"pattern": "drive"},
    "param": {"params": {"speed": 0.3}},
    "reload": {"pattern": "drive"},
    "forget": {"name": "r9"},
}


def malformed(verb: str, /, **fields: Any) -> Case:
    return Case(verb, Refusal.INVALID_REQUEST, fields, drops=True)


CASES = (
    malformed("run", verb="stop"),
    malformed("run", verb="fly"),
    malformed("run", operator=""),
    malformed("run", pattern=5),
    malformed("run", pattern=None),
    malformed("run", params=["a"]),
    malformed("run", params={"speed": math.nan}),
    *(malformed("run", seconds=value) for value in (0, -1.5, math.inf, True, "x")),
    malformed("param", params={}),
    malformed("param", params="speed"),
    malformed("reset", ids="all"),
    malformed("reload", pattern=5),
    malformed("reload", is_rerun="yes"),
    malformed("run", id="x" * 64),
    # Not even the refusal can be addressed.
    *(
        Case(verb, None, {"targets": None}, drops=True)
        for verb in ("run", "reset", "reload", "param", "forget")
    ),
    Case("run", None, {"targets": {"r" * 64: None}}, drops=True),
    # For other robots.
    *(
        Case(verb, None, {"targets": {"r9": None}})
        for verb in ("run", "reset", "reload", "param", "forget")
    ),
    *(
        Case(verb, Refusal.STALE_EPOCH, quotes=False)
        for verb in ("run", "reset", "reload", "param")
    ),
    Case("run", Refusal.STALE_EPOCH, {"targets": {"r1": None}}),
    Case("run", Refusal.INVALID_CONDITION, {"until": ["someday"]}),
    Case("forget", Refusal.MEMBER_ALIVE, {"name": "r2"}),
)


def ask(swarm: Swarm, *requests: Request) -> list[Reply]:
    """The replies to requests that are all sent at once."""
    return ask_raw(swarm, *((one.verb, encode(one)) for one in requests))


def ask_raw(swarm: Swarm, *payloads: tuple[str, bytes]) -> list[Reply]:
    """The replies to payloads on the keys of these verbs, all sent at once."""
    replies: list[Reply] = []
    decode, done = Decoder(Reply), threading.Semaphore(0)

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            replies.append(decode(reply.ok.payload.to_bytes()))

    if not swarm.viewer.sessions("r1"):
        swarm.status("r1")
    (session,) = swarm.viewer.sessions("r1")
    for name, payload in payloads:
        session.get(
            build(swarm.name, "r1", CONTROL, name, "eve"),
            zenoh.handlers.Callback(on_reply, done.release),
            payload=payload,
            timeout=CAP,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
    assert all(done.acquire(timeout=CAP) for _ in payloads)
    return replies


def drops(status: Status) -> int:
    """Of what the network says; a loaded machine also leaves out what a newer sample overtook."""
    counts = status.health.dropped
    return sum(count for kind, count in counts.items() if not kind.startswith("driver/"))


def test_wrong_and_oversized_requests_are_refused_and_the_robot_drives_on(swarm: Swarm) -> None:
    body = swarm.body("r1")
    swarm.start("r1", body)
    swarm.start("r2")
    old = swarm.status("r1").epoch
    swarm.run_drive("r1")
    moving = body.wait_stepped()
    before = swarm.status("r1")

    for number, case in enumerate(CASES):
        request = {
            "verb": case.verb,
            "id": f"case{number}",
            "operator": "eve@x",
            "targets": {"r1": to_builtins(before.epoch if case.quotes else old)},
            **VALID.get(case.verb, {}),
            **case.fields,
        }
        replies = ask_raw(swarm, (case.verb, b"\x01" + msgpack.packb(request)))
        expected = [] if case.answer is None else [(Code.REFUSED, case.answer)]
        assert [(reply.code, reply.refusal) for reply in replies] == expected, (case, replies)
    counted = drops(swarm.status("r1")) - drops(before)
    assert counted == sum(case.drops for case in CASES)
    run = build(swarm.name, "r1", CONTROL, "run", "eve")
    for size in (MAX_WIRE - 1000, MAX_WIRE, 8 * MAX_WIRE):
        swarm.viewer.put(run, bytes(size))
    assert swarm.ctl("members").code == 0
    after = swarm.status("r1")
    assert (after.state, after.epoch, after.generation) == (
        State.RUNNING,
        before.epoch,
        before.generation,
    )
    body.wait_moving(boottime())
    assert body.ran_since(moving)


def test_a_replayed_run_is_carried_out_once(swarm: Swarm) -> None:
    swarm.start("r1")
    seen = swarm.status("r1").epoch
    request = RunRequest(id="run1", operator="eve@x", targets={"r1": seen}, pattern="drive")
    replies = ask(swarm, *[request] * 100)
    assert {reply.code for reply in replies} == {Code.APPLIED}  # the one reply, again and again
    assert len({reply.epoch for reply in replies}) == 1
    ran = swarm.status("r1")
    assert (ran.generation, ran.epoch.revision) == (1, seen.revision + 1)
    later = ask(swarm, *[replace(request, id="run2")] * 100)
    assert {reply.code for reply in later} == {Code.REFUSED}
    assert swarm.status("r1").epoch == ran.epoch


def test_a_flood_of_estops_is_bounded_and_can_be_reset(swarm: Swarm) -> None:
    body = swarm.body("r1")
    daemon = swarm.start("r1", body)
    swarm.start("r2")
    swarm.run_drive("r1")
    body.wait_moving()
    began = time.monotonic()
    number = itertools.count()

    def is_full() -> bool:
        for _ in range(MAX_HELD):
            swarm.viewer.send(Stop(id=f"e{next(number)}", verb="estop", operator="eve@x"))
        return len(swarm.status("r1").latches) > MAX_HELD

    wait_until(is_full, "r1 holds all that it may")
    print(f"{next(number)} estops after {time.monotonic() - began:.2f} s")
    stopped = boottime()
    held = swarm.status("r1").latches
    assert len(held) == MAX_HELD + 1  # and one for all the others
    swarm.await_state("r2", State.ESTOPPED)
    assert not body.moved_since(stopped)

    daemon.kill()
    swarm.start("r1", body)
    assert swarm.status("r1").latches.keys() == held.keys()
    wait_until(lambda: swarm.ctl("reset", "--all", "--yes").code == 0, "both are reset")
    assert {swarm.status(robot).state for robot in ("r1", "r2")} == {State.IDLE}
    assert not body.moved_since(stopped)


def test_only_swarm_wide_latches_of_others_are_taken_over(swarm: Swarm) -> None:
    """A named latch of a peer holds only that peer; a beacon of r1's own id is no peer."""
    swarm.start("r1")
    instance = b"ghost!"
    single = {"e1": Latch(issuer="eve@x", scope="robots")}
    for robot in ("ghost", "r1"):
        swarm.viewer.send(Latches(robot=robot, instance=instance, digest=b"x", held=single))
    everyone = {"e2": Latch(issuer="eve@x", scope="swarm")}
    assert swarm.status("r1").state is State.IDLE
    swarm.viewer.send(Latches(robot="ghost", instance=instance, digest=b"y", held=everyone))
    assert swarm.await_state("r1", State.ESTOPPED).latches.keys() == {"e2"}
