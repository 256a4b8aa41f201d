from __future__ import annotations

import os
from pathlib import Path

import pytest

from swarmd.core.messages import Latch
from swarmd.daemon.latchfile import LatchFile
from swarmd.robot.latches import MAX_CLEARED, MAX_HELD, OVERFLOW, Latches, LatchRecord

SWARM = Latch(issuer="alice", scope="swarm")


def test_reset_clears_only_its_ids() -> None:
    latches = Latches()
    latches.add("a", SWARM)
    latches.add("b", SWARM)
    latches.clear(["a"])
    assert set(latches.held) == {"b"}


def test_reset_latch_returns_by_estop_but_not_by_a_peer() -> None:
    latches = Latches()
    latches.add("a", SWARM)
    latches.clear(["a"])
    assert latches.adopt({"a": SWARM}) == ()
    assert not latches.held
    assert latches.add("a", SWARM)
    assert set(latches.held) == {"a"}


def test_reset_ids_survive_a_restart() -> None:
    latches = Latches()
    latches.add("a", SWARM)
    latches.clear(["a"])
    again = Latches(latches.record())
    assert again.adopt({"a": SWARM, "b": SWARM}) == ("b",)


def test_flood_of_estops_stays_latched_within_bounds() -> None:
    latches = Latches()
    for n in range(10_000):
        latches.add(f"e{n}", SWARM)
    assert len(latches.held) == MAX_HELD + 1
    assert latches.held[OVERFLOW].scope == "robots"  # the others already hold every peer
    latches.clear(f"e{n}" for n in range(10_000))
    assert set(latches.held) == {OVERFLOW}
    assert len(latches.record().cleared) == MAX_CLEARED


def test_unchanged_record_is_not_written_again(tmp_path: Path) -> None:
    file = LatchFile(tmp_path / "deep" / "down")
    assert file.read() == LatchRecord()
    record = LatchRecord(held={"e1": Latch(issuer="anna", scope="swarm")})
    assert file.write(record)
    written = file.path.stat().st_mtime_ns, file.path.stat().st_ino
    assert file.write(LatchRecord(held=dict(record.held)))
    assert (file.path.stat().st_mtime_ns, file.path.stat().st_ino) == written
    assert LatchFile(tmp_path / "deep" / "down").read() == record


def test_failed_write_is_repeated(tmp_path: Path) -> None:
    blocker = tmp_path / "state"
    blocker.write_text("in the way")
    file, record = LatchFile(blocker), LatchRecord(cleared=("e1",))
    assert not file.write(record)
    blocker.unlink()
    assert file.write(record)
    assert LatchFile(blocker).read() == record


def test_file_and_folder_are_synced_before_the_ack(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    really = os.fsync

    def fsync(descriptor: int) -> None:
        synced.append(os.fstat(descriptor).st_ino)
        really(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    file = LatchFile(tmp_path / "state")
    assert file.write(LatchRecord(cleared=("e1",)))
    assert synced == [file.path.stat().st_ino, file.path.parent.stat().st_ino]


def test_unreadable_file_latches(tmp_path: Path) -> None:
    file = LatchFile(tmp_path)
    file.path.write_bytes(b"rubbish")
    assert Latches(file.read()).held


def test_unwritable_disk_returns_false(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    assert not LatchFile(tmp_path / "file" / "state").write(Latches().record())
