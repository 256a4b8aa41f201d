"""Frames between a simulated robot and its daemon, on sockets of this process."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.link.carriers import robot_link
from swarmd.link.carriers.robot_link import (
    HELLO,
    MAX_CONNECTIONS_OF_ROBOT,
    MAX_PAYLOAD,
    MAX_STRANGERS,
    Connection,
    Frame,
    Hello,
    RobotClient,
    RobotServer,
    dial,
    read_endpoint,
)
from tests.support.examples import examples
from tests.support.processes import free_endpoint, wait_until

CAP = 20.0


def tcp_pair() -> tuple[socket.socket, socket.socket]:
    """Two ends of a TCP connection on loopback."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        one = socket.create_connection(server.getsockname())
        other, _ = server.accept()
    return one, other


@pytest.fixture
def ends() -> Iterator[tuple[Connection, Connection]]:
    one, other = (Connection(end) for end in tcp_pair())
    yield one, other
    one.close()
    other.close()


@pytest.fixture
def server() -> Iterator[RobotServer]:
    made = RobotServer("tcp/127.0.0.1:0", "s", ("a", "b"), "the test")
    yield made
    made.close()


def heard(one: Connection, count: int) -> list[Frame]:
    """So many frames, once they have come."""
    frames: list[Frame] = []

    def have_come() -> bool:
        frames.extend(one.receive())
        return len(frames) >= count

    wait_until(have_come, f"{count} frames")
    return frames


def test_frames_come_whole_and_in_their_order(ends: tuple[Connection, Connection]) -> None:
    one, other = ends
    sent = [Frame("scan", b"x" * size) for size in (0, 1, 70_000, 3)] + [Frame("", b"end")]
    came: list[Frame] = []

    for frame in sent:
        assert one.send(*frame)
        came += heard(other, 1)
    assert came == sent


def test_a_frame_without_room_is_dropped_whole(ends: tuple[Connection, Connection]) -> None:
    one, other = ends
    sent: list[int] = []
    while one.send("n", b"%06d" % len(sent) + b"x" * 9_000):
        sent.append(len(sent))
    assert not one.send("n", b"dropped")
    assert one.is_open
    came = heard(other, len(sent) - 1)

    def goes() -> bool:
        came.extend(other.receive())
        return one.send("last", b"")

    wait_until(goes, "room again")
    came += heard(other, 1)
    assert came[-1] == Frame("last", b"")
    assert [int(payload[:6]) for _, payload in came[:-1]] == sent
    assert {len(payload) for _, payload in came[:-1]} == {9_006}


def test_what_was_sent_before_the_end_arrives(ends: tuple[Connection, Connection]) -> None:
    one, other = ends
    other.send("unread", b"x" * 1000)
    one.send("cmd_vel", b"zero")
    one.close()
    assert heard(other, 1) == [Frame("cmd_vel", b"zero")]

    def is_over() -> bool:
        other.receive()
        return not other.is_open

    wait_until(is_over, "the end")


def test_a_frame_that_is_too_long_ends_the_connection(
    ends: tuple[Connection, Connection],
) -> None:
    one, other = ends
    one.send("n", b"whole")
    one.socket.sendall(b"\x01" + (MAX_PAYLOAD + 1).to_bytes(4, "little") + b"n")
    assert heard(other, 1) == [Frame("n", b"whole")]
    wait_until(lambda: not other.receive() and not other.is_open, "the end")


def test_a_peer_that_reads_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_link, "GIVE_UP", 0.3)
    end, other = tcp_pair()
    one = Connection(end)

    def is_given_up() -> bool:
        one.send("scan", b"x" * 9_000)
        return not one.is_open

    wait_until(is_given_up, "the end")
    one.close()
    other.close()
    assert not one.is_open


class Flooded(socket.socket):
    """A socket whose sender is always faster than its reader."""

    reads = 0

    def recvmsg(self, size: int, room: int = 0, flags: int = 0, /) -> tuple[bytes, Any, int, Any]:
        return self.recv(size), [], 0, None

    def recv(self, size: int, flags: int = 0, /) -> bytes:
        self.reads += 1
        assert self.reads < 100, "the reader does not return"
        return b"\xff" * size

    def shutdown(self, how: int, /) -> None:
        """It is not connected."""


def test_a_flood_does_not_keep_its_reader() -> None:
    flooded = Flooded()
    one = Connection(flooded)
    assert not one.receive()
    assert not one.is_open
    one.close()
    assert flooded.reads > 1


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(st.binary(max_size=60), max_size=8))
def test_no_bytes_raise(parts: list[bytes]) -> None:
    raw, end = tcp_pair()
    one = Connection(end)
    with raw:
        for part in parts:
            raw.sendall(part)
    names: list[str] = []

    def is_over() -> bool:
        names.extend(name for name, _ in one.receive())
        return not one.is_open

    wait_until(is_over, "the end")
    one.close()
    assert all(len(name) <= 255 for name in names)


def test_a_robot_has_a_bounded_number_of_connections(server: RobotServer) -> None:
    where = read_endpoint(server.endpoint, "")
    made = []
    for _ in range(MAX_CONNECTIONS_OF_ROBOT + 1):
        one = dial(where, Hello("s", "a"), CAP)
        assert one is not None
        made.append(one)

    def is_settled() -> bool:
        server.receive()
        for one in made:
            one.receive()
        return sum(one.is_open for one in made) == MAX_CONNECTIONS_OF_ROBOT

    wait_until(is_settled, "one too many is refused")
    assert server.dropped == 1
    made[0].close()
    other = dial(where, Hello("s", "b"), CAP)
    assert other is not None

    def is_known() -> bool:
        server.receive()
        return bool(other.receive())

    wait_until(is_known, "another robot")
    for one in (*made[1:], other):
        one.close()


def test_connections_that_say_nothing_keep_no_daemon_out(server: RobotServer) -> None:
    where = read_endpoint(server.endpoint, "")
    silent = []
    for _ in range(3 * MAX_STRANGERS):
        silent.append(Connection(socket.create_connection((where.host, where.port))))
        server.receive()
    one = dial(where, Hello("s", "a"), CAP)
    assert one is not None

    def is_known() -> bool:
        server.receive()
        return bool(one.receive())

    wait_until(is_known, "the daemon is known")
    for each in (*silent, one):
        each.close()


def test_a_daemon_is_taken_from_among_many_strangers(server: RobotServer) -> None:
    where = read_endpoint(server.endpoint, "")
    silent = [socket.create_connection((where.host, where.port)) for _ in range(2 * MAX_STRANGERS)]
    one = dial(where, Hello("s", "a"), CAP)
    assert one is not None
    silent += [socket.create_connection((where.host, where.port)) for _ in range(2 * MAX_STRANGERS)]
    for _ in range(4):
        server.receive()
    assert [name for name, _ in heard(one, 1)] == [HELLO]
    one.close()
    for each in silent:
        each.close()


def test_a_connection_that_does_not_listen_is_sent_nothing(server: RobotServer) -> None:
    one = dial(read_endpoint(server.endpoint, ""), Hello("s", "a", listens=False), CAP)
    assert one is not None
    one.send("cmd_vel", b"zero")
    received = []

    def has_come() -> bool:
        received.extend(server.receive())
        server.send("a", "scan", b"x")
        return bool(received)

    wait_until(has_come, "the zero")
    assert received[0][:3] == ("a", "cmd_vel", b"zero")
    assert [name for name, _ in heard(one, 1)] == [HELLO]
    one.close()


def test_a_client_connects_again_to_a_server_that_returns() -> None:
    endpoint = free_endpoint()
    came: list[Frame] = []

    async def story() -> None:
        server = RobotServer(endpoint, "s", ("a",), "the test")
        client = RobotClient(read_endpoint(endpoint, ""), Hello("s", "a"), came.extend)
        running = asyncio.create_task(client.run())
        for number in range(2):
            while not client.is_known or len(came) <= number:
                server.receive()
                server.send("a", "scan", bytes([number]))
                await asyncio.sleep(0.01)
            assert client.send("cmd_vel", b"x")
            server.close()
            while client.is_known:
                await asyncio.sleep(0.01)
            assert not client.send("cmd_vel", b"lost")
            del came[number + 1 :]
            server = RobotServer(endpoint, "s", ("a",), "the test")
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        server.close()

    asyncio.run(asyncio.wait_for(story(), CAP))
    assert [payload for _, payload in came] == [b"\0", b"\1"]


def connects_to_itself(made: socket.socket, where: tuple[str, int]) -> Awaitable[None]:
    """What happens if the kernel gives a socket the port that it dials."""
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    made.bind(where)
    return asyncio.get_running_loop().sock_connect(made, where)


def finds_nothing(made: socket.socket, where: tuple[str, int]) -> Awaitable[None]:
    """What happens if a host does not answer."""
    return asyncio.get_running_loop().create_future()


@pytest.mark.parametrize("connect", [connects_to_itself, finds_nothing])
def test_a_client_tries_again_where_nothing_answers(
    connect: Callable[[socket.socket, tuple[str, int]], Awaitable[None]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(robot_link, "CONNECT_TIMEOUT", 0.01)
    attempts = 0

    async def story() -> None:
        loop = asyncio.get_running_loop()
        client = RobotClient(read_endpoint(free_endpoint(), ""), Hello("s", "a"), print)
        original = loop.sock_connect

        async def counted(made: socket.socket, where: tuple[str, int]) -> None:
            nonlocal attempts
            attempts += 1
            with monkeypatch.context() as patch:
                patch.setattr(loop, "sock_connect", original)
                trying = connect(made, where)
            await trying

        monkeypatch.setattr(loop, "sock_connect", counted)
        running = asyncio.create_task(client.run())
        while attempts < 2:
            await asyncio.sleep(0.01)
            assert not client.is_known
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    asyncio.run(asyncio.wait_for(story(), CAP))
    assert attempts == 2


def test_a_client_ends_though_its_connection_is_refused_at_the_same_moment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def run() -> None:
        loop = asyncio.get_running_loop()
        tried = loop.create_future()
        refused = loop.create_future()

        def connect(*_: object) -> asyncio.Future[None]:
            if not tried.done():
                tried.set_result(None)
            return refused

        monkeypatch.setattr(loop, "sock_connect", connect)
        client = RobotClient(read_endpoint(free_endpoint(), ""), Hello("s", "a"), print)
        task = asyncio.create_task(client.run())
        await tried
        refused.set_exception(ConnectionRefusedError)
        task.cancel()
        done, _ = await asyncio.wait({task}, timeout=CAP)
        assert done
        assert task.cancelled()

    asyncio.run(run())
