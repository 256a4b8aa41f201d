"""The files of the audit log: order, pages, rotation, restarts and a disk that fails."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from swarmd.core.verbs import AuditEntry, AuditQuery
from swarmd.daemon import audit
from swarmd.daemon.audit import FILES, MAX_PENDING, AuditLog
from tests.support.processes import CAP, wait_until

ENTRY = AuditEntry(
    boot=1.0,
    clock="c",
    operator="anna",
    source="10.0.0.5",
    verb="stop",
    what="stop",
    result="applied",
)


def age_of(entry: AuditEntry) -> float | None:
    return 100.0 - entry.boot if entry.clock == "c" else None


def entries(folder: Path, **query: float) -> list[AuditEntry]:
    return AuditLog(folder, print).read(AuditQuery(**query), age_of)[0]  # type: ignore[arg-type]


@pytest.fixture
def events() -> list[str]:
    return []


@contextlib.contextmanager
def opened(folder: Path, events: list[str], max_bytes: int = 1 << 20) -> Iterator[AuditLog]:
    log = AuditLog(folder, events.append, max_bytes=max_bytes)
    yield log
    log.close()


def test_entries_are_json_lines_numbered_across_restarts(tmp_path: Path, events: list[str]) -> None:
    for boot in (1.0, 2.0):
        with opened(tmp_path / "r1", events) as log:
            log.add(replace(ENTRY, boot=boot))
    lines = (tmp_path / "r1/audit.jsonl").read_text().splitlines()
    assert [json.loads(line)["seq"] for line in lines] == [1, 2]
    assert [one.boot for one in entries(tmp_path / "r1")] == [1.0, 2.0]
    assert events == []


def test_pages_go_back_in_time_and_end(tmp_path: Path, events: list[str]) -> None:
    with opened(tmp_path, events) as log:
        for boot in range(10):
            log.add(replace(ENTRY, boot=float(boot)))
    log = AuditLog(tmp_path, print)
    page, has_more, _ = log.read(AuditQuery(count=4), age_of)
    assert ([one.seq for one in page], has_more) == ([7, 8, 9, 10], True)
    page, has_more, _ = log.read(AuditQuery(count=6, before=7), age_of)
    assert ([one.seq for one in page], has_more) == ([1, 2, 3, 4, 5, 6], False)
    assert [one.seq for one in entries(tmp_path, since=93.5)] == [8, 9, 10]


def test_what_is_of_unknown_age_is_not_since(tmp_path: Path, events: list[str]) -> None:
    with opened(tmp_path, events) as log:
        log.add(replace(ENTRY, clock="before the reboot"))
        log.add(ENTRY)
    assert [one.seq for one in entries(tmp_path, since=1000.0)] == [2]


def test_files_are_rotated_and_bounded(tmp_path: Path, events: list[str]) -> None:
    with opened(tmp_path, events, max_bytes=1000) as log:
        for boot in range(60):
            log.add(replace(ENTRY, boot=float(boot)))
    assert log._thread is not None
    log._thread.join(CAP)  # `close` does not wait for a thread that a busy machine delays
    files = sorted(tmp_path.iterdir())
    assert len(files) == FILES
    assert all(file.stat().st_size <= 1000 for file in files)
    numbers = [one.seq for one in entries(tmp_path)]
    assert numbers == list(range(numbers[0], 61))
    assert 1 < numbers[0] < 61


def test_a_damaged_line_is_left_out(tmp_path: Path, events: list[str]) -> None:
    with opened(tmp_path, events) as log:
        log.add(ENTRY)
    with (tmp_path / "audit.jsonl").open("ab") as file:
        file.write(b'{"seq": 2, "bo\n\xff\xfe\n')
    with opened(tmp_path, events) as log:
        log.add(ENTRY)
    assert [one.seq for one in entries(tmp_path)] == [1, 2]


def test_a_failing_disk_is_told_once_and_what_was_lost_is_counted(
    tmp_path: Path, events: list[str]
) -> None:
    folder = tmp_path / "r1"
    folder.write_text("a file where the folder would be")
    log = AuditLog(folder, events.append)
    for _ in range(3):
        log._write(ENTRY)
    assert len(events) == 1
    assert log.fault
    folder.unlink()
    log._write(ENTRY)
    assert len(events) == 2
    assert log.fault == ""
    (entry,) = entries(folder)
    assert (entry.seq, entry.left_out) == (1, 3)


def test_a_slow_disk_never_blocks_and_its_losses_are_counted(
    tmp_path: Path, events: list[str]
) -> None:
    with opened(tmp_path, events) as log, log._lock:  # the disk hangs
        for _ in range(MAX_PENDING + 20):
            log.add(ENTRY)
    written = [json.loads(line) for line in (tmp_path / "audit.jsonl").read_text().splitlines()]
    lost = sum(one.get("left_out", 0) for one in written)
    assert 0 < lost <= 20
    assert len(written) + lost == MAX_PENDING + 20


def test_entries_that_are_still_being_written_are_read(
    tmp_path: Path, events: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pause, write = threading.Event(), AuditLog._write

    def slowly(log: AuditLog, entry: AuditEntry) -> None:
        pause.wait(0.02)
        write(log, entry)

    monkeypatch.setattr(AuditLog, "_write", slowly)
    monkeypatch.setattr(audit, "READ_TIMEOUT", CAP)
    with opened(tmp_path, events) as log:
        assert log.read(AuditQuery(), age_of) == ([], False, "")
        for count in range(1, 6):
            log.add(ENTRY)
            found, _, fault = log.read(AuditQuery(), age_of)
            assert ([one.seq for one in found], fault) == (list(range(1, count + 1)), "")


@pytest.mark.parametrize("entries", [1, MAX_PENDING + 20])
def test_a_question_says_that_the_disk_hangs(
    tmp_path: Path, events: list[str], entries: int
) -> None:
    with opened(tmp_path, events) as log:
        log.add(ENTRY)
        wait_until(lambda: len(log.read(AuditQuery(), age_of)[0]) == 1, "an entry is written")
        with log._lock:  # the disk hangs
            for _ in range(entries):
                log.add(ENTRY)
            found, _, fault = log.read(AuditQuery(), age_of)
            assert (found, "the newest entries are missing" in fault) == ([], True)
        wait_until(lambda: log.read(AuditQuery(), age_of)[2] == "", "the disk has taken them")
