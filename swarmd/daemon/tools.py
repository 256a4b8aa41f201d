"""Answers operators' questions about a robot's condition: audit log, logs, links and doctor.

These questions change nothing. Slow answers, such as reads of the disk, are made in threads.
"""

from __future__ import annotations

import asyncio
import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec

from swarmd.core import verbs
from swarmd.core.clock import FIRST_WALL, boottime, clock_id
from swarmd.core.codec import encode
from swarmd.core.kernels import describe_kernels
from swarmd.core.log_ring import LogRing
from swarmd.core.machine import measure_machine
from swarmd.core.messages import Code, KeySummary, Reply, Sandbox
from swarmd.core.refusal import Refusal
from swarmd.core.threads import hand_over
from swarmd.daemon.audit import AuditLog
from swarmd.daemon.network import Network
from swarmd.daemon.requests import SendReply
from swarmd.link.carriers.network_facts import measure_network
from swarmd.settings.settings import DaemonSettings

log = logging.getLogger(__name__)


class LogCapture(logging.Handler):
    """Puts each log record into a ring, from any thread; on the root logger until `close`."""

    def __init__(self, ring: LogRing) -> None:
        super().__init__()
        self._ring = ring
        logging.getLogger().addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record; its source is the module without the name of the package."""
        source = record.name.removeprefix("swarmd.")
        text = record.getMessage()
        if record.exc_info and record.exc_info[1] is not None:
            error = record.exc_info[1]
            text = f"{text}: {type(error).__name__}: {error}"
        self._ring.add(boottime(), record.levelno, source, text)

    def close(self) -> None:
        """Keep no more."""
        logging.getLogger().removeHandler(self)
        super().close()


MAX_LINKS = 512  # in an answer
MAX_PINGS = 20  # round trips that one question measures
PUBLISH_PERIOD = 0.2  # s between two batches of records
MAX_BATCH = 48 * 1024  # bytes of records in a batch or an answer
RECORD_OVERHEAD = 64  # bytes of a record beside its text, at most
CACHE_TIME = 2.0  # s for which measured facts of the machine are reused


class FieldTools:
    """Answers questions about the condition of a robot, its daemon and its network.

    `instance`: the id of this daemon process, in hex. `version`: the version of swarmd. `audit`:
    the audit log. `storage_fault`: why a restart would lose latches; empty without a fault.
    """

    def __init__(
        self,
        settings: DaemonSettings,
        instance: str,
        network: Network,
        *,
        version: str,
        keys: Callable[[], KeySummary | None],
        sandbox: Callable[[], Sandbox | None],
    ) -> None:
        """Begin to capture log records, and open the audit log in the folder of this robot.

        `keys()`: a summary of identity and roster, None in a swarm without keys. `sandbox()`: how
        the pattern host is confined. Both are called at each use, since their values change.
        """
        self._settings = settings
        self._instance = instance
        self._network = network
        self._version = version
        self._keys = keys
        self._sandbox = sandbox
        self._loop = asyncio.get_running_loop()
        self._ring = LogRing()  # the last log records
        self._capture = LogCapture(self._ring)
        self._published = 0  # number of the last log record that was published
        self._publish_at = 0.0  # s; the next batch of records is due
        self._next_ping = 0  # the index of the robot to ping next
        self._measuring = threading.Lock()  # guards the facts, which a thread measures
        self._measured_at = -math.inf  # s; when `_facts` were measured
        # Measured by `_measured_facts` at the first question.
        self._facts: tuple[verbs.MachineFacts, verbs.NetworkFacts]
        self.storage_fault = ""  # set by the daemon
        folder = settings.state_dir / settings.network.swarm / settings.id
        self.audit = AuditLog(folder, lambda text: hand_over(self._loop, log.warning, "%s", text))

    def advance(self, now: float) -> None:
        """Publish new records to subscribers; the daemon's tick calls this."""
        if now < self._publish_at or self._ring.last == self._published:
            return
        self._publish_at = now + PUBLISH_PERIOD
        since = self._published
        self._published = self._ring.last
        self._network.publish("log", lambda: encode(self._batch(self._ring.since(since))))

    def close(self) -> None:
        """Write the queued entries of the audit log, and keep no more log records."""
        self.audit.close()
        self._capture.close()

    # Members

    def on_forget(self, request: verbs.ForgetRequest, answer: SendReply) -> None:
        """Remove a member from the list of members, unless the member is alive."""
        name = request.name
        code = Code.APPLIED
        refusal = None
        text = f"forgot {name}"
        if not self._network.forget(name):
            code = Code.REFUSED
            refusal = Refusal.MEMBER_ALIVE
            text = f"{name} is alive"
        robot = self._settings.id
        answer(Reply(id=request.id, robot=robot, code=code, refusal=refusal, text=text))

    # Audit

    def on_audit(self, query: verbs.AuditQuery) -> Callable[[], verbs.AuditReply]:
        """Entries of the audit log; read in a thread."""
        return partial(self._read_audit, query)

    def _read_audit(self, query: verbs.AuditQuery) -> verbs.AuditReply:
        now = boottime()
        clock = clock_id()
        wall = time.time()

        def age_of(entry: verbs.AuditEntry) -> float | None:
            if entry.clock == clock:
                return max(now - entry.boot, 0.0)
            is_known = entry.wall is not None and wall >= FIRST_WALL
            return max(wall - (entry.wall or 0.0), 0.0) if is_known else None

        entries, has_more, fault = self.audit.read(query, age_of)
        return verbs.AuditReply(
            robot=self._settings.id,
            entries=tuple(entries),
            ages=tuple(map(age_of, entries)),
            has_more=has_more,
            fault=fault[:1000],
        )

    # Logs

    def on_logs(self, query: verbs.LogsQuery) -> verbs.LogBatch:
        """The newest log records that match the query."""
        return self._batch(self._ring.matching(query))

    def _batch(self, records: list[verbs.LogRecord]) -> verbs.LogBatch:
        """The newest records that fit into MAX_BATCH bytes."""
        bytes_left = MAX_BATCH
        first = max(len(records) - verbs.LOG_PAGE, 0)
        for index in range(len(records) - 1, first - 1, -1):
            bytes_left -= len(records[index].text.encode()) + RECORD_OVERHEAD
            if bytes_left < 0:
                first = index + 1
                break
        return verbs.LogBatch(
            robot=self._settings.id,
            instance=self._instance,
            now=boottime(),
            last=self._ring.last,
            records=tuple(records[first:]),
            left_out=self._ring.left_out,
        )

    # Links

    def on_links(self, query: verbs.LinksQuery) -> verbs.LinksReply:
        """The quality of the links from other robots to this robot; pings them on request."""
        links = sorted(self._network.links(), key=lambda link: link[1].age)
        if query.measures and links:
            names = [robot for robot, _, _ in sorted(links)]
            first = self._next_ping % len(names)
            self._network.ping((names[first:] + names[:first])[:MAX_PINGS])
            self._next_ping = first + MAX_PINGS
        reports = tuple(
            verbs.LinkReport(robot, link.received, link.lost, link.age, link.round_trip, ways)
            for robot, link, ways in links[:MAX_LINKS]
        )
        unlisted = max(len(links) - MAX_LINKS, 0)
        return verbs.LinksReply(robot=self._settings.id, links=reports, unlisted=unlisted)

    # Doctor

    def on_doctor(self, _: verbs.Nothing) -> Callable[[], verbs.DoctorReply]:
        """Facts of the machine and the network; measured in a thread."""
        alive = set(self._network.alive)
        ways = Counter(
            way for robot, _, ways in self._network.links() for way in ways if robot in alive
        )
        heard = {**ways, "any": len(alive)}
        return partial(self._doctor, heard)

    def _doctor(self, heard: dict[str, int]) -> verbs.DoctorReply:
        """The condition of the robot, its machine and its network; called in a thread.

        `heard`: for each way of datagrams, such as `multicast`, the number of robots that are heard
        by this way; `any`: by any way.
        """
        settings = self._settings
        keys = self._keys()
        machine, network = self._measured_facts()
        return verbs.DoctorReply(
            robot=settings.id,
            version=self._version,
            kernels=describe_kernels(),  # whether the arithmetic kernels are compiled
            profile=settings.network.profile,
            machine=msgspec.structs.replace(machine, wall=time.time()),  # not from the cache
            network=network,
            identity_expires=None if keys is None else float(keys.expires),
            roster=None if keys is None else keys.generation,
            heard=heard,
            storage=self.storage_fault,
            sandbox=self._sandbox(),
        )

    def _measured_facts(self) -> tuple[verbs.MachineFacts, verbs.NetworkFacts]:
        """Measure machine and network, unless the last facts are at most CACHE_TIME s old."""
        settings = self._settings
        with self._measuring:
            if boottime() - self._measured_at > CACHE_TIME:
                # The loader of settings always sets a folder; the type permits None.
                recordings = Path(settings.recording.folder or "recordings")
                folders = (("state", settings.state_dir), ("recordings", recordings))
                network = measure_network(settings.network.interface_name)
                self._facts = (measure_machine(folders), network)
                self._measured_at = boottime()
            return self._facts
