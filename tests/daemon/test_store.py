"""Files that are whole and on the disk in time, and a thread that writes to a slow disk."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec import Struct

from swarmd.core.clock import boottime
from swarmd.core.codec import encode
from swarmd.core.messages import Latch
from swarmd.core.pattern_manifest import Signed
from swarmd.daemon import store
from swarmd.daemon.store import CodeRecord, LatchFile, PatternFiles, RecordWriter, StateFile
from swarmd.robot.latches import Latches, LatchRecord


def test_unchanged_record_is_not_written_again(tmp_path: Path) -> None:
    file = LatchFile(tmp_path / "deep" / "down")
    assert file.read() == LatchRecord()
    record = LatchRecord(held={"e1": Latch(issuer="anna", scope="swarm")})
    assert file.store(record)
    written = file.path.stat().st_mtime_ns, file.path.stat().st_ino
    assert file.store(LatchRecord(held=dict(record.held)))
    assert (file.path.stat().st_mtime_ns, file.path.stat().st_ino) == written
    assert LatchFile(tmp_path / "deep" / "down").read() == record


def test_a_latch_keeps_its_age_while_the_machine_is_up(tmp_path: Path) -> None:
    latches = Latches()
    latches.add("e1", Latch(issuer="anna", scope="swarm", age=3.0), now=50.0)
    assert LatchFile(tmp_path).store(latches.record())
    again = Latches(LatchFile(tmp_path).read(), now=60.0)
    assert again.aged(60.0) == {"e1": Latch(issuer="anna", scope="swarm", age=13.0)}


def test_after_a_restart_of_the_machine_the_age_is_not_known(tmp_path: Path) -> None:
    held = {"e1": Latch(issuer="anna", scope="swarm")}
    record = LatchRecord(held=held, since={"e1": 4000.0}, clock="another boot")
    (tmp_path / "latches").write_bytes(encode(record))
    latches = Latches(LatchFile(tmp_path).read(), now=boottime())
    assert latches.aged(boottime()) == held


def test_failed_write_is_repeated(tmp_path: Path) -> None:
    blocker = tmp_path / "state"
    blocker.write_text("in the way")
    file, record = LatchFile(blocker), LatchRecord(cleared=("e1",))
    assert not file.store(record)
    blocker.unlink()
    assert file.store(record)
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
    assert file.store(LatchRecord(cleared=("e1",)))
    assert synced == [file.path.stat().st_ino, file.path.parent.stat().st_ino]


@pytest.mark.parametrize(
    "harm",
    [
        lambda path: path.write_bytes(b"\x01\x93 not a latch record"),
        lambda path: path.write_bytes(b""),
        lambda path: path.mkdir(),
        os.mkfifo,  # to open it would wait for a writer
    ],
    ids=["rubbish", "empty", "folder", "pipe"],
)
def test_unreadable_file_latches(tmp_path: Path, harm: Callable[[Path], object]) -> None:
    file = LatchFile(tmp_path)
    harm(file.path)
    assert Latches(file.read()).held


def test_unwritable_disk_returns_false(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    assert not LatchFile(tmp_path / "file" / "state").store(Latches().record())


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
    assert not file.store(record)
    assert file.fault
    blocker.unlink()
    assert file.check()
    assert file.fault == ""
    assert LatchFile(blocker).read() == record


def test_a_record_that_is_on_the_disk_again_is_not_replaced_by_one_that_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(path: Path, content: bytes) -> None:
        path.write_bytes(content)
        raise OSError(5, "the folder is not synced")

    file, record = LatchFile(tmp_path), LatchRecord(cleared=("e1",))
    assert file.store(record)
    with monkeypatch.context() as context:
        context.setattr(store, "write_whole", write)
        assert not file.store(LatchRecord(cleared=("e2",)))
    assert file.store(record)
    assert LatchFile(tmp_path).read() == record
    file.check()
    assert LatchFile(tmp_path).read() == record


class Note(Struct, frozen=True):
    number: int = 0


class Disk(StateFile[Note]):
    """A disk whose writes wait until `is_open` is set, and fail while `fault` is not empty."""

    def __init__(self) -> None:
        super().__init__(Path("state"), Note, "")
        self.is_open = threading.Event()
        self.written: list[int] = []
        self.asked = 0
        self.fault = ""
        self.events: list[str] = []

    def write(self, record: Note) -> None:
        self.asked += 1
        assert self.is_open.wait(60.0)
        if self.fault:
            raise OSError(5, self.fault)
        self.written.append(record.number)


@pytest.fixture
def disk() -> Disk:
    return Disk()


@pytest.fixture
def writer(disk: Disk) -> RecordWriter[Note]:
    return RecordWriter(disk, disk.events.append)


async def test_the_loop_goes_on_while_a_write_blocks_and_the_newest_record_follows(
    disk: Disk, writer: RecordWriter[Note]
) -> None:
    for record in (1, 2):
        writer.store(Note(record))
    third = asyncio.create_task(writer.write(Note(3)))
    async with asyncio.timeout(60.0):
        while not disk.asked:
            await asyncio.sleep(0.005)
    for _ in range(20):
        await asyncio.sleep(0.005)
    writer.store(Note(4))
    assert (disk.asked, disk.written, third.done()) == (1, [], False)
    disk.is_open.set()
    assert await third == ""  # a later record is on the disk
    await writer.close()
    assert disk.written == [2, 4]
    assert disk.events == []


async def test_a_fault_is_told_once_and_tried_again(
    disk: Disk, writer: RecordWriter[Note], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "RETRY_PERIOD", 0.01)
    disk.fault = "Input/output error"
    disk.is_open.set()
    assert await writer.write(Note(1)) == disk.fault
    async with asyncio.timeout(60.0):
        while disk.asked < 3:
            await asyncio.sleep(0.005)
        disk.fault = ""
        while len(disk.events) < 2:
            await asyncio.sleep(0.005)
    await writer.close()
    assert len(disk.events) == 2
    assert disk.written == [1]


async def test_a_newer_record_does_not_wait_for_the_next_try(
    disk: Disk, writer: RecordWriter[Note]
) -> None:
    disk.fault = "Input/output error"
    disk.is_open.set()
    assert await writer.write(Note(1)) == disk.fault
    disk.fault = ""
    assert await writer.write(Note(2)) == ""
    assert disk.written == [2]


async def test_a_writer_closes_although_the_disk_fails(
    disk: Disk, writer: RecordWriter[Note]
) -> None:
    disk.fault = "Input/output error"
    disk.is_open.set()
    assert await writer.write(Note(1)) == disk.fault
    await asyncio.wait_for(writer.close(), 60.0)
    assert disk.asked == 2


async def test_a_write_that_raises_something_else_ends_the_daemon() -> None:
    crashes: list[object] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda loop, context: crashes.append(context.get("exception")))

    class Broken(Disk):
        def write(self, record: Note) -> None:
            raise ValueError(record)

    RecordWriter(Broken(), lambda text: None).store(Note(1))
    async with asyncio.timeout(60.0):
        while not crashes:
            await asyncio.sleep(0.005)
    assert isinstance(crashes[0], ValueError)


def test_a_table_with_a_damaged_manifest_is_no_record(tmp_path: Path) -> None:
    files = PatternFiles(tmp_path)
    files.write(CodeRecord((Signed(b"damaged"),)))
    assert PatternFiles(tmp_path).read() == CodeRecord()
