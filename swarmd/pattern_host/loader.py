"""Imports a pattern's class from where it is found: the only module that imports plugin code."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
from collections.abc import Mapping
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, get_args

from swarmd.core.errors import PluginError, UnknownPatternError, unknown
from swarmd.kit.behavior import Pattern
from swarmd.kit.params import Params
from swarmd.plugins import IN_FOLDER, MISSION

_CHANNEL_TYPES = (bool, int, float, str, bytes, list, dict)


class PatternLoader:
    """Maps pattern names to classes.

    `origins`: name -> (module:Class or path, whether it is a file).
    """

    def __init__(self, origins: Mapping[str, tuple[str, bool]]) -> None:
        self.origins = origins
        self._files: dict[Path, type[Pattern[Any]]] | None = None
        self._missions: dict[tuple[Path, int, int], type[Pattern[Any]]] = {}
        self._open: list[str] = []

    def begin(self, origins: Mapping[str, tuple[str, bool]]) -> None:
        """Begin a load: each file is read as it is now, and once until the next load."""
        self.origins, self._files = origins, {}
        self._missions.clear()

    def __call__(self, name: str) -> type[Pattern[Any]]:
        """The class of that name.

        Raises PluginError if there is none or several, or if its declarations contradict each
        other; ConfigError if it is a mission whose file has a fault.
        """
        if name not in self.origins:
            raise UnknownPatternError(unknown("pattern", name, self.origins))
        value, is_file = self.origins[name]
        if is_file and value.endswith(MISSION):
            return self._mission(name, Path(value))
        return self._file(Path(value)) if is_file else _from_entry_point(name, value)

    def _file(self, path: Path) -> type[Pattern[Any]]:
        if self._files is None:
            return _from_file(path)
        if path not in self._files:
            self._files[path] = _from_file(path)
        return self._files[path]

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
    folder, _, value = value.rpartition(IN_FOLDER)
    module_name, _, attribute = value.partition(":")
    if folder:
        _import_first_from(Path(folder))
    module = importlib.import_module(module_name)
    kind = getattr(module, attribute, None)
    if not isinstance(kind, type) or not issubclass(kind, Pattern):
        raise PluginError(f"pattern {name!r}: {value} is no Pattern; ask its authors")
    _check_declarations(kind)
    return kind


def _import_first_from(folder: Path) -> None:
    """Let modules be imported from an unpacked wheel, in place of an earlier version of it.

    An installed package of the same name yields: the folder holds what was pushed and tried.
    """
    tops = {entry.name.removesuffix(".py") for entry in folder.iterdir()}
    for module in list(sys.modules):
        file = getattr(sys.modules[module], "__file__", None) or ""
        if module.partition(".")[0] in tops and not file.startswith(f"{folder}/"):
            del sys.modules[module]
    sys.path[:] = [str(folder), *(one for one in sys.path if one != str(folder))]
    importlib.invalidate_caches()


def _from_file(path: Path) -> type[Pattern[Any]]:
    module = import_file(path)
    kinds = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Pattern)
        and value.__module__ == module.__name__
        and not inspect.isabstract(value)
    ]
    if len(kinds) != 1:
        found = ", ".join(kind.__name__ for kind in kinds) or "none"
        raise PluginError(f"{path} must hold exactly one Pattern; it holds {found}")
    _check_declarations(kinds[0])
    return kinds[0]


def _check_declarations(kind: type[Pattern[Any]]) -> None:
    """PluginError for a forgotten `params_type`, or a channel of a type that cannot be sent."""
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
                known = ", ".join(one.__name__ for one in _CHANNEL_TYPES)
                raise PluginError(
                    f"{kind.__name__}: channel {channel!r} is declared as {wanted!r}; "
                    f"expected one of {known}"
                )


def import_file(path: Path) -> ModuleType:
    """The file as a module, as it is now; PluginError, or what the file raises."""
    name = f"swarmd_plugin_{path.stem}"
    loader = _UncachedLoader(name, str(path))
    spec = importlib.util.spec_from_loader(name, loader)
    if spec is None:
        raise PluginError(f"{path} cannot be read as Python")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    loader.exec_module(module)
    return module


class _UncachedLoader(SourceFileLoader):
    """Compiles the file at each load and writes no bytecode.

    Cached bytecode would be taken for that of a file changed within the same second.
    """

    def get_code(self, fullname: str) -> CodeType:
        """The code of the file as it is now."""
        return self.source_to_code(self.get_data(self.path), self.path)
