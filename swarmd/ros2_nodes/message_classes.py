"""Message and service classes of one robot, as rclpy makes them from `.msg` and `.srv` files.

The definitions of the common packages come with rosbags (those of Jazzy). Those of other packages
are read from `<package>/msg/*.msg` and `<package>/srv/*.srv` below the folders of the nodes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from swarmd.core.errors import ConfigError, unknown
from swarmd.ros2_nodes.field_types import (
    FieldType,
    array_type,
    base_type,
    message_type,
    sequence_type,
)
from swarmd.ros2_nodes.node_files import NodeFiles
from swarmd.ros2_nodes.refusal import one_line
from swarmd.settings import yamlfile

_COMMON_SERVICES: Mapping[str, str] = {
    "std_srvs/srv/Empty": "---",
    "std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message",
    "std_srvs/srv/Trigger": "---\nbool success\nstring message",
}
_COMMON_DEFAULTS: Mapping[str, Mapping[str, Any]] = {"geometry_msgs/msg/Quaternion": {"w": 1.0}}
"""The only defaults of the common packages; rosbags does not keep them."""
_DEFAULT = re.compile(r"\s*[\w/<>=\[\]]+\s+(\w+)\s+([^=\s#][^#]*)")
_SPLIT = re.compile(r"^---\s*$", re.MULTILINE)
_SUFFIXES = (".msg", ".srv")
_FIELD = re.compile(r"(?!.*__)[a-z][a-z0-9_]*(?<!_)")
"""The names that fields of ROS 2 may have."""
_MAX_SIZE = 1_000_000
"""Values of a new message: its arrays of a fixed length have all of theirs."""
_MAX_TEXT = 64 * 1024
"""Bytes of a definition."""
_MAX_DEPTH = 16
"""Messages within messages; a definition that contains itself ends here."""


class Definition(NamedTuple):
    """The constants of a message type, its fields as rosbags parses them, and their defaults."""

    constants: Sequence[tuple[str, str, Any]]
    fields: Sequence[tuple[str, Any]]
    defaults: Mapping[str, Any] = MappingProxyType({})


class Message:
    """The base of all message classes; see `MessageClasses.kind`."""

    __slots__ = ()
    TYPE: str
    FIELDS: Mapping[str, FieldType]
    SIZE: int

    def __init__(self, **values: Any) -> None:
        """Set the given fields, and the others to their defaults."""
        assert values.keys() <= self.FIELDS.keys(), (
            "Invalid arguments passed to constructor: "
            f"{', '.join(sorted(values.keys() - self.FIELDS.keys()))}"
        )
        for name, field in self.FIELDS.items():
            if name in values:
                setattr(self, name, values[name])
            else:
                object.__setattr__(self, name, field.default())

    def __setattr__(self, name: str, value: Any) -> None:
        field = self.FIELDS.get(name)
        if field is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        object.__setattr__(self, name, field.check(name, value))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, type(self)):
            return False
        return all(_is_equal(getattr(self, name), getattr(other, name)) for name in self.FIELDS)

    __hash__ = None  # type: ignore[assignment]  # as rclpy's: a message can change

    def __repr__(self) -> str:
        package, _, name = self.TYPE.partition("/msg/")
        values = ", ".join(f"{field}={getattr(self, field)!r}" for field in self.FIELDS)
        return f"{package}.msg.{name}({values})"

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """The text of the type of each field."""
        return {name: field.text for name, field in cls.FIELDS.items()}

    @classmethod
    def copied(cls, message: Message) -> Message:
        """What a subscriber gets of a published message: a copy, its float32 rounded."""
        made = cls.__new__(cls)
        for name, field in cls.FIELDS.items():
            object.__setattr__(made, name, field.copy(getattr(message, name)))
        return made

    @classmethod
    def plain(cls, message: Message) -> list[Any]:
        """The fields in their order, of MessagePack's types."""
        return [field.plain(getattr(message, name)) for name, field in cls.FIELDS.items()]

    @classmethod
    def of_plain(cls, values: Any) -> Message:
        """The message of values that `plain` has given.

        ValueError, TypeError or AssertionError for others.
        """
        if not isinstance(values, list | tuple):
            raise TypeError(f"expected the fields of {cls.TYPE} as a list")
        made = cls.__new__(cls)
        for (name, field), value in zip(cls.FIELDS.items(), values, strict=True):
            setattr(made, name, field.read(value))
        return made


_TAKEN = frozenset({"TYPE", "FIELDS", "SIZE"})
"""Names of constants that a class of messages has itself."""


class MessageClasses:
    """The message classes of one robot by name; made when they are first asked for.

    `folders`: below them lie packages with `msg/*.msg` and `srv/*.srv`.
    """

    def __init__(self, files: NodeFiles, folders: Sequence[Path]) -> None:
        self._files = files
        self._paths = _definition_files(files, folders)
        names = (*_COMMON_SERVICES, *self._paths)
        self._packages = _common_packages() | {name.partition("/")[0] for name in names}
        self._kinds: dict[str, type[Message]] = {}
        self._services: dict[str, type] = {}

    def has_package(self, package: str) -> bool:
        """Whether a package has message or service types."""
        return package in self._packages

    def is_known(self, name: str) -> bool:
        """Whether there is a type `package/msg/Name` or `package/srv/Name`."""
        return name in _common() or name in _COMMON_SERVICES or name in self._paths

    def kind(self, name: str) -> type[Message]:
        """The class of `package/msg/Name`; ConfigError in one line without such a type."""
        return self._kind(name, 0)

    def service(self, name: str) -> type:
        """The class of `package/srv/Name`, with `Request` and `Response`; ConfigError."""
        if name not in self._services:
            source = _COMMON_SERVICES.get(name)
            if source is None:
                if name not in self._paths:
                    raise ConfigError(self._unknown(name, "service"))
                source = self._text(name)
            parts = _SPLIT.split(source)
            if len(parts) != 2:
                raise ConfigError(f"{name}: expected a request, a line `---` and a response")
            members = {
                end: self._made(f"{name}_{end}", _parsed(f"{name}_{end}", text), 0)
                for end, text in zip(("Request", "Response"), parts, strict=True)
            }
            self._services[name] = type(name.rpartition("/")[2], (), members)
        return self._services[name]

    def _kind(self, name: str, depth: int) -> type[Message]:
        if name not in self._kinds:
            if depth > _MAX_DEPTH:
                raise ConfigError(f"{name} contains itself")
            self._kinds[name] = self._made(name, self._definition(name), depth)
        return self._kinds[name]

    def _definition(self, name: str) -> Definition:
        if name in self._paths:  # of the nodes' own sources first, as on a robot
            return _parsed(name, self._text(name))
        if name in _common():
            constants, fields = _common()[name]
            return Definition(constants, fields, _COMMON_DEFAULTS.get(name, {}))
        raise ConfigError(self._unknown(name, "message"))

    def _text(self, name: str) -> str:
        text = self._files.read(self._paths[name])
        if len(text) > _MAX_TEXT:
            raise ConfigError(f"{name}: has {len(text)} bytes; expected {_MAX_TEXT} or less")
        return text.decode(errors="replace")

    def _unknown(self, name: str, what: str) -> str:
        known = [one for one in (*_common(), *self._paths) if one.partition("/")[2][:3] in name]
        text = unknown(f"{what} type", name, known)
        text = text.partition("; there are:")[0]
        return f"{text}; name the folder of its package in `path` of the launch file"

    def _made(self, name: str, definition: Definition, depth: int) -> type[Message]:
        fields: dict[str, FieldType] = {}
        size = 0
        members: dict[str, Any] = {constant: value for constant, _, value in definition.constants}
        for field, node in definition.fields:
            if field == "structure_needs_at_least_one_member":
                continue
            if not _FIELD.fullmatch(field):
                raise ConfigError(f"{name}: {field!r} is no name of a field, such as `max_speed`")
            if field in fields or field in members or hasattr(Message, field):
                raise ConfigError(f"{name}: the name {field!r} is taken; rename the field")
            fields[field] = self._checked(name, field, node, definition.defaults, depth)
            size += self._size(node, depth)
            if size > _MAX_SIZE:
                raise ConfigError(
                    f"{name}: {field}: a message has {size} values; expected {_MAX_SIZE} or less"
                )
        if not members.keys().isdisjoint(_TAKEN):
            raise ConfigError(f"{name}: {' and '.join(sorted(_TAKEN))} are no names of constants")
        members |= {"__slots__": tuple(fields), "TYPE": name, "FIELDS": fields}
        members["SIZE"] = size
        members["__module__"] = ".".join(name.split("/")[:2])
        return type(name.rpartition("/")[2], (Message,), members)

    def _checked(
        self, name: str, field: str, node: Any, defaults: Mapping[str, Any], depth: int
    ) -> FieldType:
        """The type of a field; ConfigError for a default that it cannot have."""
        default = defaults.get(field)
        kind, detail = node
        inner = node if kind in (Nodetype.BASE, Nodetype.NAME) else detail[0]
        if kind == Nodetype.ARRAY and detail[1] < 1:
            raise ConfigError(f"{name}: {field}: an array of {detail[1]}; expected 1 or more")
        if inner[0] == Nodetype.NAME and not self.is_known(inner[1]):
            raise ConfigError(f"{name}: {field}: {self._unknown(inner[1], 'message')}")
        try:
            made = self._field(node, default, depth)
            return made if default is None else _with_default(made, field, default)
        except (AssertionError, ValueError, TypeError, OverflowError) as error:
            text = yamlfile.brief(default)
            raise ConfigError(f"{name}: {field}: {text} is no default: {error}") from None

    def _size(self, node: Any, depth: int) -> int:
        """The values of a field of a new message."""
        kind, detail = node
        if kind == Nodetype.NAME:
            return self._kind(detail, depth + 1).SIZE
        if kind == Nodetype.ARRAY:
            inner, length = detail
            return max(1, int(length) * self._size(inner, depth))
        return 1

    def _field(self, node: Any, default: Any, depth: int) -> FieldType:
        kind, detail = node
        if kind == Nodetype.BASE:
            name, bound = detail
            return base_type(name, bound=bound, default=default)
        if kind == Nodetype.NAME:
            inner = self._kind(detail, depth + 1)
            return message_type(detail.replace("/msg/", "/"), inner)
        inner_node, length = detail
        item = self._field(inner_node, None, depth)
        if kind == Nodetype.ARRAY:
            return array_type(item, length)
        return sequence_type(item, length)


@lru_cache(maxsize=1)
def _common() -> Mapping[str, Any]:
    """The definitions that come with rosbags, by the full name; reading them takes 90 ms."""
    return get_typestore(Stores.ROS2_JAZZY).fielddefs


@lru_cache(maxsize=1)
def _common_packages() -> frozenset[str]:
    """The packages whose definitions come with rosbags."""
    return frozenset(name.partition("/")[0] for name in _common())


def _definition_files(files: NodeFiles, folders: Sequence[Path]) -> dict[str, Path]:
    """The `.msg` and `.srv` files below the folders, by the full name of their type."""
    found: dict[str, Path] = {}
    for folder in folders:
        for path in files.listed(folder, _SUFFIXES):
            kind = path.parent.name
            if kind == path.suffix[1:]:
                found.setdefault(f"{path.parent.parent.name}/{kind}/{path.stem}", path)
    return found


def _parsed(name: str, text: str) -> Definition:
    # As rosbags names the types of a service, which it knows as messages.
    parsed_name = name.replace("/srv/", "/msg/")
    try:
        constants, fields = get_types_from_msg(f"{text}\n", parsed_name)[parsed_name]
    except (TypesysError, ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
        fault = one_line(" ".join(str(error).split()))[:120] or "is no definition of a message"
        raise ConfigError(f"{name}: {fault}") from None
    defaults = {}
    for line in text.splitlines():
        match = _DEFAULT.fullmatch(line.partition("#")[0].rstrip())
        if match:
            defaults[match[1]] = _value(match[2].strip())
    return Definition(constants, fields, defaults)


def _value(text: str) -> Any:
    """The default in a definition: a bool, a number, or a text with or without quotes."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text.strip("\"'")


def _with_default(kind: FieldType, name: str, default: Any) -> FieldType:
    """The type with a default that it has checked; lists are written as in `int32[] x [1, 2]`.

    AssertionError, ValueError or TypeError for another one.
    """
    if not kind.text.endswith(("]", ">")):
        is_whole = kind.text.startswith(("int", "uint"))
        if kind.text == "bool" and default not in (True, False):
            raise ValueError("expected true or false")
        if is_whole and type(default) is not int:
            raise ValueError("expected a whole number")
        kind.check(name, kind.default())
        return kind
    values = yamlfile.read_value(default) if isinstance(default, str) else default
    if kind.text.startswith(("float", "sequence<float")) and isinstance(values, list):
        values = [float(one) for one in values]
    kept = kind.check(name, values)
    return kind._replace(default=lambda: kind.copy(kept))


def _is_equal(here: Any, there: Any) -> bool:
    is_same = here == there
    return bool(is_same.all()) if hasattr(is_same, "all") else bool(is_same)
