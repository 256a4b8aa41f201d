"""Parameter files of ROS2swarm (Kaiser et al., ICRA 2022) as parameters of our patterns.

A parameter file of ROS2swarm belongs to one node, such as `attraction_pattern`. Each of its names
begins with the name of the node, except for the limits that all nodes share. `COUNTERPARTS` has a
row for each node: the pattern of swarmd that does the same, and the parameter for each name. Units
are m, s, m/s and rad/s in both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from msgspec import Struct

from swarmd.core.errors import ConfigError, unknown
from swarmd.settings import yamlfile

_NODE_PARAMETERS = "ros__parameters"  # the key under which ROS 2 keeps the parameters of a node
_SHARED = {"max_translational_velocity": "speed", "max_rotational_velocity": "turn"}
_RATE = "a pattern steps at its own rate, mostly 10 Hz"
_RANGE_MIN = "`scan.range_min` of the platform file takes its place"
_RANGE_MAX = "`scan.range_max` of the platform file takes its place"
_COMBINED = "it combines nodes with a magnetometer, which no driver reads"
_PROTECTION = "protection is a section of the platform file, and never off"


class Counterpart(NamedTuple):
    """The pattern of swarmd that does the same as a node of ROS2swarm.

    `pattern`: the name of the pattern; empty if no pattern does the same. `fixed`: the parameters
    by which the pattern uses the equations of ROS2swarm. `names`: maps parameters of the node to
    parameters of the pattern. `without`: maps parameters of the node that the pattern lacks to the
    reason. `note`: how the pattern differs, or why there is no pattern.
    """

    pattern: str
    fixed: Mapping[str, Any] = MappingProxyType({})
    names: Mapping[str, str] = MappingProxyType({})
    without: Mapping[str, str] = MappingProxyType({})
    note: str = ""


class Conversion(Struct, frozen=True):
    """A converted file: the pattern with its parameters, and what has no counterpart.

    `left_out` has the reason for each name of the file that was not converted.
    """

    node: str
    pattern: str
    parameters: Mapping[str, Any]
    left_out: Mapping[str, str]
    notes: tuple[str, ...] = ()


def _field(prefix: str) -> dict[str, str]:
    """The parameters of a potential field, which attraction and dispersion share."""
    return {
        f"{prefix}_max_range": "paper_range",
        f"{prefix}_front_attraction": "bias",
        f"{prefix}_threshold": "rays",
        f"{prefix}_linear_if_alone": "linear_if_alone",
        f"{prefix}_angular_if_alone": "angular_if_alone",
        **_SHARED,
    }


def _vote(prefix: str) -> dict[str, str]:
    """The parameters of a vote; `_opinions` converts its opinions."""
    return {f"{prefix}_timer_period": "window"}


_PAPER = {"law": "paper"}
_OLD_STOP = "a key of ROS2swarm 1.0; `linear_if_alone` and `angular_if_alone` take its place"

COUNTERPARTS: Mapping[str, Counterpart] = MappingProxyType(
    {
        "attraction": Counterpart(
            "attraction",
            _PAPER,
            _field("attraction"),
            {"attraction_min_range": _RANGE_MIN, "attraction_stop_if_alone": _OLD_STOP},
        ),
        "dispersion": Counterpart(
            "dispersion",
            _PAPER,
            _field("dispersion"),
            {
                "dispersion_min_range": _RANGE_MIN,
                "dispersion_stop_if_alone": _OLD_STOP,
                "dispersion_allow_dynamic_max_range_setting": "`swarmctl param set` always works",
            },
        ),
        "drive": Counterpart(
            "drive",
            names={"drive_linear": "speed", "drive_angular": "turn"},
            without={"drive_timer_period": _RATE},
        ),
        "random_walk": Counterpart(
            "random_walk",
            _PAPER,
            {
                "random_walk_linear": "speed",
                "random_walk_angular": "turn",
                "random_walk_rot_interval": "turn_time",
                "random_walk_lin_interval_min": "straight_min",
                "random_walk_lin_interval_max": "straight_max",
            },
            {"random_walk_timer_period": _RATE},
        ),
        "minimalist_flocking": Counterpart(
            "flocking",
            _PAPER,
            {
                "minimalist_flocking_translational_velocity": "speed",
                "minimalist_flocking_rotational_left_velocity": "paper_turn",
                "minimalist_flocking_zone1_threshold": "near",
                "minimalist_flocking_zone3_threshold": "far_aside",
                "minimalist_flocking_zone4_threshold": "far_behind",
            },
            {
                "minimalist_flocking_rotational_right_velocity": "the turn to the right is as fast"
                " as `paper_turn` to the left",
                "minimalist_flocking_zone2_threshold": "`near` is one distance for both zones",
                "minimalist_flocking_drive_timer_period": _RATE,
                "minimalist_flocking_zone2_robot_threshold": "objects are told by their width, not"
                " by a number of rays",
                "minimalist_flocking_robot_threshold": "objects are told by their width, not by a"
                " number of rays",
                "minimalist_flocking_zone_borders": "the four sectors are fixed",
                "max_range": _RANGE_MAX,
                "min_range": _RANGE_MIN,
            },
        ),
        "majority_rule": Counterpart("majority_rule", names=_vote("majority_rule")),
        "voter_model": Counterpart("voter_model", names=_vote("voter_model")),
        "discussed_dispersion": Counterpart(
            "discussed_dispersion",
            _PAPER,
            {
                "discussed_dispersion_discussion_time": "discuss",
                "discussed_dispersion_discussion_base_distance": "base",
                "discussed_dispersion_discussion_opinion_multiply": "step",
                "majority_rule_timer_period": "window",
                **_SHARED,
            },
            {
                "discussed_dispersion_timer_period": _RATE,
                **dict.fromkeys(
                    (
                        "dispersion_max_range",
                        "dispersion_front_attraction",
                        "dispersion_threshold",
                        "dispersion_linear_if_alone",
                        "dispersion_angular_if_alone",
                    ),
                    "the distance follows from `base` and `step`; the rest is as in the paper",
                ),
                "dispersion_min_range": _RANGE_MIN,
                "dispersion_stop_if_alone": _OLD_STOP,
                "dispersion_allow_dynamic_max_range_setting": "the vote sets the distance",
            },
        ),
        "attraction2": Counterpart(
            "", note="`attraction` with law settling also pulls more to nearer robots"
        ),
        "aggregation": Counterpart(
            "", note="`attraction` and `one_bit_aggregation` gather robots by other rules"
        ),
        "magnetometer": Counterpart("", note="no driver reads a magnetometer"),
        "rat_search": Counterpart("", note="`follow_wall` follows walls, without a maze"),
        "voter_model_with_limiter": Counterpart(
            "", note="`voter_model` with `radio.range` limits the receivers of a vote"
        ),
        "flocking": Counterpart("", note=_COMBINED),
        "flocking2": Counterpart("", note=_COMBINED),
        "beeclust": Counterpart("", note="`cue_aggregation` gathers robots where a field is high"),
        "line_avoidance": Counterpart("", note="no driver reads sensors of the ground's color"),
        "hardware_protection_layer": Counterpart("", note=_PROTECTION),
        "sensor_specification": Counterpart("", note="sensors are a section of the platform file"),
    }
)
"""By the prefix of a node's parameters."""

_VOTES = {
    "majority_rule": "majority_rule",
    "voter_model": "voter_model",
    "discussed_dispersion": "majority_rule",
}
"""For each node that votes: the prefix of its parameters of opinions."""
_OPINIONS = ("choose_start_value_at_random", "initial_value", "min_opinion", "max_opinion")
"""These parameters, behind the prefix and `_`."""


def read_parameter_file(path: Path) -> Conversion:
    """Convert a parameter file of ROS2swarm, which belongs to one node.

    ConfigError with file and name for any other file, for a node without a counterpart,
    and for a value of a wrong type. The pattern's bounds are not checked.
    """
    given = _parameters(path)
    node = _node_of(path, given)
    counterpart = COUNTERPARTS[node]
    if not counterpart.pattern:
        raise ConfigError(
            f"{path}: {node} has no counterpart: {counterpart.note}; pattern ros2_nodes may run"
            " their own node (docs/ros2_nodes.md)"
        )
    parameters: dict[str, Any] = dict(counterpart.fixed)
    left_out: dict[str, str] = {}
    notes = [counterpart.note] if counterpart.note else []
    opinions: dict[str, Any] = {}
    opinion_names: set[str] = set()  # parameters of the node from which `opinions` are computed
    if node in _VOTES:
        prefix = _VOTES[node]
        opinions = _opinions(path, prefix, given)
        opinion_names = {f"{prefix}_{end}" for end in _OPINIONS}
        lowest = given.get(f"{prefix}_min_opinion", 0)
        if lowest != 0:
            notes.append(f"opinion 0 here is opinion {lowest} of ROS2swarm")
    for name, value in given.items():
        if name in counterpart.names:
            parameters[counterpart.names[name]] = _number(path, name, value)
        elif name in counterpart.without:
            left_out[name] = counterpart.without[name]
        elif name not in opinion_names:
            left_out[name] = "ROS2swarm has no such parameter in this node"
    return Conversion(node, counterpart.pattern, parameters | opinions, left_out, tuple(notes))


def _parameters(path: Path) -> Mapping[str, Any]:
    """The parameters of the one node in a file, by name."""
    try:
        contents = yamlfile.read(path)
    except ConfigError as error:
        raise ConfigError(
            f"{error}; expected a parameter file of ROS2swarm, such as attraction_pattern.yaml"
        ) from error
    nodes = [
        (node, content[_NODE_PARAMETERS])
        for node, content in contents.items()
        if isinstance(content, Mapping) and isinstance(content.get(_NODE_PARAMETERS), Mapping)
    ]
    if len(nodes) != 1:
        raise ConfigError(
            f"{path}: {len(nodes)} nodes with `{_NODE_PARAMETERS}`; expected one, as in a parameter"
            " file of ROS2swarm"
        )
    return dict(nodes[0][1])


def _node_of(path: Path, given: Mapping[str, Any]) -> str:
    """The node whose parameters these are, by their prefix, else by the name of the file."""
    stem = path.stem.removesuffix("_pattern").replace("_pattern2", "2")
    if stem in COUNTERPARTS:
        return stem
    # The parameters of a combined node have the prefixes of its parts, too.
    if any(name.startswith("discussed_dispersion_") for name in given):
        return "discussed_dispersion"
    for node in sorted(COUNTERPARTS, key=len, reverse=True):  # one prefix may begin another
        if any(name.startswith(f"{node}_") for name in given):
            return node
    raise ConfigError(f"{path}: {unknown('node of ROS2swarm', stem, list(COUNTERPARTS))}")


def _opinions(path: Path, vote: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Number of opinions and first opinion; ours count from 0, and ROS2swarm's from a minimum."""
    if f"{vote}_max_opinion" not in given:
        raise ConfigError(f"{path}: no {vote}_max_opinion; expected the number after the last one")
    lowest = _integer(path, f"{vote}_min_opinion", given.get(f"{vote}_min_opinion", 0))
    end = _integer(path, f"{vote}_max_opinion", given[f"{vote}_max_opinion"])
    if end <= lowest:
        raise ConfigError(f"{path}: {vote}_max_opinion is {end}; expected more than {lowest}")
    opinions: dict[str, Any] = {"opinions": end - lowest}
    is_random = given.get(f"{vote}_choose_start_value_at_random", True)
    if not isinstance(is_random, bool):
        name = f"{vote}_choose_start_value_at_random"
        value = yamlfile.brief(is_random)
        raise ConfigError(f"{path}: {name} is {value}; expected true or false")
    if not is_random:
        name = f"{vote}_initial_value"
        initial = _integer(path, name, given.get(name, 0))
        if not lowest <= initial < end:
            raise ConfigError(f"{path}: {name} is {initial}; expected {lowest} to {end - 1}")
        opinions["initial"] = initial - lowest
    return opinions


def _number(path: Path, name: str, value: object) -> float | int:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) < math.inf:  # type: ignore[arg-type]
        raise ConfigError(f"{path}: {name} is {yamlfile.brief(value)}; expected a number")
    return value  # type: ignore[return-value]


def _integer(path: Path, name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ConfigError(f"{path}: {name} is {yamlfile.brief(value)}; expected an integer")
    return value
