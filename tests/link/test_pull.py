"""Blobs that one robot pulls from another over real sessions."""

from __future__ import annotations

import asyncio
import hashlib
import os
from collections.abc import Iterator

import pytest

from swarmd.core.errors import NetworkError
from swarmd.link.carriers.bus import ZenohBus
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.carriers.session import open_listening, session_options
from swarmd.link.datagram import Address
from swarmd.link.settings import NetworkSettings, parse_endpoint
from swarmd.link.spread.pull import PIECE, Puller, pull, serve_shared

BLOBS = {"small": b"abc", "large": os.urandom(3 * PIECE + 17), "": b"the table", "empty": b""}


@pytest.fixture
def peer(runner: asyncio.Runner, settings: NetworkSettings) -> Iterator[Address]:
    """The address of robot r01, which shares BLOBS."""
    options = session_options(settings)
    session, endpoint = open_listening("tcp/127.0.0.1:0", options, "a test")

    async def make() -> ZenohBus:
        bus = ZenohBus(session, swarm=settings.swarm, robot="r01", drops=DropCounter())
        serve_shared(bus, "pattern", lambda name, asker: BLOBS.get(name))
        return bus

    bus = runner.run(make())
    parsed = parse_endpoint(endpoint)
    yield parsed.host, parsed.port
    bus.close()
    session.close()


@pytest.mark.parametrize("name", BLOBS)
async def test_a_blob_is_pulled_whole(name: str, settings: NetworkSettings, peer: Address) -> None:
    digest = hashlib.sha256(BLOBS[name]).digest()
    found = await pull(settings, "r01", peer, "pattern", "r02", name=name, digest=digest)
    assert found == BLOBS[name]


async def test_a_blob_that_is_missing_too_long_or_another_is_refused(
    settings: NetworkSettings, peer: Address
) -> None:
    with pytest.raises(NetworkError, match="not here"):
        await pull(settings, "r01", peer, "pattern", "r02", name="other")
    with pytest.raises(NetworkError, match="at most 2 "):
        await pull(settings, "r01", peer, "pattern", "r02", name="small", limit=2)
    with pytest.raises(NetworkError, match="SHA-256"):
        await pull(settings, "r01", peer, "pattern", "r02", name="small", digest=bytes(32))


async def test_a_pull_from_an_address_at_which_nothing_listens_ends(
    settings: NetworkSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("swarmd.link.carriers.session.PULL_LINK_TIMEOUT", 0.3)
    done: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    puller = Puller(settings, "r02", drops=DropCounter())

    def on_done(blob: bytes | None, why: str) -> None:
        assert blob is None
        done.set_result(why)

    assert puller.pull("r01", ("127.0.0.1", 9), "pattern", on_done=on_done)
    assert not puller.pull("r01", ("127.0.0.1", 9), "pattern", on_done=on_done)  # one at a time
    async with asyncio.timeout(20.0):
        assert "127.0.0.1:9" in await done
    puller.close()
