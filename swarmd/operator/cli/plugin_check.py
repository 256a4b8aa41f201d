"""Inspects plugin code in a child process: swarmctl and swarmd import no plugin code.

Plugin code may end the child, or hang. Then the present item is reported with the line of code, and
another child inspects the remaining items (`swarmd.pattern_host.plugin_inspector`).
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, Literal, NamedTuple

from swarmd.core.errors import ConfigError, PluginError, unknown
from swarmd.core.processes import MAX_OUTPUT, how_it_ended
from swarmd.link.keys.identity import SYSTEM_FOLDER, user_folder
from swarmd.plugins import pattern_names

Record = dict[str, Any]
DESCRIBE_TIMEOUT = 15.0
"""Seconds for one pattern, for the first pattern with the import of numpy."""

MISSION_TIMEOUT = 30.0
"""Seconds for a mission: the child imports every pattern that it names."""

STACK_TIMEOUT = 3.0
"""Seconds that a child that hangs may take to write its stack, also on a busy machine."""

_MAX_POINTS = 64
"""The most points of a check, and items of an inspection beyond those that were asked for."""
_MAX_ANSWER = 1 << 24  # bytes of a child's standard output
WORK_PERIOD = 0.5  # s between two looks at the processor time of a child that is late

NO_OUTPUT = "it prints nothing"
NO_SIDE_EFFECTS = "it opens and starts nothing"
SKIPPED = "the other points"
_FRAME = re.compile(rb'\s*File "(.+)", line (\d+)')
_PLACE = re.compile(r" \(\S+:\d+\)$")
_NUMBER = re.compile(r"\d+(\.\d+)?(e[-+]\d+)?")


@dataclass(frozen=True, slots=True)
class Point:
    """A checked rule of the contract of patterns. `text`: the fault, or a remark.

    `repeated`: the rule is violated by a fault that an earlier point has reported.
    """

    name: str
    result: Literal["ok", "fault", "repeated", "skipped"]
    text: str = ""


def describe_patterns(
    names: Sequence[str], plugin_dir: Path | None, platform: str, timeout: float = DESCRIBE_TIMEOUT
) -> list[Record]:
    """Describes the patterns `names`, or all patterns without names, each by a JSON object.

    A pattern that cannot be loaded within `timeout` s has a description with `error`. PluginError
    if the child process that imports the patterns fails.
    """
    options = ["--platform", platform, *_plugin_dir_option(plugin_dir)]
    left = list(names or pattern_names(plugin_dir))
    rows: list[Record] = []
    while left:
        count = len(rows)
        for row in _inspect([*options, "describe", *left], timeout, plugin_dir):
            if "result" in row:
                rows.append(row)
            elif "lost" in row:
                error = f"the process that imports it {row['how']}"
                rows.append({"name": row["lost"], "error": error, "source": row["source"]})
        if len(rows) == count:
            raise PluginError("the process that describes patterns ended without an answer")
        left = left[len(rows) - count :]
    return rows


def check_runs(
    runs: Sequence[Record],
    plugin_dir: Path | None,
    platform: str,
    timeout: float = DESCRIBE_TIMEOUT,
) -> dict[str, str]:
    """Why a robot would refuse each run, by the run's name; empty for a run that it would load.

    `runs`: with `name`, `pattern`, `layers` (the parameters by source, weakest first), `until`, and
    `provides` (the inputs of the robot). PluginError if the child process fails before a run.
    """
    options = ["--platform", platform, *_plugin_dir_option(plugin_dir)]
    faults = {run["name"]: "not checked, since the run before has ended the check" for run in runs}
    for row in _inspect([*options, "runs", json.dumps(runs)], timeout, plugin_dir):
        if "result" in row:
            faults[row["result"]] = row["fault"]
        elif "lost" in row:
            faults[row["lost"]] = f"the process that imports it {row['how']}"
    return faults


def parameter_fault(specs: Mapping[str, Record], key: str, value: object) -> str:
    """The fault of a parameter's name, type or bounds; empty without a fault."""
    if key not in specs:
        return unknown("parameter", key, specs)
    spec = specs[key]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    is_wrong = is_number != (spec["type"] in ("int", "float"))
    if spec["type"] == "int" and isinstance(value, float):
        is_wrong = not value.is_integer()
    if is_wrong and not isinstance(value, str | None):
        return f"{key} is {value!r}; expected {spec['wanted']}"
    low = spec["ge"]
    high = spec["le"]
    if isinstance(value, int | float) and not (
        (low is None or value >= low) and (high is None or value <= high)
    ):
        return f"{key} is {value!r}; expected {spec['wanted']}"
    return ""


def check_parameters(
    pattern: str, values: Mapping[str, object], plugin_dir: Path | None, platform: str
) -> None:
    """ConfigError for a parameter that the pattern does not take, or a value out of its bounds.

    Rules between several parameters are not checked; robots check these. PluginError if the pattern
    does not load.
    """
    (row,) = describe_patterns((pattern,), plugin_dir, platform)
    if "error" in row:
        raise PluginError(row["error"])
    specs = {spec["name"]: spec for spec in row["params"]}
    for key, value in values.items():
        if fault := parameter_fault(specs, key, value):
            raise ConfigError(f"{pattern}: {fault} (see swarmctl patterns show {pattern})")


def check_mission(
    file: Path, platform: str, plugin_dir: Path, timeout: float = MISSION_TIMEOUT
) -> list[str]:
    """A line for each fault of the mission; PluginError if importing a pattern ends the child."""
    options = ["--platform", platform, *_plugin_dir_option(plugin_dir)]
    for row in _inspect([*options, "mission", str(file)], timeout, plugin_dir):
        if "result" in row:
            return list(row["faults"])
        if "lost" in row:
            text = f"the process that imports the patterns of {file} {row['how']}"
            raise PluginError(f"{text}; look at their code")
    raise PluginError(f"the process that checks {file} ended without an answer")


def check_file(path: Path, timeout: float) -> Iterator[Point]:
    """Yields the points (rules of the contract) of a pattern's file, each as soon as it is known.

    A child process checks the points, each within `timeout` s.

    1. If the plugin's code ends the child in a point, another child checks the remaining points.
    2. No further point is checked if the child ends in the first point (the import of the file), if
       a further child ends in a point that is checked already, or if a point hangs.
    3. Raises PluginError if the child fails before the first point.

    What the plugin's code writes into the answers of the child neither prolongs the time of a point
    nor the check: at most _MAX_POINTS points are checked.
    """
    checked_names: list[str] = []  # the names of the points that were checked so far
    known_faults: set[str] = set()  # a fault that an earlier point has shown counts as repeated
    side_effects: list[str] = []
    needs_child = True
    with TemporaryFile() as log:  # all that the plugin's code prints
        while needs_child:
            needs_child = False
            words = ["check", str(path), "--done", *checked_names]
            for row in _inspect(words, timeout, path.parent, log):
                if "side_effect" in row and row["side_effect"] not in side_effects:
                    side_effects.append(row["side_effect"])
                # Each further child checks again the points before the tests, such as the import.
                if row.get("result") in checked_names:
                    continue
                check = _check_of(row)
                if check is None:
                    continue
                is_import = not checked_names  # the first point imports the file
                is_repeated = check.name in checked_names  # each further child would end there, too
                checked_names.append(check.name)
                yield _point(check.name, check.fields, known_faults)
                if check.hangs or is_repeated:
                    yield Point(SKIPPED, "skipped", "correct the failed point first")
                is_last = is_import or is_repeated or len(checked_names) >= _MAX_POINTS
                needs_child = check.has_ended_child and not is_last
        log.seek(0)
        text = log.read(MAX_OUTPUT).decode(errors="replace")
        printed = [line for line in text.splitlines() if line]
    # Two points about the whole check.
    for name, faults in ((NO_OUTPUT, printed), (NO_SIDE_EFFECTS, side_effects)):
        yield Point(name, "fault" if faults else "ok", _first_of(faults))


class _Check(NamedTuple):
    """The result of the check of a point, made from a row of `_inspect`."""

    name: str  # the name of the point
    fields: Record  # `fault` and `on`, or `text` without a fault
    hangs: bool
    has_ended_child: bool  # the plugin's code ended the child


def _check_of(row: Record) -> _Check | None:
    """The check that ends with `row`; None for a row of another kind."""
    if "lost" in row:  # the child ended, or hangs
        fields = {"fault": f"the process that checks it {row['how']}"}
        hangs = row["hangs"]
        return _Check(row["lost"], fields, hangs, has_ended_child=not hangs)
    if "result" in row:  # the child goes on, also after a hang that it noticed itself
        return _Check(row["result"], row, row.get("is_hang", False), has_ended_child=False)
    return None


def _point(name: str, row: Record, faults: set[str]) -> Point:
    """The point, `repeated` if an earlier point has the same fault, its numbers aside."""
    fault = row.get("fault")
    if fault is None:
        return Point(name, "ok", str(row.get("text", "")))
    place = _PLACE.search(fault)
    key = _NUMBER.sub("#", _PLACE.sub("", fault)) + (place[0] if place else "")
    if key in faults:
        return Point(name, "repeated", str(fault))
    faults.add(key)
    on = row.get("on")
    return Point(name, "fault", f"{on}: {fault}" if on else str(fault))


def _first_of(lines: Sequence[str]) -> str:
    more = f", and {len(lines) - 1} more" if len(lines) > 1 else ""
    return f"{lines[0][:200]}{more}" if lines else ""


def _plugin_dir_option(plugin_dir: Path | None) -> list[str]:
    return [] if plugin_dir is None else ["--plugin-dir", str(plugin_dir)]


def _inspect(
    words: Sequence[str], timeout: float, folder: Path | None, log: IO[bytes] | None = None
) -> Iterator[Record]:
    """Yields the rows (JSON objects) of a child process that imports plugin code.

    The child works on items: the points of a check, or the patterns to describe. The first row of
    an item has the key `begin`, and the last row the key `result`. The row `begin` is not yielded.
    If the child ends or hangs in an item, this function adds a last row, which has the
    fields of the row `begin`, and

    - `lost`: the name of the item,
    - `how`: how the child ended, in words, with the line of code,
    - `hangs`: True if the child hangs.

    `words`: the arguments of `swarmd.pattern_host.plugin_inspector`. `timeout`: s for each item.
    `folder`: the folder of the plugin's code. `log` takes the child's standard error. PluginError
    if the child reports an error outside an item, or ends or hangs before its first item.
    """
    with _started(words, log) as child:
        assert child.stdout is not None
        open_item: Record | None = None
        code_place = ""
        late = f"is not done after {timeout:g} s"
        hangs = ""  # how, in words
        try:
            for line in _lines(child.stdout, timeout, child.pid, _MAX_POINTS + len(words)):
                row = _record_of(line)
                if "end" in row:  # all items are done
                    return
                if "error" in row and "result" not in row:  # the error concerns no item
                    raise PluginError(row["error"])
                if "begin" in row:
                    open_item = row
                elif row:
                    if "result" in row:
                        open_item = None
                    yield row
                else:  # a line of a stack, which the child prints before it ends
                    code_place = code_place or _place_of(line, folder)
            # Plugin code may have closed the child's standard output.
            hangs = late if _is_running(child) else ""
        except TimeoutError as error:
            hangs = str(error) or late
        how = hangs or how_it_ended(child.returncode)
        if open_item is None:
            from swarmd.core.python_path import replaced_text

            replaced = replaced_text()
            cause = f"; {replaced} swarmctl" if replaced else ""
            raise PluginError(f"the process that inspects patterns {how}{cause}")
        if hangs:
            # From its first item on, the child prints its stack on SIGUSR1.
            code_place = code_place or _place_of_hang(child, folder)
        yield {
            **open_item,
            "lost": open_item["begin"],
            "how": how + code_place,
            "hangs": bool(hangs),
        }


def _place_of_hang(child: subprocess.Popen[bytes], folder: Path | None) -> str:
    """The place in the code of `folder` at which a child hangs; empty if not known.

    On SIGUSR1 the child prints its stack.
    """
    assert child.stdout is not None
    child.send_signal(signal.SIGUSR1)
    with contextlib.suppress(TimeoutError):
        for line in _lines(child.stdout, STACK_TIMEOUT, child.pid):
            if place := _place_of(line, folder):
                return place
    return ""


@contextlib.contextmanager
def _started(words: Sequence[str], log: IO[bytes] | None) -> Iterator[subprocess.Popen[bytes]]:
    """A context manager that starts the child process of `_inspect`, and kills it at the end."""
    # -P: a random.py in the current folder must not shadow a module.
    command = [sys.executable, "-P", "-m", "swarmd.pattern_host.plugin_inspector"]
    # The sandbox hides these folders from plugin code.
    secret_folders = (SYSTEM_FOLDER.parent, user_folder())
    command += [f"--secret={path}" for path in secret_folders if path is not None]
    command += ["--parent", str(os.getpid()), *words]
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=log or subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    ) as child:
        try:
            yield child
        finally:
            child.kill()


def _lines(stream: IO[bytes], timeout: float, pid: int, items: int = 0) -> Iterator[bytes]:
    """Yields whole lines until the end of the stream, for `timeout` s and for each begun item.

    A row `begin` of an item that has not begun before starts the time anew, `items` times at most.
    Other lines do not: plugin code may write them without end. TimeoutError at the end of the time,
    and with a text beyond _MAX_ANSWER bytes.

    A busy machine or a cold disk may delay a process. So a process that works, and has used less
    than `timeout` s of processor time since the item began, gets more time.
    """
    buffer = b""
    size = 0
    begun: set[str] = set()
    deadline = time.monotonic() + timeout
    until = used_by(pid)[0] + timeout
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        while True:
            now = time.monotonic()
            if now >= deadline:
                used, is_at_work = used_by(pid)
                if not is_at_work or used >= until:
                    raise TimeoutError
                deadline = now + min(WORK_PERIOD, timeout)
            if not selector.select(deadline - now):
                continue
            piece = os.read(stream.fileno(), 65536)
            if not piece:
                return
            size += len(piece)
            if size > _MAX_ANSWER:
                raise TimeoutError(f"has printed more than {_MAX_ANSWER} bytes")
            *whole, buffer = (buffer + piece).split(b"\n")
            for line in whole:
                item = str(_record_of(line).get("begin", ""))
                if item and item not in begun and len(begun) < items:
                    begun.add(item)
                    deadline = time.monotonic() + timeout
                    until = used_by(pid)[0] + timeout
                yield line


def used_by(pid: int) -> tuple[float, bool]:
    """(processor time of a process in s, True if the process runs or waits for processor or disk).

    (0.0, False) for a process that has ended.
    """
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0, False
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"), fields[0] in "RD"


def _record_of(line: bytes) -> Record:
    """The line as a row; empty for a line that the child's plugin code has printed."""
    with contextlib.suppress(ValueError):
        row = json.loads(line)
        if isinstance(row, dict):
            return row
    return {}


def _place_of(line: bytes, folder: Path | None) -> str:
    """` (own.py:12)` for a line of a stack that names a file in `folder`; else empty."""
    frame = _FRAME.match(line)
    if frame is None or folder is None:
        return ""
    file = Path(os.fsdecode(frame[1]))
    return f" ({file.name}:{int(frame[2])})" if file.parent == folder.resolve() else ""


def _is_running(child: subprocess.Popen[bytes]) -> bool:
    """True unless the child is ending, which takes a moment after it has closed its output."""
    try:
        child.wait(timeout=1.0)
    except subprocess.TimeoutExpired:
        return True
    return False
