"""All that a robot knows as bytes, so that a replay goes on from any instant of a run.

The bytes are a pickle that only `recall` reads. `recall` makes values, arrays and the classes of a
robot and nothing else: a recording comes from another machine and must not run code here. The
layout is that of one version of swarmd, with kernels compiled or interpreted as they were.
"""

from __future__ import annotations

import io
import pickle
import zlib
from types import MappingProxyType, MethodType
from typing import Any

import numpy as np
from msgspec import MsgspecError

from swarmd.core.errors import CodecError
from swarmd.core.values import Array
from swarmd.robot.robot import HANDLERS, Robot
from swarmd.robot.settings import RobotSettings

MAX_BYTES = 1 << 24
"""Of a memory before it is packed."""

_PACKAGES = ("swarmd.robot.", "swarmd.protection.", "swarmd.sensing.")
_VALUES = frozenset(
    f"swarmd.core.{name}"
    for name in (
        *("arrival_delay", "behaviour", "events", "goal", "hazard", "host_messages", "messages"),
        *("record", "token_bucket", "values", "verbs"),
    )
)
"""Modules of the core with values and pure classes alone."""
_OTHERS = frozenset(
    {("array", "_array_reconstructor"), ("array", "array"), ("collections", "deque")}
    | {("collections", "Counter"), ("msgspec._utils", "rebuild")}
    | {("random", "Random"), (__name__, "_array"), (__name__, "_method"), (__name__, "_proxy")}
    | {(__name__, "_scalar"), (__name__, "_view")}
)
_FAULTS = (
    *(pickle.UnpicklingError, pickle.PickleError, zlib.error, ArithmeticError, AssertionError),
    *(AttributeError, BufferError, EOFError, ImportError, LookupError, MemoryError, MsgspecError),
    *(RuntimeError, TypeError, ValueError),
)
"""Raised for damaged bytes, and for those of another version."""


def remember(robot: Robot, limit: int = MAX_BYTES) -> bytes:
    """All that `robot` knows now, but for its settings; CodecError beyond `limit` bytes."""
    file = io.BytesIO()
    try:
        _Pickler(file, pickle.HIGHEST_PROTOCOL).dump(robot)
    except _FAULTS as error:  # such as a value of another library
        raise CodecError(f"the memory of the robot cannot be written: {error!r}") from error
    data = zlib.compress(file.getvalue(), 1)
    if len(data) > limit:
        raise CodecError(f"the memory of the robot has {len(data)} bytes; at most {limit} fit")
    return data


def recall(data: bytes, settings: RobotSettings) -> Robot:
    """The robot of `remember`, with these settings; CodecError if the bytes are none for it."""
    try:
        packed = zlib.decompressobj()
        found = _Unpickler(packed.decompress(data, MAX_BYTES), settings).load()
        if not packed.eof:
            raise EOFError(f"it is cut off, or has more than {MAX_BYTES} bytes")
    except _FAULTS as error:
        raise CodecError(f"no memory of a robot of this version: {error!r}") from error
    if not isinstance(found, Robot):
        raise CodecError(f"no memory of a robot: {type(found).__name__}")
    return found


class _Pickler(pickle.Pickler):
    def persistent_id(self, obj: Any) -> str | None:
        if obj is HANDLERS:
            return "handlers"
        return "settings" if isinstance(obj, RobotSettings) else None

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, MethodType):
            return _method, (obj.__self__, obj.__name__)
        if isinstance(obj, MappingProxyType):
            return _proxy, (dict(obj),)
        if isinstance(obj, np.generic):
            return _scalar, (obj.tobytes(), obj.dtype.str)
        is_view = _is_view(obj)
        if not is_view and not isinstance(obj, np.ndarray):
            return NotImplemented
        array = np.asarray(obj)
        place = array.shape, array.strides, array.dtype.str
        base = _base_of(obj)
        if base is obj:
            data = bytearray(array.tobytes("A"))
            return _array, (data if array.flags.writeable else bytes(data), *place)
        # The views of one base share its numbers again.
        start = _address(array) - _address(np.asarray(memoryview(base)))
        return _view, (base, start, *place, is_view)


class _Unpickler(pickle.Unpickler):
    def __init__(self, data: bytes, settings: RobotSettings) -> None:
        super().__init__(io.BytesIO(data))
        self._outer = {"handlers": HANDLERS, "settings": settings}

    def persistent_load(self, pid: Any) -> Any:
        return self._outer[pid]

    def find_class(self, module: str, name: str) -> Any:
        found = None
        if (module, name) in _OTHERS:
            found = super().find_class(module, name)
        elif _is_ours(module) and "." not in name:
            found = super().find_class(module, name)
            # A module holds classes of others, too, such as Path, which writes files.
            is_class = isinstance(found, type) and _is_ours(found.__module__)
            if not is_class and not name.startswith("__pyx_unpickle_"):
                found = None
        if found is None:
            raise pickle.UnpicklingError(f"{module}.{name} is no part of a robot's memory")
        return found


def _is_ours(module: str) -> bool:
    """True for the modules whose classes are in a memory."""
    return module in _VALUES or (module.startswith(_PACKAGES) and module != __name__)


def _is_view(obj: Any) -> bool:
    """True for a view of memory: of Python, or of the kernels."""
    return type(obj).__name__ in ("memoryview", "_memoryviewslice")


def _base_of(obj: Any) -> Any:
    """The object that holds the numbers of an array or a view."""
    while True:
        if _is_view(obj):
            obj = obj.obj if isinstance(obj, memoryview) else obj.base
        elif isinstance(obj, np.ndarray) and obj.base is not None:
            obj = obj.base
        else:
            return obj


def _address(array: Array) -> int:
    return int(array.__array_interface__["data"][0])


def _kind(kind: str) -> np.dtype[Any]:
    """The type of numbers; not that of objects, whose bytes are addresses in memory."""
    found = np.dtype(kind)
    if found.kind not in "biufc":
        raise pickle.UnpicklingError(f"an array of {kind!r}; expected numbers")
    return found


def _array(
    data: bytes | bytearray, shape: tuple[int, ...], strides: tuple[int, ...], kind: str
) -> Array:
    array: Array = np.ndarray(shape, _kind(kind), data, 0, strides)
    if array.nbytes != len(data):  # else a few bytes make an endless array
        raise ValueError(f"an array of {array.nbytes} bytes is made of {len(data)}")
    return array


def _proxy(values: dict[str, Any]) -> MappingProxyType[str, Any]:
    return MappingProxyType(values)


def _scalar(data: bytes, kind: str) -> Any:
    return np.frombuffer(data, _kind(kind))[0]


def _view(
    base: Any,
    start: int,
    shape: tuple[int, ...],
    strides: tuple[int, ...],
    kind: str,
    is_view: bool,
) -> Any:
    array: Any = np.ndarray(shape, _kind(kind), base, start, strides)
    if array.nbytes > MAX_BYTES:
        raise ValueError(f"a view of {array.nbytes} bytes; at most {MAX_BYTES} fit")
    return memoryview(array) if is_view else array


def _method(one: Any, name: str) -> MethodType:
    found = getattr(one, name) if _is_ours(type(one).__module__) else None
    if not isinstance(found, MethodType) or name.startswith("__"):
        raise pickle.UnpicklingError(f"{name} is no method")
    return found
