"""Remedies for common mistakes in the code of a pattern: a misspelt name, a name of ROS, an import.

An exception of a pattern becomes one line: its text, `remedy` and the place in the author's code.
This module changes no exception and calls no code of the pattern but `__dir__` of its objects.
"""

from __future__ import annotations

import builtins
import linecache
import re
import traceback
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import NamedTuple

import swarmd
from swarmd.core.errors import nearest
from swarmd.core.values import Inputs

_BEARINGS = "`inputs.scan.bearings` has the direction of each ray"
_EACH_STEP = "`drive(self, inputs)` is called at each step, and returns the Twist"
_NUMBERS = "the fields of a Twist are numbers: `Twist(linear=0.2, angular=0.5)`"
ROS_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "angle_min": _BEARINGS,
        "angle_max": _BEARINGS,
        "angle_increment": _BEARINGS,
        "time_increment": "`inputs.scan.ages` has the age of each ray",
        "header": "`inputs.scan.stamp` is the time of a scan, and `inputs.now` that of the step",
        "position": "`pose.x` and `pose.y` are the position",
        "orientation": "`pose.yaw` is the heading in rad",
        "publish": "`drive` returns the Twist instead",
        "create_publisher": _EACH_STEP,
        "create_subscription": _EACH_STEP,
        "create_timer": _EACH_STEP,
        "get_clock": "`inputs.now` is the time in s",
        "get_logger": "`Outputs(report={..})` of `step` gives values for the operator",
        "get_parameter": "`self.params.NAME` is the value, which `Params` declares",
        "declare_parameter": "a field of `Params` declares a parameter",
    }
)
"""By an attribute of a ROS node or message: what a pattern has in its place."""
ROS_MODULES = frozenset(
    {"rospy", "rclpy", "geometry_msgs", "sensor_msgs", "nav_msgs", "std_msgs", "tf", "tf2_ros"}
)
_NO_ROS = "a pattern imports no ROS: it gets `inputs`, and returns a Twist"
_OF_SENSORS = frozenset(
    {"ranges", "bearings", "range_min", "range_max", "stamp", "pose", "twist", "x", "y", "yaw"}
)
MAX_TEXT = 200
"""The most characters of an exception's own text in a line."""
_IMMUTABLE = re.compile(r"immutable type: '(\w+)'")
_ON_NUMBER = re.compile(r"'float' object has no attribute '[xyz]'")
_RELATIVE = re.compile(r"from\s+\.(\w+)")
_NO_PARENT = "attempted relative import with no known parent package"
_ABOVE = "attempted relative import beyond top-level package"


class Place(NamedTuple):
    """A line of code."""

    file: str
    line: int


def place_of(error: BaseException) -> Place | None:
    """The line of the author's code that raised; None without a traceback.

    The last line that lies neither in Python's own and installed modules nor in swarmd. Without
    such a line, the last line of all.
    """
    if isinstance(error, SyntaxError) and error.filename:  # has no frame in the author's file
        return Place(error.filename, error.lineno or 1)
    lines = [Place(f.filename, f.lineno or 1) for f in traceback.extract_tb(error.__traceback__)]
    own = [line for line in lines if not _is_installed(line.file)]
    return next(reversed(own or lines), None)


def one_line(error: BaseException) -> str:
    """An exception with remedy and place: `ZeroDivisionError: division by zero (shy.py:12)`."""
    text = str(error)
    if isinstance(error, SyntaxError) and error.filename:  # its text repeats the place
        text = error.msg
    text = with_remedy(" ".join(text.split())[:MAX_TEXT], error)
    place = place_of(error)
    where = "" if place is None else f" ({place.file.rsplit('/', 1)[-1]}:{place.line})"
    return f"{type(error).__name__}: {text}{where}"


def remedy(error: BaseException) -> str:
    """What to do about the mistake behind an exception, in a few words; empty if not known."""
    if isinstance(error, ImportError):
        return _of_import(error)
    if isinstance(error, NameError) and error.name:
        return _of_name(error.name, _last_frame(error))
    if isinstance(error, AttributeError):
        return _of_attribute(error)
    return ""


def with_remedy(text: str, error: BaseException) -> str:
    """The text of an exception, with `remedy` if there is one."""
    found = remedy(error)
    return f"{text}; {found}" if found else text


def _is_installed(file: str) -> bool:
    """Whether a file is part of Python, of an installed package or of swarmd."""
    if file.startswith("<"):
        return True
    import sysconfig  # 3 ms of the start of each host, and only an error needs it

    folders = {*sysconfig.get_paths().values(), str(Path(swarmd.__file__).parent)}
    return any(file.startswith(f"{folder}/") for folder in folders)


def _last_frame(error: BaseException) -> FrameType | None:
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return None if trace is None else trace.tb_frame


# imports


def _of_import(error: ImportError) -> str:
    """The remedy for a module that is not found."""
    place = place_of(error)
    missing = error.name or ""
    if missing.partition(".")[0] in ROS_MODULES:
        return _NO_ROS
    if place is None or _is_installed(place.file):
        return ""
    file = Path(place.file)
    text = str(error)
    is_folder_pattern = file.name == "pattern.py" or (file.parent / "pattern.py").is_file()
    if _ABOVE in text:
        return f"put the module into the folder {file.parent.name}/, and import it with one dot"
    beside = _modules_beside(file)
    if _NO_PARENT in text:
        written = _RELATIVE.search(linecache.getline(place.file, place.line))
        return _as_folder(file, written[1] if written else "MODULE")
    if missing.startswith("swarmd_plugin_"):  # of a folder
        module = missing.partition(".")[2]
        close = nearest(module, beside)
        meant = f"; did you mean .{close}?" if close else ""
        return f"there is no {module.replace('.', '/')}.py in {file.parent.name}/{meant}"
    if missing and missing in beside:
        if is_folder_pattern:
            return f"write `from .{missing} import ..`: the folder is a package"
        return _as_folder(file, missing)
    return ""


def _modules_beside(file: Path) -> list[str]:
    """The names of the Python files beside `file`, without tests."""
    with suppress(OSError):
        stems = sorted(path.stem for path in file.parent.glob("*.py") if path.name != file.name)
        return [stem for stem in stems if not stem.startswith(("test_", "__"))]
    return []


def _as_folder(file: Path, module: str) -> str:
    """How a file that imports the module beside it becomes the folder of a pattern."""
    return (
        f"a pattern of several files is a folder: move them to {file.stem}/pattern.py and"
        f" {file.stem}/{module}.py, and write `from .{module} import ..`"
    )


# names


def _of_name(name: str, frame: FrameType | None) -> str:
    """The remedy for a name that is not defined in `frame`."""
    values = {} if frame is None else {**frame.f_globals, **frame.f_locals}
    params = getattr(values.get("self"), "params", None)
    if name in getattr(type(params), "__struct_fields__", ()):
        return f"did you mean `self.params.{name}`?"
    has_inputs = isinstance(values.get("inputs"), Inputs)
    if has_inputs and name in Inputs.__struct_fields__:
        return f"did you mean `inputs.{name}`?"
    close = nearest(name, {*values, *vars(builtins)})
    return f"did you mean `{close}`?" if close else ""


def _of_attribute(error: AttributeError) -> str:
    """The remedy for an attribute that an object lacks, or that cannot be set."""
    if found := _IMMUTABLE.search(str(error)):
        is_twist = found[1] == "Twist"
        example = "Twist(linear=0.2)" if is_twist else "msgspec.structs.replace(value, NAME=..)"
        return f"a {found[1]} never changes; make a new one: `{example}`"
    if _ON_NUMBER.search(str(error)):  # `error.name` is empty if the attribute was to be set
        return _NUMBERS
    name = error.name
    owner = error.obj
    if not name:
        return ""
    if callable(owner) and name in Inputs.__struct_fields__ and not isinstance(owner, type):
        return f"did you mean `inputs.{name}`?"
    if owner is None and name in _OF_SENSORS:
        return "a value of `inputs` is None before its first measurement, and without the sensor"
    is_ours = any(kind.__module__.partition(".")[0] == "swarmd" for kind in type(owner).__mro__)
    if is_ours and name in ROS_NAMES:
        return ROS_NAMES[name]
    close = nearest(name, _attributes(owner))
    return f"did you mean `.{close}`?" if close else ""


def _attributes(owner: object) -> Iterator[str]:
    """The public attributes of an object."""
    with suppress(Exception):  # a plugin may define `__dir__`
        yield from (name for name in dir(owner) if not name.startswith("_"))
