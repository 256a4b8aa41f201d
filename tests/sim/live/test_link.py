"""The world's links with real peers on loopback."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
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
from swarmd.link.carriers.robot_link import Connection, Frame, Hello, dial, read_endpoint
from swarmd.sim.live.link import Command, WorldLink, WorldView
from swarmd.sim.live.state import WorldState
from tests.support.processes import wait_until
from tests.support.traces import world_state

CAP = 20.0
ANY_PORT = "tcp/127.0.0.1:0"


@pytest.fixture
def link() -> Iterator[WorldLink]:
    with_two = WorldLink("s", ("a", "b"), ANY_PORT)
    yield with_two
    with_two.close()


def dialled(link: WorldLink, robot: str, swarm: str = "s") -> Connection:
    """A connection of a daemon; what it has sent has arrived, but was not taken in."""
    made = dial(read_endpoint(link.endpoint, ""), Hello(swarm, robot), CAP)
    assert made is not None
    return made


@pytest.fixture
def peers(link: WorldLink) -> Iterator[dict[str, Connection]]:
    made = {robot: dialled(link, robot) for robot in ("a", "b")}
    yield made
    for one in made.values():
        one.close()


def test_an_endpoint_in_use_is_one_clear_error(link: WorldLink) -> None:
    with pytest.raises(NetworkError, match="in use"):
        WorldLink("s", ("a",), link.endpoint)


@pytest.mark.parametrize("endpoint", ["", "127.0.0.1:7790", "tcp/127.0.0.1", "tcp/127.0.0.1:99999"])
def test_an_invalid_endpoint_is_refused(endpoint: str) -> None:
    with pytest.raises(ConfigError, match="endpoint"):
        WorldLink("s", ("a",), endpoint)


def test_only_the_newest_command_of_each_robot_is_kept(
    link: WorldLink, peers: dict[str, Connection]
) -> None:
    for speed in (0.1, 0.2, 9.0):
        for robot, peer in peers.items():
            peer.send("cmd_vel", encode_command(Twist(speed if robot == "a" else -speed), 1, 1))
    taken: dict[str, Command] = {}

    def all_there() -> bool:
        taken.update(link.take_commands())
        return {one.twist.linear for one in taken.values()} == {9.0, -9.0}

    wait_until(all_there, "all_there")
    assert (taken["a"].twist.linear, taken["b"].twist.linear) == (9.0, -9.0)
    assert link.take_commands() == {}


def test_a_malformed_command_replaces_no_valid_one(
    link: WorldLink, peers: dict[str, Connection]
) -> None:
    peers["a"].send("cmd_vel", encode_command(Twist(0.2), 1, 1))
    peers["a"].send("cmd_vel", b"garbage")
    peers["a"].send("velocity", encode_command(Twist(0.3), 1, 1))
    taken: dict[str, Command] = {}

    def counted() -> bool:
        taken.update(link.take_commands())
        return link.dropped == 2

    wait_until(counted, "counted")
    assert taken["a"].twist.linear == 0.2


def test_what_names_no_robot_of_this_world_first_is_counted_and_ended(link: WorldLink) -> None:
    strangers = [dialled(link, "stranger"), dialled(link, "a", swarm="other")]
    silent = dial(read_endpoint(link.endpoint, ""), Hello("s", "a"), CAP)
    assert silent is not None
    for one in strangers:
        one.send("cmd_vel", encode_command(Twist(0.2), -1, -1))

    def ended() -> bool:
        link.receive()
        for one in strangers:
            one.receive()
        return link.dropped >= 2 and not any(one.is_open for one in strangers)

    wait_until(ended, "ended")
    assert link.take_commands() == {}
    for one in (*strangers, silent):
        one.close()


def test_a_frozen_daemon_holds_up_neither_the_world_nor_the_commands_of_others(
    link: WorldLink, peers: dict[str, Connection]
) -> None:
    def welcomed() -> bool:
        link.receive()
        return bool(peers["b"].receive())

    wait_until(welcomed, "welcomed")
    payload = b"x" * 1500
    while not link.dropped:  # the daemon reads nothing
        link.publish("a", "scan", payload)
    peers["b"].send("cmd_vel", encode_command(Twist(0.1), 1, 1))
    taken: dict[str, Command] = {}

    def came() -> bool:
        taken.update(link.take_commands())
        return "b" in taken

    wait_until(came, "the command")
    before = link.dropped
    link.publish("b", "scan", payload)
    assert link.dropped == before
    frames: list[Frame] = []

    def thawed() -> bool:
        frames.extend(peers["a"].receive())
        link.publish("a", "odometry", b"new")
        return frames[-1].name == "odometry"

    wait_until(thawed, "what is sent after the thaw")
    assert {one.payload for one in frames if one.name == "scan"} == {payload}


def test_the_age_of_a_command_counts_from_its_arrival() -> None:
    now = [100.0]
    link = WorldLink("s", ("a",), ANY_PORT, clock=lambda: now[0])
    peer = dialled(link, "a")
    peer.send("cmd_vel", encode_command(Twist(0.1), 1, 1))
    taken: dict[str, Command] = {}

    def came() -> bool:
        taken.update(link.take_commands())
        return bool(taken)

    wait_until(came, "the command")
    assert taken["a"].arrival <= now[0]
    assert taken["a"].arrival == pytest.approx(100.0)  # no longer ago than the last look
    peer.close()
    link.close()


@pytest.mark.parametrize("payload", [encode_message("a", "vote/opinion", b"x"), b"garbage"])
def test_a_message_of_another_or_a_malformed_one_is_counted_and_dropped(
    link: WorldLink, peers: dict[str, Connection], payload: bytes
) -> None:
    peers["b"].send("sent", payload)
    taken: list[MessageWire] = []

    def counted() -> bool:
        link.receive()
        taken.extend(link.take_messages())
        return link.dropped > 0

    wait_until(counted, "counted")
    assert taken == []


def test_messages_are_passed_on(link: WorldLink, peers: dict[str, Connection]) -> None:
    said = MessageWire("b", "vote/opinion", b"x")
    came: list[MessageWire] = []

    def passed_on() -> bool:
        peers["b"].send("sent", encode_message("b", "vote/opinion", b"x"))
        link.receive()
        link.messages("a", link.take_messages())
        for name, payload in peers["a"].receive():
            if name == "received":
                came.extend(decode_messages(payload))
        return bool(came)

    wait_until(passed_on, "passed on")
    assert came[0] == said


def test_a_viewer_sees_the_state(link: WorldLink) -> None:
    seen: list[WorldState] = []
    with WorldView("s", link.viewers) as view:
        view.watch(seen.append)

        def shown() -> bool:
            link.publish_state(world_state([(0.0, 0.0, 0.0)], time=12.5))
            return bool(seen)

        wait_until(shown, "shown")
    assert seen[0].time == 12.5
    assert seen[0].arena == (6.0, 6.0)


def test_a_world_that_is_not_there_is_one_clear_error() -> None:
    gone = WorldLink("s", ("a",), ANY_PORT)
    gone.close()
    with (
        WorldView("s", gone.viewers) as view,
        pytest.raises(NetworkError, match="'poses'"),
    ):
        view.ask("poses", timeout=0.2)


def test_a_state_of_many_robots_stays_within_the_size_limit() -> None:
    three = (1.0 / 3.0, -1.0 / 3.0, 3.0)
    many = {"poses": (three,) * 500, "twists": (three,) * 500, "commanded": (True,) * 500}
    whole = replace(world_state([]), ids=tuple(f"robot-{i:03d}" for i in range(500)), **many)
    assert len(encode(whole)) < MAX_SENSOR_PAYLOAD
