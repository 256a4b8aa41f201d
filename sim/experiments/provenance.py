"""Provenance of results: versions of software, digests of code and git commits."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Set
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES, all_suffixes
from importlib.metadata import version
from pathlib import Path

import msgspec

import swarmd
from swarmd.core.errors import SwarmError
from swarmd.core.files import read_regular, user_path
from swarmd.core.kernels import describe_kernels
from swarmd.core.pin import functions_here
from swarmd.plugins import (
    MAX_MISSION_SIZE,
    METRICS_FILE,
    MISSION,
    PATTERN_FILE,
    mission_files,
    pattern_files,
)
from swarmd.ros2_nodes.launch_file import is_launch_text

NOT_IN_RUNS = frozenset(
    (
        *("acceptance", "calibration", "cli", "client", "daemon", "drivers", "film", "learning"),
        *("live", "plots", "recording", "replay", "report", "testing", "texts", "view"),
    )
)
"""Folders of swarmd that no run imports, also not within functions; a change there changes no
result.

The folders of others may have these names, too, and are then imported: they are never left out."""

OF_EXPERIMENTS = frozenset({"cores.py", "executor.py", "pool.py"})
"""The files of `sim/experiments` that a run imports, and what a client asks of a worker: the others
plan runs, and judge results."""

_SUFFIXES = tuple(all_suffixes())  # of source, compiled code and extension modules
_GIT_SECONDS = 10.0


class GitState(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A checkout's commit, and whether tracked files differ from it."""

    commit: str
    is_dirty: bool


def made_with(functions: Mapping[str, str] | None = None) -> dict[str, str]:
    """Versions of the software and of the functions that results depend on, by name.

    `functions`: what the process computes with that simulates, as `functions_here` gives it there;
    None: this process. `code` is the digest of swarmd's sources.
    """
    import mujoco
    import numpy as np

    code_at_first(os.getpid(), Path(swarmd.__file__).parent)
    return {
        "swarmd": version("swarmd"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "mujoco": mujoco.__version__,
        "scipy": version("scipy"),
        "msgspec": msgspec.__version__,
        "kernels": describe_kernels(),
        "libc": " ".join(platform.libc_ver()).strip() or "unknown",
        **(functions_here() if functions is None else functions),
        "code": digest_of_code(Path(swarmd.__file__).parent),
    }


@cache
def code_at_first(pid: int, package: Path) -> str:
    """The digest of swarmd's code when this process first asked for it, or for `made_with`.

    A kept worker may compute with that code although the files have changed since.
    """
    return digest_of_code(package)


def _is_of_metrics(path: Path) -> bool:
    """Whether a file has the metrics beside a pattern: no robot runs it.

    The manifest has its digest under the metrics that were asked for.
    """
    return path.name == METRICS_FILE and path.with_name(PATTERN_FILE).is_file()


def deciding(made: Mapping[str, str]) -> dict[str, str]:
    """The entries of `made_with` that decide the bits of results.

    A pinned process has equal bits on every x86-64, whatever the name of the processor is.
    """
    is_free = made.get("pinned") == "yes"
    return {name: text for name, text in made.items() if not (is_free and name == "processor")}


def digest_of_code(folder: Path) -> str:
    """The SHA-256 of the names and contents of swarmd's Python files and missions.

    What no run imports is left out: the folders NOT_IN_RUNS, and the files of `sim/experiments`
    that are not OF_EXPERIMENTS, and METRICS_FILE beside a pattern. Symbolic links are followed.
    """
    digest = hashlib.sha256()
    experiments = folder / "sim" / "experiments"
    # Without compiled kernels, which differ between machines: `made_with` names their form.
    sources = [
        path
        for path in _python_files(folder, NOT_IN_RUNS)
        if path.suffix == ".py"
        and (path.parent != experiments or path.name in OF_EXPERIMENTS)
        and not _is_of_metrics(path)
    ]
    for path in (*sources, *mission_files(folder / "config" / "missions")):
        digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
        digest.update(hashlib.sha256(read_regular(path)).digest())
    return digest.hexdigest()


def digest_of_kernels(folder: Path) -> str:
    """The SHA-256 of the names and contents of swarmd's compiled kernels.

    Beside the digest of the sources: other flags of the compiler give other libraries.
    """
    digest = hashlib.sha256()
    for path in _python_files(folder, NOT_IN_RUNS):
        if path.name.endswith(tuple(EXTENSION_SUFFIXES)):
            digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
            digest.update(hashlib.sha256(read_regular(path)).digest())
    return digest.hexdigest()


def digests_of_plugins(folder: Path) -> dict[str, str]:
    """The SHA-256 of each file of a plugin folder that may be imported, and of missions, by name.

    These are all files from which a pattern is found (`pattern_files`), and the Python files beside
    and below them, which a pattern may import, and the launch files of nodes, which choose modules.
    SwarmError if one is not a regular file.
    """
    files = {*pattern_files(folder), *_python_files(folder), *_launch_files(folder)}
    try:
        return {
            path.relative_to(folder).as_posix(): hashlib.sha256(read_regular(path)).hexdigest()
            for path in sorted(files)
        }
    except OSError as error:
        raise SwarmError(f"{error.filename}: cannot be read: {error.strerror}") from error


def is_launch_file(path: Path) -> bool:
    """Whether a YAML file is a launch file of `ros2_nodes`: it has a line `nodes: ...`."""
    if path.suffix != ".yaml":
        return False
    try:
        return is_launch_text(read_regular(path, MAX_MISSION_SIZE))
    except OSError:
        return True  # it is compared, and found to be unreadable


def is_code(name: str) -> bool:
    """Whether a file of `digests_of_folders` is run as code, or chooses it: a mission does not."""
    return not name.endswith(MISSION) or is_launch_file(user_path(name))


def _launch_files(folder: Path) -> Iterator[Path]:
    return (path for path in _files(folder, (".yaml",)) if is_launch_file(path))


def digests_of_folders(folders: Iterable[str]) -> dict[str, str]:
    """The SHA-256 of the plugin files in all folders, by path; `~` is expanded to read a folder."""
    return {
        f"{folder}/{name}": digest
        for folder in folders
        for name, digest in digests_of_plugins(user_path(folder)).items()
    }


def git_state(folder: Path) -> GitState | None:
    """The commit of the git checkout that tracks files of `folder`, and whether files have changed.

    None if no checkout tracks files of the folder, or if git is missing. None also if git would run
    a filter program of the checkout's configuration that cannot be switched off.
    """
    tracked = _git(folder, "ls-files", "--", ".")
    commit = _git(folder, "rev-parse", "HEAD") if tracked else None
    if not commit:
        return None
    scopes_and_keys = _git(folder, *_LIST_FILTERS, no_match="")
    # `-c KEY=` cannot switch off a key that contains "=".
    if scopes_and_keys is None or "=" in scopes_and_keys:
        return None
    scoped_keys = [line.partition("\t") for line in scopes_and_keys.splitlines()]
    filters = [key for scope, _, key in scoped_keys if scope in ("local", "worktree")]
    changed_files = _git(folder, *_STATUS, no_filters=filters)
    return GitState(commit=commit, is_dirty=bool(changed_files))


_NO_PROGRAMS = ("core.fsmonitor=false", f"core.hooksPath={os.devnull}")
_LIST_FILTERS = ("config", "--show-scope", "--name-only", "--get-regexp", r"^filter\.")
"""Lines `SCOPE<TAB>KEY`; `local` and `worktree` are the configuration of the checkout."""
_STATUS = ("status", "--porcelain", "--untracked-files=no", "--ignore-submodules=dirty")


def _git(
    folder: Path, *words: str, no_match: str | None = None, no_filters: Iterable[str] = ()
) -> str | None:
    """Run a git command in `folder`; returns its output, or None if git fails or is missing.

    `no_match`: what is returned for exit code 1, by which `git config` reports that no key matches.
    The folder may come from a stranger, and its git configuration may name programs that git runs.
    So hooks, the file system monitor, downloads and the filters of the keys `no_filters` are
    switched off. The configuration of a submodule may name further programs: `git status` is called
    with the options in `_STATUS`, by which git does not enter submodules.
    """
    settings = (*_NO_PROGRAMS, *(f"{key}=" for key in no_filters))
    options = [word for setting in settings for word in ("-c", setting)]
    try:
        completed = subprocess.run(
            ["git", "-C", str(folder), *options, *words],
            capture_output=True,
            text=True,
            timeout=_GIT_SECONDS,
            check=False,
            stdin=subprocess.DEVNULL,
            env={
                **os.environ,
                "GIT_OPTIONAL_LOCKS": "0",  # read only
                "GIT_NO_LAZY_FETCH": "1",
                "GIT_ALLOW_PROTOCOL": "none",
            },
        )
    except (OSError, subprocess.TimeoutExpired, UnicodeDecodeError):
        return None
    if completed.returncode:
        return no_match if completed.returncode == 1 else None
    return completed.stdout.strip()


def _python_files(folder: Path, left_out: Set[str] = frozenset()) -> Iterator[Path]:
    """The files below a folder that Python imports, in the order of their names."""
    return _files(folder, _SUFFIXES, left_out)


def _files(
    folder: Path, suffixes: tuple[str, ...], left_out: Set[str] = frozenset()
) -> Iterator[Path]:
    """The files below a folder with one of these suffixes, in the order of their names.

    Without folders of the names `left_out`, and without caches of compiled code. A folder to which
    several links lead is visited once.
    """
    visited: set[tuple[int, int]] = set()
    for name, folders, files in os.walk(folder, followlinks=True):
        about = os.stat(name)
        if (place := (about.st_dev, about.st_ino)) in visited:
            folders.clear()
            continue
        visited.add(place)
        folders[:] = sorted(f for f in folders if f not in (*left_out, "__pycache__"))
        yield from (Path(name) / file for file in sorted(files) if file.endswith(suffixes))
