"""The verbs of the plane `control`: requests and questions of operators, with a row for each verb.

A row of the table `VERBS` decides

1. which service of a daemon answers the verb,
2. which roles may use the verb,
3. whether a robot refuses a request that quotes an earlier epoch (count of the robot's changes),
4. the line of the audit log.

A new verb needs a struct and a row here, a method `on_<verb>` of its handler, a file of
`operator/cli/`, and a line in `VERBS` of `operator/cli/swarmctl.py`.

Unknown fields of the structs are ignored, so that a newer peer can add fields. Bounds: bounds.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from typing import Annotated, Any, Generic, Literal, TypeVar

from msgspec import Meta, Struct

from swarmd.core.bounds import (
    Count,
    FileName,
    Id,
    IncidentId,
    Line,
    Name,
    ParamValues,
    ReasonText,
    Seconds,
    Word,
)
from swarmd.core.errors import CodecError
from swarmd.core.goal import MAX_LABELS, Goal
from swarmd.core.incident import MAX_TEXT, Incident, OperatorName, Signature, Wall
from swarmd.core.messages import Epochs, PeerView, Reply, Sandbox

MAX_LATE = 0.5
"""A run that is to start at a time is refused so many seconds after it."""
MAX_AHEAD = 60.0
"""A run is to start at most so many seconds ahead."""

MAX_AGE = 5.0
"""Seconds, beside `planned`, for which a start counts after it was issued."""
MAX_PLANNED = 3600.0
"""Seconds of `planned` that count at most."""

MAX_INCIDENTS = 64  # that a robot lists
MAX_FINDINGS = 1000
"""Findings of assumption monitors in one request: three of each robot at most."""


# Requests

MAX_ROSTER_PART = 40 * 1024
"""Bytes of a roster in one request: about 2000 names."""
CertificatePem = Annotated[bytes, Meta(max_length=2048)]


class _AnyRequest(Struct, frozen=True, kw_only=True, tag_field="verb"):
    """The fields that every request has. On the wire `verb` names the type of request.

    A request is issued when its user types, clicks or calls it. What the operator's side does then
    (query of the robots, canary, wait for a start time) does not make the request later.

    - `age`: s since the request was issued. Of a request that may start a run an upper bound: the
      age includes the longest round trip of the operator's last query of the robots.
    - `planned`: s of the age for which the operator's side worked (start-up, looks, canaries,
      earlier requests) or waits for a start time. A robot refuses a start that is older than
      MAX_AGE and this time.
    - `clock`, `issued`: the clock of the operator's machine (`core/clock.clock_id`), and the time
      in s on this clock at which the request was issued. Empty: not known.
    - `issued_at`: by robot, the earliest time in s on the robot's own clock at which the request
      may have been issued, for robots whose clock the operator has heard. Unlike `age` this time
      also holds for a copy that arrives late.
    """

    id: Name
    operator: Annotated[str, Meta(min_length=1, max_length=128)]
    age: Seconds = 0.0
    planned: Seconds = 0.0
    clock: Word = ""
    issued: Seconds = 0.0
    issued_at: dict[Name, Seconds] = {}

    @property
    def verb(self) -> str:
        """The last chunk of the key on which this request is sent."""
        return str(self.__struct_config__.tag)


def shared_fields(source: Struct, kind: type[Struct]) -> dict[str, Any]:
    """The fields of `source` that `kind` has by the same name: a field that is added is carried."""
    return {name: getattr(source, name) for name in kind.__struct_fields__ if hasattr(source, name)}


class _EpochRequest(_AnyRequest, frozen=True, kw_only=True):
    """A request that changes a robot only if the robot's epoch is still the quoted one."""

    targets: Epochs


class RunRequest(_EpochRequest, frozen=True, kw_only=True, tag="run"):
    """Run a pattern; the run ends after `seconds`, or when any condition of `until` holds.

    - `goal`: the goal of the run, with the same pattern, parameters and ends. The robot refuses a
      goal that is less (by the order of `core/goal.py`) than the goal that it holds.
    - `at`: by robot, the start time in s on the robot's own clock (CLOCK_BOOTTIME). The pattern is
      loaded before. A robot without an entry starts once the pattern is loaded. The robot refuses a
      request that arrives MAX_LATE after its start time, or later.
    - `speed`: the greatest speed of the run in m/s, beside that of the robot; None: no bound.
    """

    pattern: Name
    params: ParamValues = {}
    seconds: Annotated[float, Meta(gt=0.0, le=1e7)] | None = None
    until: tuple[Word, ...] = ()
    goal: Goal | None = None
    at: dict[Name, Seconds] = {}
    speed: Annotated[float, Meta(gt=0.0, le=100.0)] | None = None


class ResumeRequest(_EpochRequest, frozen=True, kw_only=True, tag="resume"):
    """Run the robot's own goal, which is offered or whose run has ended.

    `digest`: of the goal that the operator saw, in hex; the robot refuses if its own goal has
    another digest. Empty: any goal.
    """

    digest: Word = ""


class GoalRequest(_EpochRequest, frozen=True, kw_only=True, tag="goal"):
    """Set a goal without a run; a robot offers the goal, or stands if the goal has no pattern."""

    goal: Goal


class LabelRequest(_EpochRequest, frozen=True, kw_only=True, tag="label"):
    """Replace the labels of a robot, which keeps them on disk.

    None: back to the labels of the swarm file.
    """

    labels: Annotated[tuple[Id, ...], Meta(max_length=MAX_LABELS)] | None


class ResetRequest(_EpochRequest, frozen=True, kw_only=True, tag="reset"):
    """Clear the latches (emergency stops) with these `ids`, and a fault.

    `findings`: the violated assumptions of protection to clear, as named in the status. A running
    robot refuses to clear a finding: without the finding it would drive faster.
    """

    ids: tuple[Name, ...] = ()
    findings: Annotated[tuple[Line, ...], Meta(max_length=MAX_FINDINGS)] = ()
    reason: ReasonText = ""


class DriveRequest(_EpochRequest, frozen=True, kw_only=True, tag="drive"):
    """Take a robot by hand, or release it; the commands come as datagrams (`link/datagram.py`).

    - `is_release`: the hand ends that the request with the id `hand` began; else a hand begins. The
      epoch is not compared for a release: the hand may have been there for minutes.
    - `seconds`: after them the hand is lost; None: no bound.
    - `speed`: the greatest speed in m/s, beside that of the robot; None: no bound.
    """

    is_release: bool = False
    hand: Word = ""
    seconds: Annotated[float, Meta(gt=0.0, le=1e7)] | None = None
    speed: Annotated[float, Meta(gt=0.0, le=100.0)] | None = None


class ParamRequest(_EpochRequest, frozen=True, kw_only=True, tag="param"):
    """Set parameters of the running pattern."""

    params: Annotated[ParamValues, Meta(min_length=1)]


class ReloadRequest(_EpochRequest, frozen=True, kw_only=True, tag="reload"):
    """Replace a pattern's code. The flags decide about a present run of the pattern.

    - No flag: the run ends.
    - `is_rerun`: the run ends, and a new run with the new code follows.
    - `keeps_running`: the run continues with the old code. Set by a push without `is_rerun`.
    """

    pattern: Name
    is_rerun: bool = False
    keeps_running: bool = False


class PushRequest(_EpochRequest, frozen=True, kw_only=True, tag="push"):
    """A piece of a pushed pattern; after the last piece the robot tries and adopts the pattern.

    - `content`, `signature`: the manifest (`core/pattern_manifest.py`) and its signature.
    - `offset`: bytes of the pattern before the piece `data`.
    - `is_rerun`: a present run of the pattern ends, and a new run with the new code follows. False:
      nothing moves or stops, so the robot does not compare its epoch.
    """

    content: Annotated[bytes, Meta(max_length=8192)]
    signature: Annotated[bytes, Meta(max_length=64)] = b""
    offset: Count = 0
    data: Annotated[bytes, Meta(max_length=32768)] = b""
    is_rerun: bool = False


class ForgetRequest(_EpochRequest, frozen=True, kw_only=True, tag="forget"):
    """Remove the member `name`, which failed or left, from the list of members."""

    name: Name


class RecordRequest(_EpochRequest, frozen=True, kw_only=True, tag="record"):
    """Start or stop the recording of a robot; it moves nothing, so the epoch is not compared."""

    action: Literal["start", "stop"]


class MarkRequest(_EpochRequest, frozen=True, kw_only=True, tag="mark"):
    """Begin an incident with these words: all robots keep their last minute. It moves nothing.

    `incident`: its id, which all targets get. `marked`: s since 1970 by the operator's clock.
    `signature`: the operator's, of `mark_part`, so that all robots know whose words they are; empty
    in a swarm without keys, and from an older version.
    """

    words: ReasonText
    incident: IncidentId
    marked: Wall = 0.0
    signature: Signature = b""


class RosterRequest(_EpochRequest, frozen=True, kw_only=True, tag="roster"):
    """Take a signed roster, and the new certificate of the robot's name if there is one.

    `secret`: the swarm's secret at the generation of the roster; empty for a robot that the roster
    lacks. `certificates`: by robot, in PEM, for the robot's present key.

    The epoch is not compared: a robot takes the request even if the robot has changed since the
    operator's last query. The request never starts motion, but may end a run.
    """

    roster: Annotated[bytes, Meta(max_length=MAX_ROSTER_PART)]
    secret: Annotated[bytes, Meta(max_length=32)] = b""
    certificates: Annotated[dict[Name, CertificatePem], Meta(max_length=32)] = {}


class StopRequest(_AnyRequest, frozen=True, kw_only=True, tag="stop"):
    """Stop. `targets` None: every robot; the epochs are not compared.

    A run that was requested later than the stop continues.
    """

    targets: Epochs | None = None


class EstopRequest(_AnyRequest, frozen=True, kw_only=True, tag="estop"):
    """Emergency stop, which a robot holds as a latch until a reset.

    - `scope`: if it is `swarm`, the latch spreads to all robots of the swarm.
    - `is_relayed`: another robot relayed the request. A robot on which this latch was reset before
      refuses a relayed request.

    Goals that were set later stay valid.
    """

    targets: Epochs | None = None
    scope: Literal["swarm", "robots"] = "swarm"
    reason: ReasonText = ""
    is_relayed: bool = False


Request = (
    RunRequest
    | StopRequest
    | EstopRequest
    | ResetRequest
    | ParamRequest
    | DriveRequest
    | ReloadRequest
    | ResumeRequest
    | GoalRequest
    | LabelRequest
)
AnyRequest = Request | ForgetRequest | RecordRequest | MarkRequest | RosterRequest | PushRequest


def starts_motion(request: AnyRequest) -> bool:
    """True for a start: a request that may start a run, or takes a robot by hand."""
    always = isinstance(request, RunRequest | ResumeRequest)
    always |= isinstance(request, DriveRequest) and not request.is_release
    return always or (isinstance(request, ReloadRequest | PushRequest) and request.is_rerun)


class RequestHeader(Struct, frozen=True, kw_only=True):
    """The fields of a malformed request that a refusal needs; of any type and wire version."""

    id: object = ""
    operator: object = ""
    targets: object = None


# Questions and their answers


class Nothing(Struct, frozen=True):
    """The question of a verb whose payload is empty."""


class MembersQuery(Struct, frozen=True, kw_only=True):
    """Asks every daemon for its `PeerView`, except those in `answered`."""

    answered: tuple[Name, ...] = ()


class RecordingFile(Struct, frozen=True, kw_only=True):
    """A file of a recording. Times in s on the robot's clock, None while unknown.

    `crc`: the CRC-32 of a finished file. `dropped`: entries that were lost in it.
    """

    name: FileName
    size: Count
    is_open: bool
    crc: Count | None = None
    dropped: Count = 0
    begin: Seconds | None = None
    end: Seconds | None = None


class RecordingsReply(Struct, frozen=True, kw_only=True):
    """The recordings of a robot; `now`: s on the clock `clock` of the robot, at the answer.

    `fault`: why the last recording ended by itself; empty otherwise.
    """

    robot: Name
    now: Seconds
    clock: Annotated[str, Meta(max_length=32)]
    files: tuple[RecordingFile, ...]
    fault: Line = ""


class FetchQuery(Struct, frozen=True, kw_only=True):
    """Asks for `length` bytes of a recording from `offset` on."""

    file: FileName
    offset: Count
    length: Annotated[int, Meta(gt=0, le=32768)]


class FetchReply(Struct, frozen=True, kw_only=True):
    """Bytes of a recording with their CRC-32. `size`: of the file. `text`: why `data` is empty."""

    robot: Name
    file: FileName
    offset: Count
    size: Count
    data: bytes
    crc: Count
    text: Line = ""


class KeptIncident(Struct, frozen=True, kw_only=True):
    """An incident of which a robot keeps its last minute.

    - `age`: s since the incident, on the clock of this robot; None: not known after a reboot.
    - `begin`, `end`: s after the incident (negative: before) between which the file has entries;
      None while the minute after it is not over. `missing`: why seconds are missing; empty if none.
    - `file`, `size`, `crc`: of the file; size 0 without one.
    - `operator`: who marked it, which this robot knows: from the operator, or by its signature;
      empty else. `source`: the peer that handed it on, and says how long ago it was, if that is not
      the robot that told it.
    """

    incident: Incident
    age: Seconds | None
    begin: Annotated[float, Meta(ge=-1e9, le=1e9)] | None = None
    end: Annotated[float, Meta(ge=-1e9, le=1e9)] | None = None
    missing: Line = ""
    file: FileName
    size: Count = 0
    crc: Count = 0
    operator: OperatorName = ""
    source: Word = ""


class IncidentsReply(Struct, frozen=True, kw_only=True):
    """The incidents that a robot keeps, oldest first; `now`: s on the clock `clock` of the robot.

    `kept`: s that the black box holds now; None: it is off. `fault`: why it keeps nothing.
    """

    robot: Name
    now: Seconds
    clock: Annotated[str, Meta(max_length=32)]
    incidents: Annotated[tuple[KeptIncident, ...], Meta(max_length=MAX_INCIDENTS)] = ()
    kept: Seconds | None = None
    fault: Line = ""


class PushedPatternReport(Struct, frozen=True, kw_only=True):
    """A pushed pattern on a robot.

    - `standing`: provisional (new), held (has run for 60 s without a fault), returned (has failed;
      the version before is used again), missing (not pulled yet) or removed.
    - `version`, `digest` (hex): of the code that a run uses; empty without code.
    - `pushed`: the digest of the newest push.
    - `ran`: s of runs without a fault.
    - `source`: the operator or robot that handed the code over.
    - `text`: why the code has failed, or cannot be used.
    """

    name: Name
    standing: Word
    version: Word = ""
    digest: Word = ""
    pushed: Word = ""
    ran: Seconds = 0.0
    source: Line = ""
    issuer: Word = ""
    generation: Count = 0
    text: Line = ""


class PushedPatternsReply(Struct, frozen=True, kw_only=True):
    """The pushed patterns of a robot; `generation`: the greatest generation that it knows.

    `newest`, `signature`: the signed manifest of that generation, as its proof.
    """

    robot: Name
    generation: Count = 0
    patterns: tuple[PushedPatternReport, ...] = ()
    newest: Annotated[bytes, Meta(max_length=8192)] = b""
    signature: Annotated[bytes, Meta(max_length=64)] = b""


AUDIT_PAGE = 100
"""Entries of an answer."""
LOG_PAGE = 200
"""Records of an answer, and of a batch that a robot publishes."""
MAX_LOG_LINE = 500
"""Characters of a record."""

LogLine = Annotated[str, Meta(max_length=MAX_LOG_LINE)]


class AuditEntry(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A request that a robot answered, or a latch or goal that it adopted from a peer.

    - `seq`: the number of the entry, counted by the robot.
    - `boot`: the time in s on the robot's clock `clock`, which begins anew at each boot.
    - `wall`: the time in s since 1970 (UTC); None if the wall clock had not been set.
    - `targets`: the count of target robots; None: all robots.
    - `left_out`: the count of earlier entries that were not written, since they were too many or
      the disk had a fault.
    - `permit`: the name of the permit of the operator's key; empty for an operator of the roster.
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
    permit: Word = ""


class AuditQuery(Struct, frozen=True, kw_only=True):
    """Asks for the last `count` entries whose `seq` is below `before`, of the last `since` s."""

    before: Count | None = None
    since: Seconds | None = None
    count: Annotated[int, Meta(ge=1, le=AUDIT_PAGE)] = AUDIT_PAGE


class AuditReply(Struct, frozen=True, kw_only=True):
    """Entries, oldest first, and the age of each in s.

    For an entry from before the last boot, the age follows from the wall clock. Such an age is None
    if the wall clock was not set when the entry was written, or is not set now. `has_more`: older
    entries match, too. `fault`: why entries cannot be written at present.
    """

    robot: Name
    entries: Annotated[tuple[AuditEntry, ...], Meta(max_length=AUDIT_PAGE)]
    ages: Annotated[tuple[Seconds | None, ...], Meta(max_length=AUDIT_PAGE)]
    has_more: bool
    fault: Line = ""


class LogRecord(Struct, frozen=True, array_like=True):
    """A line of a daemon's log, or a line that its pattern printed (`pattern`).

    `seq` counts the records of an instance. `at`: s on the robot's clock. `level`: of `logging`.
    """

    seq: Count
    at: Seconds
    level: Annotated[int, Meta(ge=0, le=100)]
    source: Word
    text: LogLine


class LogsQuery(Struct, frozen=True, kw_only=True):
    """Asks for the last `count` records of at least `level` that contain `grep`, ignoring case."""

    count: Annotated[int, Meta(ge=1, le=LOG_PAGE)] = 50
    level: Annotated[int, Meta(ge=0, le=100)] = 0
    grep: Annotated[str, Meta(max_length=200)] = ""


class LogBatch(Struct, frozen=True, kw_only=True):
    """Log records of a robot, oldest first. `now`: s on its clock. `last`: its latest `seq`.

    `left_out`: the count of lines in this life of the daemon that exceeded the rate limit.
    """

    robot: Name
    instance: Name
    now: Seconds
    last: Count
    records: Annotated[tuple[LogRecord, ...], Meta(max_length=LOG_PAGE)]
    left_out: Count = 0


class LinkReport(Struct, frozen=True, array_like=True):
    """The link from a robot: beacons received and lost, s since the last, round trip in s.

    `ways`: multicast, broadcast, unicast.
    """

    robot: Name
    received: Count
    lost: Count
    age: Seconds
    round_trip: Seconds | None
    ways: Annotated[tuple[Word, ...], Meta(max_length=4)] = ()


class LinksQuery(Struct, frozen=True, kw_only=True):
    """Asks for the links of a robot. `measures`: also ping the peers, for a later answer."""

    measures: bool = False


class LinksReply(Struct, frozen=True, kw_only=True):
    """The links of a robot, last heard first. `unlisted`: the count of further links."""

    robot: Name
    links: Annotated[tuple[LinkReport, ...], Meta(max_length=512)]
    unlisted: Count = 0


class DiskFacts(Struct, frozen=True, kw_only=True):
    """A folder and its disk. `free` (for this user), `size`: in bytes. `fault`: of a test write."""

    purpose: Word
    path: Line
    free: Count = 0
    size: Count = 0
    fault: Line = ""


class MachineFacts(Struct, frozen=True, kw_only=True):
    """A machine: load of the last minute, memory in bytes, `wall` in s since 1970 (UTC).

    `is_synced`: whether the kernel considers the wall clock synchronised; None if unknown.
    `throttled`: the bits of `vcgencmd get_throttled` of a Raspberry Pi; None on other machines.
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
    throttled: Count | None = None


class PortFacts(Struct, frozen=True, kw_only=True):
    """The processes that use a port, such as `swarmd (412)`; empty: free; `?`: unknown."""

    protocol: Word
    port: Count
    users: Annotated[tuple[Word, ...], Meta(max_length=32)] = ()


class NetworkFacts(Struct, frozen=True, kw_only=True):
    """An interface, and its properties that may block datagrams.

    `mtu`, `has_multicast`: None if unknown. `firewall`: none, open, drops or unknown.
    `firewall_text`: the rules that drop, or why the firewall is unknown.
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
    """A robot's measurements of its own machine and network, for `swarmctl doctor`.

    - `identity_expires`: the end of the certificate in s since 1970 (UTC). `roster`: the generation
      of the roster. Both are None without keys.
    - `heard`: the number of alive robots whose datagrams come by each way, such as `multicast`.
    - `storage`: why a restart would lose latches; empty without a fault.
    - `sandbox`: the sandbox of the pattern host.
    """

    robot: Name
    version: Word
    kernels: Line
    profile: Word
    machine: MachineFacts
    network: NetworkFacts
    identity_expires: Wall | None = None
    roster: Count | None = None
    heard: dict[Word, Count] = {}
    storage: Line = ""
    sandbox: Sandbox | None = None


# Lines of the audit log

MAX_PART = 60
"""Characters of one text in the audit log that its sender chose."""


def shortened(text: str, length: int = MAX_PART) -> str:
    """The text, cut between words, with an ellipsis, to at most `length` characters."""
    if len(text) <= length:
        return text
    kept = text[: length - 3]
    words, blank, _ = kept.rpartition(" ")
    is_whole = text[len(kept)] == " " or not blank
    return f"{kept if is_whole else words.rstrip(' ,;:')}..."


def mark_text(operator: str, words: str) -> str:
    """The words of an incident that an operator marks."""
    return shortened(f"{operator}: {words}", MAX_TEXT)


def _assignments(values: Mapping[str, object]) -> str:
    return shortened(" ".join(f"{name}={value}" for name, value in values.items()))


def _joined(*parts: str) -> str:
    return " ".join(filter(None, parts))


def _run_line(request: RunRequest) -> str:
    return _joined(
        request.pattern,
        _assignments(request.params),
        "" if request.seconds is None else f"for {request.seconds:g} s",
        f"until {shortened(' or '.join(request.until))}" if request.until else "",
        "" if request.goal is None else f"as goal {request.goal.generation}",
    )


def _label_line(request: LabelRequest) -> str:
    labels = request.labels
    return "as configured" if labels is None else shortened(", ".join(labels) or "none")


def _reset_line(request: ResetRequest) -> str:
    findings = f"of {shortened('; '.join(request.findings))}" if request.findings else ""
    return _joined(findings, _reason_line(request))


def _reason_line(request: ResetRequest | EstopRequest) -> str:
    return f"({shortened(request.reason)})" if request.reason else ""


def _push_line(request: PushRequest) -> str:
    from swarmd.core.pattern_manifest import Signed, read_entry  # not at each start of swarmctl

    try:
        return read_entry(Signed(request.content)).manifest.label
    except CodecError:
        return "what cannot be read"


# The table


class Handler(Enum):
    """The part of a daemon that answers a verb, by its method `on_<verb>`.

    All members except ROBOT and NETWORK name services: fields of `Services` in daemon/requests.py.
    """

    ROBOT = "robot"
    """`RequestHandler` in robot/requests.py; the reply is one of the robot's actions."""
    NETWORK = "network"
    """`ZenohBus.serve_view`."""
    RECORDING = "recording"
    INCIDENTS = "incidents"
    ROSTERS = "rosters"
    PUSHES = "pushes"
    PUSHED = "pushed"
    TOOLS = "tools"

    @property
    def is_service(self) -> bool:
        """True for a service of the daemon."""
        return self not in (Handler.ROBOT, Handler.NETWORK)


Asked = TypeVar("Asked", bound=Struct)
Answer = TypeVar("Answer")


class Verb(Struct, Generic[Asked, Answer], frozen=True):
    """A row of the table. `name`: the chunk of the key after `control/`.

    - `asked`: the type of the payload; `Nothing` if the payload is empty.
    - `audit` returns the part of a line of the audit log that stands between verb and targets, such
      as the pattern of a run.
    - `is_for_operators`: viewers may not ask this question.
    """

    name: str
    asked: type[Asked]
    answer: type[Answer]
    handler: Handler
    audit: Callable[[Asked], str] = lambda request: ""
    is_for_operators: bool = False

    @property
    def is_request(self) -> bool:
        """True for a request, which is audited and repeated with one id; False for a question."""
        return issubclass(self.asked, _AnyRequest)

    @property
    def needs_epoch(self) -> bool:
        """True for requests that may start motion, or change a run.

        The robot refuses such a request unless it quotes the present epoch.
        """
        return self.handler is Handler.ROBOT and not self.is_datagram

    @property
    def is_datagram(self) -> bool:
        """True if a `Stop` datagram carries the request, too, as `swarmctl` sends it."""
        return issubclass(self.asked, StopRequest | EstopRequest)

    @property
    def is_for_viewers(self) -> bool:
        """True if viewers may ask; operators may ask every verb, robots no verb."""
        return not self.is_request and not self.is_for_operators


def _request(
    asked: type[Asked],
    handler: Handler,
    audit: Callable[[Asked], str] = lambda request: "",
) -> Verb[Asked, Reply]:
    """The row of a request; the verb's name is the tag of the request's struct."""
    return Verb(str(asked.__struct_config__.tag), asked, Reply, handler, audit)


_ROBOT = Handler.ROBOT
_TOOLS = Handler.TOOLS
_RECORDING = Handler.RECORDING

MEMBERS = Verb("members", MembersQuery, PeerView, Handler.NETWORK)
RECORDINGS = Verb("recordings", Nothing, RecordingsReply, _RECORDING)
FETCH = Verb("fetch", FetchQuery, FetchReply, _RECORDING)
INCIDENTS = Verb("incidents", Nothing, IncidentsReply, Handler.INCIDENTS)
INCIDENT = Verb("incident", FetchQuery, FetchReply, Handler.INCIDENTS, is_for_operators=True)
PLUGINS = Verb("plugins", Nothing, PushedPatternsReply, Handler.PUSHED)
LOGS = Verb("logs", LogsQuery, LogBatch, _TOOLS)
AUDIT = Verb("audit", AuditQuery, AuditReply, _TOOLS, is_for_operators=True)
LINKS = Verb("links", LinksQuery, LinksReply, _TOOLS)
DOCTOR = Verb("doctor", Nothing, DoctorReply, _TOOLS)
_ROWS: tuple[Verb[Any, Any], ...] = (
    MEMBERS,
    _request(RunRequest, _ROBOT, _run_line),
    _request(ResumeRequest, _ROBOT),
    _request(
        GoalRequest,
        _ROBOT,
        lambda request: f"{request.goal.generation}: {request.goal.pattern or 'stand'}",
    ),
    _request(LabelRequest, _ROBOT, _label_line),
    _request(StopRequest, _ROBOT),
    _request(EstopRequest, _ROBOT, _reason_line),
    _request(ResetRequest, _ROBOT, _reset_line),
    _request(ParamRequest, _ROBOT, lambda request: _assignments(request.params)),
    _request(DriveRequest, _ROBOT, lambda request: "released" if request.is_release else ""),
    _request(ReloadRequest, _ROBOT, lambda request: request.pattern),
    _request(PushRequest, Handler.PUSHES, _push_line),
    _request(ForgetRequest, _TOOLS, lambda request: request.name),
    _request(RecordRequest, _RECORDING, lambda request: request.action),
    _request(MarkRequest, Handler.INCIDENTS, lambda request: f"({shortened(request.words)})"),
    _request(RosterRequest, Handler.ROSTERS),
    *(RECORDINGS, FETCH, INCIDENTS, INCIDENT, PLUGINS, LOGS, AUDIT, LINKS, DOCTOR),
)
VERBS: Mapping[str, Verb[Any, Any]] = {row.name: row for row in _ROWS}
