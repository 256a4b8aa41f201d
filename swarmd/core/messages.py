"""The messages between robots and operators: typed structs, no numpy (swarmctl imports them).

Unknown fields are ignored, so that a newer peer can add fields. Types with bounds: bounds.py.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from swarmd.core.bounds import (
    Angle,
    BoundedScalar,
    Coordinate,
    Count,
    Height,
    Line,
    Metres,
    Name,
    Rate,
    Seconds,
    Speed,
    Stamp,
    Step,
    Word,
)
from swarmd.core.goal import GoalStatus
from swarmd.core.refusal import Refusal

MAX_EVENTS = 10
"""Events that a robot keeps and tells."""
MAX_TRACKS = 32
"""Tracks that a robot shows."""
STATUS_SILENCE = 3.0
"""A status older than this, in s, is not the present one: robots send one each second."""


def shown(group: str, title: str, unit: str = "") -> Meta:
    """The words of a field, for `describe`, pages and Python: its group, its title and its unit.

    A required field is always shown, any other field unless its value is empty.
    """
    return Meta(title=title, extra={"group": group, "unit": unit})


class State(StrEnum):
    """The state of a robot; `robot/state_machine.py` has the transitions."""

    IDLE = "idle"
    RUNNING = "running"
    STOPPED = "stopped"
    ESTOPPED = "estopped"
    FAULTED = "faulted"


class Reason(StrEnum):
    """Why a robot does not move: exactly one reason for every standstill."""

    # idle
    NEVER_ASKED = "never_asked"
    FINISHED = "finished"
    RESET = "reset"
    # stopped, estopped, faulted
    OPERATOR = "operator"
    RELOADED = "reloaded"
    ESTOP = "estop"
    LOOP_STALLED = "loop_stalled"
    LOAD_FAILED = "load_failed"
    DUPLICATE_ID = "duplicate_id"
    QUARANTINED = "pattern_quarantined"
    LEAVING = "leaving"
    NETWORK_CHANGED = "network_changed"
    ROSTER_CHANGED = "roster_changed"
    SUPERSEDED = "superseded"  # by a greater goal
    LEASE_ENDED = "lease_ended"  # the operator was not heard for the run lease
    LOW_BATTERY = "low_battery"
    # holds: each makes the command zero; a hold that lasts ends the run
    NO_SCAN = "no_scan"
    INVALID_SCAN = "invalid_scan"
    STALE_SCAN = "stale_scan"
    SCAN_CONFLICT = "two_scan_sources"
    BASE_CONFLICT = "two_bases"
    HAZARD = "hazard"  # the base reports one, or its source of such reports is silent
    FROZEN_SCAN = "frozen_scan"
    FROZEN_STAMP = "frozen_stamp"  # scans differ, and their stamps do not
    CLOCK_SET = "clock_set"  # stamps jumped, so that scans are rejected or seem late
    LATE_SCAN = "late_scan"
    STALE_ODOMETRY = "stale_odometry"
    COMMAND_EXPIRED = "command_expired"
    DRIVER_LOST = "driver_lost"
    INCOMPATIBLE_PEER = "incompatible_peer"
    HAND_LOST = "hand_lost"  # who drove the robot was not heard; its run waits
    NO_POSE = "no_pose"  # the robot has a fence, and no usable pose in its frame
    PATTERN_RESTARTING = "pattern_restarting"
    # running, with a command of zero
    NO_REQUESTED_COMMAND = "no_requested_command"
    PROTECTION = "protection"


class Code(StrEnum):
    """The kinds of answer to a request."""

    APPLIED = "applied"
    REFUSED = "refused"
    FAILED = "failed"


class Epoch(Struct, frozen=True):
    """The state of a robot as an operator saw it: the instance, and the count of its changes."""

    instance: Name
    revision: Count


Epochs = dict[Name, Epoch | None]


class ReplyHeader(Struct, frozen=True, kw_only=True):
    """The fields of a `Reply` that are read from every version."""

    id: Name
    robot: Name
    code: str
    refusal: str | None = None
    text: Line = ""


class Reply(Struct, frozen=True, kw_only=True):
    """A robot's answer (acknowledgement) to a request. `refusal` is set unless `code` is applied.

    `is_moving`: in the answer to a stop, the robot commands zero, but odometry does not show so far
    that the base rests.
    """

    id: Name
    robot: Name
    code: Code
    refusal: Refusal | None = None
    text: Line = ""
    epoch: Epoch | None = None
    is_moving: bool = False


class LimitingObstacle(Struct, frozen=True, gc=False):
    """One obstacle that constrains the command.

    - `bearing`: in rad from the axle. `gap`: in m from the footprint.
    - `cap`: the limit in m/s of the outline's speed towards the obstacle.
    - `age`: s from the measurement of the obstacle until the decision; None if the protection mode
      does not use this age.
    - `age_cost`: by how many m/s the `age` lowers `cap`.
    """

    bearing: Annotated[float, Meta(ge=-7.0, le=7.0)]
    gap: Metres
    cap: Speed
    age: Seconds | None = None
    age_cost: Speed = 0.0


class DecisionSummary(Struct, frozen=True, kw_only=True):
    """The latest decision of protection.

    - `rows`: the obstacles that constrain the command, the tightest first.
    - `is_recovering`: the judged command came from recovery, which leads around an obstacle, not
      from the pattern.
    - `duty`: the share of ticks since `run` in which protection was active.
    - `speed_share`: the factor of the speed limits, below 1 after a violated assumption.
    - `avoiding`: what avoidance does, such as `avoiding tb3-04` or `passes an opening`; empty if
      it does nothing.
    """

    mode: Word = "potential_field"
    is_active: bool = False
    requested_linear: Speed = 0.0
    requested_angular: Speed = 0.0
    requested_lateral: Speed = 0.0
    safe_linear: Speed = 0.0
    safe_angular: Speed = 0.0
    safe_lateral: Speed = 0.0
    min_gap: Annotated[Metres | None, shown("Protection", "nearest", "m")] = None
    scan_age: Annotated[Seconds | None, shown("Protection", "scan age", "s")] = None
    rows: tuple[LimitingObstacle, ...] = ()
    is_recovering: bool = False
    duty: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    decisions: Count = 0
    speed_share: Annotated[float, Meta(ge=0.0, le=1.0)] = 1.0
    avoiding: Line = ""


class RecordingSummary(Struct, frozen=True, kw_only=True):
    """The present recording of a robot: file, size in bytes, and count of dropped entries."""

    file: Line
    size: Count
    dropped: Count


class DelayFigure(Struct, frozen=True, kw_only=True):
    """The delay of scans, measured by one method.

    - `method`: `stamps` (stamps of scans and odometry are compared) or `turns` (while the robot
      turns, scans are matched to the odometry).
    - `delay`: the mean age of the rays of a scan on arrival, in s; None: unknown, for the reason in
      `text`.
    - `spread`: a standard deviation in s. With `stamps`, that of the delays of single scans. With
      `turns`, that of the estimate `delay`.
    - `age`: s since the last sample.
    """

    method: Word
    delay: Seconds | None = None
    spread: Seconds = 0.0
    samples: Count = 0
    age: Seconds = 0.0
    text: Line = ""

    @property
    def line(self) -> str:
        """The delay with spread, samples and age in one line, or why the delay is unknown."""
        if self.delay is None:
            return f"by {self.method}: not known: {self.text}"
        return (
            f"by {self.method}: {self.delay:.3f} s +- {self.spread:.3f} s, {self.samples} samples,"
            f" the last {self.age:.0f} s ago"
        )


class ScanDelaySummary(Struct, frozen=True, kw_only=True):
    """The delay of scans: declared by the platform, and measured. In s.

    - `declared`: the latency in the platform's file.
    - `added`: the measured delay beyond `declared`. Protection assumes `declared` plus `added` as
      the delay of a scan.
    - `bound`: the robot is held while `added` exceeds this bound.
    """

    declared: Seconds
    added: Seconds
    bound: Seconds
    figures: tuple[DelayFigure, ...] = ()


class NarrowestPassage(Struct, frozen=True):
    """The least widths in m through which protection lets a robot drive.

    `door`: between two posts. `corridor`: between two long walls. `meeting`: a corridor in which
    two such robots can pass each other.
    """

    door: Metres
    corridor: Metres
    meeting: Metres


class SetDown(Struct, frozen=True, kw_only=True):
    """Where a robot may be set down, so that protection lets it drive off at once.

    - `gap`: m from its outline to walls and other obstacles, at least.
    - `lidar`: m around its lidar that must be free; None: no such circle.
    - `unseen`: m by which protection assumes that obstacles extend beyond what the lidar shows.
    """

    gap: Metres
    lidar: Metres | None = None
    unseen: Metres = 0.0


class WallsStandSummary(Struct, frozen=True):
    """The assumption that walls which have stood do not begin to move (`walls_stand`).

    The assumption is for walls that are straight for `length` m and have stood for `seconds`.
    `is_used`: False once protection has seen such a wall move. `foot`: m by which such walls stick
    out at most; None: as all obstacles.
    """

    length: Metres
    seconds: Seconds
    is_used: bool = True
    foot: Metres | None = None


class FenceSummary(Struct, frozen=True, kw_only=True):
    """The fence of a robot, in the shared frame `frame`.

    - `polygons`: corners in m; first the polygon to stay in, then the polygons to keep out of.
    - `clearance`: m from the robot to the fence, negative for a robot outside; None without a
      usable pose, for the reason in `text`.
    - `error`: the bound of the error of `clearance` in m.
    - `limits`: the fence changed the last command.
    - `holds`: the setting `without_pose` is `hold`: the robot stands while it has no usable pose.
    """

    frame: Name
    polygons: tuple[tuple[tuple[Coordinate, Coordinate], ...], ...] = ()
    clearance: Metres | None = None
    error: Metres = 0.0
    limits: bool = False
    holds: bool = True
    text: Line = ""


class BatterySummary(Struct, frozen=True, kw_only=True):
    """The battery of a robot with the settings `on_low_battery`.

    - `charge`: the share of a full battery; None without a fresh reading.
    - `is_low`: the charge fell under `below`, and has not risen to the higher bound since.
    - `pattern`: the pattern that a robot with a low battery runs; None: the robot stands.
    - `runs`: the present run is the run of `pattern` for the low battery.
    """

    charge: float | None
    below: float
    is_low: bool
    pattern: Word | None = None
    runs: bool = False


class ProcessUsage(Struct, frozen=True, kw_only=True):
    """Usage of a process: `cpu`, the share of a core over the last second; `memory` in bytes."""

    cpu: Annotated[float, Meta(ge=0.0, le=1e4)]
    memory: Count


class Sandbox(Struct, frozen=True, kw_only=True):
    """The accesses that the kernel denies a pattern host: of `files`, `network`, `processes`.

    `missing`: the accesses that are not denied, with the reason; empty if all are denied.
    """

    denied: tuple[Word, ...] = ()
    missing: Line = ""


class Health(Struct, frozen=True, kw_only=True):
    """Measurements of the daemon itself. Rates in Hz, times in s.

    - `network`: the state of the interface, such as `wlan0: up, 10.0.0.5`.
    - `storage`: why a restart would lose latches; empty if latches are on disk.
    - `black_box`: how much it keeps for incidents, or why nothing.
    - `usage`, `pattern_usage`: the usage of the daemon and of its pattern host. None: unknown, in
      the first second.
    - `sandbox`: the sandbox of the pattern host; None until the first host has started.
    """

    scan_rate: Annotated[Rate, shown("Health", "scan rate", "Hz")] = 0.0
    loop_p99: Annotated[Seconds, shown("Health", "loop p99", "s")] = 0.0
    loop_stalls: Annotated[Count, shown("Health", "loop stalls")] = 0
    host_restarts: Annotated[Count, shown("Health", "host restarts")] = 0
    dropped: dict[Word, Count] = {}
    driver: Annotated[Line, shown("Health", "driver")] = ""
    driver_up: bool = False
    network: Annotated[Line, shown("Health", "network")] = ""
    storage: Annotated[Line, shown("Health", "storage")] = ""
    black_box: Annotated[Line, shown("Health", "black box")] = ""
    usage: Annotated[ProcessUsage | None, shown("Health", "daemon")] = None
    pattern_usage: Annotated[ProcessUsage | None, shown("Health", "pattern host")] = None
    sandbox: Annotated[Sandbox | None, shown("Health", "sandbox")] = None


class Latch(Struct, frozen=True, kw_only=True):
    """An emergency stop that has not been reset.

    - `age`: s since it was issued, when the robot made the message; None: not known, as after a
      restart of the robot's machine.
    """

    issuer: Annotated[str, Meta(max_length=128)]
    scope: Annotated[Literal["swarm", "robots"], shown("Emergency stops", "for")]
    reason: Line = ""
    age: Seconds | None = None


class LoggedEvent(Struct, frozen=True, kw_only=True):
    """An event in a robot's log. `at` in s since the daemon started."""

    at: Seconds
    text: Line


class Body(Struct, frozen=True, kw_only=True):
    """The body of a robot, as the robot reports it to peers.

    - `surface_speed`: the highest speed of any surface of the robot near an obstacle, in m/s.
    - `radius`: the radius of a circle around the axle that contains the robot, in m.
    - `scan_plane`: the height of the robot's range sensor above the floor, in m.
    - `lowest`, `highest`: each horizontal plane between these heights in m meets the body.

    A height that the platform does not declare is None.
    """

    platform: Word
    surface_speed: Annotated[float, Meta(ge=0.0, le=1000.0)]
    radius: Annotated[float, Meta(ge=0.0, le=1000.0)]
    scan_plane: Height | None = None
    lowest: Height | None = None
    highest: Height | None = None


class PeerFinding(Struct, frozen=True, kw_only=True):
    """A property of the peer `robot` that contradicts an assumption of this robot's protection.

    - `kind`: `unseen`: the lidar does not detect the peer. `faster`: the peer is faster than this
      robot assumes. `unknown`: the peer does not report enough of its body.
    - `text`: the finding in one line.
    - `holds`: this robot stands because of the finding.
    """

    robot: Name
    kind: Literal["unseen", "faster", "unknown"]
    text: Line
    holds: bool


MUTE = "mute"
DEAF = "deaf"
UNHEARD = "unheard"
MISFIT = "misfit"
STRAYS = "strays"
DOUBTED = "doubted"
"""The kinds of `PeerFault`."""
SUSPICIONS = frozenset({UNHEARD, DOUBTED})
"""The kinds that this robot alone finds: it may be the culprit."""


class PeerFault(Struct, frozen=True, kw_only=True):
    """A fault of the robot `robot` that it cannot know of itself: peers tell it.

    - `kind`: `mute`: its beacons arrive and its pattern's messages do not. `deaf`: it hears the
      beacons of others and not the messages that still others hear. Robots name both by a majority.
      `unheard`: the robot with this status misses its messages, and no majority tells it.
      `misfit`: what its lidar shows does not fit where two robots or more see it. `strays`: it
      moves while it tells that it stands, as two robots or more find. `doubted`: the robot with
      this status alone finds one of both. A later version may tell further kinds.
    - `by`, `of`: so many of the robots that could tell the fault tell it; for `deaf` they hear
      messages; for `unheard` and `doubted` without the robot with this status.
    - `tellers`: those robots, and the robot with this status is `self`; only of `misfit`, `strays`
      and `doubted`.
    - `figure`: by what this robot itself finds it; empty if others tell it.
    - `since`: s since the beacon before the first message that was missed, or, if only others miss
      messages, since their beacons tell it.
    """

    robot: Name
    kind: Word
    by: Count
    of: Count
    since: Seconds = 0.0
    tellers: tuple[Name, ...] = ()
    figure: Line = ""

    @property
    def text(self) -> str:
        """The fault in words, without its time."""
        told = f"{self.by} of {self.of}"
        if self.kind == MUTE:
            return f"mute: its beacons arrive, and its messages do not at {told} robots"
        if self.kind == DEAF:
            return f"deaf: messages do not arrive at it, and arrive at {told} others"
        if self.kind == UNHEARD:
            return (
                f"unheard: its beacons arrive here, and its messages do not; {told} others tell the"
                " same: one of the two radios is at fault"
            )
        figure = f" ({self.figure})" if self.figure else ""
        if self.kind == MISFIT:
            return (
                f"misfit: its lidar does not show robots where they are, as {told} robots"
                f" tell{figure}"
            )
        if self.kind == STRAYS:
            return f"strays: it moves while it tells that it stands, as {told} robots tell{figure}"
        if self.kind == DOUBTED:
            return (
                f"doubted by this robot{figure}; {told} others tell the same: one of the two robots"
                " is at fault"
            )
        return f"{self.kind}: told by {told} robots"


class Param(Struct, frozen=True, kw_only=True):
    """The value of a parameter and the layer it comes from."""

    value: BoundedScalar | None
    source: Word


class KeySummary(Struct, frozen=True, kw_only=True):
    """The generation of a daemon's roster, and the end of its certificate in s since 1970 (UTC)."""

    generation: Count
    expires: Count


class Status(Struct, frozen=True, kw_only=True):
    """The published status of a robot: on each change and at 1 Hz.

    - `readings`: the latest values of the robot's scalar sensors, such as `battery` from 0 to 1.
    - `stale_readings`: the sensors without a fresh value.
    - `version`: of the daemon's package. `kernels`: which code decides (`describe_kernels`).
    - `body`: the body that the robot's beacons report.
    - `peers`: a finding for each peer that the robot may not see, or that is faster than the robot
      assumes.
    - `passage`: the narrowest widths through which protection lets the robot drive; None if the
      protection mode has no such width.
    - `walls_stand`: None for a robot that does not assume standing walls.
    - `fence`: None without a fence. `battery`: None without the settings `on_low_battery`.
    - `findings`: the violated assumptions for which the robot drives slower, each with its
      evidence.
    - `not_following`: how the base fails to follow its commands, or follows late; empty if the base
      follows.
    - `goal`: None before the robot has seen a goal. `keys`: None in an insecure swarm.
    - `places`: where the robot knows its neighbors to be, in its base frame, in a line for each.
    - `programs`: the Zenoh programs whose liveliness tokens the robot sees.
    - `words`: what each word of an operator means to the robot, as its platform's file says.
    - `set_down`: None if the protection mode has no such distance.
    - `held_for`: for how many s protection has kept a robot in place that asks for motion and has
      free floor ahead or behind; None below 10 s.
    - `driven_by`: the operator who drives the robot by hand; empty without one.
    - `peer_faults`: faults of robots, this one among them, that only peers can tell.
    """

    robot: Name
    instance: Annotated[Name, shown("Robot", "instance")]
    platform: Annotated[Word, shown("Robot", "platform")]
    driver: Word
    host: Annotated[Word, shown("Robot", "host")]
    profile: Word
    is_secured: bool
    state: State
    reason: Annotated[Reason | None, shown("State", "reason")]
    detail: Annotated[Line, shown("State", "detail")]
    pattern: Annotated[Word | None, shown("State", "pattern")]
    generation: Annotated[Count, shown("State", "generation")]
    since: Seconds
    epoch: Annotated[Epoch, shown("State", "revision")]
    changed_by: Annotated[Line, shown("State", "changed by")]
    latches: dict[Name, Latch]
    labels: Annotated[tuple[Word, ...], shown("Robot", "labels")]
    params: dict[Word, Param]
    report: dict[Word, BoundedScalar]
    decision: DecisionSummary
    health: Health
    uptime: Annotated[Seconds, shown("Robot", "up for", "s")]
    readings: dict[Word, BoundedScalar] = {}
    stale_readings: tuple[Word, ...] = ()
    events: tuple[LoggedEvent, ...] = ()
    version: Annotated[Word, shown("Robot", "version")] = ""
    kernels: Annotated[Line, shown("Robot", "kernels")] = ""
    scan_delay: ScanDelaySummary | None = None
    body: Annotated[Body | None, shown("Robot", "body")] = None
    peers: tuple[PeerFinding, ...] = ()
    passage: Annotated[NarrowestPassage | None, shown("Protection", "passes")] = None
    walls_stand: Annotated[WallsStandSummary | None, shown("Protection", "walls stand")] = None
    fence: Annotated[FenceSummary | None, shown("Protection", "fence")] = None
    battery: Annotated[BatterySummary | None, shown("State", "battery")] = None
    findings: tuple[Line, ...] = ()
    not_following: Annotated[Line, shown("Protection", "base")] = ""
    neighbors: Annotated[tuple[Name, ...], shown("Health", "neighbors")] = ()
    places: Annotated[tuple[Line, ...], shown("Health", "places")] = ()
    recording: Annotated[RecordingSummary | None, shown("State", "recording")] = None
    goal: GoalStatus | None = None
    keys: KeySummary | None = None
    programs: Annotated[tuple[Name, ...], shown("Health", "programs")] = ()
    words: dict[Word, Line] = {}
    set_down: Annotated[SetDown | None, shown("Protection", "set down")] = None
    held_for: Annotated[Seconds | None, shown("Protection", "held for", "s")] = None
    driven_by: Annotated[Word, shown("State", "driven by")] = ""
    peer_faults: tuple[PeerFault, ...] = ()


class Motion(Struct, frozen=True, array_like=True):
    """Pose and commands of a robot, for viewers: at 10 Hz, only while a viewer subscribes.

    - `at`: s on the robot's clock.
    - `x`, `y` in m and `yaw` in rad: by odometry, in the robot's odometry frame.
    - `requested`, `safe`: commands: linear (m/s), angular (rad/s), lateral (m/s).
    - `gap`: m to the nearest obstacle; None without a return.
    - `rows`: the obstacles that constrain the command.
    """

    robot: Name
    at: Seconds
    x: Annotated[float, Meta(ge=-1e9, le=1e9)]
    y: Annotated[float, Meta(ge=-1e9, le=1e9)]
    yaw: Metres
    requested: tuple[Speed, Speed, Speed]
    safe: tuple[Speed, Speed, Speed]
    is_active: bool
    gap: Metres | None = None
    rows: tuple[LimitingObstacle, ...] = ()


class ShownPose(Struct, frozen=True, kw_only=True):
    """The pose of a robot in a frame that robots share: `x`, `y` in m and `yaw` in rad.

    `at` in s on the clock of the robot, `age` in s since the pose was measured. `error` in m and
    `yaw_error` in rad: bounds of the errors of the pose. `frame`: the name of the frame.
    """

    robot: Name
    at: Seconds
    age: Seconds
    x: Coordinate
    y: Coordinate
    yaw: Metres
    error: Metres
    yaw_error: Angle
    frame: Name


class ShownDecision(Struct, frozen=True, kw_only=True):
    """The last decision of protection, with the state and the reason of a standstill.

    `at` in s on the clock of the robot.
    """

    robot: Name
    at: Seconds
    state: State
    reason: Reason | None
    decision: DecisionSummary


class ShownMessage(Struct, frozen=True, kw_only=True):
    """A message that the pattern of a robot sent. `at` in s on the clock of the robot.

    `value`: the value that the pattern sent, made of MessagePack's types.
    """

    robot: Name
    at: Seconds
    channel: Line
    value: Any


class ScanWire(Struct, frozen=True, array_like=True):
    """One scan. `ranges` in m as little-endian float32; `stamp` in s on the clock of the sensor.

    `bearings` in rad and `ages` in s of the rays: (first, step) if regular, else little-endian
    float32. `ages` None: the sensor does not report ages; they follow from the platform's sweep.
    """

    seq: Count
    stamp: Stamp
    ranges: bytes
    bearings: tuple[Angle, Angle] | bytes
    ages: tuple[Seconds, Step] | bytes | None = None


class ShownTrack(Struct, frozen=True, array_like=True, gc=False):
    """A tracked object: centre, velocity and radius in the base frame, in m and m/s.

    - `name`: the peer that it is, or "" if it is no robot, by kin; None: not known.
    """

    x: Metres
    y: Metres
    vx: Speed
    vy: Speed
    radius: Metres
    name: Annotated[str, Meta(max_length=63)] | None = None


class Tracks(Struct, frozen=True, array_like=True):
    """The nearest tracked objects of a robot, for viewers: with each scan, while subscribed."""

    robot: Name
    tracks: Annotated[tuple[ShownTrack, ...], Meta(max_length=MAX_TRACKS)] = ()


class StatusHeader(Struct, frozen=True, kw_only=True):
    """The fields of a `Status` that are read from every version."""

    robot: Name
    instance: Name
    state: Word
    epoch: Epoch | None = None
    reason: Word | None = None
    detail: Line = ""
    pattern: Word | None = None
    latches: dict[Name, Latch] = {}
    version: Word = ""


class Presence(StrEnum):
    """The presence of a member: alive, left (ended in order), or failed (vanished)."""

    ALIVE = "alive"
    LEFT = "left"
    FAILED = "failed"


class Member(Struct, frozen=True, kw_only=True):
    """A robot as another peer sees it. `age`: seconds since its presence changed."""

    robot: Name
    instance: Name
    presence: Presence
    age: Seconds
    status: Status | None = None


class PeerView(Struct, frozen=True, kw_only=True):
    """A daemon's answer to `members`: its own status, and every other robot that it knows.

    Alive members come without a status, since each of them answers the same query.
    """

    robot: Name
    status: Status
    members: tuple[Member, ...]
    roster: tuple[Name, ...] = ()
