"""Imports a pattern's class from where it is found: the one place that imports plugin code."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
from collections.abc import Mapping
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from swarmd.core.errors import PluginError, UnknownPatternError, unknown
from swarmd.kit.behavior import Pattern
from swarmd.plugins import MISSION


class PatternLoader:
    """From pattern names to classes. `origins`: name -> (module:Class or path, is it a file)."""

    def __init__(self, origins: Mapping[str, tuple[str, bool]]) -> None:
        self.origins = origins
        self._files: dict[Path, type[Pattern[Any]]] | None = None
        self._missions: dict[tuple[Path, int, int], type[Pattern[Any]]] = {}
        self._open: list[str] = []

    def begin(self, origins: Mapping[str, tuple[str, bool]]) -> None:
        """A load begins: files are read as they are now, and each of them once until the next."""
        self.origins, self._files = origins, {}
        self._missions.clear()

    def __call__(self, name: str) -> type[Pattern[Any]]:
        """The class; PluginError if there is none of that name, or not exactly one.

        ConfigError if it is a mission whose file has a fault.
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
    module_name, _, attribute = value.partition(":")
    module = importlib.import_module(module_name)
    kind = getattr(module, attribute, None)
    if not isinstance(kind, type) or not issubclass(kind, Pattern):
        raise PluginError(f"pattern {name!r}: {value} is no Pattern; ask its authors")
    return kind


def _from_file(path: Path) -> type[Pattern[Any]]:
    module = _module(path)
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
    return kinds[0]


def _module(path: Path) -> ModuleType:
    name = f"swarmd_plugin_{path.stem}"
    loader = _AsWritten(name, str(path))
    spec = importlib.util.spec_from_loader(name, loader)
    if spec is None:
        raise PluginError(f"{path} cannot be read as Python")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    loader.exec_module(module)
    return module


class _AsWritten(SourceFileLoader):
    """Compiles the file each time, and leaves nothing beside it.

    Bytecode that was kept counts as that of a file changed within the same second.
    """

    def get_code(self, fullname: str) -> CodeType:
        """The code of the file as it is now."""
        return self.source_to_code(self.get_data(self.path), self.path)
