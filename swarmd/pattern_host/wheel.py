"""Inspects wheels of pushed patterns, and packs the folder of a pattern as a wheel.

A wheel is a zip of pure Python with exactly one entry point of the group `swarmd.patterns` (PyPA:
binary distribution format). No code of the wheel is executed here.
"""

from __future__ import annotations

import ast
import io
import os
import stat
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from email.parser import HeaderParser
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from swarmd.core.errors import PluginError
from swarmd.core.files import read_regular
from swarmd.core.keys import is_id
from swarmd.plugins import PATTERN_FILE, PATTERNS, class_name, parsed

MAX_FILES = 500
MAX_UNPACKED = 8 * 1024 * 1024
MAX_METADATA = 256 * 1024
_NATIVE = (".so", ".pyd", ".dll", ".dylib")
# Modules that a pattern host has imported before a pushed pattern is loaded.
_TAKEN = sys.stdlib_module_names | {"swarmd", "numpy", "msgspec", "msgpack"}


class WheelPattern(NamedTuple):
    """The pattern of a wheel: its name, the version of the wheel, and `module:Class`."""

    name: str
    version: str
    value: str


def inspect_wheel(content: bytes, label: str) -> WheelPattern:
    """The pattern of a wheel; PluginError in one line, which begins with `label`, for a fault.

    Refused: native code, names outside the wheel's folder, data files outside packages, modules
    that would hide imported modules, and more than MAX_FILES files or MAX_UNPACKED bytes.
    """
    with _opened(content, label) as archive:
        _check_files(archive, label)
        about = _about(archive, label)
        wheel = _headers(archive, about / "WHEEL", label)
        if wheel.get("Root-Is-Purelib", "").lower() != "true":
            raise PluginError(f"{label} has native code; only wheels of pure Python are sent")
        version = _headers(archive, about / "METADATA", label).get("Version", "")
        points = _entry_points(archive, about / "entry_points.txt", label)
    if len(points) != 1:
        names = ", ".join(sorted(points.names)) or "none"
        raise PluginError(
            f"{label} must declare exactly one entry point of {PATTERNS}; it declares {names}"
        )
    point = next(iter(points))
    is_class = point.pattern.fullmatch(point.value) and point.module and point.attr
    if not is_id(point.name) or not is_class:
        raise PluginError(f"{label} declares {point.name} = {point.value}; expected module:Class")
    return WheelPattern(point.name, version[:32], f"{point.module}:{point.attr}")


def packed_folder(folder: Path, name: str) -> bytes:
    """A wheel with the files of the folder of the pattern `name`; equal files give equal bytes.

    All files count but hidden ones and caches of compiled code, and so does the wheel's digest. The
    folder becomes the package `swarmd_pushed_<name>`. PluginError in one line if it is not clear
    which class is the pattern, or if `inspect_wheel` refuses the wheel.
    """
    package = f"swarmd_pushed_{name}"
    about = f"{package}-0.dist-info"
    value = f"{package}.{PATTERN_FILE.removesuffix('.py')}:{_class_in(folder / PATTERN_FILE, name)}"
    files = {f"{package}/{path.relative_to(folder).as_posix()}": path for path in _files(folder)}
    size = sum(path.stat().st_size for path in files.values())
    if size > MAX_UNPACKED:
        raise PluginError(f"{folder} has {size} bytes; at most {MAX_UNPACKED} are taken")
    contents = {inside: read_regular(path) for inside, path in files.items()}
    contents.setdefault(f"{package}/__init__.py", b"")
    contents[f"{about}/METADATA"] = f"Metadata-Version: 2.1\nName: {package}\n".encode()
    contents[f"{about}/WHEEL"] = b"Wheel-Version: 1.0\nRoot-Is-Purelib: true\n"
    contents[f"{about}/entry_points.txt"] = f"[{PATTERNS}]\n{name} = {value}\n".encode()
    buffer = io.BytesIO()
    # Not compressed: other versions of zlib would give other bytes.
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for inside, content in sorted(contents.items()):
            archive.writestr(zipfile.ZipInfo(inside), content)
    return buffer.getvalue()


def _files(folder: Path) -> Iterator[Path]:
    """The regular files below a folder, without hidden ones and caches of compiled code."""
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(one for one in folders if not one.startswith((".", "__pycache__")))
        for file in sorted(files):
            path = Path(place, file)
            if not file.startswith(".") and path.is_file():
                yield path


def _class_in(file: Path, name: str) -> str:
    """The class of the pattern `name` in its file, by the source: no code is executed.

    It is the only class that derives from a class called `...Pattern` and is no base of another
    such class, or else the class that has the name of the pattern.
    """
    source = read_regular(file)
    bases_of: dict[str, set[str]] = {}
    for node in parsed(source, file).body:
        if isinstance(node, ast.ClassDef):
            written = [one.value if isinstance(one, ast.Subscript) else one for one in node.bases]
            bases_of[node.name] = {ast.unparse(one).rpartition(".")[2] for one in written}
    kinds: set[str] = set()  # the classes of patterns
    for kind, bases in bases_of.items():
        if any(base.endswith("Pattern") or base in kinds for base in bases):
            kinds.add(kind)
    last = [kind for kind in kinds if not any(kind in bases_of[other] for other in kinds)]
    if len(last) == 1:
        return last[0]
    if (usual := class_name(name)) in bases_of:
        return usual
    raise PluginError(f"{file}: which class is the pattern is not clear; call it {usual}")


@contextmanager
def _opened(content: bytes, label: str) -> Iterator[zipfile.ZipFile]:
    """The opened archive; in the block, errors of a damaged archive become a PluginError."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            yield archive
    except (PluginError, OSError):
        raise
    except Exception as error:  # a damaged archive makes zipfile and zlib raise anything
        text = " ".join(str(error).split())
        raise PluginError(f"{label} is no wheel: {text}") from error


def _check_files(archive: zipfile.ZipFile, label: str) -> None:
    """PluginError if a robot may not unpack the files of a wheel; `label`: the wheel."""
    files = [info for info in archive.infolist() if not info.is_dir()]
    size = sum(info.file_size for info in files)
    if len(files) > MAX_FILES or size > MAX_UNPACKED:
        raise PluginError(
            f"{label} has {len(files)} files of {size} bytes;"
            f" at most {MAX_FILES} of {MAX_UNPACKED} are taken"
        )
    paths = {PurePosixPath(info.filename) for info in files}
    folders = {folder for path in paths for folder in path.parents}
    if both := sorted(map(str, paths & folders)):
        raise PluginError(f"{label} has the file {both[0]!r}, which is also a folder")
    for info in files:
        _check_file(info, label)
        _read(archive, info, label)  # PluginError if the content is damaged


def _check_file(info: zipfile.ZipInfo, label: str) -> None:
    """PluginError for a file that a robot may not unpack.

    Refused: files outside the folder of the wheel, links, native code, and modules that would hide
    modules of the robot.
    """
    path = PurePosixPath(info.filename)
    is_relative = bool(path.parts) and not path.is_absolute() and ".." not in path.parts
    is_inside = is_relative and "\\" not in info.filename
    # The upper 16 bits of the attributes are the Unix mode. A link could point anywhere.
    is_link = stat.S_ISLNK(info.external_attr >> 16)
    if not is_inside or is_link or not info.filename.isprintable():
        raise PluginError(f"{label} has the file {info.filename!r}, which lies elsewhere")
    if path.suffix.lower() in _NATIVE or ".so." in path.name:
        raise PluginError(f"{label} has native code: {info.filename}")
    top_name = path.parts[0]
    if top_name.removesuffix(".py") in _TAKEN:
        raise PluginError(f"{label} would hide a module of that name: {info.filename}")
    if top_name.endswith(".data"):  # an installer moves such files to other folders
        raise PluginError(f"{label} has files outside its packages: {info.filename}")


def _about(archive: zipfile.ZipFile, label: str) -> PurePosixPath:
    tops = {PurePosixPath(name).parts[0] for name in archive.namelist() if "/" in name}
    infos = [name for name in tops if name.endswith(".dist-info")]
    if len(infos) != 1:
        raise PluginError(f"{label} is no wheel: it needs one folder .dist-info")
    return PurePosixPath(infos[0])


def _text(archive: zipfile.ZipFile, path: PurePosixPath, label: str) -> str:
    try:
        info = archive.getinfo(str(path))
    except KeyError:
        raise PluginError(f"{label} is no wheel: it lacks {path}") from None
    if info.file_size > MAX_METADATA:
        raise PluginError(f"{label}: {path} has more than {MAX_METADATA} bytes")
    return _read(archive, info, label).decode(errors="replace")


def _read(archive: zipfile.ZipFile, info: zipfile.ZipInfo, label: str) -> bytes:
    # zipfile reads at most the size that the head states, whereas an import reads the whole file:
    # a greater stated size makes zipfile show a false one.
    larger = copy(info)
    larger.file_size += 1
    with archive.open(larger) as file:
        content = file.read()
    if len(content) != info.file_size:
        raise PluginError(f"{label}: {info.filename} has not the size that its head states")
    return content


def _headers(archive: zipfile.ZipFile, path: PurePosixPath, label: str) -> dict[str, str]:
    return dict(HeaderParser().parsestr(_text(archive, path, label)).items())


def _entry_points(archive: zipfile.ZipFile, path: PurePosixPath, label: str) -> EntryPoints:
    if str(path) not in archive.namelist():
        return EntryPoints(())
    from configparser import ConfigParser  # 2 ms, and few daemons get a wheel
    from configparser import Error as ParserError

    parser = ConfigParser(delimiters=("=",), interpolation=None, strict=False)
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # names keep their case
    try:
        parser.read_string(_text(archive, path, label))
    except ParserError as error:
        raise PluginError(f"{label}: {path} cannot be read: {error}") from error
    points = parser.items(PATTERNS) if parser.has_section(PATTERNS) else ()
    return EntryPoints(EntryPoint(name, value, PATTERNS) for name, value in points)
