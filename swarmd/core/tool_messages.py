"""The messages of the verbs that look after robots: audit, logs, links and doctor.

Typed and bounded as those in `messages.py`. No request is among them: they change nothing.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from swarmd.core.bounds import Count, Line, Name, Seconds, Word
from swarmd.core.messages import Sandbox

AUDIT_PAGE = 100
"""Entries of an answer."""
LOG_PAGE = 200
"""Records of an answer, and of a batch that a robot publishes."""
MAX_LOG_LINE = 500
"""Characters of a record."""

Wall = Annotated[float, Meta(ge=0.0, le=1e11)]
OperatorName = Annotated[str, Meta(max_length=128)]
LogLine = Annotated[str, Meta(max_length=MAX_LOG_LINE)]


class AuditEntry(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A request that a robot answered, or a latch that it took from a peer.

    `seq` counts the entries of a robot. `boot`: the clock `clock` of the robot in s; `wall` in s
    since 1970 (UTC), None if its clock had not been set. `targets` None: all robots. `left_out`:
    earlier entries that were not written, since there were too many or the disk failed.
    """

    seq: Count = 0
    boot: Seconds
    clock: Word
    wall: Wall | None = None
    operator: OperatorName
    source: Word
    verb: Word
    targets: Count | None = None
    what: Line
    result: Word
    text: Line = ""
    left_out: Count = 0


class AuditQuery(Struct, frozen=True, kw_only=True):
    """Asks for the last `count` entries, with a `seq` below `before`, of the last `since` s."""

    before: Count | None = None
    since: Seconds | None = None
    count: Annotated[int, Meta(ge=1, le=AUDIT_PAGE)] = AUDIT_PAGE


class AuditReply(Struct, frozen=True, kw_only=True):
    """Entries, the oldest first, and the age of each in s; None: it was before the last boot.

    `has_more`: older ones fit the question. `fault`: why entries are not written at present.
    """

    robot: Name
    entries: Annotated[tuple[AuditEntry, ...], Meta(max_length=AUDIT_PAGE)]
    ages: Annotated[tuple[Seconds | None, ...], Meta(max_length=AUDIT_PAGE)]
    has_more: bool
    fault: Line = ""


class LogRecord(Struct, frozen=True, array_like=True):
    """A line of a daemon's log, or a line that its pattern printed (`pattern`).

    `seq` counts the records of an instance; `at` on the robot's clock; `level` as in `logging`.
    """

    seq: Count
    at: Seconds
    level: Annotated[int, Meta(ge=0, le=100)]
    source: Word
    text: LogLine


class LogsQuery(Struct, frozen=True, kw_only=True):
    """Asks for the last `count` records of at least `level` that hold `grep`, in any case."""

    count: Annotated[int, Meta(ge=1, le=LOG_PAGE)] = 50
    level: Annotated[int, Meta(ge=0, le=100)] = 0
    grep: Annotated[str, Meta(max_length=200)] = ""


class LogBatch(Struct, frozen=True, kw_only=True):
    """Records of a robot, the oldest first; `now` is its clock, `last` its latest number.

    `left_out`: lines of this life of the daemon that were too many to be kept.
    """

    robot: Name
    instance: Name
    now: Seconds
    last: Count
    records: Annotated[tuple[LogRecord, ...], Meta(max_length=LOG_PAGE)]
    left_out: Count = 0


class LinkReport(Struct, frozen=True, array_like=True):
    """How a robot hears another one; see `LinkQuality`. `ways`: multicast, broadcast, unicast."""

    robot: Name
    received: Count
    lost: Count
    age: Seconds
    round_trip: Seconds | None
    ways: Annotated[tuple[Word, ...], Meta(max_length=4)] = ()


class LinksQuery(Struct, frozen=True, kw_only=True):
    """Asks how a robot hears others; with `measures` it measures round trips for a later answer."""

    measures: bool = False


class LinksReply(Struct, frozen=True, kw_only=True):
    """The links of a robot, those that were heard last first; `unlisted`: further ones."""

    robot: Name
    links: Annotated[tuple[LinkReport, ...], Meta(max_length=512)]
    unlisted: Count = 0


class DiskFacts(Struct, frozen=True, kw_only=True):
    """A folder and its disk: bytes free for this user and in all; `fault`: why it is unwritable."""

    purpose: Word
    path: Line
    free: Count = 0
    size: Count = 0
    fault: Line = ""


class MachineFacts(Struct, frozen=True, kw_only=True):
    """A machine: load of the last minute, memory in bytes, `wall` in s since 1970 (UTC).

    `is_synced`: whether the kernel holds its clock for synchronised; None: not known.
    """

    host: Word
    python: Word
    cores: Count
    load: Annotated[float, Meta(ge=0.0, le=1e6)]
    memory: Count
    free_memory: Count
    wall: Wall
    is_synced: bool | None
    disks: Annotated[tuple[DiskFacts, ...], Meta(max_length=8)] = ()


class PortFacts(Struct, frozen=True, kw_only=True):
    """The process that listens on a port, such as `swarmd (412)`; empty: free; `?`: not known."""

    protocol: Word
    port: Count
    users: Annotated[tuple[Word, ...], Meta(max_length=32)] = ()


class NetworkFacts(Struct, frozen=True, kw_only=True):
    """An interface and what may keep datagrams out.

    `mtu`, `has_multicast`: None if not known. `firewall`: none, open, drops or unknown, with the
    rules that drop, or the reason, in `firewall_text`.
    """

    interface: Word
    exists: bool
    is_up: bool
    addresses: Annotated[tuple[Word, ...], Meta(max_length=32)]
    mtu: Count | None
    has_multicast: bool | None
    is_wireless: bool
    ports: Annotated[tuple[PortFacts, ...], Meta(max_length=8)]
    firewall: Word
    firewall_text: Line = ""


class DoctorReply(Struct, frozen=True, kw_only=True):
    """What a robot measures of itself for `swarmctl doctor`.

    `identity_expires`: s since 1970 (UTC), `roster`: its generation; None without keys. `heard`:
    robots that are alive by the way in which their datagrams come. `storage`: why latches would be
    lost by a restart. `sandbox`: of the pattern host.
    """

    robot: Name
    version: Word
    kernels: Word
    profile: Word
    machine: MachineFacts
    network: NetworkFacts
    identity_expires: Wall | None = None
    roster: Count | None = None
    heard: dict[Word, Count] = {}
    storage: Line = ""
    sandbox: Sandbox | None = None
