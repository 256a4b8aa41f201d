"""The weight of the project: lines and files of folders, files that name a concept, forms to avoid.

`tests/test_weight.py` compares the numbers with `tests/weights.toml`; `python -m benchmarks.house`
prints and lowers them.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WEIGHTS = Path("tests/weights.toml")
SOURCES = ("swarmd", "patterns", "drivers", "sim")
"""The folders that the wheel installs; concepts and forms are counted in these alone."""

UNITS = {
    "source": ("lines", "files"),
    "tests": ("lines", "files"),
    "markdown": ("lines", "files"),
    "named": ("source files",),
    "counts": ("places",),
}
"""The tables of the file, and what their numbers count."""
SLACK = 0.97
"""A number below this share of its limit must be lowered."""
_TABLES = {
    "source": (
        (*SOURCES, "benchmarks", "studies", "examples", "docs"),
        (".py", ".js", ".css", ".html"),
    ),
    "tests": (("tests",), (".py",)),
    "markdown": ((".", "docs", "benchmarks", "patterns"), (".md",)),
}
PATTERN = "patterns/NAME"
"""The row of the heaviest folder of a pattern: to add a pattern changes no number."""
_WHOLE = ("benchmarks", "studies", "examples", "docs/site")  # one row with all that is below
_HEAD = """\
# Limits of tests/test_weight.py. A number above its limit is a fault, and one below 97 % of it.
# `make weight ARGS=--write` lowers limits, adds rows of new folders, and removes rows of folders
# that are gone. A limit is raised by hand, in a commit of its own with the reason. A new row of
# [named] begins with any number above the present one.
"""

_GENERATED = re.compile(
    r"<!-- (?!results|faults)\w+: .*? -->\n(.*?)<!-- [\w ]*\bend\b[\w ]* -->", re.DOTALL
)

Weights = dict[str, dict[str, tuple[int, ...]]]
Places = dict[str, dict[str, list[str]]]

_Function = ast.FunctionDef | ast.AsyncFunctionDef


def texts(root: Path = ROOT) -> Iterator[tuple[str, Path, str]]:
    """Table, path below `root` and text of each file that has a weight; links are not followed."""
    for table, (folders, suffixes) in _TABLES.items():
        for folder in folders:
            for path in _files(root / folder, folder != "."):
                if path.suffix in suffixes:
                    yield table, path.relative_to(root), path.read_text(encoding="utf-8")


def folder_weights(root: Path = ROOT) -> Weights:
    """Lines and files of each folder, and of the heaviest pattern, for each kind of text."""
    weights: Weights = {table: {} for table in _TABLES}
    for table, path, text in texts(root):
        row = _row(table, path)
        lines, files = weights[table].get(row, (0, 0))
        weights[table][row] = (lines + text.count("\n"), files + 1)
    for rows in weights.values():
        of_patterns = [rows.pop(row) for row in [*rows] if row.startswith("patterns/")]
        if of_patterns:
            lines_of_each, files_of_each = zip(*of_patterns, strict=True)
            rows[PATTERN] = (max(lines_of_each), max(files_of_each))
    return {table: dict(sorted(rows.items())) for table, rows in weights.items()}


def places(words: Iterable[str], root: Path = ROOT) -> Places:
    """The source files that name each of `words`, and the places of each fault of form.

    A pattern may name what it uses. Its outcome is a study.
    """
    named: dict[str, list[str]] = {word: [] for word in words}
    counts: dict[str, list[str]] = {name: [] for name in _FORMS}
    classes: dict[str, list[str]] = defaultdict(list)
    importers: dict[str, set[str]] = defaultdict(set)
    short: dict[str, str] = {}
    for path in chain.from_iterable(_files(root / folder) for folder in SOURCES):
        if path.suffix != ".py" or path.name == "outcome.py":
            continue
        file, text = path.relative_to(root).as_posix(), path.read_text(encoding="utf-8")
        for word, files in named.items() if not file.startswith("patterns/") else ():
            if word in text and re.search(rf"\b{word}\b", text):
                files.append(file)
        tree = ast.parse(text)
        module = _module(file)
        if path.name != "__init__.py" and text.count("\n") < _SHORT_FILE:
            short[module] = file
        for top in tree.body:
            if isinstance(top, ast.ClassDef) and not top.name.startswith("_"):
                classes[top.name].append(f"{file}:{top.lineno} {top.name}")
        for node in ast.walk(tree):
            for name in _imported(node):
                importers[name].add(file)
            for name in _forms_of(node):
                counts[name].append(f"{file}:{getattr(node, 'lineno', 1)}")
    counts["short_files_with_one_importer"] = [
        f"{file}, imported by {user}"
        for module, file in short.items()
        if len(importers[module]) == 1
        for user in importers[module]
    ]
    counts["public_classes_named_twice"] = [
        ", ".join(where) for where in classes.values() if len(where) > 1
    ]
    counts["generated_lines_in_git"] = [
        f"{path.relative_to(root).as_posix()}: {line[:60]}"
        for path in _files(root / "docs")
        if path.suffix == ".md"
        for part in _GENERATED.findall(path.read_text(encoding="utf-8"))
        for line in part.splitlines()
    ]
    return {"named": named, "counts": counts}


def measured(limits: Weights, root: Path = ROOT) -> Weights:
    """All numbers; the concepts are those that `limits` names."""
    listed = places(limits.get("named", {}), root)
    return folder_weights(root) | {
        table: {name: (len(where),) for name, where in rows.items()}
        for table, rows in listed.items()
    }


def faults(weights: Weights, limits: Weights) -> Iterator[str]:
    """A line for each number above its limit, below `SLACK` of it, or without a limit."""
    for table, name, unit, number, limit in _compared(weights, limits):
        row = f"{WEIGHTS}: [{table}] {name}: {number} {unit}"
        if limit is None:
            yield f"{row}, no limit; `make weight ARGS=--write` adds it"
        elif number > limit:
            is_listed = table in ("named", "counts")
            names = f"; `make weight ARGS='--list {name}'` lists them" if is_listed else ""
            yield (
                f"{row}, limit {limit}: take {number - limit} out, or raise the limit in a"
                f" commit of its own with the reason{names}"
            )
        elif number < SLACK * limit:
            yield f"{row}, limit {limit}: lower it to {number} with `make weight ARGS=--write`"


def lowered(weights: Weights, limits: Weights) -> Weights:
    """The limits, none above its number; with rows of the present folders."""
    new: Weights = {table: {} for table in UNITS}
    for table, name, _, number, limit in _compared(weights, limits):
        if name in weights[table]:
            low = number if limit is None else min(number, limit)
            new[table][name] = (*new[table].get(name, ()), low)
    return new


def read_limits(root: Path = ROOT) -> Weights:
    """The limits of the file; empty without one."""
    path = root / WEIGHTS
    tables = tomllib.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return {
        table: {name: tuple(row) if isinstance(row, list) else (row,) for name, row in rows.items()}
        for table, rows in tables.items()
    }


def as_toml(limits: Weights) -> str:
    """The text of the file."""
    lines = [_HEAD]
    for table, units in UNITS.items():
        lines.append(f"[{table}]  # {', '.join(units)}")
        for name, row in limits.get(table, {}).items():
            key = name if re.fullmatch(r"\w+", name) else f'"{name}"'
            lines.append(f"{key} = {row[0] if len(units) == 1 else list(row)}")
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def _compared(weights: Weights, limits: Weights) -> Iterator[tuple[str, str, str, int, int | None]]:
    """(table, row, unit, number, limit) of each number of either; a row that is missing is 0.

    Raises ValueError for a row of the file that has more or fewer numbers than its table.
    """
    for table, units in UNITS.items():
        numbers, bounds = weights.get(table, {}), limits.get(table, {})
        for name in dict.fromkeys(chain(numbers, bounds)):
            if len(bounds.get(name, units)) != len(units):
                row = f"{WEIGHTS}: [{table}] {name} has {len(bounds[name])} numbers"
                raise ValueError(f"{row}; expected {len(units)}: {', '.join(units)}")
            for index, unit in enumerate(units):
                number = numbers[name][index] if name in numbers else 0
                yield table, name, unit, number, bounds[name][index] if name in bounds else None


def _files(folder: Path, is_deep: bool = True) -> Iterator[Path]:
    """The files below a folder, in order, without caches and what links lead to."""
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if path.is_symlink() or path.name.startswith((".", "__pycache__")):
            continue
        if path.is_file():
            yield path
        elif is_deep:
            yield from _files(path)


def _row(table: str, file: Path) -> str:
    """The row of a file: its folder; for tests the first two of its folders."""
    folder = file.parent.as_posix()
    if table == "tests":
        return "/".join(file.parts[:-1][:2])
    return next((name for name in _WHOLE if f"{folder}/".startswith(f"{name}/")), folder)


def _imported(node: ast.AST) -> list[str]:
    """The modules that a statement imports, and each name that might be a module."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}", *(f"{node.module}.{alias.name}" for alias in node.names)]
    return []


def _module(file: str) -> str:
    """The import name of a file."""
    parts = file.removesuffix(".py").removesuffix("/__init__").split("/")
    return ".".join(parts if parts[0] == "swarmd" else ["swarmd", *parts])


# Forms: faults that a reader stumbles over, each with its bound

_SHORT_FILE = 100  # lines
_LONG_CLASS = 600
_LONG_FUNCTION = 80
_MANY_ARGUMENTS = 8
_MANY_VALUES = 3  # of an assignment of tuples
_MANY_SEMICOLONS = 2  # of a docstring
_VAGUE = ("one", "found", "other")
_FORMS = (
    "short_files_with_one_importer",
    "callables_in_constructors",
    "classes_above_600_lines",
    "constructors_above_8_arguments",
    "functions_above_80_lines",
    "public_classes_named_twice",
    "assignments_of_three_values",
    *(f"name_{word}" for word in _VAGUE),
    "docstrings_above_two_semicolons",
    "docstrings_with_a_second_it",
    "generated_lines_in_git",
)


def _forms_of(node: ast.AST) -> Iterator[str]:
    """The names of the forms that a node has, a name for each occurrence."""
    if isinstance(node, ast.Name | ast.arg):
        name = node.id if isinstance(node, ast.Name) else node.arg
        if name in _VAGUE:
            yield f"name_{name}"
    elif isinstance(node, ast.Assign):
        values, targets = node.value, node.targets[0]
        if (
            isinstance(values, ast.Tuple)
            and isinstance(targets, ast.Tuple)
            and len(values.elts) >= _MANY_VALUES
        ):
            yield "assignments_of_three_values"
    elif isinstance(node, ast.ClassDef | _Function | ast.Module):
        text = ast.get_docstring(node) or ""
        if text.count(";") > _MANY_SEMICOLONS:
            yield "docstrings_above_two_semicolons"
        if any(len(re.findall(r"\bit\b", part, re.I)) > 1 for part in re.split(r"[.:]\s", text)):
            yield "docstrings_with_a_second_it"
        if isinstance(node, ast.Module):
            return
        lines = (node.end_lineno or node.lineno) - node.lineno + 1
        if isinstance(node, ast.ClassDef):
            if lines > _LONG_CLASS:
                yield "classes_above_600_lines"
            return
        if lines > _LONG_FUNCTION:
            yield "functions_above_80_lines"
        if node.name == "__init__":
            arguments = [*node.args.posonlyargs, *node.args.args[1:], *node.args.kwonlyargs]
            if len(arguments) > _MANY_ARGUMENTS:
                yield "constructors_above_8_arguments"
            for argument in arguments:
                if argument.annotation and "Callable" in ast.unparse(argument.annotation):
                    yield "callables_in_constructors"
