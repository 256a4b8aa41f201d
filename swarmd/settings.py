"""The settings of one daemon, read once: files, command line and environment into one value.

Weakest to strongest: defaults, `$SWARM`, the file named by `swarm_file`, the daemon's own file,
the command line. `provenance` says for every key which of them won.
"""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, cast

from msgspec import Struct

from swarmd.errors import ConfigError, unknown
from swarmd.frames import Layers
from swarmd.keys import check_id
from swarmd.layered import Layered
from swarmd.platforms import Options, Parameters, load_platform, platform_names
from swarmd.values import Platform, Value
from swarmd.yamlfile import Data, read, shown

__all__ = ["DaemonSettings", "load_daemon_settings", "load_platform", "platform_names"]

DEFAULT = "default"
_ENDPOINT = re.compile(r"(tcp|udp|tls|quic)/\S+:\d{1,5}")
# Command-line options that are not called like their key.
_OPTIONS = {"driver_options": "--driver-option", "seeds": "--seed"}


class ParametersSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pattern parameters by label and by robot, above those of the platform."""

    labels: dict[str, Parameters] = {}
    robots: dict[str, Parameters] = {}


class SwarmFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that may stand in swarm.yaml: what the robots of one swarm share."""

    swarm: str = DEFAULT
    profile: Literal["dev", "field"] = "dev"
    interface: str | None = None
    listen: list[str] = []
    seeds: list[str] = []
    roster: list[str] = []
    labels: dict[str, list[str]] = {}
    parameters: ParametersSection = ParametersSection()


class DaemonFile(SwarmFile, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that may stand in the file of one daemon: swarm.yaml's keys and its own."""

    swarm_file: str | None = None
    id: str | None = None
    platform: str = "waffle_pi"
    driver: str = "simulated"
    driver_options: Options = {}
    state_dir: str | None = None
    plugin_dir: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DaemonSettings:
    """Everything one daemon is told, checked.

    `state_dir` is shared by all daemons of a user: `<state_dir>/<swarm>/<id>` is this one's.
    `provenance`: key -> file, `--option`, `$VARIABLE`, `host name` or `default`.
    """

    id: str
    swarm: str
    profile: Literal["dev", "field"]
    interface: str | None
    listen: tuple[str, ...]
    seeds: tuple[str, ...]
    platform: Platform
    driver: str
    driver_options: Mapping[str, Value]
    labels: tuple[str, ...]
    parameters: ParametersSection
    roster: tuple[str, ...]
    state_dir: Path
    plugin_dir: Path | None
    die_with_parent: int | None = None
    provenance: Mapping[str, str] = field(default_factory=dict)

    def pattern_layers(self, pattern: str) -> Layers:
        """The parameters configured for a pattern by source, weakest first; empty ones left out.

        Sources: `platform`, `label <name>` in the order of the file, `robot`.
        """
        labelled = self.parameters.labels
        layers = [("platform", self.platform.patterns.get(pattern, {}))]
        layers += [
            (f"label {name}", labelled.get(name, {}).get(pattern, {})) for name in self.labels
        ]
        layers += [("robot", self.parameters.robots.get(self.id, {}).get(pattern, {}))]
        return tuple((source, values) for source, values in layers if values)


def load_daemon_settings(
    config: Path | None,
    overrides: Mapping[str, object],
    environ: Mapping[str, str] = os.environ,
) -> DaemonSettings:
    """The settings from a file (None: no file), `overrides` and the environment.

    `overrides` has the keys of `DaemonFile` and `die_with_parent`; None means not given.
    ConfigError names source, key, value, what was wanted and the nearest valid key.
    """
    given = {key: value for key, value in overrides.items() if value is not None}
    parent = given.pop("die_with_parent", None)
    layers = _layers(config, given, environ)
    file = layers.build(DaemonFile)
    _check_names(layers, file)
    _check_network(layers, file)
    near = config.parent if config is not None and "platform" not in given else Path()
    platform = load_platform(file.platform, near)
    robot = _robot_id(layers, file)
    return DaemonSettings(
        id=robot,
        swarm=file.swarm,
        profile=file.profile,
        interface=file.interface,
        listen=tuple(file.listen),
        seeds=tuple(file.seeds),
        platform=platform,
        driver=file.driver,
        driver_options=_driver_options(platform, file),
        labels=tuple(label for label, robots in file.labels.items() if robot in robots),
        parameters=file.parameters,
        roster=tuple(file.roster),
        state_dir=_path(layers, "state_dir", file.state_dir, config) or _state_dir(environ),
        plugin_dir=_path(layers, "plugin_dir", file.plugin_dir, config),
        die_with_parent=cast("int | None", parent),
        provenance=_provenance(layers),
    )


def _layers(config: Path | None, given: Mapping[str, Any], environ: Mapping[str, str]) -> Layered:
    sources: list[tuple[str, Mapping[str, Any]]] = [
        (_OPTIONS.get(key, f"--{key.replace('_', '-')}"), {key: value})
        for key, value in given.items()
    ]
    if config is not None:
        own = read(config)
        sources += [(shown(config), own), *_included(config, own)]
    if environ.get("SWARM"):
        sources.append(("$SWARM", {"swarm": environ["SWARM"]}))
    return Layered(*sources, (DEFAULT, {}))


def _included(config: Path, own: Data) -> list[tuple[str, Data]]:
    name = own.get("swarm_file")
    if not isinstance(name, str):
        return []
    path = config.parent / Path(name).expanduser()
    data = read(path)
    Layered((shown(path), data)).build(SwarmFile)
    return [(shown(path), data)]


def _check_names(layers: Layered, file: DaemonFile) -> None:
    _check_id(layers, ("swarm",), file.swarm, "swarm")
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
    for key, endpoints in (("listen", file.listen), ("seeds", file.seeds)):
        for index, endpoint in enumerate(endpoints):
            if not _ENDPOINT.fullmatch(endpoint):
                raise layers.error(
                    (key, index),
                    f"{key}[{index}] is {endpoint!r}; wanted an endpoint such as tcp/10.0.0.1:7447",
                )
    if file.profile == "field" and file.interface is None and not file.listen:
        raise layers.error(
            ("profile",),
            "profile field needs an interface, such as wlan0, or listen; give --interface",
        )


def _robot_id(layers: Layered, file: DaemonFile) -> str:
    if file.id is None:
        name = socket.gethostname().partition(".")[0].lower()
        return check_id(
            name, "the robot's id, taken from the host name as none was given with --id,"
        )
    _check_id(layers, ("id",), file.id, "id")
    return file.id


def _driver_options(platform: Platform, file: DaemonFile) -> Mapping[str, Value]:
    options = Layered(("", file.driver_options), ("", platform.drivers.get(file.driver, {})))
    return options.data


def _path(layers: Layered, key: str, value: str | None, config: Path | None) -> Path | None:
    """The path; one from the file is relative to the file, one from the command line to here."""
    if value is None:
        return None
    is_ours = config is not None and layers.source(key) == shown(config)
    return (config.parent if is_ours and config else Path()) / Path(value).expanduser()


def _state_dir(environ: Mapping[str, str]) -> Path:
    base = environ.get("XDG_STATE_HOME", "")
    if os.path.isabs(base):  # the XDG specification: relative ones are to be ignored
        return Path(base) / "swarmd"
    home = environ.get("HOME", "")
    if not os.path.isabs(home):
        raise ConfigError("state_dir: there is no $HOME to keep state in; give --state-dir")
    return Path(home) / ".local/state/swarmd"


def _provenance(layers: Layered) -> Mapping[str, str]:
    derived = {"id": "host name"}
    return {
        key: layers.source(key) or derived.get(key, DEFAULT)
        for key in DaemonFile.__struct_fields__
        if key != "swarm_file"
    }
