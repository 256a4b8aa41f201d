"""Bad messages on every key that a daemon listens to: all are counted, and disturb no robot."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from swarmd.core.clock import boottime
from swarmd.core.codec import MAX_CONTROL, MAX_MESSAGE, MAX_SENSOR_PAYLOAD, encode, encode_value
from swarmd.core.keys import build
from swarmd.core.messages import REQUEST_TYPES, AnyRequest, Epoch, MembersQuery, Presence, State
from swarmd.core.values import Neighbor, Odometry, Pose, Twist
from swarmd.driver_api.hw_codec import (
    encode_neighbors,
    encode_odometry,
    encode_readings,
    encode_scan,
)
from swarmd.network.membership import MAX_MEMBERS
from swarmd.network.session import open_session
from tests.support.fake_daemon import light_status
from tests.support.garbage import KINDS, Garbage
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from tests.support.fake_body import Body
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

PER_KIND = 160
PER_KEY = 20
MESH = ("control/", "safety/", "state/", "msg")
WRONG_HW = tuple(
    f"driver/hw/{sense}:key" for sense in ("scan", "odometry", "neighbors", "readings")
)
ODD_NAMES = ("UPPER", "a b", "röbot", "-dash", "x" * 64, "a.b", "%20", "r1\\", "~")


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
    """A session that sends wrong messages to `r1`."""

    def __init__(self, swarm: Swarm) -> None:
        self._swarm = swarm
        self._rng = random.Random(1)
        self.session = open_session(swarm.settings)
        self.sent = 0

    def put(self, key: str, payload: bytes) -> None:
        """Publish, and let nothing be lost on the way."""
        self.session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)

    def ask(self, key: str, payload: bytes) -> None:
        """Query, without waiting for an answer."""
        block = zenoh.CongestionControl.BLOCK
        self.session.get(key, _ignore, payload=payload, timeout=5.0, congestion_control=block)

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
        made.session.close()


def request(verb: str) -> AnyRequest:
    fields: dict[str, Any] = {
        "run": {"pattern": "drive", "params": {"speed": 0.1}},
        "param": {"params": {"speed": 0.1}},
        "reload": {"pattern": "drive"},
        "forget": {"name": "r9"},
    }
    return REQUEST_TYPES[verb](
        id="f00d",
        operator="eve@x",
        targets={"r1": Epoch(instance="0123456789ab", revision=3)},
        **fields.get(verb, {}),
    )


def mesh_targets(swarm: str) -> Iterator[Target]:
    """Every key of the mesh session."""
    requests = {verb: encode(request(verb)) for verb in REQUEST_TYPES if verb != "estop"}
    for verb, valid in {**requests, "members": encode(MembersQuery(answered=("r1",)))}.items():
        key = build(swarm, "r1", "control", verb)
        yield Target(key, valid, MAX_CONTROL, (f"control/{verb}",), is_query=True)
    key, valid = build(swarm, "r1", "safety", "estop"), encode(request("estop"))
    for is_query in (True, False):
        yield Target(key, valid, MAX_CONTROL, ("safety/estop", "control/estop"), is_query)
    ghost = encode(light_status("ghost", "0123456789ab"))
    yield Target(build(swarm, "ghost", "state", "status"), ghost, MAX_CONTROL, ("state/status",))
    said = encode_value({"opinion": 1, "words": ["a", "b"]})
    key = build(swarm, "ghost", "msg", "majority_rule/opinion")
    yield Target(key, said, MAX_MESSAGE, ("msg",))


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
    swarm.start("r2")
    swarm.run_drive("r1")
    moving = body.wait_stepped()
    before = swarm.status("r1")

    for target, kind in itertools.product(mesh_targets(swarm.name), KINDS):
        vandal.flood(vandal.ask if target.is_query else vandal.put, target, kind)
    for target, kind in itertools.product(body_targets(swarm.name, body), KINDS):
        vandal.flood(body.put, target, kind)
    say_on_wrong_keys(swarm, vandal, body)
    hold_odd_tokens(swarm, vandal)

    after = swarm.status("r1")
    print(f"{vandal.sent} bad messages; {after.health.dropped}")
    print(f"loop p99 {after.health.loop_p99 * 1e3:.1f} ms")
    assert vandal.sent >= 10_000
    assert (after.state, after.epoch) == (State.RUNNING, before.epoch)
    assert after.health.loop_stalls == 0
    body.wait_moving(boottime())
    assert body.ran_since(moving)
    listed = swarm.ctl("members", "-o", "json")
    assert {member["robot"] for member in listed.json["members"]} == {"r1", "r2"}
    assert swarm.ctl("estop").code == 0


def say_on_wrong_keys(swarm: Swarm, vandal: Vandal, body: Body) -> None:
    """Wildcards reach whomever they match; so do names that no robot can have."""
    name = swarm.name
    everyone = ("**", "swarm/**", f"swarm/{name}/**", f"swarm/{name}/r1/**", "swarm/*/r1/*/*")
    puts = [f"swarm/{name}/*/state/status", f"swarm/{name}/*/msg/*/*", "swarm/*/*/safety/estop"]
    puts += [f"swarm/{name}/r1/state/status", f"swarm/{name}/r1/msg/majority_rule/opinion"]
    puts += [f"swarm/{name}/{odd}/state/status" for odd in ODD_NAMES]
    puts += [f"swarm/{name}/ghost/msg/{odd}/opinion" for odd in ODD_NAMES]
    status, stop = encode(light_status("ghost", "0123456789ab")), encode(request("stop"))
    for key in (*everyone, *puts):
        vandal.count(vandal.put, key, itertools.repeat(status, PER_KEY), MESH)
    for key in (*everyone, f"swarm/{name}/r1/control/*", "swarm/*/*/control/run"):
        vandal.count(vandal.ask, key, itertools.repeat(stop, PER_KEY), MESH)
    scan = encode_scan(body.clear(1, 0.0))
    for key in (*everyone, f"swarm/{name}/*/hw/scan"):
        vandal.count(body.put, key, itertools.repeat(scan, PER_KEY), WRONG_HW)


def hold_odd_tokens(swarm: Swarm, vandal: Vandal) -> None:
    """Tokens under names that no robot can have are counted as they come and as they go."""
    keys = [f"swarm/{swarm.name}/{odd}/alive/0123456789ab" for odd in ODD_NAMES]
    keys += [f"swarm/{swarm.name}/ghost/alive/{odd}" for odd in ODD_NAMES]
    liveliness = vandal.session.liveliness()
    before = vandal.dropped(("alive",))
    tokens = [liveliness.declare_token(key) for key in keys]
    wait_until(lambda: vandal.dropped(("alive",)) >= before + len(keys), "odd tokens counted")
    for token in tokens:
        token.undeclare()
    wait_until(lambda: vandal.dropped(("alive",)) >= before + 2 * len(keys), "and their end")
    vandal.sent += 2 * len(keys)


def test_false_robots_do_not_hide_real_ones(swarm: Swarm, vandal: Vandal) -> None:
    """Their tokens are all that they have; more of them than a daemon keeps."""
    body = swarm.body("r1")
    swarm.start("r1", body)
    swarm.run_drive("r1")
    before = swarm.status("r1")
    names = [f"ghost-{number}" for number in range(MAX_MEMBERS + 50)]
    liveliness = vandal.session.liveliness()
    tokens = [
        liveliness.declare_token(build(swarm.name, name, "alive", "0123456789ab")) for name in names
    ]
    wait_until(lambda: len(swarm.presences("r1")) == MAX_MEMBERS, "the crowd is listed")
    assert swarm.ctl("members").code == 0
    done = swarm.ctl("stop", "r1")
    assert done.outcome == (0, "1 targeted, 1 applied")
    swarm.run_drive("r1")
    for token in tokens:
        token.undeclare()
    wait_until(
        lambda: set(swarm.presences("r1").values()) == {Presence.FAILED}, "the crowd has gone"
    )
    swarm.start("r2")
    swarm.await_presence("r1", "r2", Presence.ALIVE)
    after = swarm.status("r1")
    assert (after.state, after.epoch.instance) == (State.RUNNING, before.epoch.instance)
    assert after.health.loop_stalls == 0
    body.wait_moving(boottime())
