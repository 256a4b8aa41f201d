"""The settings of one daemon, read once from files, command line and environment.

Weakest to strongest: defaults, `$SWARM`, the file named by `swarm_file`, the daemon's own file,
the command line. `provenance` names the source of every key.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import msgspec
from msgspec import structs

from swarmd.core.errors import ConfigError
from swarmd.core.host_messages import Layers
from swarmd.core.keys import check_id
from swarmd.core.values import Platform, TouchZone, Value
from swarmd.kit.touch import granted_zones
from swarmd.kit.touch_config import TouchGrants
from swarmd.network.settings import NetworkSettings
from swarmd.protection.compatibility import Accepts
from swarmd.settings.layered import Layered
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.settings.swarmfile import (
    DEFAULT,
    DaemonFile,
    ParametersSection,
    RecordingSection,
    check,
    layered,
)
from swarmd.settings.yamlfile import shown

__all__ = ["DaemonSettings", "load_daemon_settings", "load_platform", "platform_names"]

_MAX_SOURCE_LENGTH = 64  # of a source in a status


@dataclass(frozen=True, slots=True, eq=False)
class DaemonSettings:
    """The checked settings of one daemon.

    `platform_name` is the configured name, or the absolute path of a file. `labels` are those of
    this robot, `label_members` the robots of every label. All daemons of a user share `state_dir`;
    `<state_dir>/<swarm>/<id>` belongs to this one. `recording` names its folder. `provenance`:
    key -> file, `--option`, `$VARIABLE`, `host name` or `default`.
    """

    id: str
    network: NetworkSettings
    platform: Platform
    platform_name: str
    driver: str
    driver_options: Mapping[str, Value]
    labels: tuple[str, ...]
    label_members: Mapping[str, tuple[str, ...]]
    parameters: ParametersSection
    touch: TouchGrants
    accepts: Accepts
    roster: tuple[str, ...]
    state_dir: Path
    plugin_dir: Path | None
    recording: RecordingSection
    die_with_parent: int | None = None
    provenance: Mapping[str, str] = field(default_factory=dict)

    @property
    def touch_zones(self) -> Mapping[str, TouchZone]:
        """The zones in which patterns may touch obstacles."""
        return granted_zones(self.touch)

    def pattern_layers(self, pattern: str) -> Layers:
        """The parameters configured for a pattern by source, weakest first; empty ones left out.

        Sources: `platform`, `label <name>` in the order of the file, `robot`.
        """
        labelled = self.parameters.labels
        layers = [("platform", self.platform.patterns.get(pattern, {}))]
        layers += [
            (f"label {name}"[:_MAX_SOURCE_LENGTH], labelled.get(name, {}).get(pattern, {}))
            for name in self.labels
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
    ConfigError names source, key, value, what was expected and the nearest valid key.
    """
    given = {key: value for key, value in overrides.items() if value is not None}
    parent = given.pop("die_with_parent", None)
    layers = layered(config, given, environ)
    file = layers.build(DaemonFile, check)
    near = config.parent if config is not None and "platform" not in given else Path()
    platform = load_platform(file.platform, near)
    robot = file.id or _host_id()
    state_dir = _path(layers, "state_dir", file.state_dir, config) or _state_dir(environ)
    recordings = _path(layers, "recording", file.recording.folder, config) or (
        state_dir / file.swarm / robot / "recordings"
    )
    options = _driver_options(platform, file)
    readings = options.get("readings")
    if isinstance(readings, dict):  # what a driver reads, patterns may need
        named = {f"reading:{name}" for name in readings}
        platform = replace(platform, provides=platform.provides | named)
    return DaemonSettings(
        id=robot,
        network=msgspec.convert(file, NetworkSettings, from_attributes=True),
        platform=platform,
        platform_name=_absolute(file.platform, near),
        driver=file.driver,
        driver_options=options,
        labels=tuple(label for label, robots in file.labels.items() if robot in robots),
        label_members={label: tuple(robots) for label, robots in file.labels.items()},
        parameters=file.parameters,
        touch=file.touch,
        accepts=Accepts.of(file.accepts_unseen, file.accepts_faster),
        roster=tuple(file.roster),
        state_dir=state_dir,
        plugin_dir=_path(layers, "plugin_dir", file.plugin_dir, config),
        recording=structs.replace(file.recording, folder=str(recordings.absolute())),
        die_with_parent=cast("int | None", parent),
        provenance=_provenance(layers, file, platform),
    )


def _host_id() -> str:
    name = socket.gethostname().partition(".")[0].lower()
    return check_id(name, "the robot's id, taken from the host name as none was given with --id,")


def _absolute(platform: str, near: Path) -> str:
    is_file = platform.endswith(".yaml")
    return str((near / Path(platform).expanduser()).absolute()) if is_file else platform


def _driver_options(platform: Platform, file: DaemonFile) -> Mapping[str, Value]:
    options = Layered(("", file.driver_options), ("", platform.drivers.get(file.driver, {})))
    return options.data


def _path(layers: Layered, key: str, value: str | None, config: Path | None) -> Path | None:
    """The path; relative to the file that holds it, or to the working directory."""
    if value is None:
        return None
    is_ours = config is not None and layers.source(key) == shown(config)
    return (config.parent if is_ours and config else Path()) / Path(value).expanduser()


def _state_dir(environ: Mapping[str, str]) -> Path:
    base = environ.get("XDG_STATE_HOME", "")
    if os.path.isabs(base):  # the XDG specification: relative paths are ignored
        return Path(base) / "swarmd"
    home = environ.get("HOME", "")
    if not os.path.isabs(home):
        raise ConfigError("state_dir: there is no $HOME to keep state in; give --state-dir")
    return Path(home) / ".local/state/swarmd"


def _provenance(layers: Layered, file: DaemonFile, platform: Platform) -> Mapping[str, str]:
    derived = {"id": "host name"}
    found = {
        key: layers.source(key) or derived.get(key, DEFAULT)
        for key in DaemonFile.__struct_fields__
        if key != "swarm_file"
    }
    if platform.drivers.get(file.driver):
        given = [found["driver_options"]] if file.driver_options else []
        found["driver_options"] = ", ".join([*given, f"platform {platform.name}"])
    return found
