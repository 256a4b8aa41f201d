"""The modules that take the place of rclpy, message packages, clocks and threads in nodes."""

from __future__ import annotations

import datetime as real_datetime
import inspect
import io
import math
import os
import random
import sys
import threading
import time as real_time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn, Self

import numpy as np

from swarmd.core.errors import ConfigError
from swarmd.ros2_nodes import logger, parameters, qos, ros_time
from swarmd.ros2_nodes.chance import Chance
from swarmd.ros2_nodes.graph import Future, Graph, Owner
from swarmd.ros2_nodes.message_classes import MessageClasses
from swarmd.ros2_nodes.node import Node, RobotSide
from swarmd.ros2_nodes.node_files import NodeFiles
from swarmd.ros2_nodes.refusal import Interrupted, NotCarriedOver, Spun
from swarmd.ros2_nodes.transforms import tf2_ros

_TIMER = "a callback never waits; use a timer (`create_timer`)"
REFUSED_MODULES: Mapping[str, str] = {
    "socket": "a pattern has no network; robots exchange the topics in `shared`",
    "subprocess": "a pattern starts no process",
    "multiprocessing": "a pattern starts no process",
    "asyncio": "a pattern has one loop; use timers and callbacks",
    "concurrent": "a pattern has one thread; use timers and callbacks",
    "_thread": "a pattern has one thread; use timers and callbacks",
    "secrets": "its numbers come from outside of the run; use `random`",
    "signal": "a pattern handles no signals",
    "select": "a pattern has no network",
    "requests": "a pattern has no network",
    "urllib": "a pattern has no network",
    "http": "a pattern has no network",
    "serial": "a pattern reaches no hardware but the robot's own topics",
    "shutil": "a pattern writes no files",
    "tempfile": "a pattern writes no files",
    "tf2_geometry_msgs": "look the transform up, and apply it to the point",
    "rclpy.action": "there are no actions; use topics, services or a timer",
    "rclpy.lifecycle": "there are no lifecycle nodes; use a Node",
    "message_filters": "there is no synchronizer; keep the last message of each topic",
    "launch": "the launch file of swarmd takes its place: docs/ros2_nodes.md",
    "launch_ros": "the launch file of swarmd takes its place: docs/ros2_nodes.md",
    "ament_index_python": "there are no installed packages of ROS; name files in the launch file",
}
"""Modules that a node may import, but not use, and what to do instead."""


class StandIns:
    """Makes the stand-ins of one robot by the name of the module."""

    def __init__(self, side: RobotSide, types: MessageClasses, files: NodeFiles) -> None:
        self._side = side
        self._types = types
        self._files = files
        self._made = {**_rclpy(side), **tf2_ros(side)}

    def __call__(self, name: str) -> ModuleType | None:
        """The module that takes the place of `name`; None if nothing does."""
        if name in self._made:
            return self._made[name]
        for refused, remedy in REFUSED_MODULES.items():
            if name == refused or name.startswith(f"{refused}."):
                return _Refused(name, f"{name}: {remedy}", self._side.graph)
        top, _, rest = name.partition(".")
        if top == "rclpy":
            raise NotCarriedOver(f"imports {name}, which the stand-in for rclpy does not have")
        if rest in ("", "msg", "srv") and self._types.has_package(top):
            return _MessagePackage(name, self._types)
        if rest.startswith(("msg.", "srv.", "action")) and self._types.has_package(top):
            raise NotCarriedOver(f"imports {name}; import the type from {top}.{rest[:3]}")
        return None

    def add(self, modules: Mapping[str, ModuleType]) -> None:
        """Add stand-ins that need the robot's chance or files."""
        self._made.update(modules)


class _MessagePackage(ModuleType):
    """`sensor_msgs`, `sensor_msgs.msg` or `.srv`: its types are made when they are asked for."""

    def __init__(self, name: str, types: MessageClasses) -> None:
        super().__init__(name)
        self.__path__: list[str] = []
        self._types = types

    def __getattr__(self, name: str) -> Any:
        package, _, folder = self.__name__.partition(".")
        if name.startswith("_") or not folder:
            raise AttributeError(name)
        full = f"{package}/{folder}/{name}"
        try:
            made = self._types.service(full) if folder == "srv" else self._types.kind(full)
        except ConfigError as error:
            raise NotCarriedOver(str(error)) from None
        setattr(self, name, made)
        return made


class _Refused(ModuleType):
    """A module whose names a node may import, but not call."""

    def __init__(self, name: str, text: str, graph: Graph) -> None:
        super().__init__(name)
        self.__path__: list[str] = []
        self._text = text
        self._graph = graph

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if name[0].isupper() and name.endswith(("Exception", "Error")):
            return type(name, (Exception,), {})
        return _refused_class(f"{self.__name__}.{name}", self._text, self._graph)


def _refused_class(name: str, text: str, graph: Graph) -> type:
    """A class in place of a function or class that a node may not use.

    Its methods are refused, too; a node may derive a class of it, and use that as little.
    """

    class Refused:
        def __new__(cls, *_: Any, **__: Any) -> Any:
            graph.refuse(f"uses {name}; {text.partition(': ')[2]}")

    Refused.__name__ = name.rpartition(".")[2]
    return Refused


def _module(name: str, **members: Any) -> ModuleType:
    module = ModuleType(name)
    module.__dict__.update(members)
    return module


# rclpy


class _Block:
    """What `with` begins, and shuts down at its end."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()

    def shutdown(self, *_: Any, **__: Any) -> Any:
        """End it."""


@dataclass
class _Spinning:
    """`rclpy.spin` and its kin; `is_starting`: a script's `main()` runs."""

    side: RobotSide

    def spin(self, *_: Any, **__: Any) -> NoReturn:
        """End the `main()` of a script: from here on the pattern calls the callbacks."""
        self.side.graph.is_leaving = True
        raise Spun

    def once(self, *_: Any, **__: Any) -> NoReturn:
        """Refused: a loop of `main()` cannot go on while the pattern waits for the next step."""
        self.side.graph.refuse(
            "rclpy.spin_once: a loop around it cannot run in a pattern; move what it does into a"
            " timer, and call rclpy.spin"
        )

    def until_done(self, node: Any, future: Future, *_: Any, **__: Any) -> None:
        """Call what waits; refused for a future that is then not done."""
        self.side.graph.run_queue()
        if not future.done():
            self.side.graph.refuse(
                "rclpy.spin_until_future_complete: the future waits for more than this robot's own"
                " services; use add_done_callback"
            )

    def is_ok(self, *_: Any, **__: Any) -> bool:
        """True until a node shuts rclpy down."""
        self.side.graph.count_question("loops on rclpy.ok()")
        return not self.side.graph.is_down

    def shutdown(self, *_: Any, **__: Any) -> None:
        """End the nodes; without effect while a script leaves its `main()`."""
        if not self.side.graph.is_leaving:
            self.side.graph.is_down = True


def _rclpy(side: RobotSide) -> dict[str, ModuleType]:
    spinning = _Spinning(side)

    class Executor(_Block):
        """Any executor: one thread."""

        def __init__(self, *_: Any, **__: Any) -> None:
            self._nodes: list[Any] = []

        def add_node(self, node: Any) -> bool:
            self._nodes.append(node)
            return True

        def remove_node(self, node: Any) -> None:
            self._nodes = [one for one in self._nodes if one is not node]

        def get_nodes(self) -> list[Any]:
            return self._nodes

        def create_task(self, callback: Callable[..., Any], *args: Any, **named: Any) -> Future:
            future = Future()
            owner = Owner("a task of an executor")
            side.graph.call(owner, lambda: future.set_result(callback(*args, **named)))
            return future

        def spin(self) -> None:
            spinning.spin()

        def spin_once(self, *_: Any, **__: Any) -> None:
            spinning.once()

        def spin_until_future_complete(self, future: Future, *_: Any, **__: Any) -> None:
            spinning.until_done(None, future)

        def wake(self) -> None:
            pass

        def shutdown(self, *_: Any, **__: Any) -> bool:
            return True

    class CallbackGroup:
        """Any group: callbacks run one after another."""

        def __init__(self, *_: Any, **__: Any) -> None:
            pass

    class Context(_Block):
        """A context without effect."""

        def __init__(self, *_: Any, **__: Any) -> None:
            pass

        def ok(self) -> bool:
            return spinning.is_ok()

        def init(self, *_: Any, **__: Any) -> None:
            pass

        def shutdown(self, *_: Any, **__: Any) -> None:
            spinning.shutdown()

        try_shutdown = shutdown

    robot_node = type("Node", (Node,), {"_robot_side": side, "__module__": "rclpy.node"})

    def create_node(node_name: str, **options: Any) -> Node:
        made: Node = robot_node(node_name, **options)
        return made

    def init(*_: Any, **__: Any) -> Context:
        return Context()

    def set_logger_level(*_: Any, **__: Any) -> None:
        pass

    def get_logger(name: str) -> logger.Logger:
        return logger.Logger(name, side.log, side.clock)

    type_ = parameters.ParameterType
    policies = {
        "ReliabilityPolicy": qos.ReliabilityPolicy,
        "QoSReliabilityPolicy": qos.ReliabilityPolicy,
        "DurabilityPolicy": qos.DurabilityPolicy,
        "QoSDurabilityPolicy": qos.DurabilityPolicy,
        "HistoryPolicy": qos.HistoryPolicy,
        "QoSHistoryPolicy": qos.HistoryPolicy,
        "LivelinessPolicy": qos.LivelinessPolicy,
        "QoSLivelinessPolicy": qos.LivelinessPolicy,
    }
    errors = {
        name: getattr(parameters, name) for name in dir(parameters) if name.endswith("Exception")
    }
    executors = dict.fromkeys(
        (
            "Executor",
            "SingleThreadedExecutor",
            "MultiThreadedExecutor",
            "StaticSingleThreadedExecutor",
        ),
        Executor,
    )
    groups = dict.fromkeys(
        ("CallbackGroup", "MutuallyExclusiveCallbackGroup", "ReentrantCallbackGroup"), CallbackGroup
    )
    no_shutdown = type("ExternalShutdownException", (Exception,), {})
    clock_types = {"ClockType": ros_time.ClockType}
    parts: dict[str, dict[str, Any]] = {
        "node": {
            "Node": robot_node,
            **dict.fromkeys(("Publisher", "Subscription", "Timer", "Service", "Client"), object),
            "Parameter": parameters.Parameter,
            "QoSProfile": qos.QoSProfile,
        },
        "qos": {
            "QoSProfile": qos.QoSProfile,
            "QoSPresetProfiles": qos.presets(),
            **policies,
            **qos.profiles(),
        },
        "parameter": {
            "Parameter": parameters.Parameter,
            "ParameterType": type_,
            "PARAMETER_SEPARATOR_STRING": ".",
            "parameter_value_to_python": parameters.python_value,
        },
        "time": {"Time": side.time, "Duration": side.duration, **clock_types},
        "duration": {"Duration": side.duration},
        "clock": {
            "Clock": lambda **_: side.clock,
            "ROSClock": lambda **_: side.clock,
            **clock_types,
        },
        "logging": {
            "get_logger": get_logger,
            "LoggingSeverity": logger.LoggingSeverity,
            "set_logger_level": set_logger_level,
        },
        "executors": {**executors, "ExternalShutdownException": no_shutdown},
        "callback_groups": groups,
        "exceptions": {**errors, "ROSInterruptException": no_shutdown},
        "task": {"Future": Future},
        "context": {"Context": Context},
        "utilities": {
            "ok": spinning.is_ok,
            "get_default_context": Context,
            "remove_ros_args": _words,
        },
        "timer": {"Timer": object, "Rate": object},
        "publisher": {"Publisher": object},
        "subscription": {"Subscription": object},
        "service": {"Service": object},
        "client": {"Client": object},
        "signals": {
            "SignalHandlerOptions": type(
                "SignalHandlerOptions", (), {"NO": 0, "SIGINT": 1, "SIGTERM": 2, "ALL": 3}
            )
        },
        "constants": {"S_TO_NS": ros_time.S_TO_NS},
    }
    made = {f"rclpy.{name}": _module(f"rclpy.{name}", **members) for name, members in parts.items()}
    whole = _module(
        "rclpy",
        __path__=[],
        init=init,
        try_shutdown=spinning.shutdown,
        shutdown=spinning.shutdown,
        ok=spinning.is_ok,
        spin=spinning.spin,
        spin_once=spinning.once,
        spin_until_future_complete=spinning.until_done,
        create_node=create_node,
        get_global_executor=Executor,
        Parameter=parameters.Parameter,
        Future=Future,
    )
    for name in parts:
        whole.__dict__[name] = made[f"rclpy.{name}"]
    made["rclpy"] = whole
    return made


def _words(args: list[str] | None = None) -> list[str]:
    """The arguments without those of ROS: a node has none."""
    return list(sys.argv if args is None else args)


# Modules of Python


def python_modules(side: RobotSide, chance: Chance) -> dict[str, ModuleType]:
    """Stand-ins for `time`, `datetime`, `threading`, `random`, `uuid` and `os`, by name."""
    return {
        "time": _time(side),
        "datetime": _datetime(side),
        "threading": _threading(side.graph),
        "random": _random(side.graph, chance),
        "uuid": _module(
            "uuid",
            **{**_public(uuid), "uuid1": lambda *_, **__: chance.uuid(), "uuid4": chance.uuid},
        ),
        "os": _os(side.graph),
        "os.path": os.path,
        "tf_transformations": _transformations(),
    }


def _public(module: ModuleType) -> dict[str, Any]:
    return {name: value for name, value in vars(module).items() if not name.startswith("__")}


def _random(graph: Graph, chance: Chance) -> ModuleType:
    text = "random: its numbers come from outside of the run; use random.Random()"
    replaced = {
        "seed": chance.seed,
        "Random": chance.generator_class(),
        "SystemRandom": _refused_class("random.SystemRandom", text, graph),
    }
    return _module("random", **{**_public(random), **replaced})


def _time(side: RobotSide) -> ModuleType:
    def seconds() -> float:
        return side.graph.now

    def nanoseconds() -> int:
        return round(side.graph.now * ros_time.S_TO_NS)

    def sleep(_: float) -> None:
        side.graph.refuse(f"time.sleep: {_TIMER}")

    clocks: dict[str, Any] = {}
    for name in ("time", "monotonic", "perf_counter", "process_time", "thread_time"):
        clocks[name] = seconds
        clocks[f"{name}_ns"] = nanoseconds
    clocks["clock_gettime"] = lambda _: seconds()
    clocks["clock_gettime_ns"] = lambda _: nanoseconds()
    members = {**_public(real_time), **clocks, "sleep": sleep}
    members["ctime"] = lambda at=None: real_time.asctime(members["gmtime"](at))
    members["asctime"] = lambda at=None: real_time.asctime(at or members["gmtime"]())
    members["localtime"] = lambda at=None: real_time.gmtime(seconds() if at is None else at)
    members["gmtime"] = members["localtime"]
    members["strftime"] = lambda form, at=None: real_time.strftime(form, at or members["gmtime"]())
    return _module("time", **members)


def _datetime(side: RobotSide) -> ModuleType:
    class RobotDatetime(real_datetime.datetime):
        @classmethod
        def now(cls, tz: real_datetime.tzinfo | None = None) -> RobotDatetime:
            return cls.fromtimestamp(side.graph.now, tz or real_datetime.UTC).replace(tzinfo=tz)

        @classmethod
        def utcnow(cls) -> RobotDatetime:
            return cls.now()

        @classmethod
        def today(cls) -> RobotDatetime:
            return cls.now()

    class RobotDate(real_datetime.date):
        @classmethod
        def today(cls) -> RobotDate:
            at = RobotDatetime.now()
            return cls(at.year, at.month, at.day)

    RobotDatetime.__name__ = "datetime"
    RobotDate.__name__ = "date"
    members = {**_public(real_datetime), "datetime": RobotDatetime, "date": RobotDate}
    return _module("datetime", **members)


def _threading(graph: Graph) -> ModuleType:
    text = f"threading: a pattern has one thread; {_TIMER}"
    refused = {
        name: _refused_class(f"threading.{name}", text, graph)
        for name in ("Thread", "Timer", "Barrier", "Condition", "Event", "Semaphore")
    }
    # Locks of one thread are never contended; a plain lock that is taken twice would wait for ever.
    locks = dict.fromkeys(("Lock", "RLock"), threading.RLock)
    return _module(
        "threading", **locks, **refused, get_ident=threading.get_ident, local=threading.local
    )


def _os(graph: Graph) -> ModuleType:
    class Os(ModuleType):
        def __getattr__(self, name: str) -> Any:
            if name.startswith("__"):
                raise AttributeError(name)
            return _refused_class(
                f"os.{name}", "os: a pattern neither starts processes nor touches files", graph
            )

    module = Os("os")
    module.__dict__.update(
        path=os.path,
        environ={},
        sep=os.sep,
        linesep=os.linesep,
        getenv=lambda key, default=None: default,
        getpid=lambda: 1,
        PathLike=os.PathLike,
        fspath=os.fspath,
    )
    return module


def _transformations() -> ModuleType:
    """The two functions of `tf_transformations` that nodes of wheeled robots use, for axes sxyz."""

    def euler_from_quaternion(quaternion: Any, axes: str = "sxyz") -> tuple[float, float, float]:
        x, y, z, w = (float(one) for one in quaternion)
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return roll, pitch, yaw

    def quaternion_from_euler(ai: float, aj: float, ak: float, axes: str = "sxyz") -> Any:
        half = (ai / 2.0, aj / 2.0, ak / 2.0)
        ci, cj, ck = (math.cos(one) for one in half)
        si, sj, sk = (math.sin(one) for one in half)
        return np.array(
            [
                si * cj * ck - ci * sj * sk,
                ci * sj * ck + si * cj * sk,
                ci * cj * sk - si * sj * ck,
                ci * cj * ck + si * sj * sk,
            ]
        )

    return _module(
        "tf_transformations",
        euler_from_quaternion=euler_from_quaternion,
        quaternion_from_euler=quaternion_from_euler,
    )


# Builtins


def builtins_of(side: RobotSide, files: NodeFiles) -> dict[str, Any]:
    """Names of builtins that the modules of nodes get in place of Python's."""

    def open_(file: Any, mode: str = "r", *_: Any, encoding: str | None = None, **__: Any) -> Any:
        if not set(mode) <= {"r", "b", "t"}:
            side.graph.refuse(f"open({str(file)!r}, {mode!r}): a pattern writes no files")
        path = files.path(str(file))
        if not path.is_relative_to(files.base):
            side.graph.refuse(
                f"open({str(file)!r}): a node reads files of the folder of its launch file alone"
            )
        content = files.read(path)
        return (
            io.BytesIO(content) if "b" in mode else io.StringIO(content.decode(encoding or "utf-8"))
        )

    def print_(*values: Any, sep: str | None = " ", **_: Any) -> None:
        text = (" " if sep is None else sep).join(map(str, values))
        side.log("info", "print", text)

    def input_(*_: Any) -> NoReturn:
        side.graph.refuse("input(): a node asks nobody; use a topic or a parameter")

    return {"open": open_, "print": print_, "input": input_, "KeyboardInterrupt": Interrupted}


# Arrays of one element


def _number(value: Any) -> Any:
    """The number in an array of one element, as numpy before 2.4 gave it."""
    return value.item() if isinstance(value, np.ndarray) and value.size == 1 else value


def one_element_arrays() -> tuple[dict[str, Any], ModuleType]:
    """Builtins `float` and `int`, and a module `math`, that take arrays of one element.

    Numpy from 2.4 on refuses these conversions of arrays with one dimension.
    """

    def lenient(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(*args: Any) -> Any:
            return function(*map(_number, args))

        return call

    members = {
        name: lenient(value) if inspect.isbuiltin(value) else value
        for name, value in _public(math).items()
    }
    return {"float": _kind_of(float), "int": _kind_of(int)}, _module("math", **members)


def _kind_of(real: type) -> type:
    """A class that makes values of `real`, of which they are instances, also of arrays."""

    class Kind(type):
        def __instancecheck__(cls, value: object) -> bool:
            return isinstance(value, real)

        def __subclasscheck__(cls, kind: type) -> bool:
            return issubclass(kind, real)

        def __call__(cls, *args: Any, **named: Any) -> Any:
            return real(*map(_number, args), **named)

        def __eq__(cls, other: object) -> bool:
            return other is real or other is cls

        def __hash__(cls) -> int:
            return hash(real)

    return Kind(real.__name__, (real,), {})


def script_path(files: NodeFiles, name: str) -> Path:
    """The path of the script of an entry; ConfigError if there is none."""
    path = files.path(name)
    if not path.is_relative_to(files.base) or not files.is_file(path):
        raise ConfigError(f"{name}: there is no such file beside the launch file")
    return path
