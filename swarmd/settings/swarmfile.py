"""The schemas of swarm.yaml and of a daemon's own file, and their checks.

This module imports no numpy: swarmctl reads swarm.yaml, too, for the network settings of the swarm.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from msgspec import Meta, Struct, defstruct, field
from msgspec.structs import fields

from swarmd.core.bounds import BoundedScalar, Name, ParamValues, Word
from swarmd.core.errors import ConfigError, unknown
from swarmd.core.files import user_path
from swarmd.core.goal import Validity
from swarmd.core.keys import check_id
from swarmd.core.names import expand_globs, expand_names
from swarmd.core.record import LABEL, Target
from swarmd.kit.conditions import parse_conditions
from swarmd.link.keys.identity import Identity, choose_identity
from swarmd.link.members.neighbor_settings import NeighborSettings
from swarmd.link.settings import NetworkSettings
from swarmd.settings.file_limits import FileLimits
from swarmd.settings.layered import Fault, Keys, Layered, dotted, fault_at
from swarmd.settings.robot_settings import Parameters, RobotSettings
from swarmd.settings.yamlfile import Data, read, shown

DEFAULT = "default"
_Flat = BoundedScalar | list[BoundedScalar]
_Inner = dict[str, _Flat | dict[str, _Flat | dict[str, BoundedScalar]]]
Option = _Flat | dict[str, _Flat | _Inner] | None
Options = dict[str, Option]

# Command-line options that are not named like their key.
_OPTIONS = {"driver_options": "--driver-option", "seeds": "--seed"}


class ParametersSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pattern parameters by label and by robot, above those of the platform.

    - `labels`: by label and pattern; each applies to robots with the label.
    - `robots`: by robot and pattern, above those of its labels.
    """

    labels: dict[str, Parameters] = {}
    robots: dict[str, Parameters] = {}


class GoalSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The goal of a swarm: the pattern that robots run.

    - `pattern`: the name of the pattern; null: robots stand.
    - `params`: parameters of the pattern.
    - `targets`: names, ranges, globs and labels (`label:red`) of robots; empty: all robots.
    - `seconds`, `until`: the run ends after this time, or with the first condition that is met.
    - `on_join`: for robots that join later. `offer`: such a robot waits for `swarmctl resume`.
      `run`: such a robot runs the pattern while the goal is younger than `valid` seconds.
    - `valid`: s within which a joining robot runs the goal; required with `on_join: run`.
    """

    pattern: Name | None = None
    params: ParamValues = {}
    targets: list[Target] = []
    seconds: Annotated[float, Meta(gt=0.0, le=1e7)] | None = None
    until: list[Word] = []
    on_join: Literal["offer", "run"] = "offer"
    valid: Validity | None = None

    @property
    def content(self) -> dict[str, Any]:
        """The fields of the `Goal` for this section."""
        return {
            "pattern": self.pattern,
            "params": self.params,
            "targets": tuple(name for word in self.targets for name in _targets(word)),
            "seconds": self.seconds,
            "conditions": tuple(self.until),
            "on_join": self.on_join,
            "valid": self.valid,
        }


if TYPE_CHECKING:

    class _SharedKeys(NetworkSettings, RobotSettings, frozen=True, kw_only=True):
        """The keys of both."""
else:
    # msgspec permits no two bases with fields: the second has them copied.
    _SharedKeys = defstruct(
        "_SharedKeys",
        [
            (one.name, one.type, field(default=one.default, default_factory=one.default_factory))
            for one in fields(RobotSettings)
        ],
        bases=(NetworkSettings,),
        module=__name__,
        frozen=True,
        kw_only=True,
    )


class SwarmFile(_SharedKeys, Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys of swarm.yaml, which the robots of one swarm share.

    The keys are those of the network (`NetworkSettings`), those of each robot (`RobotSettings`),
    and:

    - `identity`: the folder of the identity; by default the folder of the user, or of the machine,
      for this swarm.
    - `insecure`: no keys, so that anyone on the network can drive the robots.
    - `roster`: ids of all robots, also ranges such as `tb3-[01-07]`. With a roster an unknown id in
      this file is an error, and missing robots are reported.
    - `labels`: names for groups of robots (ids and ranges), as targets and for `parameters`.
    - `goal`: what `swarmctl apply` lets robots run. Daemons ignore this key.
    - `parameters`: parameters of patterns by label and by robot, above those of the platform.
    - `neighbors`: which robots are neighbors. A pattern hears the messages of neighbors alone.
    """

    identity: str | None = None
    insecure: bool = False
    roster: list[str] = []
    labels: dict[str, list[str]] = {}
    goal: GoalSection | None = None
    parameters: ParametersSection = ParametersSection()
    neighbors: NeighborSettings = NeighborSettings()

    @property
    def robots(self) -> tuple[str, ...]:
        """The ids of the roster, without ranges."""
        return tuple(name for word in self.roster for name in expand_names(word))

    @property
    def members(self) -> dict[str, tuple[str, ...]]:
        """The ids of the robots of each label."""
        return {
            label: tuple(dict.fromkeys(name for word in words for name in expand_names(word)))
            for label, words in self.labels.items()
        }


class RecordingSection(FileLimits, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a robot records, beside the limits of its files.

    - `from_start`: recording begins when the daemon starts, without `swarmctl record start`.
    - `folder`: of the recordings; by default `recordings` beside the robot's state.
    """

    from_start: bool = False
    folder: str | None = None


class BlackboxSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The black box: what a robot keeps for the recording of an incident.

    - `seconds`: how much it keeps in RAM, from 10 to 600 s; 0 turns it off. 60 s take 4 MB.
    - `folder`: of its file, on a file system in RAM; by default the `RuntimeDirectory` of the
      service, else `/dev/shm/swarmd-<uid>`. A file on a disk would be written to the disk all the
      time.
    """

    seconds: Annotated[float, Meta(ge=0.0, le=600.0)] = 60.0
    folder: str | None = None


class DaemonFile(SwarmFile, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys of the file of one daemon: the keys of swarm.yaml, and further keys.

    - `swarm_file`: the swarm.yaml to include; keys of this file replace keys of swarm.yaml.
    - `id`: this robot's id; by default the host name. A daemon does not start while another daemon
      has the same id.
    - `platform`: the kind of robot: a name, or a path that ends in .yaml.
    - `driver`, `driver_options`: the connection to its base.
    - `state_dir`: folder for files that must survive a restart, such as the latch of an emergency
      stop. If it is a memory disk, a reboot clears the emergency stop.
    - `plugin_dir`: folder of patterns and missions of your own.
    - `recording`: whether the robot records from the start, to which folder, and how much.
    - `blackbox`: how many seconds the robot keeps for incidents.
    """

    swarm_file: str | None = None
    id: str | None = None
    platform: str = "waffle_pi"
    driver: str = "simulated"
    driver_options: Options = {}
    state_dir: str | None = None
    plugin_dir: str | None = None
    recording: RecordingSection = RecordingSection()
    blackbox: BlackboxSection = BlackboxSection()


def load_swarm(
    config: Path | None, overrides: Mapping[str, object], environ: Mapping[str, str]
) -> tuple[SwarmFile, Identity | None]:
    """The swarm's settings and identity for an operator, from swarm.yaml or a daemon's own file."""
    layers = layered(config, overrides, environ)
    file = layers.build(DaemonFile, check)
    return file, identity_of(layers, file, config, environ)


def identity_of(
    layers: Layered, file: SwarmFile, config: Path | None, environ: Mapping[str, str]
) -> Identity | None:
    """The identity that the settings name, else the installed identity for the swarm, or None."""
    folder = path_of(layers, "identity", file.identity, config)
    return choose_identity(file.swarm, folder, insecure=file.insecure, environ=environ)


def path_of(layers: Layered, key: str, value: str | None, config: Path | None) -> Path | None:
    """The path of a key's value: relative to the file with this key, else to the current folder."""
    if value is None:
        return None
    is_ours = config is not None and layers.source(key) == shown(config)
    return (config.parent if is_ours and config else Path()) / user_path(value)


def layered(
    config: Path | None, overrides: Mapping[str, object], environ: Mapping[str, str]
) -> Layered:
    """All sources, strongest first: overrides, the file, its included file, `$SWARM`, defaults."""
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
    """Faults of a DaemonFile: names that no Zenoh key may have, and wrong network settings."""
    if isinstance(file, DaemonFile):
        yield from file.faults()
        yield from _check_names(file)
        for key, text in file.neighbors.faults():
            yield fault_at(("neighbors", key), text)
        for keys, text in RobotSettings.of(file).faults():
            yield fault_at(keys, text)
        if 0.0 < file.blackbox.seconds < 10.0:
            text = f"is {file.blackbox.seconds:g}; expected 10 to 600 s, or 0 for no black box"
            yield fault_at(("blackbox", "seconds"), text)
        if file.recording.keep_bytes < 2 * file.recording.file_bytes:
            text = f"is {file.recording.keep_bytes}; expected at least two files of file_bytes"
            yield fault_at(("recording", "keep_bytes"), text)


def _included(config: Path, own: Data) -> list[tuple[str, Data]]:
    name = own.get("swarm_file")
    if not isinstance(name, str):
        return []
    path = config.parent / user_path(name)
    data = read(path)
    Layered((shown(path), data)).build(SwarmFile)
    return [(shown(path), data)]


def _check_names(file: DaemonFile) -> Iterator[Fault]:
    """Yield the faults of robot names and labels: invalid, twice, or not on the roster.

    The words of roster and labels may stand for several robots, such as `tb3-[01-07]`.
    """
    if file.id is not None:
        yield from _check_id(("id",), file.id)
    roster: list[str] = []
    for index, names_text in enumerate(file.roster):
        names, faults = _expanded(("roster", index), names_text)
        yield from faults
        for name in names:
            if name in roster:
                yield ("roster", index), f"roster names {name!r} twice; keep one"
        roster += names
    for label in file.labels:
        yield from _check_label(file, label, roster)
    if file.goal is not None:
        yield from _check_goal(file.goal)
    for label in file.parameters.labels:
        if label not in file.labels:
            text = f"names {unknown('label', label, file.labels)}"
            yield fault_at(("parameters", "labels", label), text)
    for name in file.parameters.robots:
        yield from _check_robot(("parameters", "robots", name), name, roster)


def _check_label(file: DaemonFile, label: str, roster: list[str]) -> Iterator[Fault]:
    """Yield the faults of a label and its robots; `roster`: all ids, without ranges."""
    keys = ("labels", label)
    robots = file.labels[label]
    yield from _check_id(keys, label)
    if label in roster or label == file.id:
        text = "is the name of a robot; expected the label, and its robots in the list:"
        example = f"{robots[0]}: [{label}]" if robots else f"red: [{label}]"
        yield fault_at(keys, f"{text} {example}")
        return
    for names_text in robots:
        names, faults = _expanded(keys, names_text)
        yield from faults
        for name in names:
            yield from _check_robot(keys, name, roster)


def _check_goal(goal: GoalSection) -> Iterator[Fault]:
    if goal.pattern is not None:
        yield from _check_id(("goal", "pattern"), goal.pattern)
    if goal.until:
        try:
            parse_conditions(goal.until)
        except ConfigError as error:
            yield ("goal", "until"), str(error)
    if (goal.on_join == "run") != (goal.valid is not None):
        yield fault_at(("goal",), "has one of `on_join: run` and `valid`; expected both or neither")
    for index, target in enumerate(goal.targets):
        try:
            _targets(target)
        except ConfigError as error:
            text = f"is {target!r}; expected robots, a glob such as tb3-*, or label:red: {error}"
            yield fault_at(("goal", "targets", index), text)


def _targets(word: str) -> tuple[str, ...]:
    """The targets of a goal that `word` names. ConfigError for an invalid name or label."""
    label = word.removeprefix(LABEL)
    return (LABEL + check_id(label, "the label"),) if label != word else expand_globs(word)


def _expanded(keys: Keys, word: str) -> tuple[tuple[str, ...], list[Fault]]:
    """The names that a word of the roster or of a label stands for, and the faults of the word."""
    try:
        return expand_names(word), []
    except ConfigError as error:
        return (), [fault_at(keys, f"is {word!r}; expected robots such as tb3-[01-07]: {error}")]


def _check_robot(keys: Keys, name: str, roster: list[str]) -> Iterator[Fault]:
    yield from _check_id(keys, name)
    if roster and name not in roster:
        yield fault_at(keys, f"names {unknown('robot in the roster', name, roster)}")


def _check_id(keys: Keys, value: str) -> Iterator[Fault]:
    try:
        check_id(value, dotted(keys))
    except ConfigError as error:
        yield keys, str(error)
