"""Imperfections of simulated robots: noise, bias, drop-outs, delays.

Sources:

- [LDS] ROBOTIS e-Manual, appendices LDS-01 and LDS-02.
- [driver] hls_lfcd_lds_driver, the ROS driver of the LDS-01.
- [UMBmark] Borenstein and Feng 1995, systematic errors of differential drives.
- [sim] turtlebot3_simulations model.sdf.

Values without a source are marked "our choice".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Annotated, Any

from msgspec import Meta, Struct, to_builtins

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Platform
from swarmd.settings.layered import Layered
from swarmd.settings.yamlfile import brief

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Spread = Annotated[float, Meta(ge=0.0, le=0.2)]
Length = Annotated[float, Meta(ge=0.0, le=1.0)]
Delay = Annotated[float, Meta(ge=0.0, le=2.0)]
Acceleration = Annotated[float, Meta(ge=0.01, le=1000.0)]


class LidarNoise(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Errors of a scan: a range r becomes r (1 + b) + N(0, sd), then is rounded."""

    # the standard deviation of b, drawn once for each robot, as a share of the range
    bias: Spread = 0.0
    # the sd in m of ranges below `near`
    near_sd: Length = 0.0
    # m
    near: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.5
    # the sd of ranges from `near` on, as a share of the range
    far_sd: Spread = 0.0
    # the step in m to which ranges are rounded; 0: not at all
    resolution: Length = 0.0
    # the share of rays lost one by one
    dropout: Share = 0.0
    # the share of blocks of six rays lost whole, of sensors with `zero: lds` alone, whose driver
    # skips damaged blocks [driver]
    block_dropout: Share = 0.0
    # each ray is measured at its own time, where the platform's file describes the `sweep`
    rolling: bool = False
    # the mean age of the rays on arrival, in scan periods; with `rolling` at least half a sweep, by
    # which the rays are older than the last ray on average
    latency: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.0
    # s, of the transport of each scan
    delay: Delay = 0.0
    # a further delay of each scan is drawn from 0 to this, in s; no scan overtakes an earlier scan
    jitter: Delay = 0.0

    @property
    def differs_each_time(self) -> bool:
        """True if two scans of an unchanged scene differ."""
        return max(self.near_sd, self.far_sd, self.dropout) > 0.0


class OdometryNoise(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Errors of wheel odometry as standard deviations (sd); see [UMBmark].

    diameter: the sd of E_d - 1, where E_d is right over left wheel diameter. wheelbase: the sd of
    E_b - 1, where E_b is true over assumed wheelbase. E_d and E_b are drawn once for each robot.
    slip: the sd of a random share that is added to linear and angular motion at each reading.
    """

    diameter: Spread = 0.0
    wheelbase: Spread = 0.0
    slip: Spread = 0.0

    @property
    def is_ideal(self) -> bool:
        """True if odometry has no errors."""
        return self.diameter == self.wheelbase == self.slip == 0.0


class Actuation(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Delay and acceleration limits of a base.

    delay: s from command to motion. linear_acceleration and angular_acceleration: limits in m/s2
    and rad/s2, besides the platform's own limits; null: the platform's limits alone.
    """

    delay: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    linear_acceleration: Acceleration | None = None
    angular_acceleration: Acceleration | None = None


class Realism(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All imperfections; by default none."""

    lidar: LidarNoise = LidarNoise()
    odometry: OdometryNoise = OdometryNoise()
    actuation: Actuation = Actuation()


IDEAL = Realism()

REALISTIC = Realism(
    # Accuracy +-5 % and precision +-3.5 % of the range [LDS], read as 3 sd each; sd 10 mm near
    # [sim]. An Ouster OS1, sd 1.5 to 3 cm and no such bias, is better than this beyond 2.5 m. How
    # many rays are lost: our choice.
    lidar=LidarNoise(
        bias=0.017,
        near_sd=0.010,
        near=0.5,
        far_sd=0.012,
        resolution=0.001,
        dropout=0.01,
        block_dropout=0.005,
        rolling=True,
        latency=0.5,
    ),
    odometry=OdometryNoise(diameter=0.005, wheelbase=0.015, slip=0.02),  # our choice
    # 20 to 50 ms from command to wheel: our choice. 1 m/s2 at the rim of a wheel [sim]; turning
    # on the spot that is more than any body's own limit.
    actuation=Actuation(delay=0.03, linear_acceleration=1.0),
)

REALISMS: Mapping[str, Realism] = MappingProxyType({"ideal": IDEAL, "realistic": REALISTIC})


def realism_of(value: str | Mapping[str, Any], source: str = "realism") -> Realism:
    """The realism of a preset's name or of a mapping.

    The values of a mapping replace those of its key `preset`, by default `realistic`. ConfigError
    begins with `source` and names the first wrong key.
    """
    if not isinstance(value, str | Mapping):
        raise ConfigError(
            f"{source}: is {brief(value)}; expected {' or '.join(REALISMS)}, or keys and values"
        )
    if isinstance(value, str):
        return _preset(value, source)
    preset = _preset(value.get("preset", "realistic"), source)
    over = {key: item for key, item in value.items() if key != "preset"}
    return Layered((source, over), ("preset", to_builtins(preset))).build(Realism)


def configured(platform: Platform, realism: Realism) -> Platform:
    """The platform that robots assume in a world of this realism.

    In a world without scan noise `is_noisy` is False, since equal scans are then no sign of a
    frozen sensor. In a world without rolling scans `sweep` is None, since all rays of a scan are
    measured at once.
    """
    lidar = realism.lidar
    scan = replace(
        platform.scan,
        is_noisy=platform.scan.is_noisy and lidar.differs_each_time,
        sweep=platform.scan.sweep if lidar.rolling else None,
        is_sweep_unknown=False,
    )
    ring = platform.ranges
    if ring is not None:
        ring = replace(ring, is_noisy=ring.is_noisy and lidar.differs_each_time)
    return replace(platform, scan=scan, ranges=ring)


def _preset(name: object, source: str) -> Realism:
    if isinstance(name, str) and name in REALISMS:
        return REALISMS[name]
    raise ConfigError(f"{source}: {unknown('preset', str(name), REALISMS)}")
