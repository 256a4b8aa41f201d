"""The nodes of one robot: starts them as the launch file says, and steps them."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from msgspec import convert, to_builtins
from numpy.random import Generator

from swarmd.core.errors import ConfigError, PluginError, SwarmError
from swarmd.core.values import Inputs, Outputs, Platform, Scalar, Twist
from swarmd.ros2_nodes.chance import Chance
from swarmd.ros2_nodes.graph import Graph, Published, described
from swarmd.ros2_nodes.launch_file import (
    LaunchFile,
    Names,
    NodeEntry,
    Topics,
    parameters_of,
    read_launch_file,
)
from swarmd.ros2_nodes.logger import LogLines
from swarmd.ros2_nodes.message_classes import MessageClasses
from swarmd.ros2_nodes.node import Node, NodeSetup, RobotSide
from swarmd.ros2_nodes.node_modules import NodeModules
from swarmd.ros2_nodes.refusal import Ended, Interrupted, Spun, one_line
from swarmd.ros2_nodes.robot_topics import RobotTopics
from swarmd.ros2_nodes.ros_time import Clock, time_classes
from swarmd.ros2_nodes.shared_topics import SharedTopics
from swarmd.ros2_nodes.stand_in_modules import (
    StandIns,
    builtins_of,
    one_element_arrays,
    python_modules,
    script_path,
)


class RobotNodes:
    """The running nodes of one robot."""

    def __init__(self, launch: Path, robot: str, platform: Platform, rng: Generator) -> None:
        """Start all nodes in their order.

        ConfigError for a wrong launch file, PluginError in one line if a node cannot start.
        """
        self.launch, self._files = read_launch_file(launch)
        self._names = Names(robot, platform.name)
        self._folders = [self._files.path(self._names(one)) for one in self.launch.path]
        for folder, name in zip(self._folders, self.launch.path, strict=True):
            if not folder.is_relative_to(self._files.base):
                raise ConfigError(
                    f"{launch.name}: path: {name} does not lie below the launch file; move the file"
                    " up, or link the folder below it"
                )
            if not self._files.is_folder(folder):
                raise ConfigError(f"{launch.name}: path: there is no folder {name}")
        types = MessageClasses(self._files, self._folders)
        self.graph = Graph(types, self._on_published)
        time, duration = time_classes(types.kind)
        clock = Clock(lambda: self.graph.now, time, self.graph.refuse)
        self._lines = LogLines(robot, self.launch.log_level)
        setup = NodeSetup("", "", [], {})
        self._side = RobotSide(self.graph, clock, time, duration, self._log, setup)
        self._chance = Chance(rng)
        self.modules: list[NodeModules] = []  # of each entry
        self._namespace = self._names(self.launch.namespace).rstrip("/") or "/"
        self._topics = RobotTopics(
            convert(self._names.of_values(to_builtins(self.launch.topics)), Topics),
            self.graph,
            platform,
            self._resolved,
        )
        self._shared = SharedTopics(
            self.graph, [self._resolved(self._names(topic)) for topic in self.launch.shared]
        )
        self._began_at: float | None = None
        with self._chance.used():
            for entry in self.launch.nodes:
                self._start(entry)
            self._publish_start(self.launch)
        self.needs = self._topics.needs()

    def step(self, inputs: Inputs) -> Outputs:
        """Hand the inputs to the nodes, run their callbacks, and return what they publish."""
        if self._began_at is None:
            self._began_at = inputs.now
        now = inputs.now - self._began_at
        graph = self.graph
        done: str | None = None
        with self._chance.used():
            graph.begin_step()
            try:
                graph.run_timers(now, is_included=False)
                graph.now = now
                self._shared.deliver(inputs.messages)
                self._topics.publish(inputs)
                graph.run_queue()
                graph.run_timers(now, is_included=True)
            except Ended as ended:
                done = str(ended)
        graph.now = now
        twist = Twist() if done is not None else self._topics.current(now)
        return Outputs(twist, self._shared.outgoing(), self._report(), done)

    def _report(self) -> dict[str, Scalar]:
        report: dict[str, Scalar] = {"nodes": len(self._side.nodes)}
        if self._shared.lost:
            report["messages_lost"] = self._shared.lost
        if self._shared.refused:
            report["messages_refused"] = self._shared.refused
        return report

    # The start

    def _made_modules(self, entry: NodeEntry) -> NodeModules:
        stand_ins = StandIns(self._side, self.graph.types, self._files)
        stand_ins.add(python_modules(self._side, self._chance))
        replaced = builtins_of(self._side, self._files)
        if self.launch.one_element_arrays:
            numbers, math = one_element_arrays()
            replaced |= numbers
            stand_ins.add({"math": math})
        return NodeModules(self._files, self._folders, stand_ins, replaced, [entry.run])

    def _start(self, entry: NodeEntry) -> None:
        namespace = self._names(entry.namespace)
        if namespace and not namespace.startswith("/"):
            namespace = f"{self._namespace.rstrip('/')}/{namespace}"
        self._side.setup = NodeSetup(
            self._names(entry.name),
            namespace or self._namespace,
            parameters_of(entry, self._files, self._names),
            {self._names(old): self._names(new) for old, new in entry.remap.items()},
        )
        count = len(self._side.nodes)
        modules = self._made_modules(entry)
        self.modules.append(modules)
        try:
            with _arguments([entry.run]):
                self._run_entry(entry, modules)
        except Ended as ended:
            raise PluginError(f"{entry.run}: {ended} before its first callback") from None
        except SwarmError as error:
            raise PluginError(f"{entry.run}: {one_line(str(error))}") from error
        except SystemExit as error:
            raise PluginError(f"{entry.run}: has ended itself: sys.exit({error.code!r})") from None
        except Interrupted:
            raise PluginError(f"{entry.run}: has ended itself: KeyboardInterrupt") from None
        except KeyboardInterrupt:  # of the user of this program
            raise
        except BaseException as error:  # a node may raise anything
            text = self.graph.refused or described(error)
            raise PluginError(f"{entry.run}: {text}") from error
        if self.graph.refused:
            raise PluginError(f"{entry.run}: {self.graph.refused}")
        if len(self._side.nodes) == count:
            raise PluginError(f"{entry.run}: made no node; expected one, and rclpy.spin")
        self.graph.begin_step()
        self.graph.run_queue()

    def _run_entry(self, entry: NodeEntry, modules: NodeModules) -> None:
        """Run an entry up to where it spins."""
        try:
            started = self._called(entry, modules)
            # A bare `except:` around `rclpy.spin` has caught what leaves main().
            has_spun = self.graph.is_leaving
        except Spun:  # the end of a main(), or of a constructor that spins itself
            return
        finally:
            self.graph.is_leaving = False
        if not isinstance(started, type) and not has_spun:
            raise ConfigError("main() has returned; expected it to end in rclpy.spin(node)")

    def _called(self, entry: NodeEntry, modules: NodeModules) -> Any:
        """Call the class or function of an entry; returns what was called."""
        if entry.run.endswith(".py"):
            module = modules.run_script(script_path(self._files, entry.run))
            name = "main"
            if self.graph.is_leaving:
                return None
        else:
            module_name, _, name = entry.run.partition(":")
            if not all(word.isidentifier() for word in module_name.split(".")):
                # A slash would lead out of `path`, to files that nobody compares or pushes.
                raise ConfigError(f"run: {module_name!r} is no name of a module")
            module = modules.load(module_name)
            if not hasattr(module, "__own__"):
                raise ConfigError(f"run: {module_name} is no module below `path`")
        started: Any = getattr(module, name or "main", None)
        if started is None:
            raise ConfigError(
                f"{module.__name__} has no {name or 'main'}; expected module:Class, or a main()"
            )
        is_node = isinstance(started, type) and issubclass(started, Node)
        takes_args = not is_node and bool(inspect.signature(started).parameters)
        started(None) if takes_args else started()
        return started

    def _publish_start(self, launch: LaunchFile) -> None:
        for one in launch.start:
            kind = self.graph.types.kind(_full_type(one.type))
            message: Any = kind()
            _set_values(message, self._names.of_values(one.values), f"start: {one.topic}")
            self.graph.deliver(self._resolved(self._names(one.topic)), message)
        self.graph.begin_step()
        try:
            self.graph.run_queue()
        except Ended as ended:
            raise PluginError(str(ended)) from None

    def _resolved(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"{self._namespace.rstrip('/')}/{topic}"

    def _on_published(self, published: Published) -> None:
        self._topics.take(published)
        self._shared.take(published)

    def _log(self, severity: str, name: str, text: str) -> None:
        self._lines.write(self.graph.now, severity, name, text)


@contextmanager
def _arguments(argv: list[str]) -> Iterator[None]:
    """A block in which `sys.argv` is that of a process of its own, for `argparse`."""
    real = sys.argv
    sys.argv = argv
    try:
        yield
    finally:
        sys.argv = real


def _full_type(name: str) -> str:
    """`std_msgs/msg/Int8` for `std_msgs/Int8`."""
    return name if name.count("/") != 1 else name.replace("/", "/msg/")


def _set_values(message: Any, values: Any, where: str) -> None:
    """Set the fields of a message to values of YAML; ConfigError in one line for a wrong one."""
    for name, value in values.items():
        if name not in message.FIELDS:
            raise ConfigError(f"{where}: {message.TYPE} has no field {name!r}")
        if isinstance(value, dict):
            _set_values(getattr(message, name), value, where)
            continue
        is_whole = isinstance(value, int) and not isinstance(value, bool)
        if is_whole and message.FIELDS[name].text.startswith("float"):
            value = float(value)
        try:
            setattr(message, name, value)
        except (AssertionError, TypeError, ValueError) as error:
            raise ConfigError(f"{where}: {name} is {value!r}: {error}") from None
