"""Serialises the whole state of a robot, so that a replay can start at any instant of a run.

The bytes are compressed MessagePack: a table of kinds (types), and nodes. A node is one object or
value: the index of its kind, and its parts. A part is an atom (bool, float, int, str, None) or the
place of another node. A place is a tuple of one int, the index of the node: a bare int is an atom.
An object to which two others refer is written once, and both refer to the same object after
reading.

A value is a built-in container, an array, bytes, or an instance of a class of values (a struct, an
enum, a named tuple, a dataclass with slots). An object is an instance of any other class. Objects
may refer to one another in a circle. A value refers only to objects and to earlier values.

A recording may come from an untrusted machine. `recall` therefore makes only plain values and
objects of the listed modules of a robot, with the fields of these classes. The bytes can name no
other class, no function and no module. Bounds on size and depth limit the time of a read.

Bytes can be read by the same version of swarmd only, with the same kernels compiled.
"""

from __future__ import annotations

import zlib
from array import array
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from importlib import import_module
from itertools import chain
from math import prod
from pickle import PickleError
from random import Random
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta, MsgspecError, Struct

from swarmd.core.errors import CodecError
from swarmd.core.former_names import present_name
from swarmd.core.kernels import unit_of
from swarmd.core.values import Array
from swarmd.robot.robot import HANDLERS, Robot
from swarmd.robot.setup import RobotSetup

FORMAT = 4
MAX_BYTES = 1 << 22
"""Size of a memory before compression."""
MAX_RATIO = 100
"""Bytes before compression per byte after compression; a robot has a ratio of 8 at most."""
MAX_OBJECTS = 1000
"""Objects in a memory, each with up to 40 kB of buffers; a robot has some 100."""
MAX_DEPTH = 32
"""Nesting depth of values; a robot has 6."""
MAX_SIZE = 1 << 22
"""Parts of all values, nested parts included: a bound on the time that a comparison takes."""
_MAX_KEY = 64  # parts of a dict key or a set member: a bound on the time that its hash takes

_PACKAGES = ("swarmd.robot.",)
_VALUES = frozenset(
    f"swarmd.core.{name}"
    for name in (
        *("arrival_delay", "avoided", "events", "goal", "hazard", "host_messages", "messages"),
        *(
            "message_limits",
            "neighbor_places",
            "odometry_trail",
            "pattern_manifest",
            "record",
            "refusal",
            "kin_message",
            "token_bucket",
            "values",
            "verbs",
        ),
    )
)
"""Modules of the core that contain only values and pure classes."""
_ATOMS = frozenset({bool, float, int, str, type(None)})
_NUMBERS = frozenset({"<f8", "<f4", "<i8", "<i4", "<i2", "|i1", "<u8", "<u4", "<u2", "|u1", "|b1"})
_FAULTS = (
    *(ArithmeticError, AssertionError, AttributeError, BufferError, ImportError, LookupError),
    *(MemoryError, MsgspecError, RuntimeError, TypeError, ValueError, zlib.error),
    PickleError,  # raised by Cython if the checksum of a class's fields differs
)
"""Raised for damaged bytes, and for bytes of another version."""

_Index = Annotated[int, Meta(ge=0)]
_Place = tuple[_Index]
_Part = bool | float | int | str | _Place | None


class _Kind(Struct, frozen=True, array_like=True):
    """The type of a node: a built-in type, or a class with field names or Cython's checksum."""

    name: str
    fields: tuple[str, ...] = ()
    checksum: int = 0


class _Node(Struct, array_like=True):
    """An object or a value: the index of its kind, and its parts."""

    kind: _Index
    parts: list[_Part]


class _Memory(Struct, array_like=True):
    """The serialised state of a robot; node 0 is the robot.

    `numbers`: the contents of all arrays and bytes, joined in the order of their nodes.
    """

    format: int
    kinds: list[_Kind]
    nodes: list[_Node]
    numbers: bytes


def remember(robot: Robot, limit: int = MAX_BYTES) -> bytes:
    """The state of `robot` without its settings; CodecError if it exceeds `limit` bytes."""
    try:
        content = msgspec.msgpack.encode(_Writer(robot).memory())
    except _FAULTS as error:  # for instance for a value of another library
        raise CodecError(f"the memory of the robot cannot be written: {error!r:.300}") from error
    data = zlib.compress(content, 1)
    if len(data) > limit or len(content) > MAX_BYTES:
        raise CodecError(
            f"the memory of the robot has {len(content)} bytes, packed {len(data)}; at most"
            f" {MAX_BYTES}, packed {limit}, fit"
        )
    return data


def recall(data: bytes, setup: RobotSetup) -> Robot:
    """The robot that `remember` serialised, with `setup`; CodecError if it cannot be read."""
    most = min(MAX_BYTES, MAX_RATIO * len(data))
    try:
        packed = zlib.decompressobj()
        content = packed.decompress(data, most)
        if not packed.eof:
            raise ValueError(f"it is cut off, or has more than {most} bytes")
        if content[:1] == b"\x80":  # a pickle begins with this byte
            raise ValueError(f"it has format 1; expected {FORMAT}")
        memory = msgspec.msgpack.decode(content, type=_Memory)
        if memory.format != FORMAT:
            raise ValueError(f"it has format {memory.format}; expected {FORMAT}")
        robot = _Reader(memory, setup).robot()
    except _FAULTS as error:
        raise CodecError(f"no memory of a robot of this version: {error!r:.300}") from error
    return robot


class _Writer:
    """Serialises the state of one robot.

    `_place` adds the node of a value together with its parts. The node of an object gets its parts
    later, in `memory`: objects may refer to one another in a circle, so that no order of nodes has
    all parts before their object.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._kinds: dict[tuple[str, tuple[str, ...], int], int] = {}
        self._nodes: list[_Node] = []
        self._numbers: list[bytes] = []
        self._places: dict[int, tuple[int]] = {}
        # By id: the place of each buffer that is neither a numpy array nor an `array`.
        self._buffers: dict[int, tuple[int]] = {}
        # Keeps written objects alive, so that Python gives their ids to no other object.
        self._kept: list[object] = []
        self._objects: list[tuple[_Node, Any]] = []
        self._classes: dict[type, tuple[str, tuple[str, ...] | None]] = {}

    def memory(self) -> _Memory:
        """The memory of the robot."""
        self._place(self._robot)
        for node, obj in self._objects:  # `_parts` appends further objects to this list
            class_name, _ = self._class_of(type(obj))
            if _unpickler_of(type(obj)) is not None:
                _, (_, checksum, state), *more = obj.__reduce__()
                node.kind = self._kind(class_name, (), checksum)
                node.parts = self._parts(more[0] if more else state)
            else:
                names = (*_slots_of(type(obj)), *getattr(obj, "__dict__", ()))
                node.kind = self._kind(class_name, names)
                node.parts = self._parts([getattr(obj, name) for name in names])
        kinds = [_Kind(*kind) for kind in self._kinds]
        return _Memory(FORMAT, kinds, self._nodes, b"".join(self._numbers))

    def _kind(self, name: str, names: tuple[str, ...] = (), checksum: int = 0) -> int:
        return self._kinds.setdefault((name, names, checksum), len(self._kinds))

    def _class_of(self, kind: type) -> tuple[str, tuple[str, ...] | None]:
        """The name of a class, and its fields if it is a class of values (else None)."""
        if kind not in self._classes:
            module = kind.__module__
            if not _is_ours(module):
                raise ValueError(f"{module}.{kind.__name__} is no part of a robot's memory")
            self._classes[kind] = f"{module}.{kind.__name__}", _fields_of(kind)
        return self._classes[kind]

    def _parts(self, values: Iterable[Any]) -> list[Any]:
        parts = list(values)
        if not _ATOMS.issuperset(map(type, parts)):
            parts = [part if type(part) in _ATOMS else self._place(part) for part in parts]
        return parts

    def _place(self, value: Any) -> tuple[int]:
        """The place of the node of `value`; adds the node if `value` has none yet."""
        known_place = self._places.get(id(value))
        if known_place is not None:
            return known_place
        cls = type(value)
        # `recall` takes the handlers of its own version, and the setup that its caller gives.
        if value is HANDLERS:
            return self._add(value, self._kind("handlers"), [])
        if cls is RobotSetup:
            return self._add(value, self._kind("setup"), [])
        if cls in _TYPES:
            parts_of, _ = _TYPES[cls]
            return self._add(value, self._kind(cls.__name__), self._parts(parts_of(value)))
        if isinstance(value, np.ndarray) or _is_view(value):
            return self._array(value)
        if cls is bytes:
            return self._add_bytes(value)
        if isinstance(value, np.generic):
            parts = self._parts((value.dtype.str, value.tobytes()))
            return self._add(value, self._kind("scalar"), parts)
        return self._add_instance(value)

    def _add_bytes(self, value: bytes) -> tuple[int]:
        """Add a node with the length alone; `_numbers` joins the content of all nodes."""
        self._numbers.append(value)
        return self._add(value, self._kind("bytes"), [len(value)])

    def _add_instance(self, value: Any) -> tuple[int]:
        """Add the node of an instance of a class of swarmd; an object gets its parts later."""
        class_name, field_names = self._class_of(type(value))
        if field_names is None:  # the node is an object
            place = self._add(value, 0, [])
            self._objects.append((self._nodes[-1], value))
            return place
        parts = self._parts([getattr(value, name) for name in field_names])
        return self._add(value, self._kind(class_name, field_names), parts)

    def _add(self, value: object, kind: int, parts: list[Any]) -> tuple[int]:
        place = self._places[id(value)] = (len(self._nodes),)
        self._nodes.append(_Node(kind, parts))
        self._kept.append(value)
        return place

    def _array(self, value: Any) -> tuple[int]:
        """The place of an array, or of a view. A view refers to the node of its base array."""
        base = _base_of(value)
        given = np.asarray(value)
        is_fixed = not given.flags.writeable
        if base is value:
            if not given.flags.forc:
                raise ValueError(f"an array with the strides {given.strides}")
            order = "C" if given.flags.c_contiguous else "F"
            self._numbers.append(given.tobytes("A"))
            parts = [given.dtype.str, is_fixed, order, *given.shape]
            return self._add(value, self._kind("ndarray"), parts)
        has_node = isinstance(base, np.ndarray | array)
        place = self._place(base) if has_node else self._buffer(base)
        start = _address(given) - _address(np.asarray(memoryview(base)))
        parts = [place, start, given.dtype.str, is_fixed, _is_view(value)]
        parts += [*given.shape, *given.strides]
        return self._add(value, self._kind("view"), parts)

    def _buffer(self, base: Any) -> tuple[int]:
        """The place of the bytes of a buffer that is neither a numpy array nor an `array`."""
        if id(base) not in self._buffers:
            self._buffers[id(base)] = self._place(np.array(memoryview(base).cast("B")))
            self._kept.append(base)
        return self._buffers[id(base)]


class _Maker(NamedTuple):
    """How to make the Python object of a node from the node's parts; for one kind of nodes.

    For a kind of values `make(parts)` returns the value. For a kind of objects (`is_of_objects`)
    `make(parts)` returns an object without fields, and the function that sets its fields. The
    fields are set once all objects exist, since objects may refer to one another in a circle.
    """

    is_of_objects: bool
    make: Callable[[list[Any]], Any]


class _MadeObject(NamedTuple):
    """An object without fields, the function that sets its fields, and the parts for them."""

    object: Any
    set_fields: Callable[[Any, list[Any]], None]
    parts: list[Any]


# Count of parts and depth. An object adds nothing to the extent of a value that refers to it.
_EXTENT_OF_OBJECT = (0, 0)


class _Reader:
    """Makes the robot of one memory; raises one of `_FAULTS` for an invalid memory."""

    def __init__(self, memory: _Memory, setup: RobotSetup) -> None:
        self._memory = memory
        self._makers = {
            **{kind.__name__: make for kind, (_, make) in _TYPES.items()},
            "ndarray": self._ndarray,
            "bytes": self._bytes,
            "scalar": lambda parts: np.frombuffer(parts[1], _numbers(parts[0]))[0],
            "view": self._view,
            "setup": lambda parts: setup,
            "handlers": lambda parts: HANDLERS,
        }
        self._at = 0  # the next unread byte of `numbers`
        self._fixed: list[Array] = []  # arrays that become read-only in the end
        self._made: list[Any] = [None] * len(memory.nodes)
        self._extents: list[tuple[int, int] | None] = [None] * len(memory.nodes)
        self._size = 0

    def robot(self) -> Robot:
        """Make the object or value of each node; returns the object of node 0, the robot.

        ValueError or TypeError for invalid bytes, which may come from an untrusted machine.
        """
        # The function that makes an object of each kind, by index.
        makers = [self._maker(kind) for kind in self._memory.kinds]
        objects = self._make_objects(makers)
        self._make_values(makers)
        for made in objects:
            made.set_fields(made.object, self._resolved(made.parts))
        for array_ in self._fixed:
            array_.flags.writeable = False
        # Compiled code does not check indices: an object checks that each index that it has read
        # lies in its arrays.
        for made in objects:
            if hasattr(made.object, "check_indices"):
                made.object.check_indices()
        robot = self._made[0]
        if not isinstance(robot, Robot):
            raise TypeError(f"it is a {type(robot).__name__}; expected a Robot")
        return robot

    def _make_objects(self, makers: list[_Maker]) -> list[_MadeObject]:
        """Make all objects, empty: values and fields of objects may refer to any of them."""
        objects: list[_MadeObject] = []
        for place, node in enumerate(self._memory.nodes):
            maker = makers[node.kind]
            if maker.is_of_objects:
                if len(objects) == MAX_OBJECTS:
                    raise ValueError(f"it has more than {MAX_OBJECTS} objects")
                empty_object, set_fields = maker.make(node.parts)
                self._made[place] = empty_object
                self._extents[place] = _EXTENT_OF_OBJECT
                objects.append(_MadeObject(empty_object, set_fields, node.parts))
        return objects

    def _make_values(self, makers: list[_Maker]) -> None:
        """Make all values in the order of their nodes: a value refers only to earlier values."""
        for place, node in enumerate(self._memory.nodes):
            maker = makers[node.kind]
            if not maker.is_of_objects:
                extent = self._extent(node.parts, self._memory.kinds[node.kind].name)
                self._made[place] = maker.make(self._resolved(node.parts))
                self._extents[place] = extent

    def _resolved(self, parts: list[Any]) -> list[Any]:
        return [self._made[part[0]] if type(part) is tuple else part for part in parts]

    def _extent(self, parts: list[Any], name: str) -> tuple[int, int]:
        """The count of a value's parts, nested parts included, and its nesting depth.

        `parts`: the parts of the value. `name`: its type. Adds the count to `_size`, the total so
        far. ValueError if depth, total or the size of a dict key exceeds its bound: a small
        recording from an untrusted machine must not take long to read, compare or hash.
        """
        size = 1 + len(parts)
        depth = 0
        for number, part in enumerate(parts):
            if type(part) is not tuple:
                continue
            extent = self._extents[part[0]]
            if extent is None:
                raise ValueError("a value is part of itself, or of one before it")
            size = size + extent[0]
            depth = max(depth, extent[1])
            # A key, which is hashed: of a dict every second part, of a set every part.
            if name in _KEYED and number % _KEYED[name] == 0 and extent[0] > _MAX_KEY:
                raise ValueError(f"a key of {extent[0]} parts; at most {_MAX_KEY} are taken")
        self._size += size
        if depth >= MAX_DEPTH or self._size > MAX_SIZE:
            raise ValueError(f"values within values: {depth} deep, of {self._size} parts")
        return size, depth + 1

    def _maker(self, kind: _Kind) -> _Maker:
        """The maker for the nodes of `kind`."""
        if kind.name in self._makers:
            return _Maker(False, self._makers[kind.name])
        cls = _class_named(kind.name)
        names = _fields_of(cls)
        if names is None:
            return _Maker(True, _object_maker(cls, kind))
        if names != kind.fields:
            raise ValueError(f"{kind.name} has the fields {kind.fields}; expected {names}")
        return _Maker(False, partial(_value, cls, names))

    def _bytes(self, parts: list[Any]) -> bytes:
        """The next bytes of `numbers`; the only part is their count."""
        (size,) = parts
        at = self._at
        numbers = self._memory.numbers
        if not 0 <= size <= len(numbers) - at:
            raise ValueError(f"{size} bytes of numbers; {len(numbers) - at} are left")
        self._at += size
        return numbers[at : at + size]

    def _ndarray(self, parts: list[Any]) -> Array:
        kind, is_fixed, order, *shape = parts
        numbers = _numbers(kind)
        content = self._bytes([numbers.itemsize * prod(shape)])
        made = np.frombuffer(content, numbers).reshape(shape, order=order).copy(order)
        if is_fixed:
            self._fixed.append(made)
        return made

    def _view(self, parts: list[Any]) -> Any:
        base, start, kind, is_fixed, is_view, *spans = parts
        half = len(spans) // 2
        if isinstance(base, np.ndarray) and not base.flags.c_contiguous:
            base = base.T
        made: Any = np.ndarray(spans[:half], _numbers(kind), base, start, spans[half:])
        if made.nbytes > memoryview(base).nbytes:  # with strides of 0 few bytes fill a huge array
            raise ValueError(f"a view of {made.nbytes} bytes beyond its array")
        if is_view:
            return memoryview(made).toreadonly() if is_fixed else memoryview(made)
        if is_fixed:
            self._fixed.append(made)
        return made


def _is_ours(module: str) -> bool:
    """True if a memory may contain objects of the classes of `module`."""
    return module in _VALUES or (module.startswith(_PACKAGES) and module != __name__)


def _class_named(name: str) -> type:
    module, _, title = name.rpartition(".")
    module = present_name(module)  # a recording of 0.2.0 has former names
    cls = None
    if _is_ours(module):
        try:
            cls = vars(import_module(module)).get(title)
        except ModuleNotFoundError:
            raise ValueError(f"{name} was compiled there, and is interpreted here") from None
    # The names of a module include imported classes, such as Path, which writes files.
    if not isinstance(cls, type) or cls.__module__ != module:
        raise ValueError(f"{name} is no part of a robot's memory")
    return cls


def _fields_of(kind: Any) -> tuple[str, ...] | None:
    """The fields of a class of values; None for a class of objects."""
    if issubclass(kind, Struct):
        return tuple(kind.__struct_fields__)
    if issubclass(kind, Enum):
        return ("value",)
    if issubclass(kind, tuple):
        return tuple(kind._fields)  # the fields of a NamedTuple
    if not kind.__dictoffset__ and is_dataclass(kind):
        return tuple(field.name for field in fields(kind))
    return None


def _value(kind: Any, names: tuple[str, ...], parts: list[Any]) -> Any:
    """A value of a class, from its fields."""
    if len(parts) != len(names):
        raise ValueError(f"{len(parts)} fields of {kind.__name__}; expected {len(names)}")
    if issubclass(kind, Enum):
        return kind(parts[0])
    if issubclass(kind, Struct | tuple):
        return kind(**dict(zip(names, parts, strict=True)))
    value = object.__new__(kind)
    for name, part in zip(names, parts, strict=True):
        object.__setattr__(value, name, part)
    return value


def _object_maker(kind: type, row: _Kind) -> Callable[[list[Any]], Any]:
    """The function that makes an empty object of `kind`, with the function that sets its fields."""
    make = _unpickler_of(kind)
    if make is not None:
        return lambda parts: (make(kind, row.checksum, None), _set_state)
    if row.checksum:
        raise ValueError(f"{row.name} was compiled there, and is interpreted here")
    slots = _slots_of(kind)
    if row.fields[: len(slots)] != slots:
        raise ValueError(f"{row.name} has the fields {row.fields}; expected {slots}")
    return lambda parts: (object.__new__(kind), partial(_set_fields, slots, row.fields))


def _unpickler_of(kind: type) -> Callable[[type, int, None], Any] | None:
    """Cython's function that makes an empty object of a compiled class; None if interpreted."""
    bases = ((unit_of(base.__module__), f"__pyx_unpickle_{base.__name__}") for base in kind.__mro__)
    return next((getattr(module, name) for module, name in bases if hasattr(module, name)), None)


def _slots_of(kind: type) -> tuple[str, ...]:
    return tuple(name for base in kind.__mro__ for name in vars(base).get("__slots__", ()))


def _set_fields(slots: tuple[str, ...], names: tuple[str, ...], obj: Any, parts: list[Any]) -> None:
    values = dict(zip(names, parts, strict=True))
    for name in slots:
        object.__setattr__(obj, name, values.pop(name))
    if values:
        vars(obj).update(values)


def _set_state(obj: Any, parts: list[Any]) -> None:
    obj.__setstate__(tuple(parts))


def _items_of(mapping: Mapping[Any, Any]) -> Iterable[Any]:
    return chain.from_iterable(mapping.items())


def _mapping(parts: list[Any]) -> dict[Any, Any]:
    return dict(zip(parts[::2], parts[1::2], strict=True))


def _state_of(random: Random) -> tuple[Any, ...]:
    version, words, last = random.getstate()
    return version, np.array(words, "<u4").tobytes(), last


def _random(parts: list[Any]) -> Random:
    version, words, last = parts
    random = Random()
    random.setstate((version, tuple(np.frombuffer(words, "<u4").tolist()), last))
    return random


def _array(parts: list[Any]) -> array[Any]:
    code, content = parts
    if code not in tuple("bBhHiIlLqQfd"):
        raise ValueError(f"an array of {code!r}; expected numbers")
    return array(code, content)


def _numbers(kind: str) -> np.dtype[Any]:
    """The numpy dtype of a listed number type; never dtype object, whose bytes are pointers."""
    if kind not in _NUMBERS:
        raise ValueError(f"an array of {kind!r}; expected numbers")
    return np.dtype(kind)


def _is_view(obj: Any) -> bool:
    """True for a memoryview of Python or of Cython."""
    return type(obj).__name__ in ("memoryview", "_memoryviewslice")


def _base_of(obj: Any) -> Any:
    """The object that owns the bytes of an array or a view."""
    while True:
        if _is_view(obj):
            obj = obj.obj if isinstance(obj, memoryview) else obj.base
        elif isinstance(obj, np.ndarray) and obj.base is not None:
            obj = obj.base
        else:
            return obj


def _address(given: Array) -> int:
    return int(given.__array_interface__["data"][0])


_TYPES: Mapping[type, tuple[Callable[[Any], Iterable[Any]], Callable[[list[Any]], Any]]] = {
    list: (iter, list),
    tuple: (iter, tuple),
    set: (iter, set),
    frozenset: (iter, frozenset),
    dict: (_items_of, _mapping),
    Counter: (_items_of, lambda parts: Counter(_mapping(parts))),
    MappingProxyType: (_items_of, lambda parts: MappingProxyType(_mapping(parts))),
    deque: (lambda value: (value.maxlen, *value), lambda parts: deque(parts[1:], parts[0])),
    Random: (_state_of, _random),
    array: (lambda value: (value.typecode, value.tobytes()), _array),
}
"""By built-in type: the function that splits a value into parts, and its inverse."""
_KEYED = {"dict": 2, "Counter": 2, "mappingproxy": 2, "set": 1, "frozenset": 1}
"""By type: every n-th part, from the first, is hashed (the keys of a dict, all of a set)."""
