"""Checks one pattern's file, point by point, in a process that may be lost: `python -m` this.

A JSON line `{"begin": point}` before each point and `{"point": ..., "error": ...}` after it (null:
well), `{"seen": ...}` for each way out that the file's code took, at last `{"end": true}`. Whoever
reads knows which point has ended this process, or keeps it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import IO, Any

from swarmd.core.errors import SwarmError
from swarmd.core.keys import check_id
from swarmd.core.processes import die_with_parent
from swarmd.kit.behavior import Pattern
from swarmd.pattern_host.loader import PatternLoader
from swarmd.settings.settings import platform_names
from swarmd.testing.pattern_contract import PatternContract

LOADING = "it can be imported and holds one pattern"
MIRRORED = "mirrored scans give mirrored wishes"
NOT_CLAIMED = "is_symmetric is not claimed"
MEMORY_LIMIT = 1024 * 1024 * 1024
# Audit events (PEP 578) of what a pattern has no business with.
_OUT = (
    *("open", "socket.connect", "socket.bind", "subprocess.Popen", "os.system", "os.fork"),
    *("os.exec", "os.posix_spawn", "os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.listdir"),
    *("os.scandir", "shutil.copyfile", "shutil.rmtree", "tempfile.mkstemp", "urllib.Request"),
)


def main() -> None:
    """Check the file and end."""
    parser = argparse.ArgumentParser(prog="swarmd.pattern_host.inspect_plugin", description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--parent", type=int, required=True, help="end with this process")
    parser.add_argument("--done", nargs="*", default=[], metavar="POINT", help="leave these out")
    args = parser.parse_args()
    die_with_parent(args.parent)
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answer:
        os.dup2(2, 1)  # what the file prints is not part of the answer
        _limit_memory()
        _check(args.file.resolve(), frozenset(args.done), answer)


def _check(path: Path, done: frozenset[str], answer: IO[str]) -> None:
    def say(line: dict[str, Any]) -> None:
        with suppress(OSError, ValueError):  # the file may have closed it
            sys.stdout.flush()  # whoever asks ends this process after the last line
            sys.stderr.flush()
        print(json.dumps(line), file=answer, flush=True)

    _watch(str(path), lambda text: say({"seen": text}))
    loaded: list[type[Pattern[Any]]] = []

    def load() -> None:
        check_id(path.stem, "the file's name, which is the pattern's,")
        loaded.append(PatternLoader({path.stem: (str(path), True)})(path.stem))

    say({"begin": LOADING})
    error = _attempt(load, path)
    say({"point": LOADING, "error": error})
    for point, check in _points(loaded[0], path.parent) if error is None else ():
        if point not in done:
            say({"begin": point})
            text = "" if loaded[0].is_symmetric or point != MIRRORED else NOT_CLAIMED
            say({"point": point, "error": _attempt(check, path), "text": text})
    say({"end": True})


def _points(kind: type[Pattern[Any]], folder: Path) -> Iterator[tuple[str, Callable[[], None]]]:
    """Each point of the contract by its name in words; it is checked for all platforms."""
    contract = type("Contract", (PatternContract,), {"pattern": kind, "plugin_dir": folder})
    for name in vars(PatternContract):
        if name.startswith("test_"):
            yield name.removeprefix("test_").replace("_", " "), _check_of(contract, name)


def _check_of(contract: type[PatternContract], name: str) -> Callable[[], None]:
    def check() -> None:
        for platform in platform_names():
            case = contract()
            case.setup_method()
            try:
                getattr(case, name)(contract.subject(platform))
            except Exception as error:
                error.add_note(platform)
                raise
            finally:
                case.teardown_method()

    return check


def _attempt(call: Callable[[], None], path: Path) -> str | None:
    """None, or in one line what was raised."""
    try:
        call()
    except (Exception, SystemExit) as error:  # the file may raise anything
        where = "".join(f"{note}: " for note in getattr(error, "__notes__", ()))
        return (where + _told(error, path))[:500]
    return None


def _told(error: BaseException, path: Path) -> str:
    """What was raised, with the file's last line on the way there."""
    text = " ".join(str(error).split())
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(path)]
    if isinstance(error, SyntaxError) and error.filename == str(path):
        text, lines = error.msg, [error.lineno]
    place = f" ({path.name}:{lines[-1]})" if lines else ""
    is_worded = isinstance(error, SwarmError) or (isinstance(error, AssertionError) and text)
    kind = type(error).__name__
    return (text if is_worded else f"{kind}: {text}" if text else kind) + place


def _watch(path: str, see: Callable[[str], None]) -> None:
    """Have `see` told, once each, of the ways out that the file's own code takes."""
    told: set[str] = set()

    def hook(event: str, args: tuple[Any, ...]) -> None:
        if event not in _OUT:
            return
        line = _line_in(path, sys._getframe(1))
        if line is None:
            return
        what = f"{event} {args[0]!r}"[:120] if args else event
        text = f"{what} ({Path(path).name}:{line})"
        if text not in told:
            told.add(text)
            see(text)

    sys.addaudithook(hook)


def _line_in(path: str, frame: FrameType | None) -> int | None:
    """The line of the file that has led here; None if it was an import, or another's doing."""
    while frame is not None:
        name = frame.f_code.co_filename
        if name == path:
            return frame.f_lineno
        if name.startswith("<frozen importlib"):
            return None
        frame = frame.f_back
    return None


def _limit_memory() -> None:
    with open("/proc/self/statm") as file:
        size = int(file.read().split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = size + MEMORY_LIMIT
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


if __name__ == "__main__":
    main()
