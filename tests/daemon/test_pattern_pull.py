"""What a robot pulls when beacons show other pushed patterns; over the network: tests/swarm."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.pattern_manifest import (
    Entry,
    PatternManifest,
    Signed,
    digest_of,
    encode_manifest,
    encode_table,
    merged,
    read_entry,
)
from swarmd.daemon.pattern_transfer import CODE_PERIOD, FALSE_PERIOD, TABLE_PERIOD, PatternPull
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.robot.pushed_pattern import PushedPattern, Version
from tests.daemon.test_pattern_transfer import Rig

ADDRESS = ("10.0.0.7", 7440)
CHECKED = 100.2  # s: the end of each check of a table


def entry(name: str, generation: int = 1, code: bytes = b"x = 1\n") -> Entry:
    digest = hashlib.sha256(code).digest()
    manifest = PatternManifest(
        swarm="lab",
        name=name,
        generation=generation,
        issuer="alice",
        kind="file",
        digest=digest,
        size=len(code),
    )
    return read_entry(Signed(encode_manifest(manifest)))


class Pulls:
    """A puller that keeps what is asked: (peer, what, name), and hands the answers out later."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str, str]] = []
        self.done: Callable[[bytes | None, str], object] = lambda blob, why: None

    def pull(
        self,
        peer: str,
        address: Any,
        what: str,
        name: str = "",
        *,
        limit: int = 0,
        digest: bytes | None = None,
        on_done: Callable[[bytes | None, str], object],
    ) -> bool:
        self.asked.append((peer, what, name))
        self.done = on_done
        return True


@pytest.fixture
def rig(runner: asyncio.Runner, tmp_path: Path) -> Rig:
    made = Rig(tmp_path)
    runner.run(made.start())
    return made


def sync_of(rig: Rig) -> tuple[PatternPull, Pulls]:
    pulls = Pulls()
    return PatternPull(
        rig.state,
        rig.store,
        pulls,  # type: ignore[arg-type]
        lambda robot, entry: None,
        DropCounter(),
        clock=lambda: CHECKED,
    ), pulls


async def settled(sync: PatternPull) -> None:
    async with asyncio.timeout(20.0):
        while sync._checking is not None:
            await asyncio.sleep(0.005)


async def test_the_table_is_pulled_and_then_the_code(rig: Rig) -> None:
    sync, pulls = sync_of(rig)
    table = merged((), [entry("own", 3)])
    sync.on_beacon("r2", digest_of(table), ADDRESS, 100.0)
    assert pulls.asked == [("r2", "patterns", "")]
    pulls.done(encode_table(table), "")
    await settled(sync)
    assert rig.state.table == table
    assert pulls.asked[1:] == [("r2", "pattern", entry("own").manifest.digest.hex())]
    sync.on_beacon("r2", digest_of(table), ADDRESS, 100.5)
    assert len(pulls.asked) == 2  # the same is asked once in a while
    sync.on_beacon("r3", digest_of(table), ADDRESS, 101.0)
    assert pulls.asked[2:] == [("r3", "pattern", entry("own").manifest.digest.hex())]


async def test_nothing_is_asked_while_all_agree_or_the_other_is_behind(rig: Rig) -> None:
    sync, pulls = sync_of(rig)
    rig.store.merge([entry("own", 3)])
    rig.state.versions["own"] = PushedPattern().accept(Version.of(entry("own", 3), "alice"))
    sync.on_beacon("r2", rig.state.digest, ADDRESS, 100.0)
    sync.on_beacon("r2", digest_of(merged((), [entry("own", 2)])), ADDRESS, 101.0)
    sync.on_beacon("r2", b"", ADDRESS, 102.0)
    assert pulls.asked == []


async def test_a_table_of_strangers_is_left_out_and_not_asked_for_again_at_once(rig: Rig) -> None:
    rig.secure()
    sync, pulls = sync_of(rig)
    table = merged((), [entry(f"own{number}", number) for number in range(1, 20)])
    digest = digest_of(table)
    sync.on_beacon("r2", digest, ADDRESS, 100.0)
    pulls.done(encode_table(table), "")
    await settled(sync)
    assert rig.state.table == ()
    sync.on_beacon("r2", digest, ADDRESS, 100.0 + TABLE_PERIOD - 1.0)
    assert len(pulls.asked) == 1
    sync.on_beacon("r2", digest, ADDRESS, CHECKED + FALSE_PERIOD - 0.1)
    assert len(pulls.asked) == 1
    sync.on_beacon("r2", digest, ADDRESS, CHECKED + FALSE_PERIOD)
    assert len(pulls.asked) == 2


async def test_a_peer_that_does_not_answer_is_asked_again(rig: Rig) -> None:
    sync, pulls = sync_of(rig)
    digest = digest_of(merged((), [entry("own", 3)]))
    sync.on_beacon("r2", digest, ADDRESS, 100.0)
    pulls.done(None, "not reached")
    sync.on_beacon("r2", digest, ADDRESS, 100.0 + CODE_PERIOD)
    assert len(pulls.asked) == 2
