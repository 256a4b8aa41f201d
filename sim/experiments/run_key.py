"""The key of a run: a digest of all that its result follows from.

These are the code that a run can execute and its compiled kernels, the libraries, the functions and
the processor of a pinned worker, the variables that act as Python and libraries start, the complete
scenario, the seed, the simulated time, the metrics, and all files in the folder of plugins. A run
of which more may matter has no key: of a worker that is not pinned, with a picture in its scenario,
with a plugin of another package, or with one that does not pass the look (`plugin_look.py`).

The key has no path: a plugin that passes the look does not know where it lies.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.machinery import BYTECODE_SUFFIXES, EXTENSION_SUFFIXES, all_suffixes
from pathlib import Path
from typing import Any

import swarmd
from swarmd.core.errors import SwarmError
from swarmd.core.files import read_regular, real_path, user_path
from swarmd.plugins import MISSION, Origin, pattern_names
from swarmd.sim.experiments.manifest import NAME as MANIFEST
from swarmd.sim.experiments.plugin_look import Look, look_at
from swarmd.sim.experiments.pool import Job, variables_at_start
from swarmd.sim.experiments.provenance import (
    code_at_first,
    digest_of_code,
    digest_of_kernels,
)
from swarmd.sim.experiments.run_list import VARIABLE as LIST_VARIABLE
from swarmd.sim.experiments.run_store import SIZE_VARIABLE, VARIABLE
from swarmd.sim.metrics.catalog import names_file

FORMAT = 1
"""A rise makes all entries of the store unknown."""
MAX_FILES = 2000
MAX_BYTES = 64 << 20
"""Bounds of the files in a folder of plugins."""
_OF_TUNING = "tune.json"
_NATIVE = (*EXTENSION_SUFFIXES, *BYTECODE_SUFFIXES)
_OURS = "swarmd.patterns."


@dataclass(frozen=True, slots=True)
class Key:
    """The key of a run; `text` is empty for a run without one, and `reason` says why.

    The reason is empty, too, if no run of this machine has a key.
    """

    text: str
    reason: str = ""


class RunKeys:
    """The keys of runs that processes with one software do.

    `made_with`: the software (`provenance.made_with`). The files of plugins are read once.
    """

    def __init__(self, made_with: Mapping[str, str]) -> None:
        self._made_with = dict(made_with)
        self._package = Path(swarmd.__file__).parent
        self._kernels = digest_of_kernels(self._package)
        left_out = (VARIABLE, SIZE_VARIABLE, LIST_VARIABLE)
        at_start = {k: v for k, v in variables_at_start().items() if k not in left_out}
        code_at_first(os.getpid(), self._package)
        self._software = _digest([FORMAT, self._made_with, self._kernels, at_start])
        self._folders: dict[str, _Folder] = {}
        self._looks: dict[Path, Look] = {}
        self._scenarios: dict[str, tuple[str, str]] = {}  # the digest and the fault of each
        self._metrics: dict[str, str] = {}  # the digest of each file, by its path

    def key(self, job: Job) -> Key:
        """The key of a job."""
        if self._made_with.get("pinned") != "yes":
            return Key("")
        digest, fault = self._of_scenario(job.effective)
        if fault:
            return Key("", fault)
        metrics = []
        for origin, of_code in job.metrics.items():
            if fault := self._fault_of_metric(origin, of_code):
                return Key("", fault)
            metrics.append([_without_folder(origin), of_code])
        seconds = None if math.isinf(job.seconds) else job.seconds
        about = [digest, job.seed, seconds, metrics, job.guest is not None]
        return Key(_digest([self._software, *about]))

    def still_hold(self) -> bool:
        """Whether the files are those of which the keys were made.

        Also whether swarmd's code is that with which this process began: a worker that it has kept
        since computes with that.
        """
        code = digest_of_code(self._package)
        if not code == self._made_with.get("code") == code_at_first(os.getpid(), self._package):
            return False
        if digest_of_kernels(self._package) != self._kernels:
            return False
        if any(folder != _folder(text) for text, folder in self._folders.items()):
            return False
        return all(_digest_of_file(path) == of for path, of in self._metrics.items())

    def _of_scenario(self, effective: Mapping[str, Any]) -> tuple[str, str]:
        """The digest of a scenario with its plugins, and why its runs have no key."""
        # In its order: some layouts place robots in the order of the file.
        text = json.dumps({**effective, "plugin_dir": None})
        place = effective.get("plugin_dir") or ""
        known = self._scenarios.get(place + text)
        if known is None:
            if place and place not in self._folders:
                self._folders[place] = _folder(place)
            files = self._folders[place].digests if place else {}
            fault = self._folders[place].fault if place else ""
            known = _digest([text, files]), fault or self._fault_of(effective, place)
            self._scenarios[place + text] = known
        return known

    def _fault_of(self, effective: Mapping[str, Any], place: str) -> str:
        """Why more than the scenario and the files of its plugins may matter; else empty."""
        texts = set(_texts(effective))
        if "image" in texts:
            return "its floor is a picture in a file"
        if file := next((text for text in texts if text.endswith(MISSION)), ""):
            return f"its scenario names the file {file}"
        try:
            origins = pattern_names(user_path(place) if place else None)
        except SwarmError as error:
            return str(error)
        waiting = sorted(texts & origins.keys())
        named = set(waiting)
        while waiting:
            name = waiting.pop()
            origin = origins[name]
            if _is_ours(origin):
                continue
            if not origin.is_file:
                return f"pattern {name} is of {origin.source}"
            # Modules beside the target of a link are not among the files of the folder.
            if not Path(origin.value).is_relative_to(real_path(user_path(place))):
                return f"{origin.source} is a link out of its folder"
            if origin.value.endswith(MISSION):  # of any of the patterns in its folder
                more = {n for n, one in origins.items() if one.is_file and not _is_ours(one)}
            else:
                look = self._look(Path(origin.value))
                if look.fault:
                    return look.fault
                more = set(look.texts & origins.keys())
            waiting += sorted(more - named)
            named |= more
        return ""

    def _fault_of_metric(self, origin: str, digest: str) -> str:
        if not names_file(origin):
            # Of swarmd itself if nothing has to be compared.
            return f"metric {origin} is of another package" if digest else ""
        file = Path(origin.rpartition(":")[0])
        self._metrics[str(file)] = digest
        return self._look(file).fault

    def _look(self, file: Path) -> Look:
        if file not in self._looks:
            self._looks[file] = look_at(file)
        return self._looks[file]


@dataclass(frozen=True, slots=True)
class _Folder:
    """The SHA-256 of each file in a folder of plugins, by its path there; why it has no digest."""

    digests: Mapping[str, str]
    fault: str = ""


def _folder(text: str) -> _Folder:
    """All files below a folder, but caches of compiled code, hidden folders, and results.

    Results of experiments may lie in or below the folder in which a user works: of a folder with
    results, only what Python imports counts, and missions. Links are followed.
    """
    root = user_path(text)
    digests: dict[str, str] = {}
    size = 0
    try:
        for path in _files(root):
            name = path.relative_to(root).as_posix()
            if path.name.endswith(_NATIVE):
                return _Folder({}, f"{name} is compiled code")
            content = read_regular(path, MAX_BYTES)
            digests[name] = hashlib.sha256(content).hexdigest()
            size += len(content)
            if len(digests) > MAX_FILES or size > MAX_BYTES:
                fault = f"{root} has more than {MAX_FILES} files or {MAX_BYTES >> 20} MB"
                return _Folder({}, fault)
    except OSError as error:
        return _Folder({}, f"{error.filename}: cannot be read: {error.strerror}")
    return _Folder(digests)


def _files(root: Path) -> Iterator[Path]:
    visited: set[tuple[int, int]] = set()
    results: set[str] = set()
    for place, folders, files in os.walk(root, followlinks=True):
        about = os.stat(place)
        identity = (about.st_dev, about.st_ino)
        if identity in visited:
            folders.clear()
            continue
        visited.add(identity)
        if MANIFEST in files or _OF_TUNING in files or os.path.dirname(place) in results:
            results.add(place)
            read = (*all_suffixes(), MISSION) if place == str(root) else tuple(all_suffixes())
            files = [name for name in files if name.endswith(read)]
        folders[:] = sorted(one for one in folders if one[0] != "." and one != "__pycache__")
        yield from (Path(place, name) for name in sorted(files))


def _is_ours(origin: Origin) -> bool:
    """Whether a pattern or mission comes with swarmd, whose code and missions the key has."""
    if origin.is_file:
        return origin.source == "swarmd"
    return origin.value.startswith(_OURS) and not origin.rival


def _texts(value: Any) -> Iterator[str]:
    """All texts in plain values, the names of keys included."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield key
            yield from _texts(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _texts(inner)


def _without_folder(origin: str) -> str:
    return Path(origin).name if names_file(origin) else origin


def _digest_of_file(path: str) -> str:
    try:
        return hashlib.sha256(read_regular(path)).hexdigest()
    except OSError:
        return ""


def _digest(values: list[Any]) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()
