"""Bad messages on every key that a daemon listens to: all are counted, and disturb no robot."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import random
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, get_args

import pytest
import zenoh
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import Struct, to_builtins

from swarmd.core import messages, verbs
from swarmd.core.clock import boottime
from swarmd.core.codec import MAX_CONTROL, MAX_SENSOR_PAYLOAD, encode
from swarmd.core.errors import CodecError
from swarmd.core.events import NeighborsInput, ReadingsInput
from swarmd.core.goal import Goal
from swarmd.core.keys import CONTROL, SHARED, build
from swarmd.core.messages import Epoch, Presence, State
from swarmd.core.pattern_manifest import Signed
from swarmd.core.values import Neighbor, Odometry, Pose, Twist
from swarmd.core.verbs import VERBS, AnyRequest, FetchQuery, MembersQuery
from swarmd.daemon.daemon import Daemon
from swarmd.driver_api.hw_codec import (
    encode_input,
    encode_odometry,
    encode_scan,
)
from swarmd.link import datagram
from swarmd.link.carriers.bus import Query, ZenohBus
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.datagram import MAX_DATAGRAM, MAX_TRAILER, Beacon, Datagram, pack, tag_of
from swarmd.link.keys.roster import Role
from swarmd.link.keys.roster_change import SharedRoster
from swarmd.link.members.membership import MAX_MEMBERS
from swarmd.link.signature import Signer
from swarmd.link.spread import pull
from swarmd.settings.settings import DaemonSettings, load_daemon_settings
from tests.daemon.test_daemon import RecordingDriver
from tests.support.examples import examples
from tests.support.garbage import KINDS, hostile_message, packed
from tests.support.keys import SwarmKeys
from tests.support.processes import CAP, unique_swarm, wait_until
from tests.support.viewer import Viewer

if TYPE_CHECKING:
    from tests.support.fake_body import Body
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

PER_KIND = 10
PER_KEY = 5
MESH = ("control/", "state/")
WRONG_HW = ("driver/hw/unknown",)


@dataclass(frozen=True, slots=True)
class Target:
    """A key that is listened to, and a message that would be understood there.

    `counters`: what the kinds under which its drops are counted begin with.
    """

    key: str
    valid: bytes
    limit: int
    counters: tuple[str, ...]
    is_query: bool = False


class Vandal:
    """A visitor that sends wrong messages to `r1`."""

    def __init__(self, swarm: Swarm) -> None:
        self._swarm = swarm
        self._rng = random.Random(1)
        self.viewer = Viewer(swarm.settings)
        self.tag = tag_of(swarm.settings.profile, swarm.name)
        self.sent = 0

    def ask(self, key: str, payload: bytes) -> None:
        """Query, without waiting for an answer."""
        block = zenoh.CongestionControl.BLOCK
        for session in self.sessions:
            session.get(key, _ignore, payload=payload, timeout=5.0, congestion_control=block)

    def connect(self) -> None:
        """Dial `r1`, and return when it answers."""
        wait_until(
            lambda: bool(self.viewer.get(build(self._swarm.name, "r1", "state", "status"))),
            "r1 answers",
        )
        self.sessions = self.viewer.look()

    def flood(self, say: Callable[[str, bytes], None], target: Target) -> None:
        """Garbage of every kind on a key."""
        kinds = itertools.chain.from_iterable(itertools.repeat(kind, PER_KIND) for kind in KINDS)
        payloads = (kind(self._rng, target.valid, target.limit) for kind in kinds)
        self.count(say, target.key, payloads, target.counters)

    def count(
        self,
        say: Callable[[str, bytes], None],
        key: str,
        payloads: Iterator[bytes],
        counters: tuple[str, ...],
    ) -> None:
        """Say them, and wait until `r1` has counted as many drops more."""
        before, sent = self.dropped(counters), 0
        for payload in payloads:
            say(key, payload)
            sent += 1
        self.sent += sent
        wait_until(
            lambda: self.dropped(counters) >= before + sent,
            f"{sent} on {key} counted; so far {self.dropped(counters) - before}",
        )

    def dropped(self, counters: tuple[str, ...]) -> int:
        """How many drops `r1` has counted under these kinds."""
        counts = self._swarm.status("r1").health.dropped
        return sum(count for kind, count in counts.items() if kind.startswith(counters))


def _ignore(reply: zenoh.Reply) -> None:
    pass


@pytest.fixture
def vandal(swarm: Swarm) -> Iterator[Vandal]:
    made = Vandal(swarm)
    try:
        yield made
    finally:
        made.viewer.close()


def request(verb: str) -> AnyRequest:
    fields: dict[str, Any] = {
        "run": {"pattern": "drive", "params": {"speed": 0.1}},
        "param": {"params": {"speed": 0.1}},
        "reload": {"pattern": "drive"},
        "forget": {"name": "r9"},
        "record": {"action": "start"},
        "goal": {"goal": Goal(generation=1, issuer="eve", id="f00d", pattern="drive")},
        "label": {"labels": ("red",)},
        "push": {"content": b"pattern"},
        "roster": {"roster": b"roster"},
        "mark": {"words": "a chair fell", "incident": "0123456789ab"},
    }
    request: AnyRequest = VERBS[verb].asked(
        id="f00d",
        operator="eve@x",
        targets={"r1": Epoch(instance="0123456789ab", revision=3)},
        **fields.get(verb, {}),
    )
    return request


def mesh_targets(swarm: str) -> Iterator[Target]:
    """Every key on which a daemon answers."""
    requests = {
        row.name: encode(request(row.name))
        for row in VERBS.values()
        if row.is_request and not row.is_datagram
    }
    for verb, valid in {**requests, "members": encode(MembersQuery(answered=("r1",)))}.items():
        key = build(swarm, "r1", CONTROL, verb, "eve")
        yield Target(key, valid, MAX_CONTROL, (f"control/{verb}",), is_query=True)


def body_targets(body: Body) -> Iterator[Target]:
    """Every sense of the driver's link."""
    for name, valid, limit in (
        ("scan", encode_scan(body.clear(1, 0.0)), MAX_SENSOR_PAYLOAD),
        ("odometry", encode_odometry(Odometry(1.0, Pose(), Twist())), MAX_CONTROL),
        ("neighbors", encode_input(NeighborsInput((Neighbor("r2", 0.0),))), MAX_CONTROL),
        ("readings", encode_input(ReadingsInput({"battery": 0.9})), MAX_CONTROL),
    ):
        yield Target(name, valid, limit, (f"driver/hw/{name}",))


def test_malformed_messages_are_counted_and_disturb_no_robot(swarm: Swarm, vandal: Vandal) -> None:
    body = swarm.body("r1")
    swarm.start("r1", body)
    vandal.connect()
    swarm.start("r2", swarm.resting("r2"))
    swarm.run_drive("r1")
    moving = body.wait_stepped()
    before = swarm.status("r1")

    for target in mesh_targets(swarm.name):
        vandal.flood(vandal.ask, target)
    for target in body_targets(body):
        vandal.flood(body.put, target)
    say_on_wrong_keys(swarm, vandal, body)
    send_wrong_datagrams(vandal)

    after = swarm.status("r1")
    print(f"{vandal.sent} bad messages; {after.health.dropped}")
    print(f"loop p99 {after.health.loop_p99 * 1e3:.1f} ms")
    assert vandal.sent >= 500
    assert (after.state, after.epoch) == (State.RUNNING, before.epoch)
    body.wait_moving(boottime())
    since = [one.twist for one in body.commands if one.at >= moving.at]
    # A flood overtakes scans, and a robot whose scan is too old stands for that time.
    assert set(since) <= {moving.twist, Twist()}, set(since)
    listed = swarm.ctl("members", "-o", "json")
    assert {member["robot"] for member in listed.json["members"]} == {"r1", "r2"}
    assert swarm.ctl("estop").code == 0


def say_on_wrong_keys(swarm: Swarm, vandal: Vandal, body: Body) -> None:
    """Wildcards reach whatever they match."""
    name = swarm.name
    everyone = ("**", "swarm/**", f"swarm/{name}/**", f"swarm/{name}/r1/**", "swarm/*/r1/*/*")
    query = encode(request("param"))
    for key in (*everyone, f"swarm/{name}/r1/control/*/eve", "swarm/*/r1/*/*/*"):
        vandal.count(vandal.ask, key, itertools.repeat(query, PER_KEY), MESH)
    scan = encode_scan(body.clear(1, 0.0))
    for key in (*everyone, "", "hello", "cmd_vel", "scan2"):
        vandal.count(body.put, key, itertools.repeat(scan, PER_KEY), WRONG_HW)


def send_wrong_datagrams(vandal: Vandal) -> None:
    """Heads that are valid with bodies that are not, of every kind, until some are counted."""
    rng = random.Random(2)
    beacon = pack(vandal.tag, ghost_beacon(1))
    valid = beacon[15:]
    before = vandal.dropped(("datagram:malformed",))
    deadline = time.monotonic() + CAP
    while vandal.dropped(("datagram:malformed",)) < before + 50:
        assert time.monotonic() < deadline, "wrong datagrams are not counted"
        for kind, number in itertools.product(KINDS, range(1, 10)):
            content = kind(rng, valid, 1200)[:1300]
            length = len(content).to_bytes(2, "big")
            vandal.viewer.carrier.send(beacon[:4] + bytes([number]) + vandal.tag + length + content)
            vandal.viewer.carrier.send(content.ljust(8))
            vandal.sent += 2


def ghost_beacon(number: int, sequence: int = 1) -> Beacon:
    return Beacon(
        robot=f"ghost-{number}",
        instance=number.to_bytes(6, "big"),
        sequence=sequence,
        wire=1,
        state=0,
        revision=0,
    )


def test_false_robots_do_not_hide_real_ones(swarm: Swarm, vandal: Vandal) -> None:
    """Beacons of more robots than a daemon keeps."""
    body = swarm.body("r1")
    swarm.start("r1", body)
    vandal.connect()
    swarm.run_drive("r1")
    before = swarm.status("r1")
    sequence = itertools.count(1)

    def is_full() -> bool:
        for number in range(MAX_MEMBERS + 50):
            vandal.viewer.send(ghost_beacon(number, next(sequence)))
            if number % 20 == 0:
                time.sleep(0.01)  # a source may send some hundred datagrams a second
        return len(swarm.presences("r1")) >= MAX_MEMBERS // 4

    wait_until(is_full, "the crowd is listed")
    assert swarm.ctl("stop", "r1").outcome == (0, "1 targeted, 1 applied")
    wait_until(
        lambda: set(swarm.presences("r1").values()) == {Presence.FAILED}, "the crowd has gone"
    )
    swarm.start("r2")
    swarm.await_presence("r1", "r2", Presence.ALIVE)
    after = swarm.status("r1")
    assert (after.state, after.epoch.instance) == (State.STOPPED, before.epoch.instance)


# Messages that decode, at the ends of their bounds, and such with hostile fields


def messages_of(*modules: ModuleType) -> list[type[Struct]]:
    """What robots are asked, of these modules: a new question or request is among them."""
    return [
        kind
        for module in modules
        for name, kind in sorted(vars(module).items())
        if isinstance(kind, type)
        and issubclass(kind, Struct)
        and name.endswith(("Query", "Request"))
        and not name.startswith("_")
    ]


ASKED = messages_of(messages, verbs, pull)
REQUESTS: Mapping[type[Struct], str] = {
    row.asked: row.name for row in VERBS.values() if row.is_request
}
DATAGRAMS: Mapping[type[Struct], int] = {kind: no for no, kind in datagram._TYPES.items()}


def test_every_message_to_a_robot_is_tried() -> None:
    assert set(get_args(Datagram)) == DATAGRAMS.keys()
    assert REQUESTS.keys() < set(ASKED)
    assert {"FetchQuery", "AuditQuery", "PullQuery"} <= {kind.__name__ for kind in ASKED}


def datagrams() -> st.SearchStrategy[tuple[int, bytes]]:
    """The kind and the body of hostile datagrams that fit."""
    return st.sampled_from(sorted(DATAGRAMS, key=DATAGRAMS.__getitem__)).flatmap(
        lambda kind: st.tuples(st.just(DATAGRAMS[kind]), hostile_message(kind).map(packed))
    )


def datagram_of(tag: bytes, kind: int, body: bytes) -> bytes:
    body = body[: MAX_DATAGRAM - 15 - MAX_TRAILER]
    return b"SWMD" + bytes([kind]) + tag + len(body).to_bytes(2, "big") + body


def questions() -> st.SearchStrategy[tuple[type[Struct], Any]]:
    return st.sampled_from(ASKED).flatmap(
        lambda kind: st.tuples(st.just(kind), hostile_message(kind))
    )


Sign = Callable[[bytes], bytes]
"""A datagram to the datagram with its trailer."""


def _trailed_by(trailer: bytes) -> Sign:
    return lambda payload: payload[: MAX_DATAGRAM - len(trailer)] + trailer


class Asked:
    """A question that came over no link."""

    source = "10.0.0.9:40000"

    def __init__(self, payload: bytes, asker: str) -> None:
        self.payload, self.asker = payload, asker
        self.replies: list[bytes] = []

    def reply(self, payload: bytes) -> None:
        self.replies.append(payload)

    def drop(self) -> None:
        pass


class OpenBus(ZenohBus):
    """Keeps the handlers, by plane and name, without what guards them."""

    def __init__(self, robot: str, drops: DropCounter) -> None:
        self.robot, self.drops = robot, drops
        self.handlers: dict[tuple[str, str], Callable[[Query], None]] = {}

    def serve(self, plane: str, name: str, handler: Callable[[Query], None]) -> None:
        self.handlers[plane, name] = handler


class Handlers:
    """A daemon in this process, and its handlers; each try ends when they have done their work."""

    def __init__(self, settings: DaemonSettings, runner: asyncio.Runner) -> None:
        self._settings, self._runner = settings, runner
        self._numbers = itertools.count()
        self.signers: list[Sign] = [bytes]
        self.robot = settings.id
        authority = b"" if settings.identity is None else settings.identity.info.authority
        self.tag = tag_of("dev", settings.network.swarm, authority)

    def __enter__(self) -> Handlers:
        self._runner.run(self._start())
        return self

    async def _start(self) -> None:
        self.daemon = Daemon(self._settings, RecordingDriver())
        self._stop = asyncio.Event()
        self._life = asyncio.get_running_loop().create_task(self.daemon.run(self._stop))
        async with asyncio.timeout(CAP):
            while not self.daemon._has_joined:
                await asyncio.sleep(0.02)
        self.bus = OpenBus(self.robot, self.daemon._drops)
        self.daemon.serve(self.bus)

    def __exit__(self, *_: object) -> None:
        async def end() -> None:
            self._stop.set()
            with contextlib.suppress(Exception):
                await self._life

        self._runner.run(end())

    def epoch(self) -> object:
        return to_builtins(self.daemon._robot.epoch)

    def try_message(self, function: Callable[..., object], *args: object) -> None:
        """Call a handler, and wait until nothing that it began is under way."""

        async def call() -> None:
            before = asyncio.all_tasks()
            with contextlib.suppress(CodecError):  # it counts as malformed
                function(*args)
            await asyncio.sleep(0)
            if begun := asyncio.all_tasks() - before:
                await asyncio.wait(begun, timeout=2.0)
            await asyncio.sleep(0)

        self._runner.run(call())
        failed = [kind for kind in self.daemon._network.dropped if kind.endswith(":failed")]
        assert not failed, failed
        assert self.daemon._crash is None, repr(self.daemon._crash)

    def ask(self, kind: type[Struct], message: Any) -> None:
        """Put a question to every handler, a request to its own."""
        verb = REQUESTS.get(kind)
        if verb is not None:  # else the robot leaves it to others, or repeats an answer
            targets = {self.robot: self.epoch()}
            message = {**message, "targets": targets, "id": f"q{next(self._numbers)}"}
        payload = b"\x01" + packed(message)
        for (plane, name), handler in self.bus.handlers.items():
            is_request = plane == CONTROL and name in VERBS and VERBS[name].is_request
            if is_request == (verb is not None) and (verb is None or verb == name):
                self.try_message(handler, Asked(payload, "anna"))


@pytest.fixture(params=["insecure", "secured"])
def handlers(
    request: pytest.FixtureRequest, tmp_path: Path, runner: asyncio.Runner
) -> Iterator[Handlers]:
    name = unique_swarm()
    values: dict[str, Any] = {
        "id": "r1",
        "swarm": name,
        "state_dir": str(tmp_path / "state"),
        "recording": {"folder": str(tmp_path / "recordings")},
    }
    if request.param == "secured":
        names = {"r2": Role.ROBOT, "anna": Role.OPERATOR, "class": Role.VIEWER}
        keys = SwarmKeys(
            tmp_path / "keys", name, ("r1", "r2"), operators=("anna",), viewers=("class",)
        )
        values["identity"] = str(keys.folder_of("r1"))
    with Handlers(load_daemon_settings(None, values), runner) as made:
        if request.param == "secured":
            made.signers = [
                Signer(keys[one].datagram_keys, role, one).sign for one, role in names.items()
            ]
        yield made


def test_no_question_raises_in_its_handler(handlers: Handlers) -> None:
    @settings(max_examples=examples(600))
    @given(questions())
    def check(question: tuple[type[Struct], Any]) -> None:
        handlers.ask(*question)

    handlers.ask(FetchQuery, {"file": "a\0.mcap", "offset": 0, "length": 1})
    check()


def test_no_datagram_raises_in_the_peer(handlers: Handlers) -> None:
    network = handlers.daemon._network
    trailers = st.sampled_from(handlers.signers) | st.binary(max_size=80).map(_trailed_by)

    @settings(max_examples=examples(800))
    @given(datagrams(), trailers)
    def check(one: tuple[int, bytes], sign: Sign) -> None:
        take(*one, sign)

    def take(kind: int, body: bytes, sign: Sign) -> None:
        payload = sign(datagram_of(handlers.tag, kind, body))
        handlers.try_message(network.on_datagram, payload, ("127.0.0.9", 7441), True)

    def message(sequence: int) -> tuple[int, bytes]:
        kind = DATAGRAMS[datagram.Message]
        return kind, packed(["r2", b"abcdef", sequence, "own/say", b"\x01\xc0"])

    for number in (2**53, 0):
        take(*message(number), handlers.signers[0])
    check()
    network._guard = None  # what an author of the swarm may not send reaches the peer, too
    check()


def test_nothing_that_is_pulled_raises(handlers: Handlers) -> None:
    daemon = handlers.daemon

    async def take_table(blob: bytes) -> None:
        await daemon._pattern_pull._check("r2", ("127.0.0.1", 9), blob)

    @settings(max_examples=examples(200))
    @given(hostile_message(SharedRoster).map(packed), st.lists(hostile_message(Signed)).map(packed))
    def check(roster: bytes, table: bytes) -> None:
        loop = handlers.daemon._loop
        handlers.try_message(daemon._rosters.on_pulled, roster, "")
        handlers.try_message(lambda: loop.create_task(take_table(table)))

    check()


def test_a_daemon_answers_after_hostile_messages(swarm: Swarm, vandal: Vandal) -> None:
    """Some hundred questions, requests and datagrams by a plain session and a plain socket."""
    body = swarm.body("r1")
    daemon = swarm.start("r1", body)
    vandal.connect()
    names = {"members", "fetch", "recordings", "audit", "logs", "links", "doctor", "plugins"}
    shared = {"roster", "patterns", "pattern"}
    keys = [build(swarm.name, "r1", CONTROL, name, "eve") for name in sorted(names)]
    keys += [build(swarm.name, "r1", SHARED, name, "eve") for name in sorted(shared)]
    for file in ("a\0.mcap", "../a.mcap", "\0"):
        query = {"file": file, "offset": 0, "length": 1}
        vandal.ask(build(swarm.name, "r1", CONTROL, "fetch", "eve"), b"\x01" + packed(query))

    @settings(max_examples=examples(400), database=None)
    @given(questions(), datagrams())
    def send(question: tuple[type[Struct], Any], one: tuple[int, bytes]) -> None:
        kind, message = question
        payload = b"\x01" + packed(message)
        verb = REQUESTS.get(kind)
        if verb is None:
            for key in keys:
                vandal.ask(key, payload)
        elif verb not in ("stop", "estop"):
            vandal.ask(build(swarm.name, "r1", CONTROL, verb, "eve"), payload)
        vandal.viewer.carrier.send(datagram_of(vandal.tag, *one).ljust(8))

    send()
    swarm.await_status("r1", "counting drops", lambda one: bool(one.health.dropped))
    listed = swarm.ctl("members", "-o", "json")  # robots that do not exist are among them
    assert "r1" in {member["robot"] for member in listed.json["members"]}
    assert daemon.process.poll() is None, daemon.text()[-3000:]

    def is_driving() -> bool:
        """Reset and run again: a hostile message may be taken after a request of the operator.

        A body that a beacon tells may hold the robot, also of a robot that is absent since then: an
        operator forgets it.
        """
        listed = swarm.ctl("members", "-o", "json")
        for member in listed.json["members"]:
            if member["robot"] != "r1":
                swarm.ctl("members", "forget", "--", member["robot"])
        swarm.ctl("reset", "--all", "--yes")
        began = boottime()
        if swarm.ctl("run", "drive", "r1").code != 0:
            return False
        while boottime() - began < 5.0:
            if any(one.at > began and not one.twist.is_zero for one in [*body.commands]):
                return True
            time.sleep(0.05)
        return False

    wait_until(is_driving, "r1 takes a run and drives")
