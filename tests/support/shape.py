"""The shape of the project as numbers: statements, what a module imports, configuration keys."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from msgspec import Struct

from swarmd.drivers.crazyflie.driver import CrazyflieOptions
from swarmd.drivers.replay import ReplayOptions
from swarmd.drivers.ros.options import RmwOptions, Ros1Options
from swarmd.drivers.simulated import SimulatedOptions
from swarmd.mission.schema import MissionFile
from swarmd.settings.driver_options import BaseOptions
from swarmd.settings.platforms import PlatformFile
from swarmd.settings.swarmfile import DaemonFile
from swarmd.sim.scenarios.schema import ScenarioFile
from swarmd.sim.world.realism import Realism

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ("swarmd", "patterns", "drivers", "sim")
"""The folders that the wheel installs."""
FILES: tuple[type[Struct], ...] = (
    *(DaemonFile, PlatformFile, ScenarioFile, Realism, MissionFile),
    *(BaseOptions, RmwOptions, Ros1Options, SimulatedOptions, ReplayOptions, CrazyflieOptions),
)
"""The files that users write, and the options of drivers."""
_LOADED = re.compile(r"load_kernel\(\s*\"([\w.]+)\"")


def source_files(root: Path = ROOT) -> Iterator[Path]:
    """Each Python file of SOURCES; links are not followed."""
    folders = [root / name for name in SOURCES]
    while folders:
        for path in sorted(folders.pop().iterdir()):
            if path.is_symlink() or path.name.startswith((".", "__pycache__")):
                continue
            if path.is_dir():
                folders.append(path)
            elif path.suffix == ".py":
                yield path


def executable_statements(text: str) -> int:
    """The executable statements of a module.

    Docstrings, imports, `pass`, comments and blank lines count nothing. `a, b = 1, 2` and `a = b =
    1` count as two, so that packing saves nothing.
    """
    return statements_in(ast.parse(text))


def statements_in(tree: ast.Module) -> int:
    """As `executable_statements`, of a module that is parsed already."""
    return sum(map(_weight, statements(tree)))


def statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """All statements, without the expressions in them: these are nine tenths of the nodes."""
    inner: list[Any] = [tree]
    while inner:
        node = inner.pop()
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner += getattr(node, name, ())
        if isinstance(node, ast.stmt):
            yield node


def _weight(node: ast.stmt) -> int:
    match node:
        case ast.Import() | ast.ImportFrom() | ast.Pass():
            return 0
        case ast.Expr(value=ast.Constant(value=str())):
            return 0
        case ast.Assign(targets=targets, value=value):
            is_packed = any(isinstance(target, ast.Tuple) for target in targets)
            values = len(value.elts) if is_packed and isinstance(value, ast.Tuple) else 1
            return max(values, len(targets))
    return 1


def import_closure(module: str, *, at_start: bool = False) -> dict[str, int]:
    """The lines of each module of swarmd that a module imports, directly or not, and of itself.

    A kernel that `load_kernel` loads by its name counts as imported. An `__init__.py` leads to the
    modules that it re-exports, and does not count itself. `at_start`: without what is imported in a
    function, or for type checkers alone.
    """
    waiting = [module]
    known: dict[str, Path] = {}
    while waiting:
        name = waiting.pop()
        path = _file_of(name)
        if path is not None and name not in known:
            known[name] = path
            waiting += _imported(path, at_start=at_start)
    files = ((name, path) for name, path in known.items() if path.name != "__init__.py")
    return {name: path.read_text(encoding="utf-8").count("\n") for name, path in files}


def _file_of(module: str) -> Path | None:
    """The file of a module of swarmd; None for a name inside a module, and for other packages."""
    if module.partition(".")[0] != "swarmd":
        return None
    place = ROOT.joinpath(*module.split("."))
    files = (place.with_suffix(".py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)


@cache
def _imported(path: Path, *, at_start: bool) -> tuple[str, ...]:
    """The modules that a module imports, and each imported name, which might be a module."""
    text = path.read_text(encoding="utf-8")
    found = _LOADED.findall(text)
    tree = ast.parse(text)
    for node in tree.body if at_start else statements(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [f"{node.module}", *(f"{node.module}.{alias.name}" for alias in node.names)]
    return tuple(found)


def keys_of(*files: type[Struct]) -> dict[type[Struct], set[str]]:
    """The keys of files by the structs that declare them, with the structs of their sections."""
    waiting: list[Any] = [*files]
    found: dict[type[Struct], set[str]] = {}
    while waiting:
        kind = waiting.pop()
        if not (isinstance(kind, type) and get_origin(kind) is None and issubclass(kind, Struct)):
            waiting += get_args(kind)
        elif kind not in found and kind is not Struct:
            names = zip(kind.__struct_fields__, kind.__struct_encode_fields__, strict=True)
            own = inspect.get_annotations(kind)
            found[kind] = {key for field, key in names if field in own}
            waiting += kind.__bases__
            waiting += get_type_hints(kind, include_extras=True).values()
    return found
