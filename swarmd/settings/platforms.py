"""Reads the platform file (one kind of robot): its schema and its checks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from msgspec import Meta, Struct, structs, to_builtins

import swarmd.config
from swarmd.core.angles import wrap
from swarmd.core.bounds import Line, Word
from swarmd.core.clock import TICK
from swarmd.core.errors import ConfigError, unknown
from swarmd.core.files import user_path
from swarmd.core.values import (
    KIN,
    PLACES_BY_POSE,
    PLACES_BY_SIGHT,
    Array,
    Heights,
    Limits,
    Platform,
    ScanSpec,
    Sweep,
    Value,
    input_fault,
)
from swarmd.robot.protection.binding_range import BindingRange
from swarmd.robot.protection.compatibility import barrier_settings
from swarmd.robot.protection.footprint import Footprint
from swarmd.robot.protection.settings import (
    Avoidance,
    BarrierSettings,
    Mode,
    PotentialFieldSettings,
    StopZoneSettings,
)
from swarmd.settings.driver_options import base_options
from swarmd.settings.layered import Fault, Keys, Layered, fault_at
from swarmd.settings.robot_settings import Parameters
from swarmd.settings.swarmfile import Options
from swarmd.settings.yamlfile import Data, read_extended, shown

Coordinate = Annotated[float, Meta(ge=-100.0, le=100.0)]
Point = tuple[Coordinate, Coordinate]
Bearing = Annotated[float, Meta(ge=-360.0, le=360.0)]
SensorName = Annotated[str, Meta(pattern="^[A-Za-z_][A-Za-z0-9_]*$", max_length=63)]
Positive = Annotated[float, Meta(gt=0.0, le=1000.0)]


class SweepSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a rotating sensor measures its rays one after the other.

    - `start_deg`: bearing at which a scan begins.
    - `direction`: the sense of rotation seen from above: ccw (counter-clockwise) or cw.
    - `duration`: s of one scan; None: the scan period. A wrong value shifts obstacles while the
      robot turns.
    """

    start_deg: Bearing = 0.0
    direction: Literal["ccw", "cw"] = "ccw"
    duration: Annotated[float, Meta(gt=0.0, le=10.0)] | None = None


class ScanSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The range sensor.

    - `rays`: the number of rays, spread evenly over 360 degrees.
    - `bearings_deg`: instead of `rays`, the bearing of each ray.
    - `cone_deg`: the full width of a beam, which returns the nearest object in it. With a smaller
      value than the true width protection misplaces objects at the edge of a beam.
    - `rate`: scans a second (Hz). If it is too high, scans count as too old and the robot is held.
    - `range_min`, `range_max`: the ranges in m that the sensor measures.
    - `first_bearing_deg`: bearing of the first ray. A wrong value turns every obstacle.
    - `offset`: position (x, y) of the sensor from the axle, m. A wrong value shifts obstacles.
    - `zero`: how a range of 0 is read. `no_return`: nothing is within `range_max`. `too_close`: an
      object is nearer than `range_min`. `unknown`: the ray is not valid. `lds`: as LDS lidars do.
    - `noisy`: True: two equal scans mean a frozen sensor. False: equal scans are normal.
    - `max_gap_deg`: the widest sector without valid rays that is bridged. With a greater value a
      larger object can stand there unseen. With a smaller value more scans are invalid, and an
      invalid scan holds the robot.
    - `near`: `lost` if an object nearer than `range_min` looks like no object.
    - `latency`: mean age of the rays in s when a scan arrives. None: half a scan period, as of a
      rotating lidar. With too low a value protection acts on earlier places of obstacles.
    - `sweep`: how a rotating sensor rotates. None: all rays are measured at once. `unknown`: each
      ray counts as old as the oldest ray; `swarmctl calibrate` measures the sweep and writes it.
      A declared sweep and None override `time_increment` of ROS messages.
    - `mask`: sectors in which the sensor sees parts of its own robot, such as `[[55, 61]]`: each
      from a bearing in degrees counter-clockwise to another one. Their rays are unknown, so that an
      object that stands within such a sector alone is not seen.
    """

    rays: Annotated[int, Meta(ge=1, le=10_000)] | None = None
    bearings_deg: Annotated[list[Bearing], Meta(min_length=1, max_length=10_000)] | None = None
    cone_deg: Annotated[float, Meta(ge=0.0, le=90.0)] = 0.0
    rate: Annotated[float, Meta(gt=0.0, le=200.0)]
    range_min: Annotated[float, Meta(ge=0.0, le=1000.0)]
    range_max: Positive
    first_bearing_deg: Bearing = 0.0
    offset: Point = (0.0, 0.0)
    zero: Literal["no_return", "too_close", "unknown", "lds"] = "no_return"
    noisy: bool = True
    max_gap_deg: Annotated[float, Meta(gt=0.0, le=180.0)] = 12.0
    near: Literal["reported", "lost"] = "reported"
    latency: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    sweep: SweepSection | Literal["unknown", "measured"] | None = "unknown"
    mask: Annotated[list[tuple[Bearing, Bearing]], Meta(max_length=64)] = []


class ProtectionSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The protection mode, and the settings of each mode.

    - `mode`: `barrier` requires odometry. `off` is for simulated robots only: a daemon does not
      start with it.
    - `presets`, `preset`: settings of the mode `potential_field` by name, and the name in use. Some
      patterns and metrics derive distances from `threshold` in every mode.
    - `avoidance`: `orca` leads a robot past moving robots, in the modes `barrier` and `stop_zone`,
      if its pattern has recovery. `none`: the robot drives towards them until protection or
      recovery turns it away. The parameter `avoidance` of a run overrides it.
    - `barrier`, `stop_zone`: settings of the modes with these names. Within `slow` of the outline
      mode `stop_zone` leaves three tenths of the requested command.
    """

    mode: Mode = "barrier"
    avoidance: Avoidance = "orca"
    preset: str
    presets: dict[str, PotentialFieldSettings]
    barrier: BarrierSettings | None = None
    stop_zone: StopZoneSettings = StopZoneSettings()


class SensorSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A simulated sensor of the ground, of light or of objects.

    - `at`: position of the sensor from the axle, m.
    - `bearing_deg`: the direction of view. None: a sensor of the ground looks down, a sensor of
      light in all directions, and a sensor that recognises objects ahead.
    - `field_of_view_deg`, `range`: only for a sensor that recognises objects: the angle and the
      distance in m that it sees.
    """

    at: Point
    bearing_deg: Bearing | None = None
    field_of_view_deg: Annotated[float, Meta(gt=0.0, le=360.0)] | None = None
    range: Positive | None = None


Sensors = Annotated[list[SensorSection], Meta(min_length=1, max_length=64)]


class PlatformFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys of a platform's file.

    - `extends`: another platform or file. This file then holds only the differences.
    - `ranges`: a ring of further range sensors, for objects that the lidar does not see, with the
      keys of `scan`. Without fresh values of the ring the robot is held. None: there is no ring,
      and the sensors in a driver's option `ranges` give the scan.
    - `footprint`: convex outline in m, counter-clockwise. If it is too small, the robot collides.
      If it is too large, the robot stops earlier, and avoids gaps that it could pass.
    - `provides`: inputs that patterns may need. Patterns that need other inputs are refused.
    - `patterns`: parameters by pattern, which replace derived values.
    - `drivers`: default options by driver.
    - `heights`: None: it is not known whether this robot and other robots see each other.
    - `limits`: the highest speeds. swarmd limits no acceleration: a safe command may change at
      once, and the base limits its own acceleration.
    - `scan`, `protection`: the lidar, and the protection mode with its settings.
    - `body`: properties of the simulated robot, without effect on a real robot: mass, wheel
      separation, accelerations. `linear_acceleration` also holds sideways, unless
      `lateral_acceleration` is given.
    - `sensors`: for the simulated world, by name of a field such as `ground`, the sensors that read
      the field. Without sensors the robot reads the field at its axle. Sensors named `detections`
      recognise robots, boxes and lamps. Without effect on a real robot.
    - `words`: by driver, texts on what a robot does at a request, such as `stop`, or at an event,
      such as `low battery`, if the robot does more than the word says. `describe` shows the texts.
    """

    description: str = ""
    extends: str | None = None
    limits: Limits
    footprint: list[Point]
    scan: ScanSection
    provides: list[str]
    protection: ProtectionSection
    patterns: Parameters = {}
    drivers: dict[str, Options] = {}
    heights: Heights | None = None
    body: dict[str, Annotated[float, Meta(ge=-1e6, le=1e6)]] = {}
    ranges: ScanSection | None = None
    sensors: dict[SensorName, Sensors] = {}
    words: dict[str, dict[Word, Line]] = {}


@dataclass(frozen=True)
class _Content:
    """The layers of a platform, compared by what they hold."""

    text: str
    layers: Layered = field(compare=False)


def platform_names() -> tuple[str, ...]:
    """The names of the shipped platforms."""
    return tuple(sorted(path.stem for path in _folder().glob("*.yaml")))


def load_platform(name: str, near: Path | None = None) -> Platform:
    """The platform with the name `name`; a `name` that ends in .yaml is a path relative to `near`.

    ConfigError names file, key, value, what was expected and the nearest valid key.
    """
    stem = _find(name, near or Path()).stem
    return platform_of(stem, Layered(*platform_sources(name, near)))


def platform_sources(name: str, near: Path | None = None) -> tuple[tuple[str, Data], ...]:
    """The file of a platform and the files that it extends, each with its name, strongest first."""
    files = read_extended(_find(name, near or Path()), _find)
    return tuple((shown(path), data) for path, data in files)


def platform_of(name: str, layers: Layered) -> Platform:
    """The platform that the layers describe; ConfigError as `load_platform`."""
    return _platform(name, platform_file(layers))


def platform_file(layers: Layered) -> PlatformFile:
    """The keys of the platform that the layers describe; ConfigError as `load_platform`.

    The process keeps the result: the check takes 2 ms, and a scenario asks twice for each platform.
    """
    return _checked(_Content(repr(layers.data), layers))


@lru_cache(maxsize=64)
def _checked(content: _Content) -> PlatformFile:
    return content.layers.build(PlatformFile, _check)


def _folder() -> Path:
    return Path(swarmd.config.__path__[0]).resolve() / "platforms"


def _find(name: str, near: Path) -> Path:
    if name.endswith(".yaml"):
        return near / user_path(name)
    if name not in platform_names():
        raise ConfigError(
            f"{unknown('platform', name, platform_names())} (or give a path ending in .yaml)"
        )
    return _folder() / f"{name}.yaml"


def _check(value: Any, keys: Keys) -> Iterator[Fault]:
    match value:
        case ScanSection():
            yield from _check_scan(value, keys)
        case ProtectionSection():
            yield from _check_protection(value, keys)
        case Heights() if value.lowest >= value.highest:
            text = f"is {value.lowest:g}; expected less than highest ({value.highest:g})"
            yield fault_at((*keys, "lowest"), text)
        case PlatformFile():
            yield from _check_file(value)


def _check_scan(scan: ScanSection, keys: Keys) -> Iterator[Fault]:
    if (scan.rays is None) == (scan.bearings_deg is None):
        fault = "is missing" if scan.rays is None else f"is {scan.rays} beside bearings_deg"
        text = f"{fault}; expected one of the two: a number of rays, or a list of bearings"
        yield fault_at((*keys, "rays"), text)
    if scan.range_min >= scan.range_max:
        section = keys[-1]
        text = f"is {scan.range_min:g}; expected less than {section}.range_max ({scan.range_max:g})"
        yield fault_at((*keys, "range_min"), text)
    if scan.near == "lost" and scan.zero == "too_close":
        text = f"is lost, but {keys[-1]}.zero is too_close; expected reported, or another zero"
        yield fault_at((*keys, "near"), text)
    if scan.mask and (scan.rays is None) != (scan.bearings_deg is None):
        fault = _spec(scan).mask_fault()
        if fault:
            yield fault_at((*keys, "mask"), f"{fault}, by {keys[-1]}.max_gap_deg")


def _check_protection(protection: ProtectionSection, keys: Keys) -> Iterator[Fault]:
    zone = protection.stop_zone
    if protection.preset not in protection.presets:
        text = f"names {unknown('preset', protection.preset, protection.presets)}"
        yield fault_at((*keys, "preset"), text)
    if zone.slow < zone.stop:
        text = f"is {zone.slow:g}; expected at least stop ({zone.stop:g})"
        yield fault_at((*keys, "stop_zone", "slow"), text)


def _check_file(file: PlatformFile) -> Iterator[Fault]:
    """Yield the faults of a whole platform file: keys that contradict each other.

    Each fault is the path of the wrong key, and a text that begins with the key. After a fault of a
    key that later checks need, the later checks are left out.
    """
    yield from _check_drivers(file)
    yield from _check_sensors(file)
    fault = _shape_fault(file.footprint)
    if fault:  # all further checks need a convex polygon
        text = f"{fault}; expected a convex polygon in m, counter-clockwise seen from above"
        yield fault_at(("footprint",), text)
        return
    if file.scan.sweep == "measured":
        text = (
            "is measured, but no robot measures it while it drives; give unknown, run `swarmctl"
            " calibrate`, and use the file that it writes"
        )
        yield fault_at(("scan", "sweep"), text)
    yield from _check_ranges(file)
    yield from _check_ring(file)
    if file.protection.mode == "barrier":
        lacking = _lacking_for_barrier(file)
        if lacking:
            text = f"is barrier, which needs {lacking}, or take another mode"
            yield fault_at(("protection", "mode"), text)
            return
        yield from _check_layers(file)
    yield from _check_sight(_platform("", file))


def _check_drivers(file: PlatformFile) -> Iterator[Fault]:
    """Check the common options of drivers, and the names of inputs."""
    for name, options in file.drivers.items():
        try:
            base_options(cast(Mapping[str, Value], options), f"drivers.{name}")
        except ConfigError as error:
            yield ("drivers", name), str(error)
    for index, input_name in enumerate(file.provides):
        fault = input_fault(input_name)
        if fault:
            yield fault_at(("provides", index), f"names {fault}")


def _lacking_for_barrier(file: PlatformFile) -> str:
    """What mode barrier needs and the file lacks, with advice; empty if nothing is lacking."""
    if file.protection.barrier is None:
        return "protection.barrier; give it others_speed and unseen_extent"
    return "" if "odometry" in file.provides else "odometry; add it to provides"


def _check_layers(file: PlatformFile) -> Iterator[Fault]:
    """Check that the layers of the barrier fit the footprint."""
    barrier = file.protection.barrier
    if barrier is None:
        return
    for key, layer in barrier.layers.items():
        extent = barrier.unseen_extent
        cone = file.scan.cone_deg
        for keys, text in layer.misfits(file.footprint, extent, math.radians(cone)):
            yield fault_at(("protection", "barrier", key, *keys), text)


def _check_sensors(file: PlatformFile) -> Iterator[Fault]:
    for name, some in file.sensors.items():
        for index, sensor in enumerate(some):
            is_given = sensor.field_of_view_deg is not None, sensor.range is not None
            if is_given != (name == "detections",) * 2:
                wanted = "both" if name == "detections" else "neither: only detections have them"
                text = f"of field_of_view_deg and range has {sum(is_given)}; expected {wanted}"
                yield fault_at(("sensors", name, index), text)


def _check_ranges(file: PlatformFile) -> Iterator[Fault]:
    """Check that distances of protection lie within the ranges that the sensor measures."""
    scan = file.scan
    protection = file.protection
    places: dict[Keys, float | None] = {
        ("protection", "presets", name, "threshold"): preset.threshold
        for name, preset in protection.presets.items()
    }
    if protection.barrier is not None:
        places["protection", "barrier", "keep_out"] = protection.barrier.keep_out
    for keys, distance in places.items():
        if distance is not None and not scan.range_min < distance < scan.range_max:
            measured = f"between {scan.range_min:g} and {scan.range_max:g}"
            text = f"is {distance:g}; expected a range that the sensor measures, {measured}"
            yield fault_at(keys, text)
    stop = protection.stop_zone.stop
    reach, _ = Footprint(np.array(file.footprint)).circles(scan.offset)
    if protection.mode == "stop_zone" and reach + stop < scan.range_min:
        wanted = math.ceil(100.0 * (scan.range_min - reach)) / 100.0
        text = (
            f"is stop_zone, whose stop is {stop:g} m from the outline, nearer than the sensor"
            f" measures; expected protection.stop_zone.stop of at least {wanted:g}, or another mode"
        )
        yield fault_at(("protection", "mode"), text)


def _check_ring(file: PlatformFile) -> Iterator[Fault]:
    """Check a ring: it measures all rays at once, and reports near returns (no memory has them)."""
    ring = file.ranges
    if ring is None:
        if "ranges" in file.provides:
            yield fault_at(("provides",), "names ranges; expected the section ranges with it")
        return
    if ring.near == "lost":
        yield fault_at(("ranges", "near"), "is lost; expected reported: only scan may lose it")
    if isinstance(ring.sweep, SweepSection):
        yield fault_at(("ranges", "sweep"), "is given; expected none: a ring does not rotate")
    yield from _check_rate(_spec(ring), "ranges")


def _check_rate(spec: ScanSpec, section: str) -> Iterator[Fault]:
    if spec.stale_after < 1.5 / spec.rate:
        text = (
            f"is {spec.rate:g}; expected at least {1.5 / spec.stale_after:g}: a scan older than"
            f" {spec.stale_after:g} s holds the robot"
        )
        yield fault_at((section, "rate"), text)


def _check_sight(platform: Platform) -> Iterator[Fault]:
    """Check that rate and range of the scan sensor suffice to stop before obstacles.

    In mode `barrier` the needed range follows from speed, deceleration and age of scans. In other
    modes any range suffices. The fault of a short range also names the greatest `limits.linear`
    with which the range suffices. `_check_cone` checks wide beams.
    """
    scan = platform.scan
    limits = platform.limits
    barrier = barrier_settings(platform)
    yield from _check_rate(scan, "scan")
    if barrier is None:
        return

    needed = _needed_range(platform, barrier, limits.linear)
    yield from _check_cone(scan, barrier, needed)
    if needed <= scan.range_max:
        return
    rounded_up = math.ceil(100.0 * needed) / 100.0
    text = (
        f"is {scan.range_max:g}; expected at least {rounded_up:g}, within which"
        f" the robot stops from limits.linear {limits.linear:g} with braking_linear"
        f" {barrier.braking_linear:g} and others_speed {barrier.others_speed:g} of"
        f" protection.barrier, by scans that are {scan.stale_after:g} s old beyond scan.latency"
        f" {scan.latency:g} (scan.rate {scan.rate:g})"
    )
    fastest = _fastest_fitting(platform, barrier)
    if fastest is not None:
        text += f"; or limits.linear of at most {fastest:.2f}"
    yield fault_at(("scan", "range_max"), text)


def _needed_range(platform: Platform, barrier: BarrierSettings, top_speed: float) -> float:
    """The range in m that the sensor needs if `limits.linear` is `top_speed` m/s.

    No obstacle farther from the sensor limits the robot.
    """
    changed = replace(platform, limits=structs.replace(platform.limits, linear=top_speed))
    return BindingRange(changed, barrier, TICK).for_sensor()


def _fastest_fitting(platform: Platform, barrier: BarrierSettings) -> float | None:
    """The fastest speed below `limits.linear`, in whole cm/s, for which the range suffices.

    In m/s; None if the range suffices for no speed.
    """
    fastest_cm = math.ceil(100.0 * platform.limits.linear) - 1
    lower_speeds = (0.01 * speed_cm for speed_cm in range(fastest_cm, 0, -1))
    reach = platform.scan.range_max
    fitting = (speed for speed in lower_speeds if _needed_range(platform, barrier, speed) <= reach)
    return next(fitting, None)


def _check_cone(scan: ScanSpec, barrier: BarrierSettings, needed: float) -> Iterator[Fault]:
    """Check that `unseen_extent` covers a beam of `scan.cone` up to the `needed` range in m.

    A return counts as a point in the middle of its beam, but the object may be at an edge: the
    distance between the two is the chord of half the beam's width. `unseen_extent`, how far an
    obstacle may extend beside its return, must cover that chord.
    """
    chord = 2.0 * math.sin(scan.cone / 4.0)  # as a share of the range
    if barrier.unseen_extent >= chord * needed:
        return
    # The solution x of x = chord * (needed - unseen_extent + x): `needed` contains the extent.
    least = chord * (needed - barrier.unseen_extent) / (1.0 - chord)
    text = (
        f"is {barrier.unseen_extent:g}; expected at least {math.ceil(100.0 * least) / 100.0:g}: a"
        f" return counts in the middle of a beam of scan.cone_deg {math.degrees(scan.cone):g}, and"
        f" the robot needs ranges up to {needed:.2f} m"
    )
    yield fault_at(("protection", "barrier", "unseen_extent"), text)


def _shape_fault(points: list[Point]) -> str:
    """Why the points are not a convex counter-clockwise polygon; empty if they are."""
    if len(points) < 3:
        return f"has {len(points)} corners"
    edges = list(zip(points, points[1:] + points[:1], strict=True))
    headings = [math.atan2(b[1] - a[1], b[0] - a[0]) for a, b in edges]
    if any(a == b for a, b in edges):
        return "has the same corner twice in a row"
    turns = [wrap(b - a) for a, b in zip(headings, headings[1:] + headings[:1], strict=True)]
    if all(turn < 0.0 for turn in turns):
        return "runs clockwise"
    if any(turn <= 0.0 for turn in turns):
        corner = next(i for i, turn in enumerate(turns) if turn <= 0.0) + 1
        return f"does not turn left at corner {corner % len(points)}"
    if sum(turns) > 3.0 * math.pi:  # a simple polygon turns by 2 pi in all, a star by 4 pi
        return "crosses itself"
    return ""


def _bearings(scan: ScanSection) -> Array:
    """The bearings of the rays, (n,) rad; read-only, so that readers need no copy."""
    listed = scan.bearings_deg
    first = math.radians(scan.first_bearing_deg)
    if listed is None:
        rays = scan.rays or 0  # `_check_scan`: either `rays` or `bearings_deg` is set
        step = 2.0 * math.pi / rays
        bearings = np.array([wrap(first + i * step) for i in range(rays)])
    else:
        bearings = np.array([wrap(first + math.radians(bearing)) for bearing in listed])
    bearings.flags.writeable = False
    return bearings


def _sweep(section: SweepSection, rate: float) -> Sweep:
    return Sweep(
        start=math.radians(section.start_deg),
        direction=1.0 if section.direction == "ccw" else -1.0,
        duration=1.0 / rate if section.duration is None else section.duration,
    )


def _spec(scan: ScanSection) -> ScanSpec:
    return ScanSpec(
        bearings=_bearings(scan),
        rate=scan.rate,
        range_min=scan.range_min,
        range_max=scan.range_max,
        offset=scan.offset,
        max_gap=math.radians(scan.max_gap_deg),
        zero=scan.zero,
        is_noisy=scan.noisy,
        near=scan.near,
        latency=0.5 / scan.rate if scan.latency is None else scan.latency,
        sweep=_sweep(scan.sweep, scan.rate) if isinstance(scan.sweep, SweepSection) else None,
        is_sweep_unknown=scan.sweep == "unknown",
        cone=math.radians(scan.cone_deg),
        mask=tuple((math.radians(first), math.radians(last)) for first, last in scan.mask),
    )


_LEAST_RAYS = 90  # of a lidar whose tracks show robots: 4 degrees apart


def _provided(file: PlatformFile) -> frozenset[str]:
    """What the file names, and the places of peers by kin if the lidar shows robots of its kind."""
    provides = frozenset(file.provides)
    heights = file.heights
    is_seen = heights is not None and heights.lowest <= heights.scan_plane <= heights.highest
    has_tracks = file.protection.mode == "barrier" and len(_bearings(file.scan)) >= _LEAST_RAYS
    has_motion = {"scan", "odometry"} <= provides
    if is_seen and has_tracks and has_motion and not provides >= PLACES_BY_SIGHT:
        return provides | PLACES_BY_POSE | {KIN}
    return provides


def _platform(name: str, file: PlatformFile) -> Platform:
    protection = file.protection
    return Platform(
        name=name,
        limits=file.limits,
        footprint=np.array(file.footprint, dtype=np.float64),
        scan=_spec(file.scan),
        provides=_provided(file),
        protection={
            "mode": protection.mode,
            "avoidance": protection.avoidance,
            "preset": protection.preset,
            **to_builtins(protection.presets[protection.preset]),
            "barrier": to_builtins(protection.barrier),
            "stop_zone": to_builtins(protection.stop_zone),
        },
        patterns=file.patterns,
        drivers=cast(Mapping[str, Mapping[str, Value]], file.drivers),
        heights=file.heights,
        body=file.body,
        ranges=None if file.ranges is None else replace(_spec(file.ranges), is_sweep_unknown=False),
        sensors={name: _sensors(some) for name, some in file.sensors.items()},
        words=file.words,
    )


def _sensors(sections: list[SensorSection]) -> Array:
    bearings = (
        math.nan if section.bearing_deg is None else section.bearing_deg for section in sections
    )
    rows = [
        (*section.at, math.radians(bearing))
        for section, bearing in zip(sections, bearings, strict=True)
    ]
    if sections[0].field_of_view_deg is not None:
        seen = [
            (math.radians(section.field_of_view_deg or 0.0), section.range or 0.0)
            for section in sections
        ]
        return np.column_stack((rows, seen))
    return np.array(rows, dtype=np.float64)
