from __future__ import annotations

import os
from pathlib import Path

import pytest

from swarmd.core.messages import Latch
from swarmd.daemon.store import LatchFile
from swarmd.robot.latches import Latches, LatchRecord


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


def test_a_folder_that_cannot_be_written_is_a_fault_until_it_can(tmp_path: Path) -> None:
    blocker = tmp_path / "state"
    blocker.write_text("in the way")
    file = LatchFile(blocker)
    assert file.check()
    assert str(blocker) in file.fault
    assert not file.check()  # nothing has changed
    blocker.unlink()
    assert file.check()
    assert file.fault == ""


def test_a_latch_in_memory_is_written_once_that_is_possible(tmp_path: Path) -> None:
    blocker = tmp_path / "state"
    blocker.write_text("in the way")
    file, record = LatchFile(blocker), LatchRecord(cleared=("e1",))
    assert not file.write(record)
    assert file.fault
    blocker.unlink()
    assert file.check()
    assert file.fault == ""
    assert LatchFile(blocker).read() == record
