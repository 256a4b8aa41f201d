"""The launch file: which nodes run on a robot, with which parameters, and what its topics are."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import msgspec
from msgspec import Meta, Struct

from swarmd.core.errors import ConfigError
from swarmd.ros2_nodes.node_files import NodeFiles
from swarmd.ros2_nodes.refusal import one_line
from swarmd.settings import layered, yamlfile

ROBOT = "{robot}"
"""Stands for the robot's id in namespaces, topics and parameters; `_` in place of `-`."""
NUMBER = "{number}"
"""Stands for the digits at the end of the robot's id, without zeros before them; 0 without."""
PLATFORM = "{platform}"
"""Stands for the name of the robot's platform."""
MAX_NODES = 32
_HEAD = re.compile(rb"^nodes[ \t]*:", re.MULTILINE)

Values: TypeAlias = dict[str, Any]
Words: TypeAlias = Annotated[str, Meta(min_length=1, max_length=256)]


class NodeEntry(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One node, or one script with a `main()`.

    `run`: `module:Class`, `module:function`, or the file of a script. `parameters`: files as ROS
    writes them, and mappings of values; later ones count. `name` and `namespace` replace those of
    the node.
    """

    run: Words
    name: str = ""
    namespace: str = ""
    parameters: list[str | Values] | str | Values = []
    remap: dict[str, str] = {}


class ScanTopic(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How scans are published. `angle_min_deg`: of the first ray, by default the platform's.

    `no_return`: the range of a ray that meets nothing, by default infinity (REP 117).
    """

    topic: Words = "scan"
    angle_min_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] | None = None
    no_return: Annotated[float, Meta(ge=0.0)] | None = None
    frame: str = "base_scan"


class Topics(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the topics are; an empty name: none.

    - `command`: `geometry_msgs/Twist` or `TwistStamped`, as the publisher has it.
    - `hold`: s for which a command counts after it was published; 0 for ever.
    - `pose`: `PoseStamped` of the robot in the frame that robots share.
    - `neighbors`: `PoseArray` of the sensed robots in the base frame, in the order of their ids.
    - `readings`: by the name of a reading, the topic of its message.
    """

    scan: ScanTopic | str = "scan"
    odometry: str = "odom"
    tf: str = "/tf"
    command: Words = "cmd_vel"
    hold: Annotated[float, Meta(ge=0.0, le=3600.0)] = 1.0
    pose: str = ""
    neighbors: str = ""
    readings: dict[str, str] = {}


class Publication(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A message that is published once, before the first step."""

    topic: Words
    type: Words
    values: Values = {}


class LaunchFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The contents of a launch file.

    - `path`: folders of modules, from the folder of the launch file.
    - `shared`: topics whose messages go to the other robots, too.
    - `start`: messages that are published once.
    - `one_element_arrays`: `float`, `int` and the functions of `math` take arrays of one element in
      the nodes' modules, as with numpy before 2.4.
    - `rate`: steps a second, at which timers and commands are looked at.
    """

    nodes: Annotated[list[NodeEntry], Meta(min_length=1, max_length=MAX_NODES)]
    path: list[str] = msgspec.field(default_factory=lambda: ["."])
    namespace: str = f"/{ROBOT}"
    topics: Topics = Topics()
    shared: Annotated[list[str], Meta(max_length=16)] = []
    start: Annotated[list[Publication], Meta(max_length=64)] = []
    one_element_arrays: bool = False
    rate: Annotated[float, Meta(ge=1.0, le=50.0)] = 10.0
    log_level: Annotated[str, Meta(pattern="^(debug|info|warn|error|fatal)$")] = "info"


def is_launch_text(text: bytes) -> bool:
    """Whether a YAML file is a launch file: a line begins with `nodes:`."""
    return _HEAD.search(text) is not None


def read_launch_file(path: Path) -> tuple[LaunchFile, NodeFiles]:
    """The launch file at `path`, and the files from its folder on.

    ConfigError in one line for a file that cannot be read, or with a wrong key or value.
    """
    files = NodeFiles(path.parent)
    text = files.read(files.path(path.name))
    name = one_line(path.name)
    data = yamlfile.parsed(text, name)
    launch, faults = layered.read(data, LaunchFile, _texts_fault)
    if faults:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        raise ConfigError(f"{name}: {faults[0][1]}{more}")
    if not is_launch_text(text):  # else an experiment would not compare it as code
        raise ConfigError(f"{name}: expected a line that begins with `nodes:`")
    assert isinstance(launch, LaunchFile)
    return launch, files


def _texts_fault(struct: Any, keys: layered.Keys) -> Iterator[layered.Fault]:
    """The names in a struct that are no line; values of parameters and messages may be any text."""
    for name in struct.__struct_fields__:
        if name != "values":
            yield from _names_fault(getattr(struct, name), (*keys, name))


def _names_fault(value: Any, keys: layered.Keys) -> Iterator[layered.Fault]:
    if isinstance(value, str) and not value.isprintable():
        yield layered.fault_at(
            keys, f"is {yamlfile.brief(value)}; expected a name of printable characters in one line"
        )
    elif isinstance(value, list):
        for place, one in enumerate(value):
            if not isinstance(one, Mapping):
                yield from _names_fault(one, (*keys, place))
    elif isinstance(value, Mapping) and keys[-1] != "parameters":
        for key, one in value.items():
            yield from _names_fault(key, (*keys, key))
            yield from _names_fault(one, (*keys, key))


def scan_topic(topics: Topics) -> ScanTopic:
    """How scans are published, also where the launch file has the name of the topic alone."""
    scan = topics.scan
    return ScanTopic(topic=scan or "scan") if isinstance(scan, str) else scan


def no_return(scan: ScanTopic) -> float:
    """The range in m of a ray that meets nothing."""
    return math.inf if scan.no_return is None else scan.no_return


class Names:
    """Replaces the words in braces by those of one robot."""

    def __init__(self, robot: str, platform: str) -> None:
        digits = re.search(r"\d*$", robot)
        number = int(digits[0]) if digits is not None and digits[0] else 0
        self._words = {ROBOT: robot.replace("-", "_"), NUMBER: str(number), PLATFORM: platform}

    def __call__(self, text: str) -> str:
        """The text with the robot's own words."""
        for word, value in self._words.items():
            text = text.replace(word, value)
        return text

    def of_values(self, values: Any) -> Any:
        """The same for all texts in a value of YAML."""
        if isinstance(values, str):
            return self(values)
        if isinstance(values, list):
            return [self.of_values(value) for value in values]
        if isinstance(values, Mapping):
            return {name: self.of_values(value) for name, value in values.items()}
        return values


def parameters_of(
    entry: NodeEntry, files: NodeFiles, names: Names
) -> list[tuple[str, dict[str, Any]]]:
    """The parameters of an entry, weakest first: the pattern of a node's name, and its values.

    The pattern is as in a file of ROS, such as `/**` or `/tb3_01/follower`. ConfigError for a file
    that cannot be read, or is none of ROS.
    """
    given = entry.parameters
    found: list[tuple[str, dict[str, Any]]] = []
    for one in given if isinstance(given, list) else [given]:
        if isinstance(one, str):
            path = files.path(names(one))
            found += _of_file(names.of_values(yamlfile.parsed(files.read(path), path.name)), path)
        else:
            found.append(("/**", _flat(names.of_values(one))))
    return found


_PARAMETERS = "ros__parameters"


def _of_file(data: Mapping[str, Any], path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    found = list(_nodes_in(data, ""))
    if not found:
        raise ConfigError(
            f"{path.name}: no `{_PARAMETERS}`; expected a parameter file of ROS 2, such as"
            " `/**: {ros__parameters: {speed: 0.1}}`"
        )
    yield from found


def _nodes_in(data: Mapping[str, Any], above: str) -> Iterator[tuple[str, dict[str, Any]]]:
    for name, content in data.items():
        if not isinstance(content, Mapping):
            continue
        full = f"{above}/{name.lstrip('/')}"
        values = content.get(_PARAMETERS)
        if isinstance(values, Mapping):
            yield full, _flat(values)
        others = {key: value for key, value in content.items() if key != _PARAMETERS}
        yield from _nodes_in(others, full)


def _flat(values: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """The values by their names in ROS: `{gains: {turn: 1.0}}` gives `gains.turn`."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{above}{name}.")
        else:
            flat[f"{above}{name}"] = value
    return flat


def is_for(pattern: str, node: str) -> bool:
    """Whether a name in a parameter file means a node: `**` any words, `*` one word.

    `is_for("/**", "/tb3/follower")`; so do `/tb3/follower`, `/*/follower` and `/**/follower`, and
    `follower` alone means a node without a namespace.
    """
    words = node.strip("/").split("/")
    reached = {0}  # how many words the pattern so far may stand for
    for one in pattern.strip("/").split("/"):
        if one == "**":
            reached = set(range(min(reached), len(words) + 1))
        else:
            reached = {n + 1 for n in reached if n < len(words) and one in ("*", words[n])}
        if not reached:
            return False
    return len(words) in reached
