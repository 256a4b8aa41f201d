"""Has a pattern's file checked by a child process, and takes down what that says.

The file may end the child, or keep it for ever. Then the point at which it did so is not well, and
another child goes on behind it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

from swarmd.cli.catalog import is_running, lines, message_of
from swarmd.errors import PluginError
from swarmd.processes import how_it_ended

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
            heard = _ask(path, [point.name for point in points], patience, log)
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


def _ask(path: Path, done: Sequence[str], patience: float, log: IO[bytes]) -> _Heard:
    # -P: a random.py where this is called is not to shadow a module.
    command = [sys.executable, "-P", "-m", "swarmd.testing.checking", str(path)]
    command += ["--parent", str(os.getpid()), "--done", *done]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, env=environment
    ) as child:
        assert child.stdout is not None
        try:
            heard = _read(child.stdout, patience)
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


def _read(stream: IO[bytes], patience: float) -> _Heard:
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
