"""Message types by name: those of a ROS distribution, and a vendor's from its `.msg` files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from swarmd.core.errors import ConfigError
from swarmd.core.files import user_path
from swarmd.drivers.ros.cdr import STORE, store

_TYPE = re.compile(r"([A-Za-z]\w*)/(?:msg/)?([A-Za-z]\w*)", re.ASCII)
_CONSTANT = re.compile(r"\s*(\w+)\s+(\w+)\s*=\s*(.*?)\s*")
_MAX_SHOWN = 60


class MessageTypes:
    """The message types of a distribution and of the packages in `folders`.

    A folder is a package with `msg/*.msg`, or has such packages in it. A type of the distribution
    comes before a file of the same name. Files are read when their type is first asked for.
    """

    def __init__(self, distro: Stores, folders: Sequence[str] = ()) -> None:
        """ConfigError for a folder without `.msg` files."""
        self._distro = distro
        self._folders = [_folder(folder) for folder in folders]
        self._store = get_typestore(distro) if folders else store(distro)

    @property
    def is_ros1(self) -> bool:
        """True for the types of ROS 1."""
        return self._distro is Stores.ROS1_NOETIC

    @property
    def fielddefs(self) -> Mapping[str, Any]:
        """The constants and fields of each type that is known so far, by its full name."""
        return self._store.fielddefs

    def kind(self, name: str) -> type:
        """The class of `package/Name` or `package/msg/Name`; ConfigError for an unknown type.

        An error in a file names the file and, as far as known, the line.
        """
        match = _TYPE.fullmatch(name)
        full = f"{match[1]}/msg/{match[2]}" if match else name
        if full not in self._store.types:
            if not match or self._file(full) is None:
                raise ConfigError(self._unknown(name))
            self._add(full)
        kind: type = self._store.types[full]
        return kind

    def _add(self, full: str) -> None:
        found: dict[str, Any] = {}
        self._read(full, found, ())
        try:
            self._store.register({name: ([], fields) for name, (_, fields) in found.items()})
        except TypesysError as error:
            raise ConfigError(f"{self._file(full)}: {_line(str(error))}") from None
        for name, (constants, _) in found.items():
            self._store.fielddefs[name] = constants, self._store.fielddefs[name][1]
            setattr(self._store.types[name], STORE, self._store)

    def _read(self, full: str, found: dict[str, Any], above: tuple[str, ...]) -> None:
        """Add the definitions of a type, and of those in it that are not known yet."""
        path = self._file(full)
        assert path is not None
        try:
            text = path.read_text(errors="replace")  # comments may be in any encoding
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror}") from None
        constants, fields = _parsed(full, text, path, is_ros1=self.is_ros1)
        for _, node in fields:
            # rosbags' node of a field: (kind, detail), of a list (kind, (item, length)).
            kind, detail = node[1][0] if node[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else node
            if kind is not Nodetype.NAME or detail in self._store.types or detail in found:
                continue
            if detail in (*above, full):
                raise ConfigError(f"{_place(path, text, detail)}: {_short(detail)} contains itself")
            if self._file(detail) is None:
                raise ConfigError(f"{_place(path, text, detail)}: {self._unknown(_short(detail))}")
            self._read(detail, found, (*above, full))
        found[full] = constants, fields

    def _file(self, full: str) -> Path | None:
        """Where a type is defined; None if no folder has it."""
        package, _, rest = full.partition("/")
        for root in self._folders:
            for folder in (root / package, *([root] if root.name == package else ())):
                file: Path = folder / f"{rest}.msg"
                if file.is_file():
                    return file
        return None

    def _unknown(self, name: str) -> str:
        """One line of at most 200 characters for a type that is not known, with the nearest."""
        names = [_short(one) for one in self._store.types]
        names += [_short(one) for root in self._folders for one in _types_in(root)]
        shown = name if len(name) <= _MAX_SHOWN else f"{name[:_MAX_SHOWN]}..."
        close = get_close_matches(name.replace("/msg/", "/")[:_MAX_SHOWN], names, n=1)
        if close:
            return f"no message type {shown!r}; did you mean {close[0]!r}?"
        ros, _, distro = self._distro.value.partition("_")
        known = f"ROS {ros[-1]} {distro.title()}"
        return f"no message type {shown!r} in {known}; name its package's folder in message_path"


def _folder(given: str) -> Path:
    path = user_path(given)
    if not path.is_absolute():
        raise ConfigError(f"message_path is {given!r}; expected a path from / or ~")
    if next(_types_in(path), None) is None:
        raise ConfigError(f"message_path is {given!r}; expected packages with msg/*.msg there")
    return path


def _types_in(root: Path) -> Iterator[str]:
    """The full names of the types in a folder."""
    for file in (*root.glob("msg/*.msg"), *root.glob("*/msg/*.msg")):
        yield f"{file.parent.parent.name}/msg/{file.stem}"


def _parsed(full: str, text: str, path: Path, *, is_ros1: bool) -> tuple[Any, Any]:
    """Constants and fields of a definition.

    Constants are kept as text, since ROS 1 computes a type's md5 sum of the text, and rosbags
    refuses some of their names. A `char` becomes a `uint8`, as in the type hash of ROS 2.
    """
    lines = text.splitlines()
    constants = [_CONSTANT.fullmatch(line) for line in lines]
    rest = ["" if one else line for line, one in zip(lines, constants, strict=True)]
    try:
        _, fields = get_types_from_msg("\n".join(rest) + "\n", full)[full]
    except TypesysError:
        number = next((n for n, line in enumerate(rest, 1) if not _is_line(line)), 1)
        raise ConfigError(
            f"{path}:{number}: {_cut(rest[number - 1])!r} is no field of a message"
        ) from None
    if not is_ros1:
        fields = [(name, _without_char(node)) for name, node in fields]
    return [_constant(one) for one in constants if one], fields


def _is_line(line: str) -> bool:
    try:
        get_types_from_msg(line + "\n", "one/msg/Line")
    except TypesysError:
        return False
    return True


def _constant(match: re.Match[str]) -> tuple[str, str, str]:
    kind, name, value = match.groups()
    return name, kind, value if kind == "string" else value.partition("#")[0].strip()


def _without_char(node: Any) -> Any:
    kind, detail = node
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return kind, (_without_char(detail[0]), detail[1])
    return (kind, ("uint8", 0)) if node == (Nodetype.BASE, ("char", 0)) else node


def _place(path: Path, text: str, full: str) -> str:
    """File and line of the field that has a type."""
    name = full.rpartition("/")[2]
    wanted = re.compile(rf"\s*(?:\w+/)*{name}\b")
    number = next((n for n, line in enumerate(text.splitlines(), 1) if wanted.match(line)), 0)
    return f"{path}:{number}" if number else str(path)


def _short(full: str) -> str:
    return full.replace("/msg/", "/")


def _line(text: str) -> str:
    return _cut(" ".join(text.split()))


def _cut(text: str) -> str:
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."
