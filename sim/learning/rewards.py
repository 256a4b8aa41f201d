"""Rewards: weighted terms from metrics and contacts, or a function of the state."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array
from swarmd.sim.metrics.catalog import metric_of
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.metrics.reported import PREFIXES
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.simulation import meta_of
from swarmd.sim.trace import Trace
from swarmd.sim.world.world import World

CONTACTS = "contacts"
LIMITED = "limited"
"""Reward terms of each robot: its new contacts, and 1 while protection changes its request."""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """The swarm after a step; row i of every array is robot `ids[i]`, learner or not."""

    ids: tuple[str, ...]
    time: float  # s
    period: float  # s since the previous step
    pose: Array  # (n, 3) x, y in m and yaw in rad
    requested: Array  # (n, 3) linear, angular, lateral: the command before protection
    safe: Array  # (n, 3) the command after protection
    present: NDArray[np.bool_]  # (n,) the robot has a daemon
    limited: NDArray[np.bool_]  # (n,) protection changed the request
    contacts: NDArray[np.int64]  # (n,) contacts that began since the previous step


RewardFunction: TypeAlias = Callable[[State], Mapping[str, float]]
"""The reward of each robot by its id; a robot that is left out gets 0."""
Reward: TypeAlias = Mapping[str, float] | RewardFunction

DEFAULTS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "aggregation": {"mean_distance_to_centroid_end": -1.0, CONTACTS: -0.1},
        "dispersion": {"nearest_neighbor_median_late": 1.0, CONTACTS: -0.1},
        "one_bit_aggregation": {"mean_distance_to_centroid_end": -1.0, CONTACTS: -0.1},
    }
)
"""The weights for scenarios, used if the user gives no reward."""


def default_reward(name: str) -> Mapping[str, float]:
    """The terms for a scenario; ConfigError if there are none."""
    if name not in DEFAULTS:
        raise ConfigError(
            f"reward: scenario {name} has none of its own; give weights of metrics, such as"
            ' {"mean_distance_to_centroid_end": -1.0}, or a function of the state'
        )
    return DEFAULTS[name]


class Rewards:
    """Computes each robot's reward: call `begin` with the first state, then `of` with each state.

    The reward is a sum of terms. The term of a metric is equal for all robots: its weight times the
    change of the metric since the previous step. This term is 0 if the metric had no value before
    or after the step, or if robots have joined or left. The terms of CONTACTS and LIMITED are the
    weight times the robot's own value.
    """

    def __init__(self, reward: Reward, scenario: Scenario, seed: int, world: World) -> None:
        self._function = reward if callable(reward) else None
        weights = {} if callable(reward) else dict(reward)
        self._own = {name: weights.pop(name, 0.0) for name in (CONTACTS, LIMITED)}
        self._metrics = [(check_metric(name), weight) for name, weight in weights.items()]
        platforms = world.platforms
        self._common: Mapping[str, Any] = {
            "ids": tuple(world.ids),
            "contact_t": np.empty(0),
            "contact_pair": np.empty((0, 2), dtype=np.int64),
            "contact_speed": np.empty((0, 2)),
            "platforms": tuple(platform.name for platform in platforms),
            "footprints": {platform.name: platform.footprint for platform in platforms},
            "meta": meta_of(scenario, seed),
        }
        self._last: list[float] = []
        self._last_present = np.empty(0, dtype=np.bool_)

    def begin(self, state: State) -> None:
        """Take the state before the first step."""
        self._last = self._values(state)
        self._last_present = state.present

    def of(self, state: State) -> Mapping[str, float]:
        """The reward of each robot for the step that led to `state`."""
        if self._function is not None:
            return _checked(self._function(state), state.ids)
        values = self._values(state)
        shared = 0.0
        if np.array_equal(state.present, self._last_present):
            for (_, weight), value, last in zip(self._metrics, values, self._last, strict=True):
                change = value - last
                shared += weight * change if np.isfinite(change) else 0.0
        self._last = values
        self._last_present = state.present
        own = self._own[CONTACTS] * state.contacts + self._own[LIMITED] * state.limited
        return dict(zip(state.ids, (shared + own).tolist(), strict=True))

    def _values(self, state: State) -> list[float]:
        if not self._metrics:
            return []
        trace = Trace(
            t=np.array([state.time]),
            pose=state.pose[None],
            safe=state.safe[None],
            requested=state.requested[None],
            active=state.limited[None],
            present=state.present[None],
            **self._common,
        )
        return [_at(metric, trace) for metric, _ in self._metrics]


def check_weights(weights: Mapping[str, float]) -> None:
    """ConfigError for a term that does not exist, or a weight that is no finite number."""
    for name, weight in weights.items():
        if name not in (CONTACTS, LIMITED):
            check_metric(name)
        if not isinstance(weight, Real) or not math.isfinite(weight):
            raise ConfigError(f"reward: the weight of {name} is {weight!r}; expected a number")


def check_metric(name: str) -> Metric:
    """The metric of that name; ConfigError if it has no value at an instant."""
    metric = metric_of(name)
    if metric.series is None or name.startswith(PREFIXES):
        raise ConfigError(
            f"reward: {name} has no value at an instant of the world; take a metric over time,"
            " such as mean_distance_to_centroid_end, or a function of the state"
        )
    return metric


def _checked(given: Any, ids: tuple[str, ...]) -> dict[str, float]:
    """The result of a user's function; ConfigError unless it is finite numbers by robot."""
    if not isinstance(given, Mapping):
        raise ConfigError(f"reward: the function returned {given!r}; expected numbers by robot")
    for robot, value in given.items():
        if robot not in ids:
            raise ConfigError(f"reward: {unknown('robot', str(robot), ids)}")
        if not isinstance(value, Real) or not math.isfinite(value):
            raise ConfigError(f"reward: the reward of {robot} is {value!r}; expected a number")
    return {robot: float(value) for robot, value in given.items()}


def _at(metric: Metric, trace: Trace) -> float:
    assert metric.series is not None
    values = metric.series(trace)
    return float("nan") if values is None else float(values[-1])
