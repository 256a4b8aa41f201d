"""What patterns are, asked of a child process: neither swarmctl nor swarmd imports plugin code.

A plugin may end the child while it is imported, or keep it for ever. Then that plugin is named,
and another child is asked for those that are left.

Has a pattern's file checked by a child process, and takes down what that says.

The file may end the child, or keep it for ever. Then the point at which it did so is not well, and
another child goes on behind it.
"""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

from swarmd.core.errors import PluginError
from swarmd.core.processes import how_it_ended
from swarmd.plugins import pattern_names

Row = dict[str, Any]
PATIENCE = 15.0  # s for one pattern; the first brings numpy, perhaps from a cold disk


def describe_patterns(
    names: Sequence[str], plugin_dir: Path | None, platform: str, patience: float = PATIENCE
) -> list[Row]:
    """The named patterns (none named: all) as the pattern host's `--describe` says it.

    A pattern that cannot be loaded within `patience` s has a row with `error`. PluginError if
    even the child itself fails.
    """
    left = list(names or pattern_names(plugin_dir))
    rows: list[Row] = []
    while left:
        found = _ask(left, plugin_dir, platform, patience)
        rows += found
        left = left[len(found) :]
    return rows


def _ask(
    names: Sequence[str], plugin_dir: Path | None, platform: str, patience: float
) -> list[Row]:
    """The rows of `names` in their order, up to one that ends or keeps the child."""
    # -P: a random.py where this is called is not to shadow a module.
    command = [sys.executable, "-P", "-m", "swarmd.pattern_host.worker", "--platform", platform]
    command += ["--parent", str(os.getpid())]
    if plugin_dir is not None:
        command += ["--plugin-dir", str(plugin_dir)]
    command += ["--describe", *names]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with (
        TemporaryFile() as log,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, env=environment) as child,
    ):
        assert child.stdout is not None
        try:
            rows, culprit = _read(child.stdout, patience)
            is_over = len(rows) == len(names)
            hangs = not is_over and is_running(child)
        finally:
            child.kill()
        if not is_over and culprit is None:
            log.seek(0)
            raise PluginError(_last_line(log.read().decode(errors="replace"), hangs))
    if culprit is not None:
        how = f"is not done after {patience:.0f} s" if hangs else how_it_ended(child.returncode)
        text = f"the process that imports it {how}"
        rows.append({"name": culprit["begin"], "error": text, "source": culprit["source"]})
    return rows


def _read(stream: IO[bytes], patience: float) -> tuple[list[Row], Row | None]:
    """The rows that came, and what was begun and not done when the child ended or fell silent."""
    rows: list[Row] = []
    begun: Row | None = None
    for line in lines(stream, patience):
        message = message_of(line)
        if "end" in message:
            return rows, None
        if "begin" in message:
            begun = message
        elif "name" in message:
            rows.append(message)
            begun = None
    return rows, begun


def lines(stream: IO[bytes], patience: float) -> Iterator[bytes]:
    """Whole lines, until the end or until none has come for `patience` s."""
    buffer = b""
    deadline = time.monotonic() + patience
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        while selector.select(max(0.0, deadline - time.monotonic())):
            piece = os.read(stream.fileno(), 65536)
            if not piece:
                return
            *whole, buffer = (buffer + piece).split(b"\n")
            if whole:
                deadline = time.monotonic() + patience
            yield from whole


def message_of(line: bytes) -> Row:
    """What a line says; nothing if it is none of ours: plugin code may write where we do."""
    with contextlib.suppress(ValueError):
        message = json.loads(line)
        if isinstance(message, dict):
            return message
    return {}


def is_running(child: subprocess.Popen[bytes]) -> bool:
    """True unless it is ending; one that has closed its output is given a moment to do so."""
    try:
        child.wait(timeout=1.0)
    except subprocess.TimeoutExpired:
        return True
    return False


def _last_line(text: str, hangs: bool) -> str:
    if hangs:
        return "the process that describes patterns does not begin to"
    words = [line for line in text.splitlines() if line.strip()]
    line = words[-1] if words else "the process that describes patterns ended without a word"
    return line.removeprefix("swarmd.core.errors.").removeprefix("ConfigError: ")


PRINTS = "prints nothing"
LEAVES = "opens and starts nothing"


@dataclass(frozen=True, slots=True)
class Point:
    """One point that was checked. `text`: what is not well, or empty."""

    name: str
    is_well: bool
    text: str = ""


@dataclass(slots=True, eq=False)
class _Heard:
    """What one child has said. `begun`: the point at which it ended or fell silent."""

    points: list[Point]
    seen: list[str]
    begun: str | None = None
    is_over: bool = False


def check_file(path: Path, patience: float) -> list[Point]:
    """All points, each within `patience` s; only the first if the file cannot be loaded.

    PluginError if the child itself fails.
    """
    points: list[Point] = []
    seen: list[str] = []
    with TemporaryFile() as log:
        while True:
            heard = _ask_plugin_check(path, [point.name for point in points], patience, log)
            # Each child loads the file anew; only the first one's word on that counts.
            points += heard.points if not points else heard.points[1:]
            seen += [text for text in heard.seen if text not in seen]
            if heard.is_over or len(points) < 2:
                break
        log.seek(0)
        printed = [line for line in log.read().decode(errors="replace").splitlines() if line]
    points.append(Point(PRINTS, not printed, _first(printed)))
    points.append(Point(LEAVES, not seen, _first(seen)))
    return points


def _ask_plugin_check(path: Path, done: Sequence[str], patience: float, log: IO[bytes]) -> _Heard:
    # -P: a random.py where this is called is not to shadow a module.
    command = [sys.executable, "-P", "-m", "swarmd.pattern_host.inspect_plugin", str(path)]
    command += ["--parent", str(os.getpid()), "--done", *done]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, env=environment
    ) as child:
        assert child.stdout is not None
        try:
            heard = _read_plugin_check(child.stdout, patience)
            hangs = not heard.is_over and is_running(child)
        finally:
            child.kill()
    if heard.is_over:
        return heard
    how = f"is not done after {patience:g} s" if hangs else how_it_ended(child.returncode)
    if heard.begun is None:
        raise PluginError(f"the process that checks {path} {how}")
    heard.points.append(Point(heard.begun, False, f"the process that checks it {how}"))
    return heard


def _read_plugin_check(stream: IO[bytes], patience: float) -> _Heard:
    heard = _Heard([], [])
    for line in lines(stream, patience):
        message = message_of(line)
        if "seen" in message:
            heard.seen.append(message["seen"])
        elif "begin" in message:
            heard.begun = message["begin"]
        elif "point" in message:
            error = message.get("error")
            text = error if error is not None else message.get("text", "")
            heard.points.append(Point(str(message["point"]), error is None, str(text)))
            heard.begun = None
        elif "end" in message:
            heard.is_over = True
            return heard
    return heard


def _first(told: Sequence[str]) -> str:
    more = f", and {len(told) - 1} more" if len(told) > 1 else ""
    return f"{told[0][:200]}{more}" if told else ""
