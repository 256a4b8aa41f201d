"""Faults of robots on purpose: the one table of kinds, with parameters, units and bounds.

A kind acts at one place: on scans, odometry, commands of the base, radio messages, the process of
the daemon, the battery's reading, or the pose that a tracker measures. Angles are in degrees,
bearings count from ahead to the left. A fault of a kind replaces an earlier one of this kind.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array, Platform, Scan
from swarmd.settings.layered import Layered
from swarmd.sim.world.batteries import has_battery
from swarmd.sim.world.field_kind import Degrees
from swarmd.sim.world.noise import lost_range
from swarmd.sim.world.realism import Share

Seconds = Annotated[float, Meta(ge=0.0, le=60.0)]
Width = Annotated[float, Meta(ge=0.0, le=360.0)]
Metres = Annotated[float, Meta(ge=-10.0, le=10.0)]
Speed = Annotated[float, Meta(ge=-10.0, le=10.0)]
Spread = Annotated[float, Meta(ge=0.0, le=10.0)]
Braking = Annotated[float, Meta(ge=0.001, le=100.0)]
Carrier: TypeAlias = Literal["world", "radio", "daemon"]
"""Who carries a fault out: the world, its radio, or the host of the robot's daemon."""


@dataclass(slots=True)
class ActiveFault:
    """A fault of one robot since `since` s; `kept`: what the kind remembers, None at first."""

    kind: FaultKind
    platform: Platform
    body: Callable[[str], float]
    """A value of the platform's body by its key, such as `wheel_separation` in m."""
    rng: np.random.Generator
    since: float
    step: float
    """s of a step of the world."""
    kept: Any = None

    def keep(self, value: Any) -> Any:
        """The first value of the fault's calls."""
        self.kept = value if self.kept is None else self.kept
        return self.kept


class FaultKind(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="fault"):
    """A kind of fault with its parameters."""

    place: ClassVar[str]
    carried_by: ClassVar[Carrier] = "world"
    ends_daemon: ClassVar[bool] = False
    """the robot's daemon does not continue after the fault: it starts anew"""

    @property
    def text(self) -> str:
        """Place and kind, such as `scan frozen`."""
        return f"{self.place} {self.__struct_config__.tag}"

    @property
    def plain(self) -> dict[str, Any]:
        """The mapping of which `fault_of` makes this fault."""
        values = {name: getattr(self, name) for name in self.__struct_fields__}
        return {self.place: self.__struct_config__.tag, **values}

    def misfit(self, platform: Platform, *, is_posed: bool) -> str:
        """Why a robot cannot have this fault, empty if it can; `is_posed`: a tracker measures."""
        return ""


class ScanFault(FaultKind, frozen=True):
    """A fault of the lidar; `delay`: s that scans take longer to the robot."""

    place = "scan"
    delay = 0.0

    def seen(self, scan: Scan, fault: ActiveFault) -> Scan | None:
        """The scan in place of a sound `scan`; None: lost."""
        return scan


class FrozenScan(ScanFault, frozen=True, tag="frozen"):
    """The lidar repeats its last ranges in scans with new numbers and stamps."""

    def seen(self, scan: Scan, fault: ActiveFault) -> Scan:
        """The ranges of the first scan of the fault."""
        return replace(scan, ranges=fault.keep(scan.ranges).copy())


class BlindSector(ScanFault, frozen=True, tag="blind_sector"):
    """All rays of a sector are lost, as behind a cover."""

    # the middle of the sector
    bearing_deg: Degrees = 0.0
    # of the whole sector
    width_deg: Width = 60.0

    def seen(self, scan: Scan, fault: ActiveFault) -> Scan:
        """Lost rays within the sector."""
        lost = lost_range(fault.platform.scan)
        return _covered(scan, self.bearing_deg, self.width_deg, lost)


class NoisyScan(ScanFault, frozen=True, tag="noise"):
    """Each range has a further normal error."""

    # the standard deviation in m
    sd: Spread = 0.1

    def seen(self, scan: Scan, fault: ActiveFault) -> Scan:
        """Each range with an error of its own."""
        return _shifted(scan, fault.rng.normal(0.0, self.sd, len(scan.ranges)))


class ScanOffset(ScanFault, frozen=True, tag="offset"):
    """All ranges are too long by one length."""

    # in m, negative: too short
    offset: Metres = 0.1

    def seen(self, scan: Scan, fault: ActiveFault) -> Scan:
        """Longer ranges."""
        return _shifted(scan, self.offset)


class MirroredScan(ScanFault, frozen=True, tag="mirrored"):
    """Left and right are exchanged, as of a lidar upside down."""

    def seen(self, scan: Scan, fault: ActiveFault) -> Scan:
        """The ranges of the opposite bearings."""
        return _rearranged(scan, fault, lambda bearings: -bearings)


class TurnedScan(ScanFault, frozen=True, tag="turned"):
    """The lidar is mounted turned to the right: an obstacle ahead appears at `angle_deg`."""

    angle_deg: Degrees = 90.0

    def seen(self, scan: Scan, fault: ActiveFault) -> Scan:
        """The ranges of other bearings."""
        turn = math.radians(self.angle_deg)
        return _rearranged(scan, fault, lambda bearings: bearings - turn)


class LateScan(ScanFault, frozen=True, tag="late"):
    """Scans arrive late; their stamps are true."""

    # s
    delay: Seconds = 0.5


class ScanStamps(ScanFault, frozen=True, tag="stamps"):
    """The clock of the lidar differs from that of the robot."""

    # s, negative: scans seem older than they are
    seconds: Annotated[float, Meta(ge=-60.0, le=60.0)] = -3.0

    def seen(self, scan: Scan, fault: ActiveFault) -> Scan:
        """The same ranges with another stamp."""
        return replace(scan, stamp=scan.stamp + self.seconds)


class LostScans(ScanFault, frozen=True, tag="lost"):
    """A share of the scans is lost at random."""

    share: Share = 0.3

    def seen(self, scan: Scan, fault: ActiveFault) -> Scan | None:
        """The scan, or None."""
        return None if fault.rng.random() < self.share else scan


class Mast(ScanFault, frozen=True, tag="mast"):
    """A part of the robot itself stands before the lidar."""

    bearing_deg: Degrees = 100.0
    width_deg: Width = 6.0
    # from the lidar in m
    distance: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.05

    def seen(self, scan: Scan, fault: ActiveFault) -> Scan:
        """Short ranges at the mast."""
        return _covered(scan, self.bearing_deg, self.width_deg, self.distance)


class OdometryFault(FaultKind, frozen=True):
    """A fault of the odometry, whose error stays in the reported pose after the fault."""

    place = "odometry"

    def measured(self, motion: Array, seconds: float, fault: ActiveFault) -> Array:
        """The reported motion and twist (2, 3) in place of the true ones.

        Both linear, angular, lateral. The motion is that of the last `seconds`.
        """
        return motion


class FrozenOdometry(OdometryFault, frozen=True, tag="frozen"):
    """Pose and twist stay as they were, in readings with new stamps."""

    def measured(self, motion: Array, seconds: float, fault: ActiveFault) -> Array:
        """No motion, and the first twist of the fault."""
        return np.stack((np.zeros(3), fault.keep(motion[1])))


class OdometryDrift(OdometryFault, frozen=True, tag="drift"):
    """Odometry reports a motion that does not happen, beside the true motion."""

    # m/s
    linear: Speed = 0.05
    # rad/s
    angular: Speed = 0.05

    def measured(self, motion: Array, seconds: float, fault: ActiveFault) -> Array:
        """The motion with the drift."""
        drift = np.array((self.linear, self.angular, 0.0))
        return np.array(motion + np.stack((drift * seconds, drift)))


class OdometrySlip(OdometryFault, frozen=True, tag="slip"):
    """Each reading of motion has a random factor 1 + N(0, sd), as with wheels that slip."""

    sd: Spread = 0.5

    def measured(self, motion: Array, seconds: float, fault: ActiveFault) -> Array:
        """The motion times the factor."""
        factor = 1.0 + self.sd * float(fault.rng.standard_normal())
        return np.array(motion * factor)


class OdometryScale(OdometryFault, frozen=True, tag="scale"):
    """Linear motion is reported times a factor, as with wheels of another diameter."""

    factor: Annotated[float, Meta(ge=0.0, le=10.0)] = 1.1

    def measured(self, motion: Array, seconds: float, fault: ActiveFault) -> Array:
        """The scaled motion."""
        return np.multiply(motion, (self.factor, 1.0, self.factor))


class WrongSign(OdometryFault, frozen=True, tag="wrong_sign"):
    """Motion is reported with the wrong sign."""

    # which motion
    axis: Literal["linear", "angular"] = "linear"

    def measured(self, motion: Array, seconds: float, fault: ActiveFault) -> Array:
        """The motion with one sign changed."""
        signs = np.ones(3)
        signs[0 if self.axis == "linear" else 1] = -1.0
        return motion * signs


class BaseFault(FaultKind, frozen=True):
    """A fault of the base, which follows another command than that of the daemon."""

    place = "base"

    def followed(self, command: Array, fault: ActiveFault) -> Array:
        """The command (3,) linear, angular, lateral that the base follows in this step."""
        return command


class WeakBrakes(BaseFault, frozen=True, tag="weak_brakes"):
    """The base slows down slowly, whatever the command."""

    # m/s2
    linear: Braking = 0.3
    # rad/s2
    angular: Braking = 1.0

    def followed(self, command: Array, fault: ActiveFault) -> Array:
        """A command that falls no faster."""
        return _braked(command, np.array((self.linear, self.angular, self.linear)), fault)


class Coasts(BaseFault, frozen=True, tag="coasts"):
    """The base rolls on without a command, and slows down by friction alone."""

    # m/s2
    deceleration: Braking = 0.05

    def followed(self, command: Array, fault: ActiveFault) -> Array:
        """Instead of zero a linear command that falls."""
        most = math.inf if command.any() else self.deceleration
        return _braked(command, np.array((most, math.inf, most)), fault)


class DeadWheel(BaseFault, frozen=True, tag="dead_wheel"):
    """One wheel of a differential drive stands still."""

    side: Literal["left", "right"] = "left"

    def misfit(self, platform: Platform, *, is_posed: bool) -> str:
        """A platform that moves sideways."""
        return "has no differential drive" if platform.limits.lateral > 0.0 else ""

    def followed(self, command: Array, fault: ActiveFault) -> Array:
        """The motion of the other wheel."""
        separation = fault.body("wheel_separation")
        sign = 1.0 if self.side == "left" else -1.0  # of the living wheel's place to the right
        speed = command[0] + sign * command[1] * separation / 2.0
        return np.array((speed / 2.0, sign * speed / separation, 0.0))


class LateBase(BaseFault, frozen=True, tag="late"):
    """Commands take effect later."""

    # s
    seconds: Seconds = 0.3

    def followed(self, command: Array, fault: ActiveFault) -> Array:
        """The command of `seconds` ago; at first that of the fault's begin."""
        line: list[Array] = fault.keep([])
        line.append(command.copy())
        return line.pop(0) if len(line) > round(self.seconds / fault.step) else line[0]


class IgnoresZero(BaseFault, frozen=True, tag="ignores_zero"):
    """A command of zero has no effect: the base keeps its last motion."""

    def followed(self, command: Array, fault: ActiveFault) -> Array:
        """The last command that is not zero."""
        fault.kept = command.copy() if command.any() else fault.keep(command.copy())
        return np.array(fault.kept)


class DeadZone(BaseFault, frozen=True, tag="dead_zone"):
    """The base does not follow slow linear commands."""

    # m/s below which it stands
    speed: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.05

    def followed(self, command: Array, fault: ActiveFault) -> Array:
        """The command without a slow linear part."""
        linear, angular, lateral = command
        is_followed = abs(linear) >= self.speed
        return np.array((linear if is_followed else 0.0, angular, lateral))


class RadioFault(FaultKind, frozen=True):
    """A fault of the radio for messages of patterns and for neighbors.

    Beacons, stops and requests of operators pass.
    """

    place = "radio"
    carried_by = "radio"

    def delay(self, draw: Callable[[], float], *, is_sender: bool) -> float:
        """Seconds that a message from (`is_sender`) or to the robot takes longer; inf: it is lost.

        `draw`: gives a random number from 0 to 1.
        """
        return 0.0


class Mute(RadioFault, frozen=True, tag="mute"):
    """The robot sends nothing, and is no neighbor of others."""

    def delay(self, draw: Callable[[], float], *, is_sender: bool) -> float:
        """Lost on sending."""
        return math.inf if is_sender else 0.0


class Deaf(RadioFault, frozen=True, tag="deaf"):
    """The robot receives nothing, and has no neighbors."""

    def delay(self, draw: Callable[[], float], *, is_sender: bool) -> float:
        """Lost on receiving."""
        return 0.0 if is_sender else math.inf


class RadioLoss(RadioFault, frozen=True, tag="loss"):
    """A share of the messages from and to the robot is lost."""

    share: Share = 0.5

    def delay(self, draw: Callable[[], float], *, is_sender: bool) -> float:
        """Seconds."""
        return math.inf if draw() < self.share else 0.0


class RadioDelay(RadioFault, frozen=True, tag="delay"):
    """Messages from and to the robot take longer."""

    # s
    seconds: Seconds = 1.0

    def delay(self, draw: Callable[[], float], *, is_sender: bool) -> float:
        """Seconds."""
        return self.seconds


class ProcessFault(FaultKind, frozen=True):
    """A fault of the daemon's process, which its host carries out, not the world."""

    place = "process"
    carried_by = "daemon"


class KilledProcess(ProcessFault, frozen=True, tag="killed"):
    """The daemon is killed (SIGKILL); with `for` it starts again after this time, idle."""

    ends_daemon = True


class FrozenProcess(ProcessFault, frozen=True, tag="frozen"):
    """The daemon is halted (SIGSTOP), and continues after the fault."""


class LowBattery(FaultKind, frozen=True, tag="low"):
    """The battery reports a charge, whatever it is."""

    place = "battery"

    # as a share
    charge: Share = 0.05

    def misfit(self, platform: Platform, *, is_posed: bool) -> str:
        """A platform without a battery."""
        return "" if has_battery(platform) else "has no battery; set body.battery_time"


class PoseFault(FaultKind, frozen=True):
    """A fault of the tracker that measures the robot's pose in a shared frame."""

    place = "pose"

    def misfit(self, platform: Platform, *, is_posed: bool) -> str:
        """A robot without a tracker."""
        return "" if is_posed else "has no pose in a shared frame; set radio.places, or a fence"

    def tracked(self, pose: Array, now: float, fault: ActiveFault) -> Array:
        """The measured pose (3,) x, y, yaw in place of a sound one at `now` s."""
        return pose


class FrozenPose(PoseFault, frozen=True, tag="frozen"):
    """The tracker repeats a pose with new stamps."""

    def tracked(self, pose: Array, now: float, fault: ActiveFault) -> Array:
        """The first pose of the fault."""
        return np.array(fault.keep(pose))


class PoseDrift(PoseFault, frozen=True, tag="drift"):
    """The measured place moves away from the true place."""

    # m/s
    speed: Speed = 0.05
    # in the shared frame
    direction_deg: Degrees = 0.0

    def tracked(self, pose: Array, now: float, fault: ActiveFault) -> Array:
        """A place farther along the direction."""
        way = self.speed * (now - fault.since)
        angle = math.radians(self.direction_deg)
        x, y, yaw = pose
        return np.array((x + way * math.cos(angle), y + way * math.sin(angle), yaw))


class TurnedPose(PoseFault, frozen=True, tag="turned"):
    """The tracker's frame is turned about its origin."""

    angle_deg: Degrees = 90.0

    def tracked(self, pose: Array, now: float, fault: ActiveFault) -> Array:
        """The pose turned about the origin."""
        turn = math.radians(self.angle_deg)
        c = math.cos(turn)
        s = math.sin(turn)
        x, y, yaw = pose
        return np.array((c * x - s * y, s * x + c * y, yaw + turn))


KINDS: tuple[type[FaultKind], ...] = (
    *(FrozenScan, BlindSector, NoisyScan, ScanOffset, MirroredScan, TurnedScan, LateScan),
    *(ScanStamps, LostScans, Mast),
    *(FrozenOdometry, OdometryDrift, OdometrySlip, OdometryScale, WrongSign),
    *(WeakBrakes, DeadWheel, LateBase, Coasts, IgnoresZero, DeadZone),
    *(Mute, Deaf, RadioLoss, RadioDelay),
    *(KilledProcess, FrozenProcess, LowBattery, FrozenPose, PoseDrift, TurnedPose),
)
"""The table of all kinds."""
PLACES = tuple(dict.fromkeys(kind.place for kind in KINDS))


def fault_of(given: Mapping[str, Any], where: str) -> FaultKind:
    """The fault of a mapping such as `{scan: noise, sd: 0.2}`.

    ConfigError begins with `where`, for an unknown place, kind or parameter and for a value out of
    bounds.
    """
    places = [key for key in given if key in PLACES]
    if len(places) != 1:
        known = ", ".join(PLACES)
        text = " and ".join(places) or "no place"
        raise ConfigError(f"{where}: has {text}; expected one of {known}: {{scan: frozen}}")
    place = places[0]
    kinds = {str(kind.__struct_config__.tag): kind for kind in KINDS if kind.place == place}
    word = str(given[place])
    if word not in kinds:
        raise ConfigError(f"{where}: {unknown(f'fault of {place}', word, kinds)}")
    parameters = {key: item for key, item in given.items() if key != place}
    return Layered((where, parameters)).build(kinds[word])


def _covered(scan: Scan, bearing_deg: float, width_deg: float, distance: float) -> Scan:
    """The scan with `distance` at all rays of a sector."""
    apart = np.abs(np.remainder(np.degrees(scan.bearings) - bearing_deg + 180.0, 360.0) - 180.0)
    return replace(scan, ranges=np.where(apart <= width_deg / 2.0, distance, scan.ranges))


def _shifted(scan: Scan, lengths: Array | float) -> Scan:
    """The scan with longer ranges; a ray without a return stays so."""
    is_seen = np.isfinite(scan.ranges) & (scan.ranges > 0.0)
    longer = np.maximum(scan.ranges + lengths, 1e-3)
    return replace(scan, ranges=np.where(is_seen, longer, scan.ranges))


def _rearranged(scan: Scan, fault: ActiveFault, source: Callable[[Array], Array]) -> Scan:
    """The scan with the range of the nearest ray to `source(bearings)` at each ray."""
    if fault.kept is None:
        apart = source(scan.bearings)[:, None] - scan.bearings[None, :]
        fault.kept = np.argmin(np.abs(np.remainder(apart + np.pi, 2.0 * np.pi) - np.pi), axis=1)
    return replace(scan, ranges=scan.ranges[fault.kept])


def _braked(command: Array, most: Array, fault: ActiveFault) -> Array:
    """The command (3,), whose parts fall by `most` (3,) in m/s2 or rad/s2 at most."""
    before = fault.keep(command)
    way = most * fault.step
    is_braking = (np.abs(command) < np.abs(before)) | (command * before < 0.0)
    slower = before + np.clip(command - before, -way, way)
    fault.kept = np.where(is_braking, slower, command)
    return np.array(fault.kept)
