"""Bad messages on every key that a daemon listens to: all are counted, and disturb no robot."""

from __future__ import annotations

import itertools
import random
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from swarmd.core.clock import boottime
from swarmd.core.codec import MAX_CONTROL, MAX_SENSOR_PAYLOAD, encode
from swarmd.core.goal import Goal
from swarmd.core.keys import CONTROL, build
from swarmd.core.messages import REQUEST_TYPES, AnyRequest, Epoch, MembersQuery, Presence, State
from swarmd.core.values import Neighbor, Odometry, Pose, Twist
from swarmd.driver_api.hw_codec import (
    encode_neighbors,
    encode_odometry,
    encode_readings,
    encode_scan,
)
from swarmd.network.datagram import Beacon, pack, tag_of
from swarmd.network.membership import MAX_MEMBERS
from tests.support.garbage import KINDS, Garbage
from tests.support.processes import CAP, wait_until
from tests.support.viewer import Viewer

if TYPE_CHECKING:
    from tests.support.fake_body import Body
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

PER_KIND = 40
PER_KEY = 20
MESH = ("control/", "state/")
WRONG_HW = tuple(
    f"driver/hw/{sense}:key" for sense in ("scan", "odometry", "neighbors", "readings")
)


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

    def flood(self, say: Callable[[str, bytes], None], target: Target, kind: Garbage) -> None:
        payloads = (kind(self._rng, target.valid, target.limit) for _ in range(PER_KIND))
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
        "push": {"content": b"behaviour"},
        "roster": {"roster": b"roster"},
    }
    return REQUEST_TYPES[verb](
        id="f00d",
        operator="eve@x",
        targets={"r1": Epoch(instance="0123456789ab", revision=3)},
        **fields.get(verb, {}),
    )


def mesh_targets(swarm: str) -> Iterator[Target]:
    """Every key on which a daemon answers."""
    requests = {
        verb: encode(request(verb)) for verb in REQUEST_TYPES if verb not in ("stop", "estop")
    }
    for verb, valid in {**requests, "members": encode(MembersQuery(answered=("r1",)))}.items():
        key = build(swarm, "r1", CONTROL, verb, "eve")
        yield Target(key, valid, MAX_CONTROL, (f"control/{verb}",), is_query=True)


def body_targets(swarm: str, body: Body) -> Iterator[Target]:
    """Every key of the driver's session."""
    for name, valid, limit in (
        ("scan", encode_scan(body.clear(1, 0.0)), MAX_SENSOR_PAYLOAD),
        ("odometry", encode_odometry(Odometry(1.0, Pose(), Twist())), MAX_CONTROL),
        ("neighbors", encode_neighbors((Neighbor("r2", 0.0),)), MAX_CONTROL),
        ("readings", encode_readings({"battery": 0.9}), MAX_CONTROL),
    ):
        yield Target(build(swarm, "r1", "hw", name), valid, limit, (f"driver/hw/{name}",))


def test_malformed_messages_are_counted_and_disturb_no_robot(swarm: Swarm, vandal: Vandal) -> None:
    body = swarm.body("r1")
    swarm.start("r1", body)
    vandal.connect()
    swarm.start("r2")
    swarm.run_drive("r1")
    moving = body.wait_stepped()
    before = swarm.status("r1")

    for target, kind in itertools.product(mesh_targets(swarm.name), KINDS):
        vandal.flood(vandal.ask, target, kind)
    for target, kind in itertools.product(body_targets(swarm.name, body), KINDS):
        vandal.flood(body.put, target, kind)
    say_on_wrong_keys(swarm, vandal, body)
    send_wrong_datagrams(vandal)

    after = swarm.status("r1")
    print(f"{vandal.sent} bad messages; {after.health.dropped}")
    print(f"loop p99 {after.health.loop_p99 * 1e3:.1f} ms")
    assert vandal.sent >= 2_000
    assert (after.state, after.epoch) == (State.RUNNING, before.epoch)
    assert after.health.loop_stalls == 0
    body.wait_moving(boottime())
    assert body.ran_since(moving)
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
    for key in (*everyone, f"swarm/{name}/*/hw/scan"):
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
    assert after.health.loop_stalls == 0
