"""Platforms: one kind of robot a file, read and checked. The schema is this file's structs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np
from msgspec import Meta, Struct, to_builtins

import swarmd.config
from swarmd.core.angles import wrap
from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array, Limits, Platform, ScanSpec, Value
from swarmd.protection.footprint import Footprint
from swarmd.protection.settings import (
    BarrierSettings,
    Mode,
    PotentialFieldSettings,
    StopZoneSettings,
)
from swarmd.settings.driver_options import base_options
from swarmd.settings.layered import Layered
from swarmd.settings.swarmfile import Options, Parameters
from swarmd.settings.yamlfile import Data, read_extended, shown

Coordinate = Annotated[float, Meta(ge=-100.0, le=100.0)]
Point = tuple[Coordinate, Coordinate]
Bearing = Annotated[float, Meta(ge=-360.0, le=360.0)]
Positive = Annotated[float, Meta(gt=0.0, le=1000.0)]
_SENSED = ("scan", "odometry", "neighbors")
_OF_NEIGHBORS = ("neighbors.distance", "neighbors.bearing", "neighbors.heading")
_READING = "reading:"


class LimitsSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the base can do: m/s, rad/s; `lateral` 0 for bases that cannot move sideways."""

    linear: Annotated[float, Meta(gt=0.0, le=20.0)]
    angular: Annotated[float, Meta(gt=0.0, le=50.0)]
    lateral: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.0


class ScanSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The range sensor: rate in Hz, ranges in m, and where its rays go.

    `rays` many are spread evenly over 360 degrees, or each has its own among `bearings_deg`.
    `latency`: the mean age of its rays in s when a sweep arrives; None: half a sweep, as of one
    that turns. `near`: whether it tells of what is nearer than `range_min`.
    """

    rays: Annotated[int, Meta(ge=1, le=10_000)] | None = None
    bearings_deg: Annotated[list[Bearing], Meta(min_length=1, max_length=10_000)] | None = None
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


class ProtectionSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The arbiter: its mode, and what each mode is told; `preset` is the potential field's."""

    mode: Mode = "barrier"
    preset: str
    presets: dict[str, PotentialFieldSettings]
    barrier: BarrierSettings | None = None
    stop_zone: StopZoneSettings = StopZoneSettings()


class PlatformFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that may stand in a platform's file."""

    description: str = ""
    extends: str | None = None
    limits: LimitsSection
    footprint: list[Point]
    scan: ScanSection
    provides: list[str]
    protection: ProtectionSection
    patterns: Parameters = {}
    drivers: dict[str, Options] = {}
    body: dict[str, Annotated[float, Meta(ge=-1e6, le=1e6)]] = {}


def platform_names() -> tuple[str, ...]:
    """The platforms that come with the project."""
    return tuple(sorted(path.stem for path in _folder().glob("*.yaml")))


def load_platform(name: str, near: Path | None = None) -> Platform:
    """The platform of that name, or of that file if it ends in .yaml (relative to `near`).

    ConfigError names file, key, value, what was wanted and the nearest valid key.
    """
    stem = _find(name, near or Path()).stem
    return platform_of(stem, Layered(*platform_sources(name, near)))


def platform_sources(name: str, near: Path | None = None) -> tuple[tuple[str, Data], ...]:
    """What `load_platform` reads: the file and those it extends, by name, strongest first."""
    files = read_extended(_find(name, near or Path()), _find)
    return tuple((shown(path), data) for path, data in files)


def platform_of(name: str, layers: Layered) -> Platform:
    """The platform that the layers describe; ConfigError as `load_platform`."""
    file = layers.build(PlatformFile)
    _check(layers, file)
    return _platform(name, file)


def _folder() -> Path:
    return Path(swarmd.config.__path__[0]).resolve() / "platforms"


def _find(name: str, near: Path) -> Path:
    if name.endswith(".yaml"):
        return near / Path(name).expanduser()
    if name not in platform_names():
        raise ConfigError(
            f"{unknown('platform', name, platform_names())} (or give a path ending in .yaml)"
        )
    return _folder() / f"{name}.yaml"


def _check(layers: Layered, file: PlatformFile) -> None:
    _check_scan(layers, file.scan)
    _check_protection(layers, file)
    for name, options in file.drivers.items():
        try:
            base_options(cast(Mapping[str, Value], options), f"drivers.{name}")
        except ConfigError as error:
            raise layers.error(("drivers", name), str(error)) from error
    for index, word in enumerate(file.provides):
        if word not in (*_SENSED, *_OF_NEIGHBORS) and not _is_reading(word):
            words = (*_SENSED, *_OF_NEIGHBORS, f"{_READING}<name>")
            raise layers.error(("provides", index), f"provides: {unknown('word', word, words)}")
    fault = _shape_fault(file.footprint)
    if fault:
        raise layers.error(
            ("footprint",),
            f"footprint {fault}; wanted a convex polygon in m, counter-clockwise seen from above",
        )
    if file.protection.mode == "stop_zone":
        _check_stop_zone(layers, file)


def _check_scan(layers: Layered, scan: ScanSection) -> None:
    if (scan.rays is None) == (scan.bearings_deg is None):
        fault = "is missing" if scan.rays is None else f"is {scan.rays} beside bearings_deg"
        text = f"scan.rays {fault}; wanted is one of the two: how many, or a list of bearings"
        raise layers.error(("scan", "rays"), text)
    if scan.range_min >= scan.range_max:
        text = f"scan.range_min is {scan.range_min:g}"
        raise layers.error(
            ("scan", "range_min"), f"{text}; wanted less than scan.range_max ({scan.range_max:g})"
        )
    if scan.near == "lost" and scan.zero == "too_close":
        raise layers.error(
            ("scan", "near"),
            "scan.near is lost, but scan.zero is too_close; wanted is reported, or another zero",
        )


def _check_protection(layers: Layered, file: PlatformFile) -> None:
    scan, protection = file.scan, file.protection
    if protection.preset not in protection.presets:
        fault = unknown("preset", protection.preset, protection.presets)
        raise layers.error(("protection", "preset"), f"protection.preset: {fault}")
    measured = f"between {scan.range_min:g} and {scan.range_max:g}"
    for name, preset in protection.presets.items():
        if not scan.range_min < preset.threshold < scan.range_max:
            key = ("protection", "presets", name, "threshold")
            raise layers.error(
                key,
                f"{'.'.join(key)} is {preset.threshold:g}; wanted a range the sensor can measure,"
                f" {measured}",
            )
    zone, barrier = protection.stop_zone, protection.barrier
    if zone.slow < zone.stop:
        raise layers.error(
            ("protection", "stop_zone"),
            f"protection.stop_zone.slow is {zone.slow:g}; wanted at least stop ({zone.stop:g})",
        )
    keep_out = None if barrier is None else barrier.keep_out
    if keep_out is not None and not scan.range_min < keep_out < scan.range_max:
        raise layers.error(
            ("protection", "barrier", "keep_out"),
            f"protection.barrier.keep_out is {keep_out:g}; wanted a range the sensor can measure,"
            f" {measured}",
        )
    if protection.mode == "barrier":
        _check_barrier(layers, file)


def _check_stop_zone(layers: Layered, file: PlatformFile) -> None:
    """What stands in the zone that stops the robot must be seen there."""
    stop = file.protection.stop_zone.stop
    reach, _ = Footprint(np.array(file.footprint)).circles(file.scan.offset)
    if reach + stop < file.scan.range_min:
        wanted = math.ceil(100.0 * (file.scan.range_min - reach)) / 100.0
        raise layers.error(
            ("protection", "mode"),
            f"protection.mode is stop_zone, whose stop is {stop:g} m from the outline, where the"
            f" sensor sees nothing yet; wanted is protection.stop_zone.stop of at least {wanted:g}"
            " (and slow beyond it), or another mode",
        )


def _check_barrier(layers: Layered, file: PlatformFile) -> None:
    """What mode `barrier` cannot do without."""
    if file.protection.barrier is None:
        lacks = "protection.barrier; give it others_speed and unseen_extent"
    elif "odometry" not in file.provides:
        lacks = "odometry; add it to provides"
    else:
        return
    text = f"protection.mode is barrier, which needs {lacks}, or take another mode"
    raise layers.error(("protection", "mode"), text)


def _is_reading(word: str) -> bool:
    return word.startswith(_READING) and word.removeprefix(_READING).isidentifier()


def _shape_fault(points: list[Point]) -> str:
    """What keeps the points from being a convex counter-clockwise polygon; empty if nothing."""
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
    if sum(turns) > 3.0 * math.pi:  # once around is 2 pi; a star goes around twice
        return "crosses itself"
    return ""


def _bearings(scan: ScanSection) -> Array:
    """(n,) rad, where the rays go."""
    given = scan.bearings_deg
    if given is None:
        rays = scan.rays or 0  # one of the two is there
        step = 2.0 * math.pi / rays
        first = math.radians(scan.first_bearing_deg)
        return np.array([wrap(first + i * step) for i in range(rays)])
    turn = math.radians(scan.first_bearing_deg)
    return np.array([wrap(turn + math.radians(bearing)) for bearing in given])


def _platform(name: str, file: PlatformFile) -> Platform:
    scan, protection = file.scan, file.protection
    return Platform(
        name=name,
        limits=Limits(**to_builtins(file.limits)),
        footprint=np.array(file.footprint, dtype=np.float64),
        scan=ScanSpec(
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
        ),
        provides=frozenset(file.provides),
        protection={
            "mode": protection.mode,
            "preset": protection.preset,
            **to_builtins(protection.presets[protection.preset]),
            "barrier": to_builtins(protection.barrier),
            "stop_zone": to_builtins(protection.stop_zone),
        },
        patterns=file.patterns,
        drivers=cast(Mapping[str, Mapping[str, Value]], file.drivers),
        body=file.body,
    )
