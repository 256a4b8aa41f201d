"""Each listener of the project that a browser on this computer can reach, under foreign origins.

A browser lets every page connect to loopback, by WebSocket or by a request whose answer the page
cannot read, and names the page's origin. A name of the page's own may lead to loopback, too.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager, closing
from urllib.parse import urlsplit

import pytest

from swarmd.link.carriers.robot_link import RobotServer
from swarmd.link.carriers.session import open_listening
from swarmd.operator.view.access import Access
from swarmd.operator.view.server import ViewServer
from tests.operator.view.test_server import OneRobot
from tests.support.processes import CAP

TOKEN = "a-token-of-words"
OPEN, CLOSED, REFUSED, SILENT = "open", "closed", "403", ""
"""The connection is open; is open until the server has seen the wrong token; is none."""

Listener = Callable[[], AbstractAsyncContextManager[str]]


def page_of(access: Access, path: str) -> Listener:
    @asynccontextmanager
    async def listener() -> AsyncIterator[str]:
        server = ViewServer(OneRobot(), None, access)
        address = urlsplit(await server.start("127.0.0.1", 0))
        try:
            yield f"{address.netloc}{path}"
        finally:
            await server.close()

    return listener


@asynccontextmanager
async def robots_link() -> AsyncIterator[str]:
    with closing(RobotServer("tcp/127.0.0.1:0", "meadow", ["r1"], "the world")) as server:
        over = threading.Event()

        def take() -> None:
            while not over.wait(0.01):
                server.receive()

        taking = asyncio.create_task(asyncio.to_thread(take))
        try:
            yield server.endpoint.removeprefix("tcp/")
        finally:
            over.set()
            await taking


_ZENOH = {"transport/unicast/accept_timeout": 200}  # ms; what is no Zenoh waits for its end


@asynccontextmanager
async def zenoh() -> AsyncIterator[str]:
    session, endpoint = open_listening("tcp/127.0.0.1:0", _ZENOH, "a test")
    try:
        yield endpoint.removeprefix("tcp/")
    finally:
        session.close()


LISTENERS: dict[str, tuple[Listener, str, str, str]] = {
    # The listener, and what a page of its own, a foreign origin, and a foreign name get.
    "page": (page_of(Access(), "/socket"), OPEN, REFUSED, REFUSED),
    "page with token": (page_of(Access(TOKEN), f"/socket?token={TOKEN}"), OPEN, REFUSED, OPEN),
    "page without its token": (page_of(Access(TOKEN), "/socket"), CLOSED, REFUSED, CLOSED),
    "link of simulated robots": (robots_link, SILENT, SILENT, SILENT),
    "zenoh": (zenoh, SILENT, SILENT, SILENT),
}
HERE, EVIL = "{host}", "evil.example:{port}"
REQUESTS = {
    # Index of the result in LISTENERS, headers Host and Origin.
    "own": (1, HERE, "http://{host}"),
    "a program": (1, HERE, None),
    "foreign": (2, HERE, "https://evil.example"),
    "null": (2, HERE, "null"),
    "another port": (2, HERE, "http://127.0.0.1:1"),
    "a longer name": (2, HERE, "http://{host}.evil.example"),
    "a file": (2, HERE, "file://"),
    "rebound": (3, EVIL, f"http://{EVIL}"),
    "rebound, no origin": (3, EVIL, None),
}


@pytest.mark.long
@pytest.mark.parametrize("listener", LISTENERS)
async def test_pages_of_other_sites_reach_no_listener(listener: str) -> None:
    make, *results = LISTENERS[listener]
    async with make() as place:
        host, _, path = place.partition("/")
        found, wanted = {}, {}
        for name, (result, served, origin) in REQUESTS.items():
            names = {"host": host, "port": host.rpartition(":")[2]}
            heads = [f"Host: {served.format(**names)}"]
            heads += [f"Origin: {origin.format(**names)}"] if origin is not None else []
            found[name] = await upgraded(host, f"/{path}", heads)
            wanted[name] = results[result - 1]
    assert found == wanted


async def upgraded(host: str, path: str, heads: list[str]) -> str:
    """What a request for a WebSocket gets."""
    words = [
        f"GET {path} HTTP/1.1",
        *heads,
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
    ]
    name, _, port = host.rpartition(":")
    async with asyncio.timeout(CAP):
        reader, writer = await asyncio.open_connection(name, int(port))
        try:
            writer.write("\r\n".join([*words, "", ""]).encode())
            answer = await reader.readuntil(b"\r\n\r\n")
            code = answer.split()[1].decode()
            if code != "101":
                return code
            first = await reader.readexactly(1)
            return CLOSED if first == b"\x88" else OPEN
        except (asyncio.IncompleteReadError, ConnectionError):
            return SILENT
        finally:
            writer.close()
