"""Finds installed patterns, drivers, emulators and verbs by name; imports no pattern.

Plugins are declared by entry points (`swarmd.patterns`, `swarmd.drivers`, `swarmd.emulators`,
`swarmd.commands`). A pattern is

1. an entry of `swarmd.patterns` that names a class,
2. a folder `<name>` in a package that an entry of `swarmd.patterns` names, with a file `pattern.py`
   that has the class of the pattern,
3. a file `<plugin_dir>/<name>.py` or `<plugin_dir>/<name>/pattern.py` with exactly one Pattern,
   unless `<name>` begins with `test_`,
4. a mission: `<plugin_dir>/<name>.yaml` with a line `mission: ...`, or a mission of swarmd.

To read the metadata of all installed packages takes 40 ms and more. So the command line calls these
functions only where necessary, and a process reads the metadata once.
"""

from __future__ import annotations

import ast
import json
import keyword
import os
import re
import sys
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import swarmd.config
from swarmd.core.errors import ConfigError, PluginError, UnknownPatternError, unknown
from swarmd.core.files import cache_folder, open_regular, read_regular, user_path, write_whole
from swarmd.core.keys import check_id, is_id

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint, EntryPoints

    import click

    from swarmd.driver_api.driver import DriverFactory
    from swarmd.driver_api.emulator import EmulatorFactory

PATTERNS = "swarmd.patterns"
DRIVERS = "swarmd.drivers"
COMMANDS = "swarmd.commands"
EMULATORS = "swarmd.emulators"
MISSION = ".yaml"
PATTERN_FILE = "pattern.py"
"""The file of a pattern that has a folder; the folder has the pattern's name."""
METRICS_FILE = "metrics.py"
"""Beside a `pattern.py`: metrics of the pattern's runs, which experiments import, and no robot."""
IN_WHEEL = "//"
"""Between the path of a wheel and the `module:Class` that is imported from it."""
MAX_MISSION_SIZE = 1 << 20
SETTLED = 2_000_000_000
"""The time in ns after which an installation has written the metadata into a new folder."""
MAX_SUMMARIES = 1 << 20  # bytes of the file of the cache
_MOST_LISTED = 12  # names of patterns in an error
_CODING = re.compile(rb"^[ \t\f]*#.*?coding[:=]", re.MULTILINE)  # PEP 263
_CACHE = "__pycache__"
_HEAD = re.compile(rb"^(?:\xef\xbb\xbf)?([\"']?)mission\1[ \t]*:", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a pattern comes from."""

    value: str
    """`module:Class`; the path of a file if `is_file`; `<path>//module:Class` in a wheel."""
    source: str  # for display: a distribution and its version, or the file
    is_file: bool = False
    rival: str = ""  # another source with a pattern of the same name
    digest: bytes = b""  # the SHA-256 that a pushed file or wheel must have; empty for others


@dataclass(frozen=True, slots=True)
class PatternFolder:
    """A folder with the `pattern.py` of one pattern. `package`: its import name.

    `source`: the distribution and its version, or the file, for display. Beside `pattern.py` may
    lie `scenario.yaml` (a scenario that shows the pattern), `outcomes.yaml` (what it has to reach,
    with `metrics.py`) and `page.md` (its page of the docs).
    """

    path: Path
    package: str
    source: str

    @property
    def origin(self) -> Origin:
        """The class in its file: BestOfN for best_of_n."""
        name = self.path.name
        return Origin(f"{self.package}.{name}.pattern:{class_name(name)}", self.source)


def class_name(pattern: str) -> str:
    """The name of the class of a pattern in a package."""
    return "".join(word.capitalize() for word in pattern.split("_"))


def pattern_name(file: Path) -> str:
    """The name of the pattern in a file: its folder's for `pattern.py`, else the file's own."""
    return file.resolve().parent.name if file.name == PATTERN_FILE else file.stem


class PatternPlace(NamedTuple):
    """A pattern that lies in a file: its name, and the folder that makes it known.

    `folder`: as `plugin_dir` it has the pattern of this name, and those beside it.
    """

    name: str
    folder: Path


def is_pattern_path(text: str) -> bool:
    """Whether a text is the path of a pattern, not its name.

    A path has a separator (`mine/wall`, `./wall`), or ends in .py or .yaml (a mission).
    """
    return "/" in text or text.endswith((".py", MISSION))


def pattern_at(text: str) -> PatternPlace:
    """The pattern at a path: a .py, the folder of a `pattern.py`, or a mission's .yaml.

    Relative paths begin at the working directory, and `~` is expanded. ConfigError
    in one line if there is none; the file is not imported.
    """
    file = pattern_file(user_path(text)).absolute()
    if file.suffix not in (".py", MISSION):
        raise ConfigError(f"{text}: expected a pattern's .py, its folder, or a mission's {MISSION}")
    name = check_id(pattern_name(file), f"{text}: the pattern's name")
    if name.startswith("test_"):
        raise ConfigError(f"{text} is a test by its name; name the file of the pattern")
    if file.suffix == MISSION and not is_mission(file):
        raise ConfigError(f"{text} is no mission: no line begins with `mission:`")
    return PatternPlace(name, Path(os.path.normpath(pattern_folder_of(file))))


def place_of_pattern(pattern: str, plugin_dir: Path | None) -> tuple[str, Path | None]:
    """The name of a pattern that is given by name or path, and the folder in which it is known.

    ConfigError if a path does not lie in `plugin_dir`.
    """
    if not is_pattern_path(pattern):
        return pattern, plugin_dir
    name, folder = pattern_at(pattern)
    if plugin_dir is not None and plugin_dir.resolve() != folder.resolve():
        raise ConfigError(
            f"{pattern} does not lie in the plugin_dir, {plugin_dir}; leave out one of the two"
        )
    return name, folder


def unknown_pattern(name: str, known: Iterable[str]) -> str:
    """One line for a name that no known pattern has, with how to name a file of one's own."""
    names = list(known)
    text = unknown("pattern", name, names)
    if len(names) > _MOST_LISTED:
        text = text.partition("; there are:")[0]
    file = name if is_id(name) else "FILE"
    own = f"--pattern PATH/{file}.py or --plugin-dir FOLDER"
    return f"{text}; `swarmctl patterns` lists all; one of your own: {own}"


def pattern_file(path: Path) -> Path:
    """The file of a pattern: `path`, or the `pattern.py` in the folder `path`.

    ConfigError in one line if there is no such file.
    """
    try:
        is_folder = path.is_dir()
        is_file = path.is_file()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; check the path") from error
    if is_folder:
        file = path / PATTERN_FILE
        if file.is_file():
            return file
        raise ConfigError(
            f"{path} is a folder without {PATTERN_FILE}; name the pattern's file, or a folder as"
            " `swarmctl plugin new NAME --folder` makes it"
        )
    if is_file:
        return path
    is_there = os.path.lexists(path)
    fault = "is no file that can be read" if is_there else "there is no such file"
    raise ConfigError(f"{path}: {fault}; expected a pattern's file, or its folder")


def pattern_folder_of(file: Path) -> Path:
    """The folder that as `plugin_dir` makes the pattern in a file known, with those beside it."""
    return file.absolute().parent.parent if file.name == PATTERN_FILE else file.absolute().parent


def pattern_folders() -> Mapping[str, PatternFolder]:
    """The patterns that lie in folders of installed packages, by name."""
    return {
        folder.path.name: folder
        for point in entry_points_of(PATTERNS)
        if not point.attr
        for folder in _folders(point)
    }


def _folders(point: EntryPoint) -> Iterator[PatternFolder]:
    file = _source_file(point.module)
    source = _source(point)
    for path in sorted(file.parent.glob(f"*/{PATTERN_FILE}")) if file is not None else ():
        if is_id(path.parent.name):
            yield PatternFolder(path.parent, point.module, source)


def installed_patterns() -> Mapping[str, Origin]:
    """The patterns of installed packages by name."""
    return _merged(_installed())


def pattern_names(
    plugin_dir: Path | None, installed: Mapping[str, Origin] | None = None
) -> Mapping[str, Origin]:
    """All patterns by name, of packages and of the folder; PluginError if the folder is missing.

    `installed`: the patterns of packages, if the caller knows them already.
    """
    of_packages = _installed() if installed is None else installed.items()
    return _merged((*of_packages, *_dropped_in(plugin_dir)))


def _merged(origins: Iterable[tuple[str, Origin]]) -> Mapping[str, Origin]:
    by_name: dict[str, Origin] = {}
    for name, origin in origins:
        first = by_name.get(name)
        if first is None:
            by_name[name] = origin
        elif not is_same_file(first.value, origin.value):
            by_name[name] = replace(first, rival=origin.source)
    return dict(sorted(by_name.items()))


def is_same_file(first: str, second: str) -> bool:
    """True if both are files with equal content, such as a copy of a mission."""
    with suppress(OSError):
        return read_regular(first) == read_regular(second)
    return False


def check_module_name(name: str) -> None:
    """Raise PluginError unless this can be the name of a pattern's file, a Python module."""
    is_free = not keyword.iskeyword(name) and not name.startswith("test_")
    if not (is_id(name) and name.isidentifier() and is_free):
        raise PluginError(
            f"a pattern's file is a Python module, and {name!r} is no name: expected 1 to 63 of"
            " a-z, 0-9 and _, the first a letter, no word of Python's, no test_"
        )


def find_pattern(name: str, plugin_dir: Path | None) -> Origin:
    """The origin of a pattern; PluginError if no pattern or more than one has that name."""
    origins = pattern_names(plugin_dir)
    if name not in origins:
        raise UnknownPatternError(
            _bad_file_name(name, plugin_dir) or unknown_pattern(name, origins)
        )
    check_single(name, origins[name])
    return origins[name]


def places_of(origins: Mapping[str, Origin]) -> dict[str, tuple[str, bool]]:
    """For the pattern host: the value of each pattern, and whether that is a file."""
    return {name: (origin.value, origin.is_file) for name, origin in origins.items()}


def check_single(name: str, origin: Origin) -> None:
    """Raise PluginError if two patterns have this name."""
    if origin.rival:
        raise PluginError(
            f"two patterns are named {name!r}: {origin.source} and {origin.rival}; rename one"
        )


def load_driver(name: str) -> DriverFactory:
    """The driver of that name, imported; the daemon itself runs drivers."""
    return cast("DriverFactory", _load("driver", DRIVERS, name))


def load_emulator(name: str) -> EmulatorFactory:
    """The emulator of that name, imported: it simulates the robots of a driver."""
    return cast("EmulatorFactory", _load("emulator", EMULATORS, name))


def command_names() -> Mapping[str, EntryPoint]:
    """The verbs that plugins add to swarmctl."""
    return {point.name: point for point in sorted(entry_points_of(COMMANDS))}


def command_summaries() -> Mapping[str, str]:
    """The line of help of each verb that plugins add, by name.

    The lines are cached in a file. The cache is valid until the time stamp of a folder of sys.path,
    or of the source of a verb, changes. Without the cache, the search in the metadata of packages
    takes 17 ms of `--help`.
    """
    cached_lines = _cached_summaries()
    if cached_lines is not None:
        return cached_lines
    entry_points = command_names()
    lines = {name: command_summary(point) for name, point in entry_points.items()}
    source_files = [_source_file(point.module) for point in entry_points.values()]
    sources = [str(path) for path in source_files if path]
    times = {path: _time(path) for path in (*sys.path, *sources)}
    cache = {"times": times, "sources": sources, "lines": lines}
    with suppress(OSError, RuntimeError):
        _summaries_file().parent.mkdir(parents=True, exist_ok=True)
        write_whole(_summaries_file(), json.dumps(cache).encode())
    return lines


def _cached_summaries() -> Mapping[str, str] | None:
    """The lines of help in the cache; None without a valid cache, also if its file is damaged."""
    try:
        cache = json.loads(read_regular(_summaries_file(), MAX_SUMMARIES))
        if cache["times"] == {path: _time(path) for path in (*sys.path, *cache["sources"])}:
            return {str(name): str(text) for name, text in cache["lines"].items()}
    except (OSError, RuntimeError, ValueError, TypeError, LookupError, AttributeError):
        pass  # no cache, or a damaged cache
    return None


def _summaries_file() -> Path:
    """The cache file of this Python environment."""
    return cache_folder() / f"verbs-{zlib.crc32(sys.prefix.encode()):08x}.json"


def _time(path: str) -> int:
    """When a file or folder was changed, in ns; 0 if it is not there."""
    try:
        return os.stat(path or ".").st_mtime_ns
    except OSError:
        return 0


def command_summary(point: EntryPoint) -> str:
    """The first line of a verb's docstring, read from the source file without an import.

    If the source has no such line, a text that names the distribution.
    """
    with suppress(OSError, ValueError, SyntaxError):
        file = _source_file(point.module)
        text = file.read_text(encoding="utf-8") if file is not None else ""
        # The function alone: parsing a whole module would take 3 ms of the 80 of `--help`.
        head = f"def {point.attr}("
        body = text.partition(f"\n{head}")[2].partition("\n\n\n")[0]
        for function in ast.parse(f"{head}{body}").body if body else ():
            text = ast.get_docstring(cast(ast.FunctionDef, function)) or ""
            if text:
                return text.splitlines()[0]
    return f"Comes with {_source(point)}."


def _source_file(module: str) -> Path | None:
    """The file of a module, found without importing the packages it is in."""
    name, *below = module.split(".")
    spec = find_spec(name)
    for part in below:
        name = f"{name}.{part}"
        inside = spec.submodule_search_locations if spec is not None else None
        spec = None if inside is None else PathFinder.find_spec(name, inside)
    return Path(spec.origin) if spec is not None and spec.origin else None


def load_command(name: str) -> click.Command:
    """Import the verb of a plugin by its name.

    PluginError if there is no such verb, or a module is missing.
    """
    return cast("click.Command", _load("verb", COMMANDS, name))


def how_to_install(missing: str, name: str, group: str = COMMANDS) -> str:
    """The text for a plugin that needs the module `missing`, with the command that installs it."""
    point = next(iter(entry_points_of(group).select(name=name)), None)
    extra = _extra_with(point, missing) if point is not None else None
    dist = point.dist.name if point is not None and point.dist is not None else ""
    wanted = f"'{dist}[{extra}]'" if extra else missing
    return f"{name!r} needs {missing}, which is not installed; run: pip install {wanted}"


def need(*modules: str, extra: str) -> None:
    """Raise PluginError for the first missing module, with the command to install it."""
    for module in modules:
        if find_spec(module) is None:
            raise PluginError(
                f"this needs {module}, which is not installed; run: pip install 'swarmd[{extra}]'"
            )


def _installed() -> Iterator[tuple[str, Origin]]:
    for point in entry_points_of(PATTERNS):
        if not point.attr:
            yield from ((folder.path.name, folder.origin) for folder in _folders(point))
            continue
        yield point.name, Origin(point.value, _source(point))
    for path in mission_files(Path(swarmd.config.__path__[0]) / "missions"):
        yield path.stem, Origin(str(path.resolve()), "swarmd", is_file=True)


def pattern_files(folder: Path) -> Iterator[Path]:
    """The files of a `plugin_dir` that are imported by the name of a pattern, and the missions.

    `pattern_names` finds patterns in these files alone. `exp rerun` compares each of them before it
    imports any. A file may be a link; it is imported from the link's target.
    """
    for path in sorted((*folder.glob("*.py"), *folder.glob(f"*/{PATTERN_FILE}"))):
        name = pattern_name(path)
        if is_id(name) and path.is_file() and not name.startswith("test_"):
            yield path
    yield from mission_files(folder)


def modules_of(folder: Path) -> Iterator[Path]:
    """The Python files of the folder of a pattern that `pattern.py` can import, in their order.

    Folders below it count if their names are those of packages: `.venv` does not, nor does a
    folder that is a link.
    """
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if name.isidentifier() and name != _CACHE)
        for name in sorted(files):
            path = Path(place, name)
            if path.suffix == ".py" and path.stem.isidentifier() and path.is_file():
                yield path


def has_modules(file: Path) -> bool:
    """Whether the folder of a `pattern.py` has further modules, tests and `__init__.py` aside."""
    others = (path for path in modules_of(file.parent) if path != file)
    return any(not path.name.startswith(("test_", "__init__.")) for path in others)


def parsed(source: bytes, file: Path) -> ast.Module:
    """The syntax tree of the Python source of `file`; PluginError with the line of a fault."""
    try:
        return ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:  # nested too deeply
        check_text(source, str(file))
        line = getattr(error, "lineno", None)
        raise PluginError(f"{file}:{line or 1}: {getattr(error, 'msg', error)}") from error


def check_text(source: bytes, name: str) -> None:
    """PluginError with the line if the source of the Python file `name` is no UTF-8 text.

    For source that cannot be compiled. It may have another encoding that its first lines name
    (PEP 263); then this function finds no fault.
    """
    if _CODING.search(b"\n".join(source.splitlines()[:2])):
        return
    try:
        source.decode()
    except UnicodeDecodeError as error:
        line = source.count(b"\n", 0, error.start) + 1
        sign = source[error.start]
        raise PluginError(
            f"{name}:{line}: the byte 0x{sign:02x} is no UTF-8 text; save the file as UTF-8"
        ) from error


def _dropped_in(plugin_dir: Path | None) -> Iterator[tuple[str, Origin]]:
    if plugin_dir is None:
        return
    if not plugin_dir.is_dir():
        raise PluginError(
            f"plugin_dir is {plugin_dir}, which is no folder; make it or leave the option out"
        )
    for path in pattern_files(plugin_dir):
        yield pattern_name(path), Origin(str(path.resolve()), str(path), is_file=True)


def mission_files(folder: Path) -> Iterator[Path]:
    """The missions of a folder; other YAML files are ignored."""
    for path in sorted(folder.glob(f"*{MISSION}")):
        with suppress(OSError):
            if is_id(path.stem) and is_mission(path):
                yield path


def is_mission(path: Path) -> bool:
    """Whether a YAML file is a mission: it has a line `mission: ...`. OSError if unreadable.

    The daemon calls this, so it reads at most MAX_MISSION_SIZE bytes, and only regular files.
    """
    if not path.is_file():
        return False
    with open_regular(path) as file:
        return _HEAD.search(file.read(MAX_MISSION_SIZE)) is not None


def _bad_file_name(name: str, plugin_dir: Path | None) -> str:
    if plugin_dir is None or "/" in name or not (plugin_dir / f"{name}.py").is_file():
        return ""
    try:
        check_id(name, f"{plugin_dir / name}.py: the pattern's name")
    except ConfigError as error:
        return str(error)
    return ""


def _load(what: str, group: str, name: str) -> object:
    known = entry_points_of(group)
    points = known.select(name=name)
    if not points:
        raise PluginError(unknown(what, name, known.names))
    if len(points) > 1:
        sources = " and ".join(_source(point) for point in points)
        raise PluginError(f"two packages have a {what} {name!r}: {sources}; uninstall one")
    try:
        return next(iter(points)).load()
    except (ImportError, AttributeError, SyntaxError) as error:
        point = next(iter(points))
        missing = (error.name or "") if isinstance(error, ModuleNotFoundError) else ""
        if missing and missing.partition(".")[0] != point.module.partition(".")[0]:
            raise PluginError(how_to_install(missing, name, group)) from error
        text = f"{what} {name!r} of {_source(point)} cannot be loaded: {error}"
        raise PluginError(f"{text}; reinstall it or report it to its authors") from error


def entry_points_of(group: str) -> EntryPoints:
    """The entry points of a group.

    The process caches the result until the time stamp of a folder of sys.path with metadata
    changes. If a folder has changed less than SETTLED ago, an installation may be under way, and
    nothing is cached.
    """
    times = {path: _time(path) for path in map(os.path.abspath, sys.path)}
    if max(times.values()) + SETTLED > time.time_ns():
        return _entry_points.__wrapped__(group, ())
    return _entry_points(group, tuple(item for item in times.items() if _has_metadata(*item)))


@lru_cache(maxsize=8)
def _entry_points(group: str, _folders: tuple[tuple[str, int], ...]) -> EntryPoints:
    from importlib.metadata import entry_points  # it takes 2 MB; a pattern host reads no metadata

    return entry_points(group=group)


@lru_cache(maxsize=64)
def _has_metadata(path: str, _changed: int) -> bool:
    """Whether a folder holds metadata of packages; True for what is no readable folder."""
    try:
        return any(name.endswith((".dist-info", ".egg-info")) for name in os.listdir(path))
    except OSError:
        return True


def _source(point: EntryPoint) -> str:
    return _label(point.dist) if point.dist is not None else point.value


@lru_cache(maxsize=32)
def _label(dist: Distribution) -> str:
    """The name and version of a distribution; reading its metadata takes 1 ms."""
    return f"{dist.name} {dist.version}"


def _extra_with(point: EntryPoint, module: str) -> str | None:
    """The extra of the plugin's distribution that requires the module; None if no extra does."""
    root = module.partition(".")[0].lower().replace("_", "-")
    for line in point.dist.requires or () if point.dist is not None else ():
        match = re.match(r"([A-Za-z0-9._-]+).*extra\s*==\s*['\"]([\w-]+)['\"]", line)
        if match and match[1].lower().replace("_", "-").split("-")[0] == root.split("-")[0]:
            return match[2]
    return None
