"""The real `IncidentService` and `Recorder` of a virtual daemon, in virtual time.

The ring and the files of incidents are real files, in a folder of the swarm on a file system in
memory. Reduced are: the threads, which end after the time that a write takes; the pull, which goes
over the links of the virtual swarm; and the ring's content, which no history replays: the times of
the inputs, and the incidents.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeVar

from swarmd.core import verbs
from swarmd.core.bounds import keep_newest
from swarmd.core.clock import clock_id
from swarmd.core.events import TICK_INPUT, Input, TickInput
from swarmd.core.incident import Incident
from swarmd.core.messages import Status
from swarmd.core.record import RecordKind
from swarmd.core.token_bucket import TokenBucket
from swarmd.core.verbs import KeptIncident
from swarmd.daemon import incidents, recorder
from swarmd.daemon.incidents import IncidentService, _signed, _Told
from swarmd.daemon.recorder import Recorder
from swarmd.daemon.recording.head import RecordingHead
from swarmd.daemon.recording.incident_file import SUFFIX, IncidentHead, read_head
from swarmd.daemon.requests import SendReply
from swarmd.link.datagram import Address, Beacon
from swarmd.link.spread.pull import PULL_BURST, PULL_RATE, PULL_TIMEOUT
from swarmd.robot.actions import Actions
from swarmd.settings.swarmfile import BlackboxSection

if TYPE_CHECKING:
    from tests.histories.swarm import VirtualDaemon

T = TypeVar("T")
THREAD_TIME = 0.01  # s of a thread that writes nothing
RATE = 2000  # bytes of the ring for each second: a tick has some 30


@dataclass(frozen=True, slots=True)
class Death:
    """A daemon was killed: which, when, and the revision of its robot then.

    `last`: s at which its loop turned last. `known`: the incidents that the robot kept before.
    """

    instance: str
    revision: int
    at: float
    last: float
    known: frozenset[str]


class _Recorder(Recorder):
    """Writes a tick to the ring for each input, and no decisions."""

    def input(self, input: Input, now: float) -> None:
        super().input(TICK_INPUT, now)

    def _decided(self, input: Input, actions: Actions, now: float, state: str) -> None:
        pass

    def _status(self, status: Status, now: float) -> None:
        pass


class _Puller:
    """As `Puller`: one pull at a time, at a limited rate; one over a cut link fails late."""

    def __init__(self, box: BlackBox) -> None:
        self._box = box
        self._rate = TokenBucket(PULL_RATE, PULL_BURST)
        self._pull: object = None  # the one under way

    def pull(
        self, peer: str, address: Address, what: str, *, on_done: Callable[[bytes | None, str], Any]
    ) -> bool:
        daemon, swarm = self._box.daemon, self._box.daemon.swarm
        if self._pull is not None or not self._rate.take(1.0, swarm.now):
            return False
        begun = self._pull = object()

        def end(blob: bytes | None, reason: str) -> None:
            if self._pull is begun:
                self._pull = None
                self._box.call(on_done, blob, reason)

        def serve() -> None:
            blob = swarm.robots[peer].black_box.served()
            if blob is not None and swarm.reaches(peer, daemon.name):
                swarm.at(swarm.now + 2.0 * swarm.delay, partial(end, blob, ""))

        swarm.at(swarm.now + PULL_TIMEOUT, partial(end, None, "no answer"))
        if swarm.reaches(daemon.name, peer) and swarm.reaches(peer, daemon.name):
            other = swarm.robots[peer]
            swarm.at(swarm.now + 2.0 * swarm.delay, partial(other.take, serve))
        return True


class Incidents(IncidentService):
    """The service of one life of a daemon; its judge sees what it takes and writes."""

    def __init__(self, box: BlackBox, *args: Any, **options: Any) -> None:
        self._box = box
        super().__init__(*args, **options)

    def on_mark(self, request: verbs.MarkRequest, answer: SendReply) -> None:
        with self._box.at_work():
            super().on_mark(request, answer)

    @property
    def told(self) -> list[tuple[Incident, float]]:
        """The incidents that it hands to other robots, and s at which they began."""
        return [(one.incident, one.at) for one in self._told.values() if one.told is not None]

    def _on_status(self, status: Status) -> None:
        with self._box.at_work():
            super()._on_status(status)

    def _tell(self, told: Any) -> None:
        super()._tell(told)
        self._box.took(told.incident, told.at, told.source)

    def _note_kept(self, head: IncidentHead, size: int, crc: int) -> None:
        super()._note_kept(head, size, crc)
        self._box.wrote()

    def _on_written(self, id: str, written: Any) -> None:
        kept = {gone: self._kept[gone] for gone in written.removed}
        self._box.displaced(tuple(self._kept.values()), kept, written.head)
        super()._on_written(id, written)

    def _write(self, told: Any, source: Any, **options: Any) -> None:
        left = source.read()  # now: the descriptor of a virtual thread would outlive a kill
        super()._write(told, source._replace(read=lambda: left), **options)

    def _end(self, error: Exception) -> None:
        raise error  # a fault of the black box, or of its judge

    def _in_thread(self, work: Callable[[], T], on_done: Callable[[T], object]) -> None:
        is_write = not isinstance(work, partial)  # to sign and to check take no disk
        seconds = self._box.daemon.disk_time if is_write else THREAD_TIME
        swarm = self._box.daemon.swarm
        swarm.at(swarm.now + seconds, partial(self._box.call, lambda: on_done(work())))


class BlackBox:
    """The black box of one life of a daemon, with the files of its robot."""

    def __init__(self, daemon: VirtualDaemon, *, keeps_files: bool) -> None:
        """`keeps_files` False: the state folder is another one, without incidents."""
        self.daemon, self._life = daemon, daemon.lives
        self.began = daemon.swarm.now
        self.writes_at = self.began + daemon.disk_time + 1.0  # what the daemon before left
        self.frozen_at = -math.inf
        self.is_closed = False
        folder = daemon.swarm.folder / daemon.name
        self._memory = folder / "memory"
        self.files = folder / incidents.LIST
        if not keeps_files:
            shutil.rmtree(self.files, ignore_errors=True)
        swarm, chance = daemon.swarm, daemon.swarm.chance_of_ids
        wall = SimpleNamespace(time=lambda: swarm.now + swarm.wall + daemon.wall)
        system = SimpleNamespace(environ=os.environ, urandom=chance.randbytes)
        self._fakes: dict[Any, dict[str, Any]] = {
            incidents: {"boottime": lambda: swarm.now, "time": wall, "os": system, "RATE": RATE},
            recorder: {
                "boottime": lambda: swarm.now,
                "time": wall,
                "remember": lambda *_: b"",
            },
        }
        self.recorder = _Recorder(None, daemon.note)  # type: ignore[arg-type]  # no process
        with self._virtual_time():
            self.service = Incidents(
                self,
                daemon.name,
                folder,
                BlackboxSection(folder=str(self._memory)),
                recorder=self.recorder,
                puller=_Puller(self),  # has what the service calls
                head=self._head,
                identity=lambda: None,  # signatures have tests of their own
                is_member=daemon.knows,
                on_event=daemon.note,
            )

    def _head(self) -> RecordingHead:
        identity = self.daemon.robot.identity
        return RecordingHead(swarm="lab", clock=clock_id(), machine="virtual", identity=identity)

    # Life

    def open(self) -> None:
        """The daemon starts."""
        with self._virtual_time():
            self.service.open()
        if self.recorder.black_box.ring is not None:
            self.daemon.swarm.rings.add(self.recorder.black_box.ring)

    def close(self) -> None:
        """The daemon ends in order."""
        if self.recorder.black_box.ring is not None:
            self.daemon.swarm.rings.discard(self.recorder.black_box.ring)
        with self.at_work():
            self.service.close(has_crashed=False)
        self.is_closed = True

    def die(self) -> Death | None:
        """The process is killed; None if it had ended in order, or had not begun."""
        ring = self.recorder.black_box.ring
        if self.is_closed or ring is None:
            return None
        self.is_closed = True
        self.daemon.swarm.rings.discard(ring)
        ring.close()
        now = self.daemon.swarm.now
        wall = now + self.daemon.swarm.wall + self.daemon.wall
        for path in self._memory.iterdir():
            os.utime(path, (wall, wall))
        epoch = self.daemon.robot.epoch
        known = frozenset(self.heads())
        last = self.frozen_at if self.daemon.is_frozen else now
        return Death(epoch.instance, epoch.revision, now, last, known)

    # As the daemon calls it

    def step(self, input: Input, now: float) -> None:
        """As the part of `Daemon.step` after a decision."""
        self.recorder.settle(self.daemon.robot)
        if type(input) is TickInput:
            with self._virtual_time():
                self.recorder.remember(self.daemon.robot, now, 1.0)
            if self.digest:
                with self.at_work():
                    self.service.advance(now)
            else:  # notes that the loop turns, and has nothing to write
                self.service.advance(now)

    def on_lost(self, beacon: Beacon) -> None:
        """A robot has failed since this beacon."""
        with self.at_work():
            self.service.on_lost(beacon)

    def on_beacon(self, beacon: Beacon, address: Address) -> None:
        """A robot shows its digest."""
        with self.at_work():
            digest = beacon.digest(RecordKind.INCIDENT)
            self.service.on_beacon(beacon.robot, digest, address, self.daemon.swarm.now)

    @property
    def digest(self) -> bytes:
        """For beacons."""
        return self.service.digest

    def served(self) -> bytes | None:
        """The list for a peer; None before the daemon serves."""
        if not self.daemon.is_settled:
            return None
        with self._virtual_time():
            return self.service._list()

    # What the judge sees

    def heads(self) -> dict[str, IncidentHead]:
        """The heads of its files, by id."""
        if not self.files.is_dir():
            return {}
        paths = sorted(self.files.glob(f"*{SUFFIX}"))
        return {path.stem: read_head(path.read_bytes()) for path in paths}

    def has_file(self, id: str) -> bool:
        """True if it has written the file of this incident."""
        return (self.files / f"{id}{SUFFIX}").exists()

    @property
    def was_frozen(self) -> bool:
        """True if its daemon was frozen in this life."""
        return self.frozen_at > -math.inf

    def count(self) -> int:
        """The number of its files."""
        return sum(name.endswith(SUFFIX) for name in os.listdir(self.files))

    def took(self, incident: Incident, at: float, source: str) -> None:
        """It has begun to keep an incident, which the peer `source` handed on for another one."""
        if self.daemon.swarm.judge is not None:
            self.daemon.swarm.judge.on_incident(self.daemon, incident, at, source)

    def wrote(self) -> None:
        """It has written a file."""
        if self.daemon.swarm.judge is not None:
            self.daemon.swarm.judge.on_file(self.daemon)

    def displaced(
        self, before: Sequence[KeptIncident], gone: Mapping[str, KeptIncident], new: IncidentHead
    ) -> None:
        """The files `gone` give way to a new one."""
        if self.daemon.swarm.judge is not None:
            self.daemon.swarm.judge.on_displaced(self.daemon, before, gone, new)

    def cry(self, incidents_told: Sequence[Incident]) -> None:
        """Tell peers of these as the robot's own, though it has none of them."""
        with self._virtual_time():
            for one in incidents_told:
                told = _Told(one, self.daemon.swarm.now, _signed(one, None))
                keep_newest(self.service._told, one.id, told, incidents.MAX_TOLD)

    # Time

    def call(self, work: Callable[..., object], *args: Any) -> None:
        """Call this on the loop of this life of the daemon."""

        def run() -> None:
            if self._life == self.daemon.lives:
                with self.at_work():
                    work(*args)

        if self._life == self.daemon.lives:
            self.daemon.take(run)

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """The service works: in virtual time, and no robot may be moved by it."""
        judge = self.daemon.swarm.judge
        before = None if judge is None else judge.motion_of(self.daemon)
        with self._virtual_time():
            yield
        if judge is not None:
            judge.check_motion(self.daemon, before)

    @contextmanager
    def _virtual_time(self) -> Iterator[None]:
        """The modules of the service read the clocks of this robot."""
        before = [
            (vars(module), {name: vars(module)[name] for name in fakes})
            for module, fakes in self._fakes.items()
        ]
        for module, fakes in self._fakes.items():
            vars(module).update(fakes)
        try:
            yield
        finally:
            for names, values in before:
                names.update(values)


def new_ring_folder() -> Path:
    """A new folder on a file system in RAM."""
    shared = Path("/dev/shm")
    return Path(tempfile.mkdtemp(prefix="swarmd-history-", dir=shared if shared.is_dir() else None))
