"""Pseudo-reality: sensor, actuator and radio errors that each seed draws within bounds.

A behaviour that was designed in one simulation runs in simulations with other errors. A behaviour
that loses much performance there is likely to lose much on robots (the reality gap). Source: A.
Ligot and M. Birattari, "On mimicking the effects of the reality gap with simulation-only
experiments", ANTS 2018; "Simulation-only experiments to mimic the effects of the reality gap in the
automatic design of robot swarms", Swarm Intelligence 14, 2020.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import msgspec

from swarmd.core.errors import ConfigError, unknown
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.world.radio import RadioSettings, check_radio
from swarmd.sim.world.realism import Realism
from swarmd.sim.world.seeding import generator

Bounds = Mapping[str, tuple[float, float]]

BOUNDS: Bounds = MappingProxyType(
    {
        "realism.lidar.bias": (0.0, 0.04),
        "realism.lidar.near_sd": (0.0, 0.03),
        "realism.lidar.far_sd": (0.0, 0.03),
        "realism.lidar.dropout": (0.0, 0.1),
        "realism.lidar.delay": (0.0, 0.1),
        "realism.odometry.diameter": (0.0, 0.02),
        "realism.odometry.wheelbase": (0.0, 0.05),
        "realism.odometry.slip": (0.0, 0.08),
        "realism.actuation.delay": (0.0, 0.12),
        "realism.actuation.linear_acceleration": (0.5, 2.0),  # also limits braking
        "radio.loss": (0.0, 0.3),
        "radio.delay": (0.02, 0.2),
        "radio.jitter": (0.0, 0.02),
    }
)
"""The bounds of `pseudo_reality: true`: from 0 to two to four times `realistic`; our choice."""


def bounds_of(value: bool | Mapping[str, Any], realism: Realism, radio: RadioSettings) -> Bounds:
    """The bounds of the scenario's key `pseudo_reality`; True gives BOUNDS.

    ConfigError for an unknown key, and for bounds at which `realism` and `radio` are not valid: all
    lower bounds are tried together, then all upper bounds.
    """
    bounds: Bounds = BOUNDS if value is True else {}
    if isinstance(value, Mapping):
        bounds = {key: _pair(key, pair) for key, pair in value.items()}
    for end in (0, 1):
        _with({key: pair[end] for key, pair in bounds.items()}, realism, radio)
    return bounds


def draws(bounds: Bounds, seed: int) -> dict[str, float]:
    """The values of a seed by key, each uniform within its bounds.

    A value depends on seed, key and bounds alone.
    """
    return {
        key: float(generator(seed, "pseudo_reality", key).uniform(low, high))
        for key, (low, high) in bounds.items()
    }


def drawn(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with the values that the seed draws; unchanged without `pseudo_reality`."""
    if not scenario.pseudo_reality:
        return scenario
    values = draws(scenario.pseudo_reality, seed)
    realism, radio = _with(values, scenario.realism, scenario.radio)
    return replace(scenario, realism=realism, radio=radio)


def _pair(key: str, value: Any) -> tuple[float, float]:
    is_pair = isinstance(value, list | tuple) and len(value) == 2
    if not is_pair or not all(isinstance(x, int | float) and x == x for x in value):
        raise ConfigError(f"{key}: is {value!r}; expected the bounds, such as [0, 0.1]")
    low, high = map(float, value)
    if low > high:
        raise ConfigError(f"{key}: {low:g} is above {high:g}; expected the lower bound first")
    return low, high


def _with(
    values: Mapping[str, float], realism: Realism, radio: RadioSettings
) -> tuple[Realism, RadioSettings]:
    """Realism and radio with `values` by dotted key; ConfigError for a wrong key or value."""
    data: dict[str, Any] = deepcopy(
        {"realism": msgspec.to_builtins(realism), "radio": msgspec.to_builtins(radio)}
    )
    known = [key for key, value in _leaves(data) if not isinstance(value, bool | str)]
    for key, value in values.items():
        if key not in known:
            raise ConfigError(unknown("key", key, known))
        *path, last = key.split(".")
        section = data
        for part in path:
            section = section[part]
        section[last] = value
    try:
        made = msgspec.convert(data["realism"], Realism)
        heard = msgspec.convert(data["radio"], RadioSettings)
    except msgspec.ValidationError as error:
        raise ConfigError(f"a bound is refused: {error}") from None
    check_radio(heard)
    return made, heard


def _leaves(data: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    leaves = []
    for name, value in data.items():
        is_section = isinstance(value, Mapping)
        leaves += _leaves(value, f"{prefix}{name}.") if is_section else [(f"{prefix}{name}", value)]
    return leaves
