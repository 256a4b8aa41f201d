"""The shape of the project: what a module imports, configuration keys."""

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
FILES: tuple[type[Struct], ...] = (
    *(DaemonFile, PlatformFile, ScenarioFile, Realism, MissionFile),
    *(BaseOptions, RmwOptions, Ros1Options, SimulatedOptions, ReplayOptions, CrazyflieOptions),
)
"""The files that users write, and the options of drivers."""
_LOADED = re.compile(r"load_kernel\(\s*\"([\w.]+)\"")


def statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """All statements, without the expressions in them: these are nine tenths of the nodes."""
    inner: list[Any] = [tree]
    while inner:
        node = inner.pop()
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner += getattr(node, name, ())
        if isinstance(node, ast.stmt):
            yield node


def import_closure(module: str) -> set[str]:
    """The modules of swarmd that a module imports, directly or not, and itself.

    A kernel that `load_kernel` loads by its name counts as imported. An `__init__.py` leads to the
    modules that it re-exports, and does not count itself. What a function imports counts; the
    public names of `swarmd` itself do not, which are imported when they are used.
    """
    waiting = [module]
    known: dict[str, Path] = {}
    while waiting:
        name = waiting.pop()
        path = _file_of(name)
        if path is not None and name not in known:
            known[name] = path
            waiting += _imported(path)
    return {name for name, path in known.items() if path.name != "__init__.py"}


def _file_of(module: str) -> Path | None:
    """The file of a module in swarmd; None for a name in a module, and for other packages."""
    if not module.startswith("swarmd."):
        return None
    place = ROOT.joinpath(*module.split("."))
    files = (place.with_suffix(".py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)


@cache
def _imported(path: Path) -> tuple[str, ...]:
    """The modules that a module imports, and each imported name, which might be a module."""
    text = path.read_text(encoding="utf-8")
    found = _LOADED.findall(text)
    for node in statements(ast.parse(text)):
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
