"""The schemas of swarm.yaml and of a daemon's own file, and their checks.

Imports no numpy: swarmctl reads swarm.yaml too, for the network settings of the swarm.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.keys import check_id
from swarmd.core.messages import BoundedScalar
from swarmd.kit.touch_config import TouchGrants
from swarmd.network.settings import NetworkSettings
from swarmd.recording.limits import FileLimits
from swarmd.settings.layered import Fault, Keys, Layered, dotted, fault_at
from swarmd.settings.yamlfile import Data, read, shown

DEFAULT = "default"
_LIMITS = FileLimits()
PlatformName = Annotated[str, Meta(min_length=1, max_length=63)]
PlatformGrants = list[PlatformName] | dict[PlatformName, Annotated[str, Meta(max_length=256)]]
"""Platforms that are accepted, perhaps each with the reason."""
Parameters = dict[str, dict[str, BoundedScalar | None]]
Option = (
    BoundedScalar
    | list[BoundedScalar]
    | dict[str, BoundedScalar | list[BoundedScalar] | dict[str, BoundedScalar]]
    | None
)
Options = dict[str, Option]

# Command-line options that are not named like their key.
_OPTIONS = {"driver_options": "--driver-option", "seeds": "--seed"}


class ParametersSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pattern parameters by label and by robot, above those of the platform."""

    labels: dict[str, Parameters] = {}
    robots: dict[str, Parameters] = {}


class SwarmFile(NetworkSettings, Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys of swarm.yaml, which the robots of one swarm share, beside those of the network.

    - `roster`: ids of all robots; then an unknown id in this file is an error, and missing robots
      are reported.
    - `labels`: names for groups of robots, as targets and for `parameters`.
    - `touch`: the zones in which patterns may touch obstacles.
    - `accepts_unseen`, `accepts_faster`: platforms of which robots may drive beside a robot that
      does not see them, or that assumes less than their speed; a list, or reasons by platform.
      Such a robot may be driven into.
    """

    roster: list[str] = []
    labels: dict[str, list[str]] = {}
    parameters: ParametersSection = ParametersSection()
    touch: TouchGrants = {}
    accepts_unseen: PlatformGrants = []
    accepts_faster: PlatformGrants = []


class RecordingSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a robot records.

    - `from_start`: record as soon as the daemon starts, without `swarmctl record start`.
    - `folder`: where to, by default `recordings` beside the robot's state.
    - `keep_bytes`: of all recordings of this robot; the oldest are removed beyond it.
    - `file_bytes`, `file_seconds`: a new file begins after that size or time.
    """

    from_start: bool = False
    folder: str | None = None
    keep_bytes: Annotated[int, Meta(ge=2**20)] = _LIMITS.keep_bytes
    file_bytes: Annotated[int, Meta(ge=2**16)] = _LIMITS.file_bytes
    file_seconds: Annotated[float, Meta(ge=1.0, le=86400.0)] = _LIMITS.file_seconds

    @property
    def limits(self) -> FileLimits:
        """The limits of its files."""
        return FileLimits(self.file_bytes, self.file_seconds, self.keep_bytes)


class DaemonFile(SwarmFile, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys of the file of one daemon: those of swarm.yaml and its own.

    - `swarm_file`: the swarm.yaml to include; keys of this file override it.
    - `id`: this robot's id, default the host name. Two daemons of one id refuse each other.
    - `platform`, `driver`, `driver_options`: the robot and the connection to its base.
    - `state_dir`: folder for what survives a restart, such as the estop latch; on a memory disk a
      reboot clears a latched estop.
    - `plugin_dir`: folder of patterns and missions of your own.
    - `recording`: whether the robot records from the start, where to and how much.
    """

    swarm_file: str | None = None
    id: str | None = None
    platform: str = "waffle_pi"
    driver: str = "simulated"
    driver_options: Options = {}
    state_dir: str | None = None
    plugin_dir: str | None = None
    recording: RecordingSection = RecordingSection()


def load_swarm(
    config: Path | None, overrides: Mapping[str, object], environ: Mapping[str, str]
) -> SwarmFile:
    """The swarm's settings for an operator, from swarm.yaml or a daemon's own file."""
    return layered(config, overrides, environ).build(DaemonFile, check)


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


def check(file: Any, _: Keys) -> Iterator[Fault]:
    """Faults of a DaemonFile: names that no key may hold, and impossible network settings."""
    if isinstance(file, DaemonFile):
        yield from file.faults()
        yield from _check_names(file)
        if file.recording.keep_bytes < 2 * file.recording.file_bytes:
            text = f"is {file.recording.keep_bytes}; expected at least two files of file_bytes"
            yield fault_at(("recording", "keep_bytes"), text)


def _included(config: Path, own: Data) -> list[tuple[str, Data]]:
    name = own.get("swarm_file")
    if not isinstance(name, str):
        return []
    path = config.parent / Path(name).expanduser()
    data = read(path)
    Layered((shown(path), data)).build(SwarmFile)
    return [(shown(path), data)]


def _check_names(file: DaemonFile) -> Iterator[Fault]:
    if file.id is not None:
        yield from _check_id(("id",), file.id)
    for index, name in enumerate(file.roster):
        yield from _check_id(("roster", index), name)
        if name in file.roster[:index]:
            yield ("roster", index), f"roster names {name!r} twice; keep one"
    for label, robots in file.labels.items():
        yield from _check_id(("labels", label), label)
        for name in robots:
            yield from _check_robot(("labels", label), name, file.roster)
    for label in file.parameters.labels:
        if label not in file.labels:
            text = f"names {unknown('label', label, file.labels)}"
            yield fault_at(("parameters", "labels", label), text)
    for name in file.parameters.robots:
        yield from _check_robot(("parameters", "robots", name), name, file.roster)


def _check_robot(keys: Keys, name: str, roster: list[str]) -> Iterator[Fault]:
    yield from _check_id(keys, name)
    if roster and name not in roster:
        yield fault_at(keys, f"names {unknown('robot in the roster', name, roster)}")


def _check_id(keys: Keys, value: str) -> Iterator[Fault]:
    try:
        check_id(value, dotted(keys))
    except ConfigError as error:
        yield keys, str(error)
