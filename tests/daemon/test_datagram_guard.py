"""Beacons that pretend a newer roster and cannot be verified."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.daemon.datagram_guard import HINT_AGAIN, HINT_PERIOD, DatagramGuard
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.datagram import Address, Beacon, pack, tag_of
from tests.link.keyring import AUTHORITY, Keyring

TAG = tag_of("field", "lab", AUTHORITY)


@pytest.fixture
def hints() -> list[tuple[str, Address, int]]:
    return []


@pytest.fixture
def guard(tmp_path: Path, hints: list[tuple[str, Address, int]]) -> DatagramGuard:
    return DatagramGuard(
        Keyring(("r1", "r2"), ("anna",)).identity("r1"),
        TAG,
        5.0,
        tmp_path / "stops",
        DropCounter(),
        on_event=lambda text: None,
        on_newer_roster=lambda *hint: hints.append(hint),
    )


def newer(robot: str) -> bytes:
    """A beacon with a trailer of a later generation, which needs no keys."""
    body = Beacon(robot=robot, instance=b"123456", sequence=1, wire=1, state=0, revision=0)
    return pack(TAG, body) + b"\x01" + (9).to_bytes(4, "big") + bytes(24)


def test_hints_of_one_host_leave_room_for_those_of_others(
    guard: DatagramGuard, hints: list[tuple[str, Address, int]]
) -> None:
    honest = ("10.0.0.2", 7440)
    for step in range(200):  # 20 s
        now = step / 10.0
        for port in range(3):
            assert guard.author_of(newer("r9"), ("10.0.0.66", 5000 + port), now) is None
        guard.author_of(newer("r2"), honest, now)
    asked = [source for _, source, _ in hints]
    assert asked.count(honest) >= 1
    assert len(asked) <= 20.0 / HINT_PERIOD + 1
    assert sum(host == "10.0.0.66" for host, _ in asked) <= 20.0 / HINT_AGAIN + 1
    assert hints[0] == ("r9", ("10.0.0.66", 5000), 9)
