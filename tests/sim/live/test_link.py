"""The world's Zenoh session with real peers on loopback."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
import zenoh
from msgspec.structs import replace

from swarmd.core.codec import MAX_SENSOR_PAYLOAD, encode
from swarmd.core.errors import ConfigError, NetworkError
from swarmd.core.values import Twist
from swarmd.driver_api.hw_codec import (
    MessageWire,
    decode_messages,
    encode_command,
    encode_message,
)
from swarmd.sim.live.link import WorldLink, WorldView, client_options
from swarmd.sim.live.state import WorldState
from tests.support.processes import wait_until
from tests.support.traces import world_state

COMMAND = encode_command(Twist(0.2), -1, -1)
ANY_PORT = "tcp/127.0.0.1:0"


@pytest.fixture
def link() -> Iterator[WorldLink]:
    with_two = WorldLink("s", ("a", "b"), ANY_PORT)
    yield with_two
    with_two.close()


@pytest.fixture
def peer(link: WorldLink) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    for path, value in {
        **client_options(link.endpoint),
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(path, json.dumps(value))
    session = zenoh.open(config)
    yield session
    session.close()


def test_an_endpoint_in_use_is_one_clear_error(link: WorldLink) -> None:
    with pytest.raises(NetworkError, match="in use"):
        WorldLink("s", ("a",), link.endpoint)


@pytest.mark.parametrize("endpoint", ["", "127.0.0.1:7790", "tcp/127.0.0.1", "tcp/127.0.0.1:99999"])
def test_an_invalid_endpoint_is_refused(endpoint: str) -> None:
    with pytest.raises(ConfigError, match="endpoint"):
        WorldLink("s", ("a",), endpoint)


def test_only_the_newest_valid_command_of_each_robot_is_kept(
    link: WorldLink, peer: zenoh.Session
) -> None:
    def put(robot: str, payload: bytes) -> None:
        peer.put(f"swarm/s/{robot}/hw/cmd_vel", payload)

    def is_linked() -> bool:
        put("a", COMMAND)
        return bool(link.take_commands())

    wait_until(is_linked, "linked")  # from now on everything arrives in order
    for speed in (0.1, 0.2):
        for robot in ("a", "b"):
            put(robot, encode_command(Twist(speed), 1, 1))
    put("a", encode_command(Twist(9.0), -1, -1))
    put("a", b"garbage")
    wait_until(lambda: link.dropped == 1, "counted")
    taken = link.take_commands()
    assert {robot: command.twist.linear for robot, command in taken.items()} == {"a": 9.0, "b": 0.2}


@pytest.mark.parametrize(
    ("key", "payload"),
    [
        ("swarm/s/*/hw/cmd_vel", COMMAND),
        ("swarm/**", COMMAND),
        ("swarm/s/stranger/hw/cmd_vel", COMMAND),
        ("swarm/s/b/hw/sent", encode_message("a", "vote/opinion", b"of another")),
        ("swarm/s/b/hw/sent", b"garbage"),
    ],
)
def test_what_comes_on_the_key_of_another_or_is_malformed_is_counted_and_dropped(
    link: WorldLink, peer: zenoh.Session, key: str, payload: bytes
) -> None:
    def counted() -> bool:
        peer.put(key, payload)
        return link.dropped > 0

    wait_until(counted, "counted")
    assert link.take_commands() == {}
    assert link.take_messages() == []


def test_messages_and_the_state_of_the_world_arrive(link: WorldLink, peer: zenoh.Session) -> None:
    said = MessageWire("b", "vote/opinion", b"x")
    came: list[MessageWire] = []
    seen: list[WorldState] = []
    peer.declare_subscriber(
        "swarm/s/a/hw/received", lambda s: came.extend(decode_messages(s.payload.to_bytes()))
    )

    def passed_on() -> bool:
        peer.put("swarm/s/b/hw/sent", encode_message("b", "vote/opinion", b"x"))
        link.messages("a", link.take_messages())
        link.publish_state(world_state([(0.0, 0.0, 0.0)], time=12.5))
        return bool(came and seen)

    with WorldView("s", link.endpoint) as view:
        view.watch(seen.append)
        wait_until(passed_on, "passed on")
    assert came[0] == said
    assert (seen[0].time, seen[0].arena) == (12.5, (6.0, 6.0))


def test_a_world_that_is_not_there_is_one_clear_error() -> None:
    gone = WorldLink("s", ("a",), ANY_PORT)
    gone.close()
    with (
        WorldView("s", gone.endpoint) as view,
        pytest.raises(NetworkError, match="'poses'"),
    ):
        view.ask("poses", timeout=0.2)


def test_a_state_of_many_robots_stays_within_the_size_limit() -> None:
    three = (1.0 / 3.0, -1.0 / 3.0, 3.0)
    many = {"poses": (three,) * 500, "twists": (three,) * 500, "commanded": (True,) * 500}
    whole = replace(world_state([]), ids=tuple(f"robot-{i:03d}" for i in range(500)), **many)
    assert len(encode(whole)) < MAX_SENSOR_PAYLOAD
