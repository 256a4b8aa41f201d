"""The audit log of a robot: each answered request gives a log line and an audit entry.

`Audit` is pure: it limits the rates, and makes the line and the entry. `AuditLog` writes the
entries to disk, in rotated files.
"""

from __future__ import annotations

import logging
import os
import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec.structs import replace

from swarmd.core.clock import FIRST_WALL
from swarmd.core.files import read_regular
from swarmd.core.messages import Code, Reply
from swarmd.core.token_bucket import TokenBucket
from swarmd.core.verbs import MAX_PART, VERBS, AnyRequest, AuditEntry, AuditQuery, shortened

log = logging.getLogger(__name__)

MAX_LINE = 300  # characters
MAX_WHAT = 120  # characters of a request

APPLIED_RATE = 2.0
APPLIED_BURST = 20.0
OTHER_RATE = 0.2
OTHER_BURST = 5.0
"""Lines per second: refused junk must not displace the lines of applied requests."""
APPLIED_ENTRIES = 20.0
OTHER_ENTRIES = 0.1
ENTRY_BURST = 200.0
"""Entries per second, and the burst: the files have room for more than the log has. `OTHER` holds
for repeats of a stop, too. At 2 a second refused stops filled the files in 97 minutes; by
the rate of applied requests a node that repeats a stop filled them in 11."""
MAX_STOPS = 16
"""Stops that are known again between two other requests."""
PEER_RATE = 0.1
PEER_BURST = 50.0
"""Lines and entries per second for messages that robots relay: a stolen robot can invent stops,
latches and goals, which must not displace the requests of operators in the files."""
HANDED_ON = "handed on by "


class Audit:
    """Makes a log line and an audit entry for each request, within limits of the rates.

    Requests beyond the limits are counted. `write` takes a line, `keep` an entry. `clock`: the id
    of the clock of `now`, another id after each boot of the machine. `wall` returns s since 1970.
    `role_of(name)` returns the name of the permit of a key; empty without a permit.
    """

    def __init__(
        self,
        write: Callable[[str], None],
        keep: Callable[[AuditEntry], None] = lambda entry: None,
        *,
        clock: str = "",
        wall: Callable[[], float] = lambda: 0.0,
        role_of: Callable[[str], str] = lambda name: "",
    ) -> None:
        self._write = write
        self._keep = keep
        self._clock = clock
        self._wall = wall
        self._role_of = role_of
        self._lines = _Limits(APPLIED_RATE, APPLIED_BURST, OTHER_RATE, OTHER_BURST)
        self._entries = _Limits(APPLIED_ENTRIES, ENTRY_BURST, OTHER_ENTRIES, ENTRY_BURST)
        self._peer_lines = _Limits(PEER_RATE, PEER_BURST, PEER_RATE, PEER_BURST)
        self._peer_entries = _Limits(PEER_RATE, PEER_BURST, PEER_RATE, PEER_BURST)
        # Verb, operator, source and code of the stops that were kept since another request.
        self._stops: set[tuple[str, ...]] = set()

    def record(
        self,
        what: str,
        operator: str,
        source: str,
        reply: Reply,
        now: float,
        *,
        targets: int | None = None,
        is_relayed: bool = False,
    ) -> None:
        """Make the audit entry and the log line of a request and its reply, if the rates permit.

        Entries and lines have separate rate limits. `what`: the request in words, which begin with
        the verb. `source`: the address of the sender. `now` in s. `targets`: the count of target
        robots, None for all. `is_relayed`: `source` is another robot, which may have invented the
        operator. So the source becomes "handed on by ...", and lower limits hold.
        """
        line_limits = self._lines
        entry_limits = self._entries
        if is_relayed:
            source = f"{HANDED_ON}{source}"
            line_limits = self._peer_lines
            entry_limits = self._peer_entries
        result = reply.code if reply.refusal is None else f"{reply.code} ({reply.refusal})"
        is_stop = what.startswith(("stop", "estop"))
        is_applied = reply.code is Code.APPLIED or (is_stop and reply.code is Code.FAILED)

        # `take` returns how many entries were left out since the last entry, None if the rate does
        # not permit this entry.
        stop = what.partition(" ")[0], operator, source, reply.code
        is_counted = is_applied and stop not in self._stops
        omitted_entries = entry_limits.take(is_counted, now)
        if is_applied and not is_stop:
            self._stops.clear()
        if omitted_entries is not None:
            if is_stop and len(self._stops) < MAX_STOPS:
                self._stops.add(stop)
            entry = self._entry(what, operator, source, result, reply.text, now)
            self._keep(replace(entry, targets=targets, left_out=omitted_entries))

        omitted_lines = line_limits.take(is_counted, now)
        if omitted_lines is not None:
            # "by anna from 10.0.0.2", or "by anna, handed on by robot2"
            link = "," if is_relayed else " from"
            origin = f"by {shortened(operator)}{link} {shortened(source)}"
            line = f"{shortened(what, MAX_WHAT)}, {origin}: {result}: {reply.text}"
            self._write_line(line.removesuffix(": "), omitted_lines)

    def _write_line(self, line: str, omitted: int) -> None:
        """Write a line of the log; `omitted`: lines left out before, which the line tells."""
        line = printable(line)
        if omitted:
            line = f"[{omitted} requests left out of this log] {line}"
        self._write(line[:MAX_LINE])

    def note(self, what: str, operator: str, source: str, text: str, now: float) -> None:
        """Make the entry of a change without a request, such as a latch of a peer; no line."""
        self._stops.clear()  # a stop after a change is no repeat
        omitted = self._peer_entries.take(True, now)
        if omitted is not None:
            entry = self._entry(what, operator, source, "taken", text, now)
            self._keep(replace(entry, left_out=omitted))

    def _entry(
        self, what: str, operator: str, source: str, result: str, text: str, now: float
    ) -> AuditEntry:
        wall = self._wall()
        return AuditEntry(
            boot=round(now, 3),
            clock=self._clock,
            wall=round(wall, 3) if wall >= FIRST_WALL else None,
            operator=printable(shortened(operator, 128)),
            permit=self._role_of(operator),
            source=printable(shortened(source)),
            verb=printable(what.partition(" ")[0][:MAX_PART]),
            what=printable(shortened(what, MAX_WHAT)),
            result=result[:MAX_PART],
            text=printable(text[:MAX_LINE]),
        )


class _Limits:
    """Rate limits for applied and for other requests, and the count of requests left out."""

    def __init__(self, applied: float, applied_burst: float, others: float, burst: float) -> None:
        self._applied = TokenBucket(applied, applied_burst)
        self._others = TokenBucket(others, burst)
        self._left_out = 0

    def take(self, is_applied: bool, now: float) -> int | None:
        """The count of requests left out before this request; None: leave this request out, too."""
        if not (self._applied if is_applied else self._others).take(1.0, now):
            self._left_out += 1
            return None
        left_out = self._left_out
        self._left_out = 0
        return left_out


def describe_request(request: AnyRequest) -> str:
    """A request in words, such as `run drive speed=0.1 to 3 robots`."""
    targets = request.targets
    if targets is None:
        count = "all robots"
    else:
        count = "1 robot" if len(targets) == 1 else f"{len(targets)} robots"
    return " ".join(filter(None, (request.verb, VERBS[request.verb].audit(request), "to", count)))


def printable(text: str) -> str:
    """The text in one line: an operator's name must not start a new line of a log."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else "?" for char in text)


MAX_BYTES = 1 << 20  # bytes of a file
FILES = 4
MAX_PENDING = 256  # entries that wait for the disk
CLOSE_TIMEOUT = 1.0  # s that the end of the daemon waits for the disk
READ_TIMEOUT = 0.5  # s that a question waits for entries that are being written

_encoder = msgspec.json.Encoder()
_decoder = msgspec.json.Decoder(AuditEntry)


class AuditLog:
    """The audit files in `folder`, each of at most `max_bytes`.

    A thread of its own writes the entries. That thread calls `on_event` with a line for the user
    when the disk fails, and when the disk works again.
    """

    def __init__(
        self, folder: Path, on_event: Callable[[str], None], *, max_bytes: int = MAX_BYTES
    ) -> None:
        self._folder = folder
        self._on_event = on_event
        self._max_bytes = max_bytes
        self._queue: queue.Queue[AuditEntry | threading.Event | None] = queue.Queue(MAX_PENDING)
        self._lock = threading.Lock()  # guards the files
        self._thread: threading.Thread | None = None
        self._seq: int | None = None
        # Counts of entries: dropped by the loop, not written by the thread, and reported as lost.
        self._unqueued = 0
        self._unwritten = 0
        self._reported = 0
        self.fault = ""

    def add(self, entry: AuditEntry) -> None:
        """Queue an entry for the thread; never blocks. A full queue drops and counts the entry."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="swarmd-audit", daemon=True)
            self._thread.start()
        try:
            self._queue.put_nowait(entry)
        except queue.Full:
            self._unqueued += 1

    def close(self) -> None:
        """Wait for CLOSE_TIMEOUT at most until the queued entries are written."""
        if self._thread is not None:
            with suppress(queue.Full):
                self._queue.put_nowait(None)
            self._thread.join(CLOSE_TIMEOUT)

    def read(
        self, query: AuditQuery, age_of: Callable[[AuditEntry], float | None]
    ) -> tuple[list[AuditEntry], bool, str]:
        """Read the entries that match a query, oldest first.

        Also returns whether older entries match, and a fault of the disk (empty without a fault).
        `age_of` returns the age of an entry in s; None: unknown. With `query.since`, entries that
        are older or of unknown age are left out. Damaged lines are left out.

        Blocks until the queued entries are written, for READ_TIMEOUT at most. If the queue is not
        empty by then, the result lacks the queued entries, and the fault says so.
        """
        slow = f"audit log {self._path(0)}: the disk is slow, and the newest entries are missing"
        is_whole = self._await_queued()
        if not self._lock.acquire(timeout=READ_TIMEOUT):
            return [], False, slow
        try:
            entries, has_more = self._matching(query, age_of)
        finally:
            self._lock.release()
        return entries, has_more, self.fault or ("" if is_whole else slow)

    def _await_queued(self) -> bool:
        """Wait for READ_TIMEOUT at most; True once all earlier entries have left the queue."""
        if self._thread is None or not self._thread.is_alive():
            return True
        reached = threading.Event()
        with suppress(queue.Full):
            self._queue.put_nowait(reached)
        return reached.wait(READ_TIMEOUT)

    def _matching(
        self, query: AuditQuery, age_of: Callable[[AuditEntry], float | None]
    ) -> tuple[list[AuditEntry], bool]:
        entries: list[AuditEntry] = []
        for entry in self._newest_first():
            if query.before is not None and entry.seq >= query.before:
                continue
            age = age_of(entry)
            if query.since is not None and (age is None or age > query.since):
                continue
            if len(entries) == query.count:
                return entries[::-1], True
            entries.append(entry)
        return entries[::-1], False

    # On the thread

    def _run(self) -> None:
        while (entry := self._queue.get()) is not None:
            if isinstance(entry, threading.Event):
                entry.set()
                continue
            with self._lock:
                self._write(entry)

    def _write(self, entry: AuditEntry) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if self._seq is None:
                self._seq = next((newest.seq for newest in self._newest_first()), 0)
            lost = self._unqueued + self._unwritten - self._reported
            entry = replace(entry, seq=self._seq + 1, left_out=entry.left_out + lost)
            self._append(_encoder.encode(entry) + b"\n")
        except OSError as error:
            self._unwritten += 1
            if not self.fault:
                self.fault = f"audit log {self._path(0)} cannot be written ({error.strerror})"
                self._on_event(self.fault)
            return
        self._seq += 1
        self._reported += lost
        if self.fault:
            self.fault = ""
            self._on_event(f"audit log is written again; {lost} entries were lost")

    def _append(self, line: bytes) -> None:
        """Append a whole line, or nothing. Rotates the files if the line does not fit."""
        path = self._path(0)
        if path.exists() and path.stat().st_size + len(line) > self._max_bytes:
            for number in range(FILES - 1, 0, -1):
                with suppress(FileNotFoundError):
                    self._path(number - 1).replace(self._path(number))
        file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            size = os.fstat(file).st_size
            if os.write(file, line) != len(line):
                os.ftruncate(file, size)
                raise OSError(28, "No space left on device")
        finally:
            os.close(file)

    def _newest_first(self) -> Iterator[AuditEntry]:
        for number in range(FILES):
            try:
                lines = read_regular(self._path(number)).splitlines()
            except OSError:
                continue
            for line in reversed(lines):
                with suppress(msgspec.MsgspecError):
                    yield _decoder.decode(line)

    def _path(self, number: int) -> Path:
        return self._folder / (f"audit.{number}.jsonl" if number else "audit.jsonl")
