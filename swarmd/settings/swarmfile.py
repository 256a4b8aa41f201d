"""What may stand in swarm.yaml and in a daemon's own file, and the checks they must pass.

No numpy here: swarmctl reads swarm.yaml too, to meet the swarm as its robots do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from msgspec import Struct

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.keys import check_id
from swarmd.core.messages import Scalar
from swarmd.kit.touch_config import TouchGrants
from swarmd.network.settings import NetworkSettings
from swarmd.settings.layered import Layered
from swarmd.settings.yamlfile import Data, read, shown

DEFAULT = "default"
Parameters = dict[str, dict[str, Scalar | None]]
Option = Scalar | list[Scalar] | dict[str, Scalar | list[Scalar]] | None
Options = dict[str, Option]

# Command-line options that are not called like their key.
_OPTIONS = {"driver_options": "--driver-option", "seeds": "--seed"}


class ParametersSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pattern parameters by label and by robot, above those of the platform."""

    labels: dict[str, Parameters] = {}
    robots: dict[str, Parameters] = {}


class SwarmFile(NetworkSettings, Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys of swarm.yaml, which the robots of one swarm share: its network and more."""

    roster: list[str] = []
    labels: dict[str, list[str]] = {}
    parameters: ParametersSection = ParametersSection()
    touch: TouchGrants = {}


class DaemonFile(SwarmFile, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that may stand in the file of one daemon: swarm.yaml's keys and its own."""

    swarm_file: str | None = None
    id: str | None = None
    platform: str = "waffle_pi"
    driver: str = "simulated"
    driver_options: Options = {}
    state_dir: str | None = None
    plugin_dir: str | None = None


def load_swarm(
    config: Path | None, overrides: Mapping[str, object], environ: Mapping[str, str]
) -> SwarmFile:
    """What an operator must know to meet the swarm; a daemon's own file will do as well."""
    layers = layered(config, overrides, environ)
    file = layers.build(DaemonFile)
    check(layers, file)
    return file


def layered(
    config: Path | None, overrides: Mapping[str, object], environ: Mapping[str, str]
) -> Layered:
    """All sources: overrides that are not None, the file, what it includes, `$SWARM`, defaults."""
    sources: list[tuple[str, Mapping[str, Any]]] = [
        (_OPTIONS.get(key, f"--{key.replace('_', '-')}"), {key: value})
        for key, value in overrides.items()
        if value is not None
    ]
    if config is not None:
        own = read(config)
        sources += [(shown(config), own), *_included(config, own)]
    if environ.get("SWARM"):
        sources.append(("$SWARM", {"swarm": environ["SWARM"]}))
    return Layered(*sources, (DEFAULT, {}))


def check(layers: Layered, file: DaemonFile) -> None:
    """Raise ConfigError for names that no key may hold, and for a network that cannot be."""
    _check_names(layers, file)
    _check_network(layers, file)


def _included(config: Path, own: Data) -> list[tuple[str, Data]]:
    name = own.get("swarm_file")
    if not isinstance(name, str):
        return []
    path = config.parent / Path(name).expanduser()
    data = read(path)
    Layered((shown(path), data)).build(SwarmFile)
    return [(shown(path), data)]


def _check_names(layers: Layered, file: DaemonFile) -> None:
    for index, name in enumerate(file.roster):
        _check_id(layers, ("roster", index), name, f"roster[{index}]")
        if name in file.roster[:index]:
            raise layers.error(("roster", index), f"roster names {name!r} twice; keep one")
    for label, robots in file.labels.items():
        _check_id(layers, ("labels", label), label, f"labels.{label}")
        for name in robots:
            _check_robot(layers, ("labels", label), name, file.roster)
    for label in file.parameters.labels:
        if label not in file.labels:
            text = f"parameters.labels: {unknown('label', label, file.labels)}"
            raise layers.error(("parameters", "labels", label), text)
    for name in file.parameters.robots:
        _check_robot(layers, ("parameters", "robots", name), name, file.roster)


def _check_robot(layers: Layered, keys: Sequence[str], name: str, roster: list[str]) -> None:
    _check_id(layers, keys, name, ".".join(keys))
    if roster and name not in roster:
        raise layers.error(
            keys, f"{'.'.join(keys)}: {unknown('robot in the roster', name, roster)}"
        )


def _check_id(layers: Layered, keys: Sequence[str | int], value: str, what: str) -> None:
    try:
        check_id(value, what)
    except ConfigError as error:
        raise layers.error(keys, str(error)) from error


def _check_network(layers: Layered, file: DaemonFile) -> None:
    for keys, text in file.faults():
        raise layers.error(keys, text)
