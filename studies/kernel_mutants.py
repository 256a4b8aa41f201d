"""Small changes of the kernels, and the tests that notice them.

`python -m studies.kernel_mutants 40 [--seed 1]` draws a sample of changes, each of one operator,
comparison or number in one function of a kernel. It runs the tests of each changed kernel in a copy
of the sources, interpreted. A mutant that no test notices survives. mutmut cannot do this, since it
changes no decorated function.
"""

from __future__ import annotations

import argparse
import ast
import random
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from swarmd.core.kernels import KERNELS, source_of

ROOT = Path(__file__).resolve().parent.parent
COPY = ROOT / "build" / "kernel-mutants"
FOLDERS = ("swarmd", "patterns", "drivers", "sim", "config", "tests", "studies", "benchmarks")
TESTS = {
    path: f"tests/{Path(path).parent.as_posix().removeprefix('swarmd/')}"
    for path in map(source_of, KERNELS)
}
"""By the file of a kernel, the folder of its tests."""
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
}
TIMEOUT = 600.0  # s for the tests of one mutant


def places(tree: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """The nodes that a mutant changes, with their functions."""
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            for node in ast.walk(function):
                kind = _kind(node)
                if kind is not None:
                    yield node, function.name


def _kind(node: ast.AST) -> type[ast.AST] | None:
    """The operator of a node that can be changed; Constant for a number; None otherwise."""
    if isinstance(node, ast.BinOp | ast.AugAssign | ast.BoolOp):
        found: ast.AST = node.op
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        found = node.ops[0]
    elif isinstance(node, ast.Constant) and type(node.value) is float and node.value:
        return ast.Constant
    else:
        return None
    return type(found) if type(found) in OPERATORS else None


def mutate(node: ast.AST) -> str:
    """Change the node in place; what was changed."""
    if isinstance(node, ast.Constant):
        before = float(repr(node.value))
        node.value = 1.5 * before
        return f"{before:g} to {node.value:g}"
    kind = _kind(node)
    assert kind is not None
    new, text = OPERATORS[kind]
    if isinstance(node, ast.Compare):
        node.ops = [new()]  # type: ignore[list-item]  # the table pairs comparisons
    else:
        node.op = new()  # type: ignore[attr-defined]  # the table pairs operators
    return text


def sample(count: int, seed: int) -> list[tuple[str, int]]:
    """The drawn mutants, each as the kernel's path and the index of the changed place in it."""
    every = [
        (path, number)
        for path in TESTS
        for number, _ in enumerate(places(ast.parse((ROOT / path).read_text())))
    ]
    return random.Random(seed).sample(every, min(count, len(every)))


def run(path: str, number: int) -> tuple[bool, str]:
    """Whether a test notices the mutant, and a line that describes it."""
    original = (ROOT / path).read_text()
    tree = ast.parse(original)
    node, function = list(places(tree))[number]
    changed = mutate(node)
    text = f"{path}:{getattr(node, 'lineno', 0)} {function}: {changed}"
    (COPY / path).write_text(ast.unparse(tree))
    try:
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider"]
        command += ["-m", "not integration and not evidence", TESTS[path]]
        try:
            done = subprocess.run(command, cwd=COPY, capture_output=True, timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            return True, f"{text} (tests took longer than {TIMEOUT:.0f} s)"
        return done.returncode != 0, text
    finally:
        (COPY / path).write_text(original)


def make_copy() -> None:
    """Copy the sources, so that the kernels in use stay as they are."""
    shutil.rmtree(COPY, ignore_errors=True)
    COPY.mkdir(parents=True)
    for name in FOLDERS:
        ignored = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(ROOT / name, COPY / name, symlinks=True, ignore=ignored)
    for name in ("setup.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, COPY / name)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m studies.kernel_mutants", description=__doc__)
    parser.add_argument("count", type=int, help="mutants to draw")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    make_copy()
    survivors = []
    drawn = sample(options.count, options.seed)
    for path, number in drawn:
        is_noticed, text = run(path, number)
        print(f"{'killed  ' if is_noticed else 'SURVIVED'}  {text}", flush=True)
        survivors += [] if is_noticed else [text]
    print(f"{len(drawn) - len(survivors)} of {len(drawn)} mutants were noticed")


if __name__ == "__main__":
    main()
