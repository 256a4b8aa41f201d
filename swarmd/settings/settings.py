"""The settings of one daemon, read once from files, command line and environment.

The sources, from weakest to strongest: defaults, `$SWARM`, the file named by `swarm_file`, the
daemon's own file, the command line. `provenance` names the source of every key.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import msgspec
from msgspec import structs

from swarmd.core.errors import ConfigError
from swarmd.core.files import user_path
from swarmd.core.keys import check_id
from swarmd.core.values import (
    KIN,
    OPTION_INPUTS,
    PLACES_BY_POSE,
    PLACES_BY_SIGHT,
    POSE_OPTIONS,
    Platform,
    Value,
    sensor_names,
)
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.roster import Role
from swarmd.link.keys.roster_change import is_revoked
from swarmd.link.settings import NetworkSettings
from swarmd.settings import swarmfile
from swarmd.settings.layered import Layered, fault_at
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.settings.robot_settings import Parameters, PatternParameters, RobotSettings

__all__ = ["DaemonSettings", "load_daemon_settings", "load_platform", "platform_names"]


@dataclass(frozen=True, slots=True, eq=False)
class DaemonSettings:
    """The checked settings of one daemon.

    - `file`: all keys as given. Fields here have the values that follow from keys.
    - `robot`: the keys that each robot has; the robot and its recordings carry them whole.
    - `platform_name`: the configured name, or the absolute path of a file.
    - `labels`: the labels of this robot.
    - `parameters`: of this robot's patterns.
    - `state_dir`: shared by all daemons of a user; `<state_dir>/<swarm>/<id>` belongs to this
      daemon.
    - `blackbox`: how many seconds the robot keeps for incidents.
    - `recording`: how the robot records; `folder` is an absolute path.
    - `identity`: the swarm is secured if set.
    - `provenance`: the source of each key: file, `--option`, `$VARIABLE`, `host name`, `identity`
      or `default`.
    """

    id: str
    file: swarmfile.DaemonFile
    robot: RobotSettings
    network: NetworkSettings
    platform: Platform
    platform_name: str
    driver_options: Mapping[str, Value]
    labels: tuple[str, ...]
    parameters: PatternParameters
    roster: tuple[str, ...]
    state_dir: Path
    plugin_dir: Path | None
    recording: swarmfile.RecordingSection
    blackbox: swarmfile.BlackboxSection
    identity: Identity | None = None
    die_with_parent: int | None = None
    provenance: Mapping[str, str] = field(default_factory=dict)


def load_daemon_settings(
    config: Path | None, overrides: Mapping[str, object], environ: Mapping[str, str] = os.environ
) -> DaemonSettings:
    """The settings of a daemon, from overrides, a file and the environment, strongest first.

    `config`: the file; None: no file. `overrides`: options of the command line, with the keys of
    `DaemonFile` and `die_with_parent`; None means not given. Raises ConfigError, which names
    source, key, value, what was expected and the nearest valid key.
    """
    given = {key: value for key, value in overrides.items() if value is not None}
    parent = given.pop("die_with_parent", None)
    layers = swarmfile.layered(config, given, environ)
    file = layers.build(swarmfile.DaemonFile, swarmfile.check)
    # A platform's path in the file is relative to the file's folder, a path in an option to the
    # working folder.
    is_platform_option = "platform" in given
    folder = Path() if config is None or is_platform_option else config.parent
    platform = load_platform(file.platform, folder)
    identity = swarmfile.identity_of(layers, file, config, environ)
    robot = file.id or (_host_id() if identity is None else identity.name)
    _check_identity(robot, identity, file)
    robot_settings = RobotSettings.of(file)
    for fault in robot_settings.misfits(platform):
        raise layers.error(*fault_at(*fault))
    configured_state_dir = swarmfile.path_of(layers, "state_dir", file.state_dir, config)
    state_dir = configured_state_dir or state_folder(environ)
    configured_recordings = swarmfile.path_of(layers, "recording", file.recording.folder, config)
    recordings = configured_recordings or state_dir / file.swarm / robot / "recordings"
    options = _driver_options(platform, file)
    platform = with_options(platform, options)
    return DaemonSettings(
        id=robot,
        file=file,
        robot=robot_settings,
        # The file has all fields of NetworkSettings, with the same names.
        network=msgspec.convert(file, NetworkSettings, from_attributes=True),
        platform=platform,
        platform_name=_absolute(file.platform, folder),
        driver_options=options,
        labels=tuple(label for label, robots in file.members.items() if robot in robots),
        parameters=PatternParameters(
            base=(("platform", cast("Parameters", platform.patterns)),),
            labels=file.parameters.labels,
            own=file.parameters.robots.get(robot, {}),
        ),
        roster=file.robots if identity is None else identity.roster.robots,
        state_dir=state_dir,
        plugin_dir=swarmfile.path_of(layers, "plugin_dir", file.plugin_dir, config),
        blackbox=file.blackbox,
        recording=structs.replace(file.recording, folder=str(recordings.absolute())),
        identity=identity,
        die_with_parent=cast("int | None", parent),
        provenance=_provenance(layers, file, platform, identity),
    )


def _check_identity(robot: str, identity: Identity | None, file: swarmfile.DaemonFile) -> None:
    """ConfigError if the identity belongs to another robot, or a required identity is missing."""
    if identity is None:
        if file.profile != "dev" and not file.insecure:
            raise ConfigError(
                f"profile {file.profile} needs an identity of swarm {file.swarm!r}: make keys with"
                " `swarmctl keys init` and install the bundle of this robot with `swarmd install`,"
                " or let anyone on the network drive it with --insecure (insecure: true)"
            )
    elif identity.role is not Role.ROBOT:
        raise ConfigError(
            f"identity {identity.folder} is of the {identity.role} {identity.name}; a daemon needs"
            " that of a robot (--identity), or --insecure"
        )
    elif is_revoked(identity):
        raise ConfigError(
            f"{identity.name} is no longer on the roster of swarm {identity.info.swarm} (generation"
            f" {identity.roster.generation}); install a bundle of another name with --force"
        )
    elif identity.name != robot:
        raise ConfigError(
            f"identity {identity.folder} is of robot {identity.name!r}, and the id is {robot!r};"
            f" leave the id out, or give the identity of {robot}"
        )


def _host_id() -> str:
    name = socket.gethostname().partition(".")[0].lower()
    return check_id(name, "the robot's id, taken from the host name as none was given with --id,")


def _absolute(platform: str, near: Path) -> str:
    is_file = platform.endswith(".yaml")
    return str((near / user_path(platform)).absolute()) if is_file else platform


def _driver_options(platform: Platform, file: swarmfile.DaemonFile) -> Mapping[str, Value]:
    options = Layered(("", file.driver_options), ("", platform.drivers.get(file.driver, {})))
    return options.data


def with_options(platform: Platform, options: Mapping[str, Value]) -> Platform:
    """The platform with all inputs that a robot whose driver has these options gives to patterns.

    With a pose in a shared frame the robot computes the places of its peers. Cameras that give the
    places of robots replace kin.
    """
    inputs = _inputs_of(options)
    own = platform.provides
    if KIN in own and inputs >= PLACES_BY_SIGHT:
        own -= PLACES_BY_POSE | {KIN}
    provides = own | inputs
    return replace(
        platform, provides=provides | ({*PLACES_BY_POSE} if "pose" in provides else set())
    )


def _inputs_of(options: Mapping[str, Value]) -> set[str]:
    """The inputs for patterns that a driver with these options adds to those of the platform.

    An entry of `readings` with a list of topics, or with a `count`, gives several sensors.
    """
    inputs = {name for name in OPTION_INPUTS if options.get(name)}
    if any(map(options.get, POSE_OPTIONS)):
        inputs.add("pose")
    if any(
        camera.get("robots") and ("size" in camera or "Detection3D" in str(camera.get("type")))
        for _, camera in _entries_of(options, "detections")
    ):
        inputs |= PLACES_BY_SIGHT
    for name, reading in _entries_of(options, "readings"):
        topic = reading.get("topic")
        count = reading.get("count")
        sensors = len(topic) if isinstance(topic, list) else 0
        if isinstance(count, int):
            sensors = count * max(sensors, 1)
        inputs |= {f"reading:{sensor}" for sensor in sensor_names(name, sensors)}
    return inputs


def _entries_of(options: Mapping[str, Value], option: str) -> Iterator[tuple[str, dict[str, Any]]]:
    entries = options.get(option)
    for name, entry in entries.items() if isinstance(entries, dict) else ():
        yield name, entry if isinstance(entry, dict) else {}


def state_folder(environ: Mapping[str, str]) -> Path:
    """The folder for state files of a daemon or user; ConfigError without a home."""
    service = environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if os.path.isabs(service):  # set by systemd
        return Path(service)
    base = environ.get("XDG_STATE_HOME", "")
    if os.path.isabs(base):  # the XDG specification: relative paths are ignored
        return Path(base) / "swarmd"
    home = environ.get("HOME", "")
    if not os.path.isabs(home):
        raise ConfigError("state_dir: there is no $HOME to keep state in; give --state-dir")
    return Path(home) / ".local/state/swarmd"


def _provenance(
    layers: Layered, file: swarmfile.DaemonFile, platform: Platform, identity: Identity | None
) -> Mapping[str, str]:
    derived = {"id": "host name" if identity is None else "identity"}
    if identity is not None and file.identity is None:
        derived["identity"] = "found for the swarm"
    sources = {
        key: layers.source(key) or derived.get(key, swarmfile.DEFAULT)
        for key in swarmfile.DaemonFile.__struct_fields__
        if key != "swarm_file"
    }
    if platform.drivers.get(file.driver):
        given = [sources["driver_options"]] if file.driver_options else []
        sources["driver_options"] = ", ".join([*given, f"platform {platform.name}"])
    return sources
