"""Small changes of the code that decides motion, and the tests that notice them.

`python -m studies.mutants kernels --draw 40 [--seed 1]` draws a sample of changes of the kernels,
and `python -m studies.mutants of COMMIT` changes the functions and tables that a commit or a range
(`COMMIT..`, `A..B`) touched, in the files of DECIDES. A change is one operator, comparison, number,
truth value or entry of a table. The tests of the changed file run in a copy of the sources,
interpreted. A mutant that no test notices survives. mutmut cannot do this for kernels, since it
changes no decorated function.
"""

from __future__ import annotations

import argparse
import ast
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from swarmd.core.kernels import KERNELS, source_of

ROOT = Path(__file__).resolve().parent.parent
COPY = ROOT / "build" / "mutants"
FOLDERS = ("swarmd", "patterns", "drivers", "sim", "config", "tests", "studies", "benchmarks")
TESTS = {
    path: f"tests/{Path(path).parent.as_posix().removeprefix('swarmd/')}"
    for path in map(source_of, KERNELS)
}
"""By the file of a kernel, the folder of its tests."""
DECIDES = {
    "swarmd/protection/": ("tests/protection", "tests/robot"),
    "swarmd/robot/": ("tests/robot", "tests/sequences", "tests/histories"),
    "swarmd/steering/": ("tests/steering", "tests/robot"),
    "swarmd/sensing/": ("tests/sensing", "tests/robot"),
    "swarmd/core/": ("tests/core", "tests/robot", "tests/sequences"),
    "swarmd/driver_api/": ("tests/driver_api", "tests/sequences", "tests/drivers"),
    "swarmd/daemon/": ("tests/daemon", "tests/sequences"),
    "swarmd/network/operator/": ("tests/network/operator", "tests/histories", "tests/sequences"),
    "swarmd/network/": ("tests/network", "tests/histories", "tests/sequences"),
    "swarmd/client/": ("tests/client", "tests/histories", "tests/sequences"),
    "drivers/": ("tests/drivers", "tests/sequences"),
}
"""By folder of the files that decide motion, their tests, the nearest first. First match counts."""
HUNK = re.compile(r"^@@ -\S+ \+(\d+)(?:,(\d+))? @@", re.MULTILINE)
OPERATORS: dict[type[ast.AST], tuple[type[ast.AST], str]] = {
    ast.Add: (ast.Sub, "+ to -"),
    ast.Sub: (ast.Add, "- to +"),
    ast.Mult: (ast.Div, "* to /"),
    ast.Div: (ast.Mult, "/ to *"),
    ast.Lt: (ast.GtE, "< to >="),
    ast.LtE: (ast.Gt, "<= to >"),
    ast.Gt: (ast.LtE, "> to <="),
    ast.GtE: (ast.Lt, ">= to <"),
    ast.And: (ast.Or, "and to or"),
    ast.Or: (ast.And, "or to and"),
    ast.Eq: (ast.NotEq, "== to !="),
    ast.NotEq: (ast.Eq, "!= to =="),
    ast.Is: (ast.IsNot, "is to is not"),
    ast.IsNot: (ast.Is, "is not to is"),
    ast.In: (ast.NotIn, "in to not in"),
    ast.NotIn: (ast.In, "not in to in"),
}
TABLES = (ast.Set, ast.Dict)
"""Displays whose first entry a mutant drops, if there are two or more."""
TIMEOUT = 600.0  # s for the tests of one mutant


@dataclass(frozen=True)
class Mutant:
    """The change of place `number` of the file `path`, for which `tests` are run."""

    path: str
    number: int
    tests: tuple[str, ...]


def places(tree: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """The nodes that a mutant changes, each with its function; empty for a table of the module."""
    for statement in tree.body:
        if isinstance(statement, ast.Assign | ast.AnnAssign):
            yield from ((node, "") for node in ast.walk(statement) if isinstance(node, TABLES))
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            for node in ast.walk(function):
                if _kind(node) is not None:
                    yield node, function.name


def _kind(node: ast.AST) -> type[ast.AST] | None:
    """The operator of a node that can be changed, Constant, Set or Dict; None otherwise."""
    if isinstance(node, ast.BinOp | ast.AugAssign | ast.BoolOp):
        found: ast.AST = node.op
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        found = node.ops[0]
    elif isinstance(node, ast.Constant) and type(node.value) in (float, bool):
        return ast.Constant if node.value or node.value is False else None
    elif isinstance(node, TABLES) and len(_entries(node)) > 1:
        return type(node)
    else:
        return None
    return type(found) if type(found) in OPERATORS else None


def _entries(table: ast.AST) -> Sequence[ast.expr]:
    if isinstance(table, ast.Set):
        return table.elts
    return table.values if isinstance(table, ast.Dict) else ()


def mutate(node: ast.AST) -> str:
    """Change the node in place; what was changed."""
    if isinstance(node, ast.Constant):
        before = node.value
        node.value = not before if isinstance(before, bool) else 1.5 * float(repr(before))
        return f"{before!r} to {node.value!r}"
    if isinstance(node, TABLES):
        dropped = node.elts.pop(0) if isinstance(node, ast.Set) else node.keys.pop(0)
        if isinstance(node, ast.Dict):
            node.values.pop(0)
        return f"without {ast.unparse(dropped) if dropped else 'its first part'}"
    kind = _kind(node)
    assert kind is not None
    new, text = OPERATORS[kind]
    if isinstance(node, ast.Compare):
        node.ops = [new()]  # type: ignore[list-item]  # the table pairs comparisons
    else:
        node.op = new()  # type: ignore[attr-defined]  # the table pairs operators
    return text


def of_kernels() -> list[Mutant]:
    """All mutants of the kernels."""
    return [
        Mutant(path, number, (folder,))
        for path, folder in TESTS.items()
        for number, _ in enumerate(places(ast.parse((ROOT / path).read_text())))
    ]


def of_commits(commits: str) -> list[Mutant]:
    """The mutants of all functions and tables that the commits touched, as they are now."""
    commits = commits if ".." in commits else f"{commits}^!"
    command = ["git", "-C", str(ROOT), "diff", "--unified=0", "--diff-filter=d", commits, "--"]
    done = subprocess.run([*command, *DECIDES], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"no commits {commits!r} here; expected COMMIT, COMMIT.. or A..B")
    found: list[Mutant] = []
    for part in done.stdout.split("\n+++ b/")[1:]:
        path = part.partition("\n")[0]
        if path.endswith(".py") and (ROOT / path).exists():
            spans = ((int(first), int(count or 1)) for first, count in HUNK.findall(part))
            lines = {line for first, count in spans for line in range(first, first + count)}
            tests = next(names for folder, names in DECIDES.items() if path.startswith(folder))
            numbers = touched((ROOT / path).read_text(), lines)
            found += [Mutant(path, number, tests) for number in numbers]
    return found


def touched(source: str, lines: set[int]) -> list[int]:
    """The numbers of the places in functions and tables that have one of these lines."""
    tree = ast.parse(source)
    spans = [
        range(node.lineno, (node.end_lineno or node.lineno) + 1)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Assign | ast.AnnAssign)
    ]
    near = {line for span in spans if lines & {*span} for line in span}
    return [n for n, (node, _) in enumerate(places(tree)) if getattr(node, "lineno", 0) in near]


def run(mutant: Mutant) -> tuple[bool, str]:
    """Whether a test notices the mutant, and a line that describes it."""
    path = COPY / mutant.path
    original = path.read_text()
    tree = ast.parse(original)
    node, function = list(places(tree))[mutant.number]
    changed = mutate(node)
    text = f"{mutant.path}:{getattr(node, 'lineno', 0)} {function or 'table'}: {changed}"
    path.write_text(ast.unparse(tree))
    try:
        for tests in mutant.tests:
            command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider"]
            command += ["-m", "not integration and not evidence", tests]
            try:
                done = subprocess.run(command, cwd=COPY, capture_output=True, timeout=TIMEOUT)
            except subprocess.TimeoutExpired:
                return True, f"{text} (tests took longer than {TIMEOUT:.0f} s)"
            if done.returncode:
                return True, text
        return False, text
    finally:
        path.write_text(original)


def make_copy() -> None:
    """Copy the sources, so that the kernels in use stay as they are."""
    shutil.rmtree(COPY, ignore_errors=True)
    COPY.mkdir(parents=True)
    for name in FOLDERS:
        ignored = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(ROOT / name, COPY / name, symlinks=True, ignore=ignored)
    for name in ("setup.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, COPY / name)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m studies.mutants", description=__doc__)
    parser.add_argument("what", choices=("kernels", "of"))
    parser.add_argument("commits", nargs="?", metavar="COMMIT", help="COMMIT, COMMIT.. or A..B")
    parser.add_argument("--draw", type=int, metavar="N", help="test N mutants [all]")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    if (options.what == "of") != (options.commits is not None):
        parser.error("name commits with `of`, such as `of HEAD` or `of v0.1..`")
    mutants = of_kernels() if options.what == "kernels" else of_commits(options.commits)
    if options.draw is not None:
        count = min(options.draw, len(mutants))
        mutants = random.Random(options.seed).sample(mutants, count)
    make_copy()
    survivors = 0
    for mutant in mutants:
        is_noticed, text = run(mutant)
        print(f"{'killed  ' if is_noticed else 'SURVIVED'}  {text}", flush=True)
        survivors += not is_noticed
    print(f"{len(mutants) - survivors} of {len(mutants)} mutants were noticed")


if __name__ == "__main__":
    main()
