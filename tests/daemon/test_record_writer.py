"""Records that a thread writes to a disk that is slow or fails."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import pytest

from swarmd.daemon import record_writer
from swarmd.daemon.record_writer import RecordWriter

PATH = Path("state")


class Disk:
    """A disk whose writes wait until `is_open` is set, and fail while `fault` is not empty."""

    def __init__(self) -> None:
        self.is_open = threading.Event()
        self.written: list[int] = []
        self.asked = 0
        self.fault = ""
        self.events: list[str] = []

    def write(self, record: int) -> None:
        self.asked += 1
        assert self.is_open.wait(60.0)
        if self.fault:
            raise OSError(5, self.fault)
        self.written.append(record)


@pytest.fixture
def disk() -> Disk:
    return Disk()


@pytest.fixture
def writer(disk: Disk) -> RecordWriter[int]:
    return RecordWriter(PATH, disk.write, disk.events.append)


async def test_the_loop_goes_on_while_a_write_blocks_and_the_newest_record_follows(
    disk: Disk, writer: RecordWriter[int]
) -> None:
    for record in (1, 2):
        writer.store(record)
    third = asyncio.create_task(writer.write(3))
    async with asyncio.timeout(60.0):
        while not disk.asked:
            await asyncio.sleep(0.005)
    for _ in range(20):
        await asyncio.sleep(0.005)
    writer.store(4)
    assert (disk.asked, disk.written, third.done()) == (1, [], False)
    disk.is_open.set()
    assert await third == ""  # a later record is on the disk
    await writer.close()
    assert disk.written == [2, 4]
    assert disk.events == []


async def test_a_fault_is_told_once_and_tried_again(
    disk: Disk, writer: RecordWriter[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_writer, "RETRY_PERIOD", 0.01)
    disk.fault = "Input/output error"
    disk.is_open.set()
    assert await writer.write(1) == disk.fault
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
    disk: Disk, writer: RecordWriter[int]
) -> None:
    disk.fault = "Input/output error"
    disk.is_open.set()
    assert await writer.write(1) == disk.fault
    disk.fault = ""
    assert await writer.write(2) == ""
    assert disk.written == [2]


async def test_a_writer_closes_although_the_disk_fails(
    disk: Disk, writer: RecordWriter[int]
) -> None:
    disk.fault = "Input/output error"
    disk.is_open.set()
    assert await writer.write(1) == disk.fault
    await asyncio.wait_for(writer.close(), 60.0)
    assert disk.asked == 2


async def test_a_write_that_raises_something_else_ends_the_daemon() -> None:
    crashes: list[object] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda loop, context: crashes.append(context.get("exception")))

    def write(record: int) -> None:
        raise ValueError(record)

    broken = RecordWriter(PATH, write, lambda text: None)
    broken.store(1)
    async with asyncio.timeout(60.0):
        while not crashes:
            await asyncio.sleep(0.005)
    assert isinstance(crashes[0], ValueError)
