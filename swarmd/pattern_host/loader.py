"""Imports the class of a pattern; the only module that imports plugin code.

For a pushed pattern, the executed bytes are exactly the bytes whose SHA-256 was compared: a file is
read once, and a wheel is imported from a sealed copy in memory (memfd_create(2)).
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Mapping, Sequence
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, get_args

from swarmd.core.errors import ChangedCodeError, PluginError, UnknownPatternError, unknown
from swarmd.core.files import read_regular
from swarmd.kit.behavior import Pattern
from swarmd.kit.params import Params
from swarmd.plugins import (
    IN_WHEEL,
    MISSION,
    PATTERN_FILE,
    check_text,
    modules_of,
    pattern_name,
)

MAX_MODULES = 500
MAX_SOURCE = 8 * 1024 * 1024
"""Bounds of the Python files in the folder of a pattern, and of their bytes."""
_CHANNEL_TYPES = (bool, int, float, str, bytes, list, dict)


class PatternLoader:
    """Returns the class of a pattern by its name.

    `origins`: by name, `module:Class` with False, or the path of a file with True.
    """

    def __init__(self, origins: Mapping[str, tuple[str, bool]]) -> None:
        self.origins = origins
        self._digests: Mapping[str, bytes] = {}
        self._wheels: dict[bytes, str] = {}  # the path of the copy, by digest
        # The classes that this load has read, by file; None before the first load.
        self._files: dict[Path, type[Pattern[Any]]] | None = None
        # The classes of missions by path, time in ns of the last change, and size.
        self._missions: dict[tuple[Path, int, int], type[Pattern[Any]]] = {}
        self._open: list[str] = []  # the missions being read, each a part of the mission before

    def begin(
        self, origins: Mapping[str, tuple[str, bool]], digests: Mapping[str, bytes] | None = None
    ) -> None:
        """Begin a load: each file is read anew, and only once until the next load begins.

        `digests`: by name, the SHA-256 that the file or wheel must have.
        """
        self.origins = origins
        self._files = {}
        self._digests = digests or {}
        self._missions.clear()

    def __call__(self, name: str) -> type[Pattern[Any]]:
        """Import the class of the pattern called `name`.

        Raises UnknownPatternError for an unknown name. Raises PluginError if the code has no
        pattern class or several, or if the declarations of the class contradict each other. Raises
        ChangedCodeError if the code of a pushed pattern has another SHA-256 than was pushed, and
        ConfigError for a fault in the file of a mission.
        """
        if name not in self.origins:
            raise UnknownPatternError(unknown("pattern", name, self.origins))
        value, is_file = self.origins[name]
        if is_file and value.endswith(MISSION):
            return self._mission(name, Path(value))
        digest = self._digests.get(name, b"")
        if is_file:
            return self._file(Path(value), digest)
        wheel, _, value = value.rpartition(IN_WHEEL)
        if wheel:
            _import_first_from(self._wheel(Path(wheel), digest))
        return _from_entry_point(name, value)

    def _file(self, path: Path, digest: bytes) -> type[Pattern[Any]]:
        if self._files is None:
            return _from_file(path, digest)
        if path not in self._files:
            self._files[path] = _from_file(path, digest)
        return self._files[path]

    def _wheel(self, path: Path, digest: bytes) -> str:
        """The path of a sealed copy of the wheel at `path`, whose SHA-256 must be `digest`."""
        content = _checked(path, digest)
        if digest not in self._wheels:
            self._wheels[digest] = _sealed_copy(path.name, content)
        return self._wheels[digest]

    def _mission(self, name: str, path: Path) -> type[Pattern[Any]]:
        from swarmd.mission.mission import mission_class  # few hosts run one

        if name in self._open:
            raise PluginError(f"mission {name!r} is a part of itself; take it out")
        stat = path.stat()
        key = (path, stat.st_mtime_ns, stat.st_size)
        if key not in self._missions:
            self._open.append(name)
            try:
                self._missions[key] = mission_class(path, self)
            finally:
                self._open.pop()
        return self._missions[key]


def _from_entry_point(name: str, value: str) -> type[Pattern[Any]]:
    module_name, _, attribute = value.partition(":")
    module = importlib.import_module(module_name)
    kind = getattr(module, attribute, None)
    if not isinstance(kind, type) or not issubclass(kind, Pattern):
        raise PluginError(f"pattern {name!r}: {value} is no Pattern; ask its authors")
    _check_declarations(kind)
    return kind


def _sealed_copy(name: str, content: bytes) -> str:
    """The path in `/proc` of a copy of `content` in memory, which no process can change."""
    import fcntl  # imported late: only Linux has seals, and only daemons run pushed patterns

    file = os.memfd_create(name, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    with open(file, "wb", closefd=False) as copy:
        copy.write(content)
    seals = fcntl.F_SEAL_WRITE | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_SEAL
    fcntl.fcntl(file, fcntl.F_ADD_SEALS, seals)
    return f"/proc/self/fd/{file}"


def _checked(path: Path, digest: bytes) -> bytes:
    """The content of a file; ChangedCodeError if it is unreadable or has another SHA-256."""
    try:
        content = read_regular(path)
    except OSError as error:
        raise ChangedCodeError(
            f"{path.name} cannot be read ({error.strerror}); push it again"
        ) from error
    if hashlib.sha256(content).digest() != digest:
        raise ChangedCodeError(
            f"{path.name} was changed on the disk: its SHA-256 is not {digest.hex()[:8]}..;"
            " push it again"
        )
    return content


def _import_first_from(wheel: str) -> None:
    """Put a wheel first in the import path, so that its modules are imported from it.

    Loaded modules of the same names, from an earlier version of the wheel, are forgotten. The wheel
    also precedes an installed package of the same name, since the wheel was pushed and tried.
    """
    from zipfile import ZipFile  # imported late: few hosts run a wheel

    with ZipFile(wheel) as archive:
        tops = {name.partition("/")[0].removesuffix(".py") for name in archive.namelist()}
    for module in list(sys.modules):
        file = getattr(sys.modules[module], "__file__", None) or ""
        if module.partition(".")[0] in tops and not file.startswith(f"{wheel}/"):
            del sys.modules[module]
    sys.path[:] = [wheel, *(entry for entry in sys.path if entry != wheel)]
    importlib.invalidate_caches()


def _from_file(path: Path, digest: bytes = b"") -> type[Pattern[Any]]:
    module = import_file(path, digest)
    kinds = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Pattern)
        and value.__module__ == module.__name__
        and not inspect.isabstract(value)
    ]
    if len(kinds) != 1:
        names = ", ".join(kind.__name__ for kind in kinds) or "none"
        raise PluginError(f"{path} must hold exactly one Pattern; it holds {names}")
    _check_declarations(kinds[0])
    return kinds[0]


def _check_declarations(kind: type[Pattern[Any]]) -> None:
    """PluginError for a class that contradicts itself.

    It lacks `params_type`, has a channel whose type cannot be sent, or a method that takes fewer
    arguments than it is called with; most often `self` is missing.
    """
    for name, own in vars(kind).items():
        base = getattr(super(kind, kind), name, None)
        if not (inspect.isfunction(own) and inspect.isfunction(base)):
            continue
        taken, given = (
            code.co_varnames[: code.co_argcount] for code in (own.__code__, base.__code__)
        )
        if len(taken) < len(given) and not own.__code__.co_flags & inspect.CO_VARARGS:
            raise PluginError(
                f"{kind.__name__}.{name}({', '.join(taken)}): write"
                f" `def {name}({', '.join(given)})`"
                f" ({Path(own.__code__.co_filename).name}:{own.__code__.co_firstlineno})"
            )
    for base in vars(kind).get("__orig_bases__", ()):
        for params in get_args(base):
            is_params = isinstance(params, type) and issubclass(params, Params)
            if is_params and not issubclass(kind.params_type, params):
                raise PluginError(
                    f"{kind.__name__} is declared with {params.__name__} and has params_type "
                    f"{kind.params_type.__name__}; add `params_type = {params.__name__}`"
                )
    channels = kind.channels
    if isinstance(channels, Mapping):  # a combined pattern's is a property
        for channel, wanted in channels.items():
            if wanted not in _CHANNEL_TYPES:
                known = ", ".join(kind.__name__ for kind in _CHANNEL_TYPES)
                raise PluginError(
                    f"{kind.__name__}: channel {channel!r} is declared as {wanted!r}; "
                    f"expected one of {known}"
                )


def import_file(path: Path, digest: bytes = b"") -> ModuleType:
    """Import the present content of a file as a module.

    A `pattern.py` is imported as a module of a package, its folder: `from .gains import TURN`
    imports the `gains.py` beside it, also when a method does so during a run. All modules of the
    folder are read here, so that a later change of a file has no effect before the next load.

    `digest`: the expected SHA-256 of the file, which then is no package; empty for any content.
    Raises ChangedCodeError if the SHA-256 differs, PluginError if the file is not UTF-8 text or the
    folder has too many modules, and any exception of reading, compiling or executing the file.
    """
    name = f"swarmd_plugin_{pattern_name(path)}"
    _forget(name)
    if path.name == PATTERN_FILE and not digest:
        package = _FolderPackage(name, path)
        sys.meta_path.insert(0, package)
        return importlib.import_module(f"{name}.{path.stem}")
    source = _checked(path, digest) if digest else read_regular(path)
    spec = importlib.util.spec_from_loader(name, _SourceLoader(name, str(path), source))
    if spec is None or spec.loader is None:
        raise PluginError(f"{path} cannot be read as Python")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _forget(name: str) -> None:
    """Forget the modules of an earlier load of the plugin `name`."""
    sys.meta_path[:] = [
        finder
        for finder in sys.meta_path
        if not (isinstance(finder, _FolderPackage) and finder.name == name)
    ]
    for module in list(sys.modules):
        if module == name or module.startswith(f"{name}."):
            del sys.modules[module]


class _SourceLoader(SourceFileLoader):
    """Compiles the given source of a plugin's file, without cached bytecode (.pyc).

    If a file changes twice within a second, Python takes the bytecode of the first change for
    valid.
    """

    def __init__(self, name: str, path: str, source: bytes) -> None:
        super().__init__(name, path)
        self._source = source

    def get_code(self, fullname: str) -> CodeType:
        """The code of the source; PluginError if the source is no UTF-8 text."""
        try:
            return self.source_to_code(self._source, self.path)
        except (SyntaxError, ValueError):
            check_text(self._source, Path(self.path).name)
            raise


class _FolderPackage:
    """Finds the modules of the package `name`, the Python files beside and below a `pattern.py`.

    Reads them all at once. PluginError if they are more than MAX_MODULES, or MAX_SOURCE bytes.
    """

    def __init__(self, name: str, file: Path) -> None:
        self.name = name
        folder = file.parent
        self._folders = {name: folder}  # by the name of the package
        self._sources: dict[str, tuple[Path, bytes]] = {}  # by the name of the module
        size = 0
        # The folder of `file` may be unreadable in the sandbox: `file` alone is the package then.
        for path in dict.fromkeys((file, *modules_of(folder))):
            parts = path.relative_to(folder).with_suffix("").parts
            module = ".".join((name, *(parts[:-1] if parts[-1] == "__init__" else parts)))
            source = read_regular(path)
            size += len(source)
            self._sources[module] = (path, source)
            for depth in range(1, len(parts)):
                self._folders[".".join((name, *parts[:depth]))] = folder.joinpath(*parts[:depth])
            if len(self._sources) > MAX_MODULES or size > MAX_SOURCE:
                raise PluginError(
                    f"{folder} has more than {MAX_MODULES} Python files or {MAX_SOURCE} bytes of"
                    f" them; move {PATTERN_FILE} and its modules to a folder of their own"
                )

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of a module of this package; None for other modules."""
        if fullname in self._sources:
            file, source = self._sources[fullname]
            loader = _SourceLoader(fullname, str(file), source)
            spec = importlib.util.spec_from_loader(fullname, loader)
        elif fullname in self._folders:  # a folder without `__init__.py`
            spec = ModuleSpec(fullname, None, is_package=True)
        else:
            return None
        if spec is not None and fullname in self._folders:
            spec.submodule_search_locations = [str(self._folders[fullname])]
        return spec
