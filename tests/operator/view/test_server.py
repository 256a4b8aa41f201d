"""The page's server without a browser: who may connect, and what a slow page gets."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import re
from collections.abc import AsyncIterator, Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import ClientConnection, connect

from swarmd.core.clock import boottime
from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.operator.view.access import Access
from swarmd.operator.view.client import MAX_UNACKED, Client
from swarmd.operator.view.server import VIEWER_BURST, VIEWER_RATE, ViewServer, overload
from swarmd.operator.view.source import CommandProgress, ShownRobot

FRAMES = 150
CAP = 60.0
ROW = 400_000
"""Characters of a row: a few of them fill the buffers of a connection."""


class OneRobot:
    """A source of one robot with a large row, so that a page that reads nothing is soon full."""

    kind, swarm, arena, playback, revision = "live", "one", None, None, 1
    patterns: Sequence[str] = ()
    programs: Sequence[str] = ()
    descriptions: Mapping[str, Mapping[str, Any]] = {}
    link = None

    def __init__(self) -> None:
        self.robots = [ShownRobot("r1", 0, "burger", np.ones((4, 2)))]
        self.count = 0

    def frame(self) -> tuple[float, Array]:
        return 0.0, np.zeros((1, 4))

    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        self.count += 1
        return {
            "r1": {"presence": "alive", "near": float("nan"), "text": f"{self.count % 10}" * ROW}
        }

    def scan(self, name: str) -> Array | None:
        return None

    def boxes(self) -> Sequence[Any]:
        return ()

    def links(self) -> Sequence[Any]:
        return ()

    def marks(self) -> Sequence[Any]:
        return ()

    def detail(self, name: str) -> None:
        return None

    def select(self, names: Sequence[str]) -> None:
        """Nothing is watched."""


class SilentRobots:
    """A commander whose emergency stops wait for r2 until they are ended."""

    def __init__(self) -> None:
        self.verbs: list[str] = []
        self.ended = asyncio.Event()

    async def act(self, verb: str, fields: Mapping[str, Any], tell: Any) -> None:
        self.verbs.append(verb)
        if verb == "estop":
            tell(CommandProgress("estop: 1 not acknowledged", missing=["r2"]))
            await self.ended.wait()
        tell(CommandProgress(f"{verb}: done", is_final=True))

    def end_estop(self) -> None:
        self.ended.set()


@contextlib.asynccontextmanager
async def serving(
    source: Any = None, commander: Any = None, access: Access | None = None, **options: Any
) -> AsyncIterator[tuple[ViewServer, str]]:
    """A server on loopback and its address."""
    server = ViewServer(source or OneRobot(), commander, access or Access(), **options)
    address = await server.start("127.0.0.1", 0)
    try:
        yield server, address
    finally:
        await server.close()


async def connected(address: str, limit: int = 65536) -> tuple[asyncio.StreamReader, Any]:
    """A connection by hand, which answers nothing by itself."""
    host, port = address.removeprefix("http://").rstrip("/").split(":")
    return await asyncio.open_connection(host, int(port), limit=limit)


async def opened(
    address: str, token: str = "", limit: int = 65536
) -> tuple[asyncio.StreamReader, Any]:
    """The connection of a page by hand."""
    reader, writer = await connected(address, limit)
    key = base64.b64encode(os.urandom(16)).decode()
    writer.write(
        f"GET /socket?token={token} HTTP/1.1\r\nHost: {address[7:-1]}\r\nUpgrade: websocket\r\n"
        f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    await reader.readuntil(b"\r\n\r\n")
    return reader, writer


async def message(page: ClientConnection, kind: str) -> dict[str, Any]:
    """The next message of a kind; frames are acknowledged meanwhile."""
    async with asyncio.timeout(CAP):
        async for one in page:
            if isinstance(one, bytes):
                await page.send('{"kind":"ack"}')
            elif (found := json.loads(one))["kind"] == kind:
                return dict(found)
    raise AssertionError(f"no {kind}")


async def frame(page: ClientConnection) -> None:
    """Read and acknowledge the next frame."""
    async with asyncio.timeout(CAP):
        async for one in page:
            if isinstance(one, bytes):
                await page.send('{"kind":"ack"}')
                return


def socket_of(address: str, token: str = "") -> str:
    return f"{address.replace('http', 'ws', 1)}socket?token={token}"


@pytest.mark.long
@pytest.mark.parametrize("acks", [False, True], ids=["silent", "acknowledges-all"])
async def test_a_page_that_reads_nothing_gets_few_frames_and_holds_up_no_other(acks: bool) -> None:
    async with serving(frame_period=0.01) as (server, address):
        _, writer = await opened(address, limit=1024)
        try:
            (slow,) = await clients(server, 1)
            async with connect(socket_of(address), max_size=None) as page:
                for _ in range(FRAMES):
                    await frame(page)
                    if acks:
                        writer.write(b"\x81\x8e\0\0\0\0" + b'{"kind":"ack"}')
                (fast,) = [one for one in server._clients if one is not slow]
            assert fast.sent >= FRAMES
            if not acks:
                assert slow.sent <= MAX_UNACKED
            assert slow.connection.transport.get_write_buffer_size() < 3 * ROW
        finally:
            writer.close()


async def clients(server: ViewServer, count: int) -> set[Any]:
    async with asyncio.timeout(CAP):
        while server.clients < count:
            await asyncio.sleep(0.01)
    return set(server._clients)


async def test_an_emergency_stop_is_kept_for_pages_that_open_later() -> None:
    commander = SilentRobots()
    async with serving(commander=commander) as (_, address):
        async with connect(socket_of(address), max_size=None) as first:
            await first.send('{"kind":"act","id":"a","verb":"estop"}')
            await message(first, "answer")
        async with connect(socket_of(address), max_size=None) as second:
            assert (await message(second, "estop"))["missing"] == ["r2"]
            await second.send('{"kind":"act","id":"b","verb":"end_estop"}')
            while not (await message(second, "estop"))["is_final"]:
                pass
        async with connect(socket_of(address), max_size=None) as third:
            await third.send('{"kind":"act","id":"c","verb":"stop"}')
            assert (await message(third, "answer"))["line"] == "stop: done"
            await third.send('{"kind":"act","id":"d","verb":"run","seen":1000}')
            assert "too late" in (await message(third, "answer"))["line"]
        assert commander.verbs == ["estop", "stop"]


async def test_what_a_page_sees_of_the_past_starts_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swarmd.operator.session.clocks.MAX_LATENESS", 0.5)
    commander = SilentRobots()
    async with (
        serving(commander=commander, frame_period=0.01) as (_, address),
        connect(socket_of(address), max_size=None) as page,
    ):
        first = (await message(page, "plots"))["times"][0]
        await message(page, "plots")  # the first moment is a second old
        await page.send(json.dumps({"kind": "past", "time": first}))
        seen = [0]
        async with asyncio.timeout(CAP):
            while seen[-1] == max(seen):  # until a frame has a number before the last one's
                one = await page.recv()
                if isinstance(one, bytes):
                    seen.append(int.from_bytes(one[4:8], "little"))
                    await page.send('{"kind":"ack"}')
        await page.send(json.dumps({"kind": "act", "id": "1", "verb": "run", "seen": seen[-1]}))
        assert "too late" in (await message(page, "answer"))["line"]
        await page.send(json.dumps({"kind": "act", "id": "2", "verb": "stop"}))
        await message(page, "answer")
        assert commander.verbs == ["stop"]


@pytest.mark.parametrize("away", [2.0, 30.0])
async def test_a_server_that_was_frozen_starts_nothing_that_waited(
    monkeypatch: pytest.MonkeyPatch, away: float
) -> None:
    """The clock since boot goes on while the loop does not, as in a computer that sleeps."""
    ahead = 0.0
    monkeypatch.setattr("swarmd.operator.view.server.boottime", lambda: boottime() + ahead)
    commander = SilentRobots()

    async def acted(verb: str, seen: int) -> str:
        await page.send(json.dumps({"kind": "act", "id": "1", "verb": verb, "seen": seen}))
        return str((await message(page, "answer"))["line"])

    async with (
        serving(commander=commander) as (server, address),
        connect(socket_of(address), max_size=None) as page,
    ):
        await frame(page)
        seen = server.frames
        ahead = away
        assert "too late" in await acted("run", seen)
        assert await acted("stop", seen) == "stop: done"
        # A loaded machine may make one more gap; what the page sees now may start motion again.
        while await acted("run", server.frames) != "run: done":
            await frame(page)
    assert commander.verbs == ["stop", "run"]


@pytest.mark.long
async def test_a_page_that_looks_back_learns_of_new_robots_and_gets_plots() -> None:
    async with (
        serving(frame_period=0.01) as (server, address),
        connect(socket_of(address), max_size=None) as page,
    ):
        first = (await message(page, "plots"))["times"][0]
        await page.send(json.dumps({"kind": "past", "time": first}))
        await message(page, "plots")  # although it acknowledges no frame
        server.source.revision = 2  # type: ignore[misc]
        assert (await message(page, "hello"))["swarm"] == "one"
        await message(page, "plots")


@pytest.mark.parametrize(("token", "key"), [("operator-token", "anna (pupils)"), ("viewer-1", "")])
async def test_a_page_that_commands_is_told_with_whose_key(token: str, key: str) -> None:
    access = Access("operator-token", "viewer-1", key="anna (pupils)")
    async with serving(access=access) as (_, address):
        path = socket_of(address, token)
        async with connect(path, max_size=None) as page:
            assert (await message(page, "hello")).get("key", "") == key


def test_an_overloaded_computer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert overload(4.0) == ""
    assert "load 31, 2 cores" in overload(31.0)


async def test_nonsense_of_a_page_is_ignored() -> None:
    nonsense = (
        *("[]", "{}", "1", "x", '{"kind":"select","names":[{}, 1, "r9"]}', "[" * 9999),
        *(f'{{"kind":"past","time":{one}}}' for one in ("[]", "NaN", "1e999", f"1{'0' * 999}")),
        '{"kind":"past"}',
    )
    async with serving() as (_, address), connect(socket_of(address), max_size=None) as page:
        for text in nonsense:
            await page.send(text)
        await page.send('{"kind":"act","id":[],"verb":{}}')
        assert "takes no commands" in (await message(page, "answer"))["line"]
        assert (await message(page, "rows"))["rows"]["r1"]["near"] is None


HERE = "Host: 127.0.0.1"


@pytest.mark.parametrize(
    ("request_line", "headers", "token", "code"),
    [
        ("GET /", HERE, "", 200),
        ("GET /", "Host: localhost\r\nOrigin: http://localhost", "", 200),
        # Other sites reach nothing,
        ("GET /", f"{HERE}\r\nOrigin: http://evil.example", "", 403),
        # also one whose name leads to loopback.
        ("GET /", "Host: evil.example\r\nOrigin: http://evil.example", "", 403),
        ("GET /", "Host: robots.example\r\nOrigin: http://robots.example", "operator-token", 200),
        ("GET /", "Host: robots.example\r\nOrigin: http://evil.example", "operator-token", 403),
        # Malformed requests get an answer.
        ("GET /../../../etc/passwd", HERE, "", 404),
        ("GET /%2e%2e/server.py", HERE, "", 404),
        ("GET /..", HERE, "", 404),
        (f"GET /{'x' * 3000}.js", HERE, "", 404),
        ("GET //[", HERE, "", 404),
        ("GET /", "Host: [", "", 403),
        ("GET /", f"{HERE}\r\nOrigin: http://[", "", 403),
        ("GET /", f"{HERE}\r\nHost: evil.example", "", 403),
        ("GET /", f"{HERE}\r\nOrigin: null", "", 403),
    ],
)
async def test_a_request_gets_the_page_under_its_policy_or_a_refusal_and_logs_nothing(
    request_line: str, headers: str, token: str, code: int, caplog: pytest.LogCaptureFixture
) -> None:
    async with serving(access=Access(token)) as (_, address):
        reader, writer = await connected(address)
        writer.write(f"{request_line} HTTP/1.1\r\n{headers}\r\n\r\n".encode())
        async with asyncio.timeout(CAP):
            answer = (await reader.readuntil(b"\r\n\r\n")).decode()
        writer.close()
    assert answer.split()[1] == str(code)
    assert code != 200 or re.search("content-security-policy: .*script-src 'self'", answer, re.I)
    assert [one.getMessage() for one in caplog.records if one.levelname == "ERROR"] == []


@pytest.mark.parametrize(
    ("operator", "viewer"),
    [("short", ""), ("", "viewer-token"), ("same-token", "same-token"), ("a token of words", "")],
)
def test_tokens_that_protect_nothing_are_refused(operator: str, viewer: str) -> None:
    with pytest.raises(ConfigError):
        Access(operator, viewer)


def test_a_role_follows_from_the_token() -> None:
    access = Access("operator-token", "viewer-token")
    given = ("operator-token", "viewer-token", "", "other-token", "\u00e9")
    assert [access.role(one) for one in given] == ["operator", "viewer", "", "", ""]
    assert Access().role("") == "operator"
    read_only = Access("operator-token", "viewer-token", is_read_only=True)
    assert [read_only.role(one) for one in given] == ["viewer", "viewer", "", "", ""]
    assert Access(is_read_only=True).role("") == "viewer"
    with pytest.raises(ConfigError):
        Access().check_bind("0.0.0.0")
    access.check_bind("0.0.0.0")


def test_the_page_is_small_and_loads_nothing_from_elsewhere() -> None:
    texts = [file.read_text() for file in files("swarmd.operator.view").joinpath("page").iterdir()]
    assert sum(len(text.encode()) for text in texts) < 200_000
    assert [text for text in texts if re.search(r"https?://|//cdn", text)] == []


class Faulty(OneRobot):
    """A source whose second frame fails; it notes what is selected."""

    def __init__(self) -> None:
        super().__init__()
        self.selections: list[list[str]] = []
        self.frames = 0

    def frame(self) -> tuple[float, Array]:
        self.frames += 1
        if self.frames == 2:
            raise ZeroDivisionError("a fault")
        return super().frame()

    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        return {}

    def select(self, names: Sequence[str]) -> None:
        self.selections.append(list(names))


async def test_a_frame_that_fails_is_told_and_the_next_one_comes(
    caplog: pytest.LogCaptureFixture,
) -> None:
    source = Faulty()
    async with (
        serving(source, frame_period=0.01) as (_, address),
        connect(socket_of(address)) as page,
    ):
        for _ in range(4):
            await frame(page)
    assert source.frames > 4
    assert [one.getMessage() for one in caplog.records] == ["the page got no frame"]


async def test_a_flood_of_refused_commands_of_viewers_is_read_at_a_bounded_rate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The stop of an operator is taken before most of the flood."""
    taken: list[str] = []
    take = ViewServer._take

    def counted(server: ViewServer, client: Client, text: str | bytes) -> None:
        taken.append(client.role)
        take(server, client, text)

    monkeypatch.setattr(ViewServer, "_take", counted)
    robots, loop = SilentRobots(), asyncio.get_running_loop()
    access, source = Access("operator-token", "viewer-token"), OneRobot()
    monkeypatch.setattr(source, "rows", dict)
    async with (
        serving(source, robots, access) as (_, address),
        connect(socket_of(address, "viewer-token"), close_timeout=0.1) as one,
        connect(socket_of(address, "viewer-token"), close_timeout=0.1) as other,
        connect(socket_of(address, "operator-token")) as operator,
    ):
        begin = loop.time()
        for number in range(500):
            for viewer in (one, other):
                await viewer.send(json.dumps({"kind": "act", "verb": "stop", "id": number}))
        await operator.send('{"kind": "act", "verb": "stop", "id": "s", "targets": ["r1"]}')
        assert (await message(operator, "answer"))["line"] == "stop: done"
        most = VIEWER_BURST + VIEWER_RATE * (loop.time() - begin)
        assert taken.count("viewer") <= 2.0 * most
        assert robots.verbs == ["stop"]


async def test_a_flood_of_selections_reaches_the_robots_now_and_then() -> None:
    source = Faulty()
    async with (
        serving(source, frame_period=0.01) as (_, address),
        connect(socket_of(address)) as page,
    ):
        for k in range(301):
            names = [] if k % 2 else ["r1"]
            await page.send(json.dumps({"kind": "select", "names": names}))
        async with asyncio.timeout(CAP):
            while source.selections[-1:] != [["r1"]]:
                await frame(page)
        assert len(source.selections) < 100


async def test_pages_that_answer_nothing_do_not_delay_each_others_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("swarmd.operator.view.server.CLOSE_TIME", 2.0 * CAP)
    async with serving(Faulty()) as (server, address):
        pages = [await opened(address) for _ in range(3)]
        await clients(server, 3)
        ending = asyncio.create_task(server.close("it ends"))
        try:
            async with asyncio.timeout(CAP):
                await asyncio.gather(*(reader.readuntil(b"it ends") for reader, _ in pages))
        finally:
            for _, writer in pages:
                writer.write(b"\x88\x80\0\0\0\0")
                writer.close()
            await ending


async def test_connections_that_ask_nothing_take_the_place_of_no_page(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("swarmd.operator.view.server.MAX_WAITING", 3)
    idle = []
    async with serving(access=Access("operator-token")) as (server, address):
        try:
            async with connect(socket_of(address, "operator-token"), max_size=None) as page:
                await frame(page)
                idle = [await opened(address, "wrong-token") for _ in range(3)]
                idle += [await connected(address) for _ in range(3)]
                async with asyncio.timeout(CAP):
                    for reader, _ in idle[:3]:
                        with contextlib.suppress(ConnectionError):
                            await reader.read()  # to the end
                async with asyncio.timeout(CAP):
                    while len(server._waiting) < 3:  # a connection is taken later than it is made
                        await asyncio.sleep(0.01)
                assert len(server._waiting) == 3
                await frame(page)
        finally:
            for _, writer in idle:
                writer.close()


async def test_a_page_that_sends_pings_and_reads_nothing_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("swarmd.operator.view.server.MAX_UNREAD", 10_000)
    async with serving(Faulty()) as (server, address):
        _, writer = await opened(address)
        await clients(server, 1)
        pings = (b"\x89\xfd\0\0\0\0" + b"x" * 125) * 500
        async with asyncio.timeout(CAP):
            while server.clients:
                with contextlib.suppress(ConnectionError):
                    writer.write(pings)
                    await writer.drain()
                await asyncio.sleep(0)
        writer.close()
