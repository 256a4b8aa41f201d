"""The black box of a robot: its last minute in RAM, and a file of it for each incident.

An incident is found by the robot itself (`core/incident.py`), told by a peer, or marked by an
operator. TAIL s after it the service writes the ring of the recorder to a file, in a thread. The
incidents of the last minutes spread like pushed patterns: beacons show a digest of their ids, and a
robot that lacks some pulls the list of the peer. So each robot keeps its own last minute of each
incident, under one id. A robot that has an incident itself notes its own words, also if a peer told
it before.

After a daemon that was killed the next one finds the ring, and writes it. It tells again what the
daemon before may not have had the time to tell. A file that the disk refused waits in RAM.

The age of a tale is not signed: the robot that hands it on states it. So a tale at second hand uses
a budget of its own (`incident_budget.py`), the file names who handed it on, and the age that the
teller itself states replaces it.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import math
import os
import time
import zlib
from collections import deque
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Concatenate, NamedTuple, ParamSpec, TypeVar

import msgspec
from msgspec import Meta

from swarmd.core import verbs
from swarmd.core.bounds import keep_newest
from swarmd.core.clock import FIRST_WALL, STALL_TIMEOUT, boottime, clock_id
from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.files import read_regular, write_whole
from swarmd.core.incident import (
    MAX_TEXT,
    Found,
    Incident,
    IncidentKind,
    ToldIncident,
    found,
    id_of,
    mark_part,
    silent_id,
)
from swarmd.core.messages import Code, Reply, State, Status
from swarmd.core.record import DIGEST_BYTES
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import KeptIncident, mark_text, shortened
from swarmd.daemon.audit import printable
from swarmd.daemon.incident_budget import rate_of, teller_of, teller_to_give_way, to_remove
from swarmd.daemon.recorder import Recorder
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.head import RecordingHead, head_of
from swarmd.daemon.recording.incident_file import SUFFIX, IncidentHead, pack, read, read_head
from swarmd.daemon.recording.ring import (
    MAX_FILE,
    Left,
    Ring,
    entries_of,
    read_left,
    remove_old,
    ring_folder,
)
from swarmd.daemon.recording_files import piece_of
from swarmd.daemon.requests import SendReply
from swarmd.link.carriers.bus import ZenohBus
from swarmd.link.datagram import STATES, Address, Beacon
from swarmd.link.keys.content_signature import Purpose, is_signed_by, sign
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.roster import Role
from swarmd.link.spread.asks import Asks
from swarmd.link.spread.pull import Blob, Puller, serve_shared
from swarmd.settings.swarmfile import BlackboxSection

log = logging.getLogger(__name__)

TAIL = 10.0
"""Seconds after an incident that its file has, too."""
GAP = 10.0
HOURLY = 6
"""At most one incident in GAP s, and HOURLY an hour, of one origin."""
RATE = 40_000
"""Bytes of the ring for each second that it keeps: 4 MB for 60 s. A robot with 360 rays at 10 Hz
takes some 22 kB a second."""
MARGIN = 40.0  # s that the ring keeps beyond `seconds`: a segment, and TAIL
MAX_TOLD = 32
MAX_RATES = 1024
"""Origins whose last incidents are known: more than a swarm of 100 robots has."""
RETRY = 10.0  # s until a file is written again that the disk refused
MAX_WAITING = 16 * 2**20  # bytes of files that wait for the disk
MARK_AGE = 3600.0
"""S between the operator's clock at a mark and the robot's, beyond which a mark that a peer tells
counts as the words of the peer: it may be an old one that is told again."""
LIST_PERIOD = 10.0  # s until the same list is pulled from the same robot again
_SILENCES = {IncidentKind.SILENT, IncidentKind.STALL}
LIST = "incidents"  # the name of the list among the pulled blobs

T = TypeVar("T")
P = ParamSpec("P")
_told = msgspec.msgpack.Decoder(Annotated[list[ToldIncident], Meta(max_length=MAX_TOLD)])
_incident = msgspec.msgpack.Decoder(Incident)


class _Told(msgspec.Struct):
    """An incident of the last minutes: its time `at` on this robot's clock, and its signature."""

    incident: Incident
    at: float
    told: ToldIncident | None = None  # None until it is signed
    operator: str = ""  # as in `KeptIncident`
    source: str = ""  # as in `KeptIncident`

    @property
    def teller(self) -> str:
        """Whose budget it uses."""
        return teller_of(self.incident, self.source)


class _Frames(NamedTuple):
    """Frames for the file of an incident."""

    read: Callable[[], Left]  # copies them; OSError or CodecError if they cannot be read
    begin: float  # s on this robot's clock, of the first one
    end: float  # s, of the last one


class _Written(NamedTuple):
    """A file that was written, with its size and CRC-32, and the ids of those that gave way."""

    head: IncidentHead
    size: int
    crc: int
    removed: Sequence[str]


class _Refused(NamedTuple):
    """A file that the disk refused: its bytes, and why. No bytes: the frames could not be read."""

    head: IncidentHead | None
    data: bytes
    fault: str


def _contained(
    work: Callable[Concatenate[IncidentService, P], None],
) -> Callable[Concatenate[IncidentService, P], None]:
    """A method whose error ends the black box, and not the daemon."""

    @wraps(work)
    def call(self: IncidentService, /, *args: P.args, **kwargs: P.kwargs) -> None:
        try:
            work(self, *args, **kwargs)
        except Exception as error:
            self._end(error)

    return call


class IncidentService:
    """Keeps the black box of one robot, and answers the requests and questions on incidents.

    - `folder`: the robot's state folder. `head`: what a replay needs of the robot.
    - `identity`: of this robot at present; None in a swarm without keys.
    - `is_member`: whether a name is known as a robot of the swarm.
    - `on_event` takes a line for the robot's log.
    """

    def __init__(
        self,
        robot: str,
        folder: Path,
        section: BlackboxSection,
        *,
        recorder: Recorder,
        puller: Puller,
        head: Callable[[], RecordingHead],
        identity: Callable[[], Identity | None],
        is_member: Callable[[str], bool],
        on_event: Callable[[str], None],
    ) -> None:
        self._robot = robot
        self._section = section
        self._seconds = section.seconds
        self._folder = folder / LIST
        digest = hashlib.blake2b(str(folder.absolute()).encode(), digest_size=6).hexdigest()
        self._ring_name = f"{robot}-{digest}"
        self._recorder = recorder
        self._puller = puller
        self._head = head
        self._identity = identity
        self._is_member = is_member
        self._on_event = on_event
        self._status: Status | None = None  # the last one
        self._status_at = 0.0
        self._told: dict[str, _Told] = {}  # by id
        self._kept: dict[str, KeptIncident] = {}  # by id, the oldest first
        self._times: dict[str, float | None] = {}  # by id; None: s on the clock of an earlier boot
        # By origin (see `rate_of`): s of its last incidents.
        self._origins: dict[tuple[str, bool, str], deque[float]] = {}
        self._waiting: dict[str, _Refused] = {}  # by id: files that the disk refused
        self._retry_at = 0.0  # s
        self._keeps_left = False  # the ring waits for the file of what the daemon before left
        self._due: dict[str, float] = {}  # by id: s at which its file is written
        self._asks = Asks(LIST_PERIOD)
        self._tasks: set[asyncio.Task[None]] = set()
        self._is_writing = False  # a thread writes a file
        # s
        self._advanced_at = boottime()
        self._stalled_at = -math.inf
        self.fault = "" if section.seconds else "off: blackbox.seconds is 0"
        recorder.on_status = self._on_status

    # Start and end

    def open(self) -> None:
        """Read the kept files, begin the ring, and write what a killed daemon has left."""
        self._read_kept()
        if not self._seconds:
            return
        try:
            folder = ring_folder(self._section.folder, os.environ)
            try:  # before the ring begins again: a second kill must not lose it
                left = read_left(folder / self._ring_name)
                if left is not None and left.frames:
                    self._on_left(left)
            except (CodecError, ConfigError, OSError, msgspec.MsgspecError) as error:
                log.warning("what the daemon before left is lost: %s", error)
            self._tell_again()
            if self._waiting:  # the minute stays in RAM until there is room on the disk
                self._keeps_left = True
                return
            self._begin_ring(folder)
        except Exception as error:  # it ends the black box, and not the daemon
            self._end(error)

    def _begin_ring(self, folder: Path) -> None:
        """Keep the last minute from now on."""
        self._keeps_left = False
        head = self._head()
        now = boottime()
        self._recorder.black_box.ring = Ring(
            folder / self._ring_name,
            head.texts(),
            capacity=int(RATE * (self._seconds + MARGIN)),
            seconds=self._seconds + TAIL,
            boot=now,
            wall=time.time(),
        )
        remove_old(folder, time.time())  # its own, which may be old as well, has been read

    def _tell_again(self) -> None:
        """Tell the robot's own incidents of the last minutes, which its peers may not know.

        The daemon before may have died before a peer had pulled them.
        """
        oldest = boottime() - self._seconds - MARGIN
        for id, one in self._kept.items():
            at = self._times[id]
            is_recent = at is not None and at >= oldest
            if is_recent and one.incident.by == self._robot and id not in self._told:
                assert at is not None
                told = _Told(one.incident, at, operator=one.operator)
                keep_newest(self._told, id, told, MAX_TOLD)
                self._sign(told)

    def _sign(self, told: _Told) -> None:
        """Sign an incident of this robot, in a thread; it is handed on from then on."""
        work = partial(_signed, told.incident, self._identity())
        self._in_thread(work, partial(_set_told, told))

    def _read_kept(self) -> None:
        """Read the heads of the files that earlier daemons wrote."""
        heads = []
        with suppress(OSError):
            for path in self._folder.glob(f"*{SUFFIX}"):
                with suppress(OSError, CodecError):
                    data = read_regular(path, MAX_FILE)
                    head = read_head(data)
                    if path.name == head.incident.id + SUFFIX:
                        heads.append((head, len(data), zlib.crc32(data)))
        # Files of an earlier boot come first, by the wall clock, which may have been set since.
        heads.sort(key=lambda one: _place_of(one[0]))
        for head, size, crc in heads:
            self._note_kept(head, size, crc)
            if head.clock == clock_id():
                # A daemon that dies again and again begins no more incidents than one that lives.
                self._may_begin(rate_of(head.incident, head.source), head.at, gap=0.0)

    def _on_left(self, left: Left) -> None:
        """Write what an earlier daemon has left; it was killed, or has crashed."""
        if left.about.get("clock") != clock_id():
            raise CodecError("it is from before a reboot")
        entries = entries_of(left)
        if not entries:
            return
        end = max(one.at for one in entries)
        frames_left = _Frames(lambda: left, entries[0].at, end)
        for one in entries:
            if isinstance(one, frames.TextEntry) and one.topic == "/incident":
                incident = msgspec.json.decode(one.json, type=Incident)
                if incident.id not in self._kept and end - one.at <= MARGIN:
                    self._may_begin(rate_of(incident, ""), one.at, gap=0.0)
                    told = _Told(incident, one.at, operator=self._operator_of(incident))
                    self._write(told, frames_left, is_waiting=True)
        instance = ""
        with suppress(ConfigError):  # another version: peers have another id of it
            instance = head_of(left.about, "the black box").identity.instance
        text = "its daemon died (killed, or crashed); see the log"
        id = self._id_of_silence(silent_id(self._robot, instance, left.revision), end)
        self._begin(Found(IncidentKind.SILENT, text, id), at=end, left=frames_left)

    def close(self, *, has_crashed: bool) -> None:
        """Write the incidents whose last seconds are not over as they are, and end the ring.

        `has_crashed`: the next daemon writes what the ring has.
        """
        for id in list(self._due):
            self._write_due(id, is_waiting=True)
        for id in list(self._waiting):
            self._write_again(id, is_waiting=True)
        if self._recorder.black_box.ring is not None:
            self._recorder.black_box.ring.close(keeps_file=has_crashed)
            self._recorder.black_box.ring = None

    # What begins an incident

    @_contained
    def _on_status(self, status: Status) -> None:
        """Begin an incident if the robot has one since its last status."""
        before = self._status
        self._status = status
        before_at = self._status_at
        self._status_at = boottime()
        what = found(before, status)
        if what is not None and what.kind is IncidentKind.STALL:
            what = Found(what.kind, what.text, self._id_of_silence(what.id, before_at))
        if what is not None:
            self._begin(what)

    @_contained
    def on_lost(self, beacon: Beacon) -> None:
        """Begin an incident if the robot, which has failed since this last beacon, ran."""
        now = boottime()
        # A daemon that stood still has heard none of its peers.
        is_heard = now - self._advanced_at < STALL_TIMEOUT and now - self._stalled_at > GAP
        if is_heard and STATES[beacon.state : beacon.state + 1] == (State.RUNNING,):
            id = silent_id(beacon.robot, beacon.instance.hex(), beacon.revision)
            text = f"{beacon.robot} is not heard any more; it ran"
            id = self._id_of_silence(id, now)
            self._begin(Found(IncidentKind.SILENT, text, id), robot=beacon.robot)

    def _id_of_silence(self, id: str, at: float) -> str:
        """The id of a silence that began at `at` s or later; `id`: of the first one in this run.

        A file of more than TAIL s before has nothing of it, so it is another incident.
        """
        known = self._times | {known: told.at for known, told in self._told.items()}
        while (before := known.get(id)) is not None and at - before > TAIL:
            id = id_of(id)
        return id

    def on_mark(self, request: verbs.MarkRequest, answer: SendReply) -> None:
        """Begin an incident with the words of an operator."""
        text = mark_text(request.operator, request.words)
        is_begun = self._begin(Found(IncidentKind.MARK, text, request.incident), request=request)
        limit = f"at most one in {GAP:.0f} s and {HOURLY} an hour"
        fault = self._problem or limit
        answer(
            Reply(
                id=request.id,
                robot=self._robot,
                code=Code.APPLIED if is_begun else Code.REFUSED,
                refusal=None if is_begun else Refusal.BUSY,
                text=f"keeps its last {self._seconds:.0f} s" if is_begun else fault,
            )
        )

    def _begin(
        self,
        what: Found,
        *,
        robot: str = "",
        at: float | None = None,
        left: _Frames | None = None,
        request: verbs.MarkRequest | None = None,
    ) -> bool:
        """Begin an incident of this robot's own, unless it is known or too many began.

        `left`: frames of an earlier daemon; None: the file gets those of the ring. `request`: of
        the operator that marks it.
        """
        at = boottime() if at is None else at
        wall = time.time() - (boottime() - at)
        incident = Incident(
            id=what.id or os.urandom(6).hex(),
            robot=robot or self._robot,
            kind=what.kind,
            text=shortened(what.text, MAX_TEXT),
            by=self._robot,
            wall=wall if wall > FIRST_WALL else 0.0,
            operator="" if request is None else request.operator,
            marked=0.0 if request is None else request.marked,
            signature=b"" if request is None else request.signature,
        )
        told = _Told(incident, at, operator=incident.operator)
        if incident.id in self._told or incident.id in self._kept:
            self._say_itself(told)
            return True
        is_on = left is not None or self._recorder.black_box.ring is not None
        if not is_on or not self._may_begin(rate_of(incident, ""), at):
            return False
        self._tell(told)
        self._sign(told)
        if left is None:
            self._await_tail(incident, at)
        else:
            self._write(told, left, is_waiting=True)
        return True

    def _say_itself(self, own: _Told) -> None:
        """Note the robot's own words on an incident that it had, and that a peer has told before.

        An operator's mark replaces no words but those of the same mark. A mark that no operator has
        signed, or words of another kind, hide neither what befell the robot nor a silence that it
        found. If the file of the peer's tale ends before the incident, it is written again.
        """
        id = own.incident.id
        kind = own.incident.kind
        told = self._told.get(id)
        kept = self._kept.get(id)
        known = told or kept
        if known is None or known.incident.by == self._robot:
            return
        words = known.incident
        if kind == IncidentKind.MARK:
            if words.kind != IncidentKind.MARK:
                return
        elif words.kind == IncidentKind.MARK and known.operator:
            return
        is_alike = words.kind == kind or {words.kind, kind} <= _SILENCES
        if own.incident.robot != self._robot and is_alike:
            return
        if told is None:
            self._tell(own)
        self._told[id] = own
        self._sign(own)
        is_before = told is not None and own.at - told.at > 1.0
        if self._recorder.black_box.ring is not None and (
            is_before or (told is None and kind != IncidentKind.MARK)
        ):
            self._await_tail(own.incident, own.at)
        elif kept is not None:
            self._write_head(own)

    def _write_head(self, own: _Told) -> None:
        """Write the robot's own words into a file that it has written with those of a peer."""
        path = self._folder / (own.incident.id + SUFFIX)

        def work() -> _Written | str:
            """In a thread: the frames stay as they are."""
            try:
                head, left = read(path)
                head = msgspec.structs.replace(
                    head, incident=own.incident, operator=own.operator, source=""
                )
                data = pack(head, left.frames)
                write_whole(path, data, 0o600)
            except (OSError, CodecError) as error:
                return getattr(error, "strerror", None) or str(error)
            return _Written(head, len(data), zlib.crc32(data), ())

        def on_done(written: _Written | str) -> None:
            if isinstance(written, str):
                self._on_event(f"incident {own.incident.id} has the words of a peer: {written}")
            elif own.incident.id in self._kept:  # it has not given way meanwhile
                self._note_kept(written.head, written.size, written.crc)

        self._in_thread(work, on_done)

    def _may_begin(self, origin: tuple[str, bool, str], now: float, gap: float = GAP) -> bool:
        """True unless this origin began an incident within `gap` s, or HOURLY in the last hour."""
        times = self._origins.get(origin, deque(maxlen=HOURLY))
        keep_newest(self._origins, origin, times, MAX_RATES)
        is_soon = bool(times) and now - times[-1] < gap
        is_many = len(times) == HOURLY and now - times[0] < 3600.0
        if not (is_soon or is_many):
            times.append(now)
        return not (is_soon or is_many)

    def _tell(self, told: _Told) -> None:
        """Tell an incident to peers from now on, and to the log."""
        incident = told.incident
        if len(self._told) >= MAX_TOLD and (id := self._gives_way(told.teller)) is not None:
            del self._told[id]
            self._due.pop(id, None)
        keep_newest(self._told, incident.id, told, MAX_TOLD)
        what = f"{incident.kind}: {incident.text}"
        self._on_event(printable(f"incident {incident.id} of {incident.robot}: {what}"))

    def _has_room(self, teller: str) -> bool:
        """True if the list takes another incident of `teller`."""
        return len(self._told) < MAX_TOLD or self._gives_way(teller) is not None

    def _gives_way(self, teller: str) -> str | None:
        """The id of the incident in a full list that gives way to one of `teller`."""
        tellers = {id: told.teller for id, told in self._told.items()}
        return teller_to_give_way(tellers, teller, self._robot)

    def _operator_of(self, incident: Incident) -> str:
        """The operator whose mark an incident in the ring is; empty if that is not known."""
        if incident.by == self._robot:
            return incident.operator
        identity = self._identity()
        return "" if identity is None else _marked_by(incident, identity)

    def _await_tail(self, incident: Incident, at: float) -> None:
        """Note the incident in the ring at once; its file is written TAIL s after it."""
        self._due[incident.id] = max(at + TAIL, boottime())
        self._recorder.add(frames.TextEntry(at, "/incident", msgspec.json.encode(incident)))
        self._recorder.black_box.write()

    # Spread

    @property
    def digest(self) -> bytes:
        """The digest of the ids that this robot tells, for beacons; empty without any."""
        content = "\n".join(sorted(self._told)).encode()
        return hashlib.blake2b(content, digest_size=DIGEST_BYTES).digest() if content else b""

    def serve(self, bus: ZenohBus) -> None:
        """Hand the incidents of the last minutes to other robots."""
        serve_shared(bus, LIST, lambda name, asker: self._list())

    def _list(self) -> bytes:
        now = boottime()
        told = [
            msgspec.structs.replace(one.told, age=max(now - one.at, 0.0))
            for one in tuple(self._told.values())
            if one.told is not None
        ]
        return msgspec.msgpack.encode(told)

    @_contained
    def on_beacon(self, robot: str, digest: bytes, address: Address, now: float) -> None:
        """Pull the incidents of `robot` if its beacon shows others than this robot knows."""
        if not digest or self._recorder.black_box.ring is None or digest == self.digest:
            return
        if not self._asks.may((robot, digest), now):
            return
        if self._puller.pull(robot, address, LIST, on_done=partial(self._on_list, robot)):
            self._asks.wait((robot, digest), now + LIST_PERIOD)

    def _on_list(self, robot: str, blob: Blob, reason: str) -> None:
        if blob is None:
            log.info("the incidents of %s are not known: %s", robot, reason)
            return
        received = boottime()
        # A tale at second hand is read again, since the age is better known at first hand.
        known = frozenset(id for id, told in self._told.items() if not told.source)
        check = partial(_checked, blob, self._identity(), known)
        self._in_thread(check, partial(self._on_checked, robot, received))

    def _on_checked(self, robot: str, received: float, checked: list[_Told] | str) -> None:
        """Begin to keep the last minute of each incident that was told by a member."""
        if isinstance(checked, str):
            log.warning("incidents of %s: %s", robot, checked)
            return
        for told in checked:
            incident = told.incident
            told.at += received
            told.source = "" if incident.by == robot else robot
            if (known := self._told.get(incident.id)) is not None:
                self._correct(known, told)
                continue
            # Its own ones are known to this robot: a forged one must not use up its rate.
            is_ours = self._is_member(incident.robot) and self._is_member(incident.by)
            is_ours = is_ours and incident.by != self._robot
            is_late = received - told.at > self._seconds + MARGIN
            if not is_ours or is_late or incident.id in self._kept:
                continue
            # Without room the list is pulled again.
            if self._has_room(told.teller) and self._may_begin(
                rate_of(incident, told.source), boottime()
            ):
                self._tell(told)
                self._await_tail(incident, told.at)

    def _correct(self, known: _Told, told: _Told) -> None:
        """Take the time of a known incident from the robot that told it, if a peer stated it."""
        if not known.source or told.source or known.incident != told.incident:
            return
        known.at = told.at
        known.told = told.told
        known.source = ""
        if told.incident.id in self._due:
            self._due[told.incident.id] = max(told.at + TAIL, boottime())

    # Files

    @property
    def is_pending(self) -> bool:
        """True while the seconds after an incident are awaited: peers then compare clocks."""
        return bool(self._due)

    @_contained
    def advance(self, now: float) -> None:
        """Write the files that are due, one at a time, and forget what is too old to be told."""
        if now - self._advanced_at > STALL_TIMEOUT:
            self._stalled_at = now
        self._advanced_at = now
        oldest = now - self._seconds - MARGIN
        # After a suspend of the machine a file may be due for long.
        self._told = {
            id: told for id, told in self._told.items() if told.at >= oldest or id in self._due
        }
        due = next((id for id, due in self._due.items() if now >= due), None)
        if due is not None and not self._is_writing:
            self._write_due(due)
        elif self._waiting and now >= self._retry_at and not self._is_writing:
            self._write_again(next(iter(self._waiting)))

    def _write_due(self, id: str, *, is_waiting: bool = False) -> None:
        del self._due[id]
        ring = self._recorder.black_box.ring
        told = self._told.get(id)
        if ring is None or told is None:
            return
        if ring.begin is None:
            self._on_event(f"incident {id}: nothing is kept of it so far")
            return
        begin = ring.begin
        end = boottime()
        try:
            reader = ring.reader()
        except OSError as error:
            self._fail(f"incident {id} is not on disk: {error.strerror}")
            return
        self._write(told, _Frames(reader, begin, end), is_waiting=is_waiting)

    def _write(self, told: _Told, source: _Frames, *, is_waiting: bool = False) -> None:
        """Write a file with the frames of `source`, and note it as kept."""
        # Values of now: a thread writes the file, and `told` may change meanwhile.
        incident = told.incident
        at = told.at
        operator = told.operator
        handed_on = told.source
        begin = source.begin
        end = source.end
        missing = f"nothing before {begin - at:+.0f} s" if begin > at - self._seconds else ""
        if end < at + TAIL - 1.0:
            missing = "; ".join(filter(None, (missing, f"nothing after {end - at:+.0f} s")))
        kept = tuple(self._kept.values())

        def work() -> _Written | _Refused:
            """In a thread: the frames are copied, packed and written."""
            try:
                left = source.read()
            except (OSError, CodecError) as error:
                return _Refused(None, b"", getattr(error, "strerror", None) or str(error))
            head = IncidentHead(
                incident=incident,
                at=at,
                clock=clock_id(),
                begin=begin,
                end=end,
                missing=missing,
                size=len(left.frames),
                about=left.about,
                boot=left.boot,
                wall=left.wall,
                revision=left.revision,
                operator=operator,
                source=handed_on,
            )
            return _write_file(self._folder, head, pack(head, left.frames), kept)

        self._do(work, incident.id, is_waiting=is_waiting)

    def _write_again(self, id: str, *, is_waiting: bool = False) -> None:
        """Write a file that the disk has refused before."""
        refused = self._waiting[id]
        kept = tuple(self._kept.values())
        assert refused.head is not None
        work = partial(_write_file, self._folder, refused.head, refused.data, kept)
        self._do(work, id, is_waiting=is_waiting)

    def _do(
        self, work: Callable[[], _Written | _Refused], id: str, *, is_waiting: bool = False
    ) -> None:
        """Write the file of the incident `id`, in a thread or at once; note it as kept."""

        def on_done(written: _Written | _Refused) -> None:
            self._is_writing &= is_waiting  # the end may write beside a thread
            if isinstance(written, _Refused):
                self._wait_for_disk(id, written)
            else:
                self._on_written(id, written)

        if is_waiting:
            on_done(work())
        else:
            self._is_writing = True
            self._in_thread(work, on_done)

    def _on_written(self, id: str, written: _Written) -> None:
        self._waiting.pop(id, None)
        if not self._waiting:
            self.fault = ""
        for gone in written.removed:
            self._kept.pop(gone, None)
            self._times.pop(gone, None)
        self._note_kept(written.head, written.size, written.crc)
        told = self._told.get(id)
        if told is not None and told.incident != written.head.incident:
            self._write_head(told)  # the robot found it while the file was written
        if self._keeps_left and not self._waiting:
            self._begin_ring(ring_folder(self._section.folder, os.environ))

    def _wait_for_disk(self, id: str, refused: _Refused) -> None:
        """Keep a file that the disk refused, for the next try; the oldest is lost without room."""
        is_new = id not in self._waiting
        fault = f"incident {id} is not on disk: {refused.fault}"
        self._retry_at = boottime() + RETRY
        if refused.head is not None:
            self._waiting[id] = refused
        while sum(len(one.data) for one in self._waiting.values()) > MAX_WAITING:
            lost = next(iter(self._waiting))
            del self._waiting[lost]
            self._on_event(f"incident {lost} is lost: too many files wait for the disk")
        if is_new:
            self._fail(fault)

    def _note_kept(self, head: IncidentHead, size: int, crc: int) -> None:
        id = head.incident.id
        at = head.at
        self._times[id] = at if head.clock == clock_id() else None
        self._kept[id] = KeptIncident(
            incident=head.incident,
            age=None,
            begin=head.begin - at,
            end=head.end - at,
            missing=head.missing,
            file=id + SUFFIX,
            size=size,
            crc=crc,
            operator=head.operator,
            source=head.source,
        )

    @property
    def _problem(self) -> str:
        """Why nothing is kept, or why the last file was not written; empty if all is well."""
        return self.fault or self._recorder.black_box.fault

    @property
    def text(self) -> str:
        """What is kept, in a line, or why nothing is."""
        ring = self._recorder.black_box.ring
        begin = boottime() if ring is None or ring.begin is None else ring.begin
        kept = f"keeps the last {boottime() - begin:.0f} s, {len(self._kept)} incidents"
        return self._problem or kept

    def _end(self, error: Exception) -> None:
        """End the black box after an error."""
        log.info("the black box ends", exc_info=error)
        self._due.clear()
        cause = getattr(error, "strerror", None) or repr(error)
        place = getattr(error, "filename", None)
        self._recorder.black_box.end(f"{place}: {cause}" if place else cause)

    def _fail(self, fault: str) -> None:
        self.fault = fault[:MAX_TEXT]
        self._on_event(f"black box: {self.fault}")

    # Questions

    def on_incidents(self, _: verbs.Nothing) -> verbs.IncidentsReply:
        """The incidents of which this robot keeps its last minute, and those that are awaited."""
        now = boottime()
        ring = self._recorder.black_box.ring
        awaited = {
            id: KeptIncident(
                incident=told.incident, age=None, file=id + SUFFIX, operator=told.operator,
                source=told.source,
            )
            for id in self._due
            if (told := self._told.get(id)) is not None
        }  # fmt: skip
        times = self._times | {id: self._told[id].at for id in awaited}
        for id, refused in self._waiting.items():
            if (head := refused.head) is not None:
                missing = f"not on disk: {refused.fault}"[:MAX_TEXT]
                awaited[id] = KeptIncident(
                    incident=head.incident, age=None, file=id + SUFFIX, missing=missing
                )
                times[id] = head.at
        kept = [
            msgspec.structs.replace(one, age=_age(times[id], one.incident.wall, now))
            for id, one in (*self._kept.items(), *awaited.items())
        ]
        begin = None if ring is None else ring.begin
        return verbs.IncidentsReply(
            robot=self._robot,
            now=now,
            clock=clock_id(),
            incidents=tuple(kept[-verbs.MAX_INCIDENTS :]),
            kept=None if begin is None else max(now - begin, 0.0),
            fault=self._problem,
        )

    def on_incident(self, query: verbs.FetchQuery) -> Callable[[], verbs.FetchReply]:
        """Bytes of the file of an incident; the returned function runs in a thread."""
        return partial(piece_of, self._robot, self._folder, SUFFIX, query)

    def _in_thread(self, work: Callable[[], T], on_done: Callable[[T], object]) -> None:
        """Call `work` in a thread, then `on_done` with its result on the loop."""

        async def run() -> None:
            try:
                on_done(await asyncio.to_thread(work))
            except Exception as error:
                self._end(error)

        task = asyncio.get_running_loop().create_task(run())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _place_of(head: IncidentHead) -> tuple[bool, float]:
    """The place of a file among others: by the clock of this boot, and before by the wall clock."""
    is_here = head.clock == clock_id()
    return is_here, head.at if is_here else head.wall + head.at - head.boot


def _age(at: float | None, wall: float, now: float) -> float | None:
    """S since an incident at `at` s, else at `wall` s since 1970; None if a clock was not set."""
    if at is None and min(wall, time.time()) < FIRST_WALL:
        return None
    return max(time.time() - wall if at is None else now - at, 0.0)


def _write_file(
    folder: Path, head: IncidentHead, data: bytes, kept: Sequence[KeptIncident]
) -> _Written | _Refused:
    """Write a file, then remove those that give way to it; or what the disk says."""
    new = KeptIncident(
        incident=head.incident, age=None, file=head.incident.id + SUFFIX, size=len(data),
        operator=head.operator, source=head.source,
    )  # fmt: skip
    removed = to_remove(kept, new)
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(folder / new.file, data, 0o600)
        for id in removed:
            (folder / (id + SUFFIX)).unlink(missing_ok=True)
    except OSError as error:
        return _Refused(head, data, error.strerror or str(error))
    return _Written(head, len(data), zlib.crc32(data), removed)


def _signed(incident: Incident, identity: Identity | None) -> ToldIncident | None:
    """In a thread: the incident as it is told, signed in a secured swarm; None without its key."""
    content = msgspec.msgpack.encode(incident)
    if identity is None:
        return ToldIncident(content=content, age=0.0)
    from swarmd.link.keys.private_keys import load_private_key  # 64 ms, for keys alone

    try:
        key = load_private_key(identity.key)
        certificate = read_regular(identity.certificate)
    except (OSError, ConfigError) as error:
        log.warning("incident %s is not told: %s", incident.id, error)
        return None
    signature = sign(key, Purpose.INCIDENT, content)
    return ToldIncident(content=content, age=0.0, signature=signature, certificate=certificate)


def _checked(blob: bytes, identity: Identity | None, known: Collection[str]) -> list[_Told] | str:
    """In a thread: the unknown incidents of a list, each at minus its age; or what is wrong.

    An incident without the signature of its robot hides none of the others.
    """
    new = []
    try:
        for told in _told.decode(blob):
            incident = _incident.decode(told.content)
            if incident.id in known:
                continue
            if identity is not None and not _is_signed(told, incident, identity):
                log.warning("incident %s is not signed by %s", incident.id, incident.by)
                continue
            operator = "" if identity is None else _marked_by(incident, identity)
            new.append(_Told(incident, -told.age, told, operator))
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        return f"a list that cannot be read: {error}"
    return new


def _is_signed(told: ToldIncident, incident: Incident, identity: Identity) -> bool:
    """True if a robot of the roster with the name `by` has signed it."""
    from swarmd.link.keys.private_keys import holder_of  # 64 ms, for keys alone

    name, key = holder_of(told.certificate, identity.info.authority)
    is_robot = name == incident.by and identity.roster.role_of(name) is Role.ROBOT
    return is_robot and is_signed_by(key, Purpose.INCIDENT, told.content, told.signature)


def _marked_by(incident: Incident, identity: Identity) -> str:
    """The operator of the roster who has signed these words as a mark; empty if none has."""

    name = incident.operator
    now = time.time()
    if incident.kind != IncidentKind.MARK or not incident.text.startswith(f"{name}: "):
        return ""
    has_clocks = min(now, incident.marked) >= FIRST_WALL
    if has_clocks and abs(now - incident.marked) > MARK_AGE:
        return ""
    key = identity.roster.operators.get(name)
    part = mark_part(incident.id, name, incident.text, incident.marked)
    return name if is_signed_by(key, Purpose.MARK, part, incident.signature) else ""


def _set_told(told: _Told, signed: ToldIncident | None) -> None:
    told.told = signed
