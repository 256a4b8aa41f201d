"""The files that decide what a program computes, and their digest.

These are the modules that its modules import, also within functions, and the plugins, platforms,
scenarios and missions that studies and such files name: any word that is such a name counts.
"""

from __future__ import annotations

import ast
import hashlib
import re
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from swarmd import _PUBLIC
from swarmd.core.errors import SwarmError

ROOT = Path(__file__).resolve().parents[2]
_LINKED = ("config", "drivers", "patterns", "sim")
_OURS = ("swarmd", "studies", "benchmarks", "tests")
_NAMING = ("studies", "config", "patterns", "sim/metrics")
"""The folders in which words name plugins and files of values."""
_LISTING = {"swarmd.sim.scenarios.scenariofile.task_names": "config/scenarios/benchmark/*.yaml"}
"""Functions that list files, and so name all of them to the modules that import the function."""
_LAZY = ("swarmd/__init__.py",)
"""Imports of these modules happen by an attribute, and most programs use few."""
_WORD = re.compile(r"\w+")
_SHORT = 10


def forget() -> None:
    """Read the files again, which may have changed since."""
    for known in (_content, _next, _files_of, _named, _modules_before):
        known.cache_clear()


def sources_of(modules: Iterable[str]) -> list[Path]:
    """The files that decide what these modules compute."""
    waiting = [path for module in modules for path in _files_of(module)]
    found: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _next(path)
    return sorted(found)


def digest_of(modules: Iterable[str]) -> str:
    """The digest of `sources_of`: of the code without comments and docstrings, and of other files.

    It differs between series of Python, which print a syntax tree in other words.
    """
    digest = hashlib.sha256()
    for path in sources_of(modules):
        digest.update(f"{path.relative_to(ROOT).as_posix()}\0".encode())
        digest.update(_content(path).digest)
    return digest.hexdigest()[:16]


def commit_of(paths: Sequence[Path]) -> str:
    """The commit of this checkout, shortened; it says so if these files differ from it."""
    head = _git("rev-parse", f"--short={_SHORT}", "HEAD").strip()
    return head + ", with changes" * bool(_git("status", "--porcelain", "--", *map(str, paths)))


def head() -> str:
    """The whole hash of the commit of this checkout."""
    return _git("rev-parse", "HEAD").strip()


def changed_since(commit: str, paths: Sequence[Path]) -> list[str] | None:
    """The names of these files that differ from a commit; None if git does not know it.

    A change of comments and docstrings alone is none.
    """
    known = commit.partition(",")[0]
    try:
        names = _git("diff", "--name-only", known, "--", *map(str, paths)).splitlines()
    except SwarmError:
        return None
    before = _modules_before(known)
    return [name for name in names if name not in before or _means_other(name, before[name])]


def _means_other(name: str, before: bytes) -> bool:
    """Whether a module counts otherwise than it did."""
    path = ROOT / name
    try:
        return not path.is_file() or _read(path.suffix, before).digest != _content(path).digest
    except SyntaxError:
        return True


@cache
def _modules_before(commit: str) -> dict[str, bytes]:
    """The contents in a commit of the Python files that have changed since, by name."""
    names = _git("diff", "--name-only", "--diff-filter=MD", commit, "--", "*.py").splitlines()
    done = subprocess.run(
        ["git", "cat-file", "--batch"],
        cwd=ROOT,
        input="".join(f"{commit}:{name}\n" for name in names).encode(),
        capture_output=True,
        check=True,
    )
    found = {}
    rest = done.stdout
    for name in names:
        about, _, rest = rest.partition(b"\n")  # the hash, the kind and the size
        size = int(about.split()[-1])
        found[name] = rest[:size]
        rest = rest[size + 1 :]
    return found


def _git(*words: str) -> str:
    try:
        return subprocess.check_output(["git", *words], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    except (subprocess.CalledProcessError, OSError) as error:
        about = (getattr(error, "stderr", "") or str(error)).strip().splitlines()[0]
        raise SwarmError(
            f"git {words[0]} in {ROOT}: {about}; results name a commit: use a clone of the project"
        ) from error


class _Content(NamedTuple):
    """Of a file: the digest of what counts, and the modules that it may import."""

    digest: bytes
    modules: tuple[str, ...] = ()


@cache
def _content(path: Path) -> _Content:
    return _read(path.suffix, path.read_bytes())


def _read(suffix: str, content: bytes) -> _Content:
    """Of a module its code counts, without docstrings and other texts that stand alone."""
    if suffix != ".py":
        return _Content(hashlib.sha256(content).digest())
    tree = ast.parse(content)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [one for one in body if not _is_text(one)]  # type: ignore[attr-defined]
    digest = hashlib.sha256(ast.dump(tree).encode()).digest()
    return _Content(digest, tuple(dict.fromkeys(_modules(tree))))


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


@cache
def _next(path: Path) -> tuple[Path, ...]:
    """What a file imports and names."""
    found: list[Path] = []
    name = path.relative_to(ROOT).as_posix()
    if path.suffix == ".py":
        header = path.with_suffix(".pxd")
        found += [header] * header.is_file()
        if name not in _LAZY:
            found += [one for module in _content(path).modules for one in _files_of(module)]
    if name.startswith(_NAMING):
        words = set(_WORD.findall(path.read_text())) - {path.stem}
        found += [one for word in words & _named().keys() for one in _named()[word]]
    return tuple(found)


def _modules(tree: ast.AST) -> Iterator[str]:
    """The modules that a module may import: by a statement, or by a text that is such a name."""
    if isinstance(tree, ast.If) and _is_name(tree.test, "TYPE_CHECKING"):
        for other in tree.orelse:
            yield from _modules(other)
        return
    if isinstance(tree, ast.Import):
        yield from (one.name for one in tree.names)
    elif isinstance(tree, ast.ImportFrom) and tree.module:
        yield tree.module
        yield from (f"{tree.module}.{one.name}" for one in tree.names)
    elif isinstance(tree, ast.Constant) and isinstance(tree.value, str) and "." in tree.value:
        yield tree.value
    elif isinstance(tree, ast.Attribute) and _is_name(tree.value, "swarmd"):
        yield f"swarmd.{tree.attr}"
    for node in ast.iter_child_nodes(tree):
        yield from _modules(node)


def _is_name(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


@cache
def _files_of(module: str) -> tuple[Path, ...]:
    """The file of a module of this project, and those of the packages around it."""
    # A public name, such as `swarmd.env`, is imported when it is used.
    module = _PUBLIC.get(module.removeprefix("swarmd."), module)
    names = module.split(".")
    if names[0] not in _OURS or module.startswith(__package__):
        return ()
    found: list[Path] = []
    if module in _LISTING:
        found += ROOT.glob(_LISTING[module])
    for count in range(1, len(names) + 1):
        some = names[:count]
        folder = ROOT.joinpath(
            *some[1:] if some[0] == "swarmd" and some[1:2] and some[1] in _LINKED else some
        )
        files = (
            folder / "__init__.py",
            *(folder.with_suffix(suffix) for suffix in (".py", ".cpp", ".yaml")),
        )
        found += [path for path in files if path.is_file()]
    return tuple(found)


@cache
def _named() -> dict[str, list[Path]]:
    """The files that a word names: patterns, platforms, scenarios, missions."""
    named: dict[str, list[Path]] = {}
    for pattern in ("config/*/**/*.yaml", "studies/*/plugins/*.py", "examples/learning/*.py"):
        for path in sorted(ROOT.glob(pattern)):
            named.setdefault(path.stem, []).append(path)
    for path in sorted(ROOT.glob("patterns/*/*")):
        if path.suffix in (".py", ".pxd", ".yaml"):
            named.setdefault(path.parent.name, []).append(path)
    return named
