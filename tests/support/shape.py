"""The shape of the project: what a module imports, configuration keys.

`python -m tests.support.shape [COMMIT]` prints how many modules and lines the modules of CLOSURES
import, directly or not, and how much that was in another commit. No test bounds these numbers.
"""

from __future__ import annotations

import ast
import inspect
import io
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterable, Iterator
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
CLOSURES = (
    *("swarmd.robot.protection.protection", "swarmd.robot.robot", "swarmd.link.peer", "swarmd.api"),
    "swarmd.daemon.daemon",
)
"""Modules whose imports a test lists by room."""


def statements(tree: ast.Module | ast.stmt) -> Iterator[ast.stmt]:
    """All statements, without the expressions in them: these are nine tenths of the nodes."""
    inner: list[Any] = [tree]
    while inner:
        node = inner.pop()
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner += getattr(node, name, ())
        if isinstance(node, ast.stmt):
            yield node


def import_closure(module: str, *, at_start: bool = False, root: Path = ROOT) -> dict[str, Path]:
    """The modules of swarmd that a module imports, directly or not, and itself, with their files.

    An `__init__.py` leads to the modules that it re-exports, and does not count itself. What a
    function imports counts, unless `at_start`: then only what an import of the module imports. The
    public names of `swarmd` itself do not count, which are imported when they are used. `root`: the
    folder of the project.
    """
    waiting = [module]
    known: dict[str, Path] = {}
    while waiting:
        name = waiting.pop()
        path = _file_of(name, root)
        if path is not None and name not in known:
            known[name] = path
            ever, start = _imported(path)
            waiting += start if at_start else ever
    return {name: path for name, path in known.items() if path.name != "__init__.py"}


def _file_of(module: str, root: Path) -> Path | None:
    """The file of a module in swarmd; None for a name in a module, and for other packages."""
    if not module.startswith("swarmd."):
        return None
    place = root.joinpath(*module.split("."))
    files = (place.with_suffix(".py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def _at_start(tree: ast.Module) -> Iterator[ast.stmt]:
    """The statements that an import of a module carries out, of each branch but that for types."""
    waiting: list[ast.stmt] = [*tree.body]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        yield node
        is_for_types = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for name in ("body", "orelse", "finalbody"):
            if not (is_for_types and name == "body"):
                waiting += getattr(node, name, ())
        for handler in getattr(node, "handlers", ()):
            waiting += handler.body


@cache
def _imported(path: Path) -> tuple[list[str], list[str]]:
    """The modules that a module imports, and each imported name, which might be a module.

    First those of all statements, then those of an import of the module.
    """
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return _names(statements(tree)), _names(_at_start(tree))


def _names(body: Iterable[ast.stmt]) -> list[str]:
    found = []
    for node in body:
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [f"{node.module}", *(f"{node.module}.{alias.name}" for alias in node.names)]
    return found


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


def _sizes(root: Path) -> list[tuple[int, int, int, int]]:
    """Of each module of CLOSURES: modules and lines at the start, and with those of functions."""
    sizes = []
    for module in CLOSURES:
        start = import_closure(module, at_start=True, root=root).values()
        ever = import_closure(module, root=root).values()
        sizes.append((len(start), _lines(start), len(ever), _lines(ever)))
    return sizes


def _lines(paths: Iterable[Path]) -> int:
    return sum(path.read_bytes().count(b"\n") for path in paths)


def _print_sizes(commit: str | None) -> None:
    """Print the sizes of all closures, and those in another commit in brackets."""
    before: list[tuple[int, int, int, int] | None] = [None] * len(CLOSURES)
    if commit is not None:
        packed = subprocess.run(
            ["git", "archive", commit], cwd=ROOT, capture_output=True, check=True
        )
        with tempfile.TemporaryDirectory() as folder:
            with tarfile.open(fileobj=io.BytesIO(packed.stdout)) as archive:
                archive.extractall(folder, filter="tar")
            before = [*_sizes(Path(folder))]
    print(f"{'modules, lines':34}{'at the start':>24}{'ever':>28}")
    for module, now, then in zip(CLOSURES, _sizes(ROOT), before, strict=True):
        texts = [f"{number:,}" for number in now]
        if then is not None:
            texts = [f"{text} ({one:,})" for text, one in zip(texts, then, strict=True)]
        print(f"{module:30}{texts[0]:>12}{texts[1]:>18}{texts[2]:>12}{texts[3]:>18}")


if __name__ == "__main__":
    _print_sizes(sys.argv[1] if len(sys.argv) > 1 else None)
