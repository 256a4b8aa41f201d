"""What results depend on is found out: code, plugins and the state of git."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

import swarmd
from swarmd.core.errors import SwarmError
from swarmd.plugins import pattern_folders, pattern_names
from swarmd.sim.experiments.provenance import (
    NOT_IN_RUNS,
    GitState,
    digest_of_code,
    digests_of_plugins,
    git_state,
    made_with,
)


def git(folder: Path, *words: str) -> None:
    who = ("-c", "user.name=x", "-c", "user.email=x@y")
    subprocess.run(["git", "-C", str(folder), *who, *words], check=True, capture_output=True)


def test_the_digest_follows_names_contents_and_links_of_what_runs_read(tmp_path: Path) -> None:
    package, linked = tmp_path / "package", tmp_path / "sim" / "a.py"
    for folder in (tmp_path / "sim", package / "operator/cli"):
        folder.mkdir(parents=True)
        (folder / "a.py").write_text("1")
    (package / "sim").symlink_to("../sim")
    first = digest_of_code(package)
    (package / "operator/cli" / "a.py").write_text("2")
    (tmp_path / "sim" / "experiments").mkdir()
    (tmp_path / "sim" / "experiments" / "statistics.py").write_text("1")
    assert digest_of_code(package) == first
    (tmp_path / "sim" / "experiments" / "pool.py").write_text("1")
    with_pool = digest_of_code(package)
    assert with_pool != first
    for name in ("pattern.py", "metrics.py"):
        (package / "patterns" / "gather").mkdir(parents=True, exist_ok=True)
        (package / "patterns" / "gather" / name).write_text("1")
    with_pattern = digest_of_code(package)
    (package / "patterns" / "gather" / "metrics.py").write_text("2")  # a manifest names it
    assert digest_of_code(package) == with_pattern != with_pool
    linked.write_text("2")
    second = digest_of_code(package)
    linked.rename(linked.with_name("b.py"))
    assert len({first, with_pool, second, digest_of_code(package)}) == 4


def test_the_arithmetic_that_the_environment_chooses_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    free = made_with()
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Haswell")
    assert made_with() == {**free, "blas": "Haswell"} != free


@pytest.mark.integration
def test_no_run_reads_what_the_digest_leaves_out() -> None:
    modules = "swarmd.sim.experiments.pool, swarmd.patterns.attraction.pattern"
    code = f"import sys, {modules}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = [name for name in done.stdout.split() if name.partition(".")[0] == "swarmd"]
    assert not [name for name in loaded if NOT_IN_RUNS & set(name.split("."))]
    assert "swarmd.sim.lockstep.lockstep" in loaded
    assert not NOT_IN_RUNS & pattern_folders().keys()


def test_plugins_are_listed_with_their_digests(tmp_path: Path) -> None:
    for name in ("b.py", "a.py", "notes.txt"):
        (tmp_path / name).write_text("")
    empty = hashlib.sha256(b"").hexdigest()
    assert list(digests_of_plugins(tmp_path).items()) == [("a.py", empty), ("b.py", empty)]
    (tmp_path / "c.py").symlink_to("nowhere")
    with pytest.raises(SwarmError, match=r"c\.py"):
        digests_of_plugins(tmp_path)


CODE = "import pathlib; pathlib.Path('canary').touch()"
TREES: dict[str, tuple[str, str]] = {
    **{f"folder {name}": (f"{name}/pattern.py", name) for name in ("plots", "cli", "film", "live")},
    **{f"folder {name}": (f"{name}/pattern.py", name) for name in ("report", "testing", "x")},
    "file": ("x.py", "x"),
    "file of a skipped name": ("plots.py", "plots"),
    "link to a file of another name": ("x.py -> code.txt", "x"),
    "link out of a cache": ("__pycache__/pattern.py -> ../deep/evil/pattern.py", "evil"),
    "link out of a hidden folder": (".git/pattern.py -> ../deep/evil/pattern.py", "evil"),
    "link to a folder": ("plots -> deep/evil", "evil"),
    "upper case": ("PLOTS/pattern.py", ""),
    "upper suffix": ("x.PY", ""),
    "no UTF-8": ("\udcff/pattern.py", ""),
    "a test": ("test_x.py", ""),
    "compiled": ("x/__pycache__/pattern.pyc", ""),
    "a loop": ("x/pattern.py -> pattern.py", ""),
}
"""A file, or a link and its target; and the name of the pattern that is imported, or nothing."""


@pytest.mark.parametrize(("place", "pattern"), TREES.values(), ids=TREES)
def test_what_a_pattern_is_imported_from_is_compared(
    tmp_path: Path, place: str, pattern: str
) -> None:
    folder = tmp_path / "pd"
    path, _, target = place.partition(" -> ")
    (folder / path).parent.mkdir(parents=True)
    for real in ("code.txt", "deep/evil/pattern.py", *([] if target else [path])):
        (folder / real).parent.mkdir(parents=True, exist_ok=True)
        (folder / real).write_text(CODE)
    if target:
        (folder / path).symlink_to(target)
    found = pattern_names(folder, {})
    assert list(found) == ([pattern] if pattern else [])
    digest = hashlib.sha256(CODE.encode()).hexdigest()
    if pattern:
        assert (
            digests_of_plugins(folder)[Path(found[pattern].source).relative_to(folder).as_posix()]
            == digest
        )


def test_links_that_multiply_folders_end(tmp_path: Path) -> None:
    """Forty folders, each with two links to the next: 2 to the power of 40 paths."""
    for number in range(40):
        folder = tmp_path / f"f{number}"
        folder.mkdir()
        for name in "ab":
            (folder / name).symlink_to(tmp_path / f"f{number + 1}")
    (tmp_path / "f39" / "own.py").write_text("")
    assert any(name.endswith("own.py") for name in digests_of_plugins(tmp_path))


@pytest.mark.integration
def test_git_gives_the_commit_and_whether_files_have_changed(tmp_path: Path) -> None:
    git(tmp_path, "init", "-q")
    inside = tmp_path / "scenarios"
    inside.mkdir()
    (inside / "a.yaml").write_text("1")
    assert git_state(inside) is None
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "x")
    clean = git_state(inside)
    (inside / "a.yaml").write_text("2")
    dirty = git_state(inside)
    assert clean is not None
    assert len(clean.commit) == 40
    assert not clean.is_dirty
    assert dirty == GitState(commit=clean.commit, is_dirty=True)


def test_without_git_or_outside_of_it_there_is_no_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert git_state(tmp_path) is None
    monkeypatch.setenv("PATH", os.devnull)
    assert git_state(Path(swarmd.__file__).resolve().parent) is None


PROGRAMS = {
    "core.fsmonitor": "{touch}; false",
    "filter.x.clean": "{touch}; cat",
    "filter.x.process": "{touch}",
    "filter.a=b.clean": "{touch}; cat",
    "core.hooksPath": "hooks",
    "include.path": "../included",
    "remote.origin.url": "ext::touch {canary}",
}
"""Keys of a checkout's configuration that name a program, or lead to one."""


@pytest.mark.integration
@pytest.mark.parametrize("key", PROGRAMS)
def test_a_checkout_of_others_runs_no_program(key: str, tmp_path: Path) -> None:
    folder, canary = tmp_path / "checkout", tmp_path / "canary"
    (folder / "hooks").mkdir(parents=True)
    git(folder, "init", "-q")
    touch = f"sh -c 'touch {canary}'"
    hook = folder / "hooks" / "post-index-change"
    hook.write_text(f"#!/bin/sh\n{touch}\n")
    hook.chmod(0o755)
    (folder / "included").write_text(f'[filter "x"]\nclean = "{touch}; cat"\n')
    (folder / ".gitattributes").write_text(f"*.yaml filter={'a=b' if '=' in key else 'x'}\n")
    (folder / "a.yaml").write_text("1")
    git(folder, "add", ".")
    git(folder, "commit", "-qm", "x")
    os.utime(folder / "a.yaml", (1, 1))  # git has to look into it
    git(folder, "config", key, PROGRAMS[key].format(touch=touch, canary=canary))
    if key == "remote.origin.url":  # a checkout without its objects, which git would fetch
        for name, value in (("remote.origin.promisor", "true"), ("protocol.ext.allow", "always")):
            git(folder, "config", name, value)
        git(folder, "config", "extensions.partialClone", "origin")
        found = [one for one in (folder / ".git/objects").rglob("*") if one.is_file()]
        for one in found:
            kind = subprocess.run(
                ["git", "-C", str(folder), "cat-file", "-t", one.parent.name + one.name],
                capture_output=True,
                text=True,
                check=True,
            )
            if kind.stdout == "tree\n":
                one.unlink()
    git_state(folder)
    assert not canary.exists()
    with suppress(subprocess.CalledProcessError):  # armed: git itself runs the program
        git(folder, "status")
    assert canary.exists()
