"""A program that inspects plugin code for tools: `describe`, `check` and `mission`.

Tools never import plugin code, which may crash or hang: `swarmd.operator.cli.plugin_check` starts
this program and reads its JSON lines. The program confines itself (`swarmd.pattern_host.sandbox`),
and can read only the folder of the inspected file. It writes `{"begin": item}` before each item,
`{"result": item, ...}` after the item, and `{"end": true}` at the end, or `{"error": text}` if
nothing can be inspected. So the tool knows the item that crashes or hangs this process. On SIGUSR1
and on a crash, Python's stack follows.
"""

from __future__ import annotations

import argparse
import ast
import faulthandler
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from types import FrameType
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from swarmd import api
from swarmd.core.errors import PluginError, SwarmError
from swarmd.core.files import read_regular
from swarmd.core.host_messages import Layers
from swarmd.core.keys import is_id
from swarmd.core.processes import die_with_parent, limit_files, limit_growth
from swarmd.core.values import Outputs, Platform, Twist, Value, lacks_text
from swarmd.kit.behavior import MovementPattern, Pattern
from swarmd.kit.combined import CombinedPattern
from swarmd.kit.condition_state import until_conditions
from swarmd.kit.conditions import needs_of
from swarmd.kit.factory import Find, assemble, check_scan_delay
from swarmd.kit.mistakes import with_remedy
from swarmd.kit.params import Params, schema
from swarmd.kit.touch import check_zone, describe_zone
from swarmd.kit.voting_pattern import VotingPattern
from swarmd.mission.document import Document, fault_lines, read_document
from swarmd.mission.mission import Mission, mission_class, pattern_classes
from swarmd.mission.part_builder import (
    PartBuilder,
    build_parts,
    build_setters,
    check_reports,
    error_text,
)
from swarmd.mission.schema import conditions
from swarmd.pattern_host.loader import PatternLoader
from swarmd.pattern_host.sandbox import confine
from swarmd.plugins import (
    MISSION,
    PATTERN_FILE,
    Origin,
    check_module_name,
    is_mission,
    is_same_file,
    modules_of,
    pattern_folder_of,
    pattern_name,
    pattern_names,
    places_of,
)
from swarmd.settings.layered import fault_at
from swarmd.settings.settings import load_platform, platform_names

if TYPE_CHECKING:
    from swarmd.testing.pattern_contract import PatternContract  # in the inspecting child alone

LOADING = "the file holds one pattern"
IMPORTS = "it imports arithmetic alone"
DROPPED = "no command is made and dropped"
MIRRORED = "mirrored scans give mirrored commands"
NOT_CLAIMED = "is_symmetric is not claimed"
MAX_GROWTH = 1024 * 1024 * 1024
TEST_TIMEOUT = 10.0
"""Seconds of processor time that a contract test may take on one platform."""


class InspectionOutput:
    """The stream of JSON lines to the tool; prints of plugin code go to standard error instead."""

    def __init__(self) -> None:
        self._file: IO[str] = os.fdopen(os.dup(1), "w", encoding="utf-8")
        os.dup2(2, 1)
        faulthandler.enable(self._file, all_threads=False)
        faulthandler.register(signal.SIGUSR1, self._file, all_threads=False)

    def send(self, **line: Any) -> None:
        """Write a JSON line."""
        with suppress(OSError, ValueError):  # plugin code may have closed these streams
            sys.stdout.flush()  # the tool ends this process after the last line
            sys.stderr.flush()
        print(json.dumps(line), file=self._file, flush=True)


def main() -> None:
    """Entry of `python -m swarmd.pattern_host.plugin_inspector`, a child of swarmctl or swarmd.

    Imports plugin code and writes JSON lines for the verb `describe`, `check` or `mission`. The
    last line is `end`, or `error` with the text of an error of swarmd.
    """
    args = _parser().parse_args()
    die_with_parent(args.parent)
    output = InspectionOutput()
    try:
        # Memory and output are bounded and the sandbox entered before plugin code is imported.
        platform = load_platform(args.platform)
        readable = [] if args.plugin_dir is None else [args.plugin_dir]
        if args.verb in ("check", "mission"):
            readable.append(readable_beside(args.file.resolve()))
        limit_growth(MAX_GROWTH)
        limit_files()
        confine(readable, args.secret)
        if args.verb == "check":
            _check_plugin(args.file.resolve(), frozenset(args.done), output)
        elif args.verb == "describe":
            _describe_patterns(args.names, args.plugin_dir, platform, output)
        elif args.verb == "runs":
            _check_runs(json.loads(args.runs), args.plugin_dir, platform, output)
        else:
            _inspect_mission(args.file, platform, args.plugin_dir, output)
        output.send(end=True)
    except SwarmError as error:
        output.send(error=str(error))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parent", type=int, required=True, help="end with this process")
    parser.add_argument("--platform", default="waffle_pi")
    parser.add_argument("--plugin-dir", type=Path, help="folder of one-file patterns")
    parser.add_argument(
        "--secret", type=Path, action="append", default=[], help="unreadable folder"
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("describe").add_argument("names", nargs="*", help="default: all")
    check_parser = verbs.add_parser("check")
    check_parser.add_argument("file", type=Path)
    check_parser.add_argument(
        "--done", nargs="*", default=[], help="rules that are not tested again"
    )
    verbs.add_parser("mission").add_argument("file", type=Path)
    verbs.add_parser("runs").add_argument("runs", help="JSON, as `check_runs` of the tool says")
    return parser


def readable_beside(file: Path) -> Path:
    """The folder of a pattern's file, which its code may read, or only the file.

    For `pattern.py` it is the folder above, in which further patterns lie. A folder that has the
    home is never given: then it is the folder of `pattern.py`, else the file alone.
    """
    home = Path.home().resolve()
    folders = [file.parent.parent, file.parent] if file.name == PATTERN_FILE else [file.parent]
    return next((folder for folder in folders if not home.is_relative_to(folder)), file)


# describe


def _describe_patterns(
    names: Sequence[str], plugin_dir: Path | None, platform: Platform, answer: InspectionOutput
) -> None:
    origins = pattern_names(plugin_dir)
    loader = PatternLoader(places_of(origins))
    for name in names or origins:
        source = origins[name].source if name in origins else ""
        answer.send(begin=name, source=source)
        answer.send(result=name, **_describe(name, source, loader, platform))


def _describe(name: str, source: str, loader: PatternLoader, platform: Platform) -> dict[str, Any]:
    """The description of a pattern for robots of `platform`, as JSON for `swarmctl patterns`.

    `source`: the file or package of the pattern. If the pattern cannot be loaded, the description
    has only `name`, `source` and `error`. In the description, `missing` lists the sensors that the
    platform lacks, and `refused` says why a robot would refuse a mission. `refused` is empty for a
    mission that a robot takes or that cannot be tried, and for patterns that are no missions.
    """
    try:
        pattern = loader(name)
        params = schema(pattern.params_type)
        derived_defaults = pattern.defaults(platform)
        check_zone(name, pattern.touches)  # the zone in which the pattern may touch obstacles
        check_scan_delay(name, pattern.scan_delay)
        is_mission_class = issubclass(pattern, Mission)
        has_sensors = pattern.needs <= platform.provides
        has_all_defaults = not any(spec.is_required for spec in params)
        can_be_tried = has_sensors and has_all_defaults
        refused = _refusal(name, loader, platform) if is_mission_class and can_be_tried else ""
    except (Exception, SystemExit) as error:  # a plugin may raise anything
        return {"name": name, "error": error_text(error), "source": source}
    text = (pattern.__doc__ or "").strip()
    return {
        "name": name,
        "summary": text.split("\n")[0],
        "text": text,
        "kind": _kind(pattern),
        "group": pattern.group or ("missions" if is_mission_class else "yours"),
        "source": source,
        "needs": sorted(pattern.needs),
        "missing": sorted(pattern.needs - platform.provides),
        "lacks": lacks_text(pattern.needs, platform),
        "channels": {channel: type_.__name__ for channel, type_ in dict(pattern.channels).items()},
        "rate": pattern.rate,
        "report_units": dict(pattern.report_units),
        "touches": None if pattern.touches is None else describe_zone(pattern.touches),
        "platform": platform.name,
        "refused": refused,
        "params": [
            {
                **asdict(spec),
                "wanted": spec.wanted,
                "default": derived_defaults.get(spec.name, spec.default),
                "is_derived": spec.name in derived_defaults,
                "is_own": spec.name in pattern.params_type.__annotations__,  # not of a base class
            }
            for spec in params
        ],
    }


def _check_runs(
    runs: Sequence[dict[str, Any]],
    plugin_dir: Path | None,
    platform: Platform,
    answer: InspectionOutput,
) -> None:
    """For each run sends its name, and why a robot of that platform would refuse the run."""
    loader = PatternLoader(places_of(pattern_names(plugin_dir)))
    for run in runs:
        robot = replace(platform, provides=frozenset(run["provides"]))
        answer.send(begin=run["name"])
        answer.send(result=run["name"], fault=_run_fault(run, loader, robot))


def _run_fault(run: dict[str, Any], find: Find, platform: Platform) -> str:
    """Why a robot would refuse a run, as its pattern host does; empty if it would load the run."""
    try:
        _made(run["pattern"], tuple(run["layers"]), find, platform)
        until_conditions(run["until"], platform)
    except (Exception, SystemExit) as error:  # a plugin may raise anything
        return error_text(error)
    return ""


def _refusal(name: str, loader: PatternLoader, platform: Platform) -> str:
    """Why a robot of that platform would refuse a mission; empty if the robot would take it."""
    try:
        _made(name, (), loader, platform)
    except SwarmError as error:
        return str(error)
    return ""


def _made(
    name: str, layers: Layers, find: Find, platform: Platform, channel_prefix: str = ""
) -> Pattern[Any]:
    """A pattern as a robot of that platform makes it; SwarmError if the robot refuses."""
    rng = np.random.default_rng(0)
    return assemble(
        name,
        layers,
        find=find,
        robot="checked",
        platform=platform,
        rng=rng,
        channel_prefix=channel_prefix,
    ).pattern


def _kind(kind: type[Pattern[Any]]) -> str:
    if issubclass(kind, Mission):
        return "mission"
    if issubclass(kind, CombinedPattern):
        return "combined"
    if issubclass(kind, VotingPattern):
        return "voting"
    return "movement" if issubclass(kind, MovementPattern) else "pattern"


# check


def _check_plugin(path: Path, done: frozenset[str], output: InspectionOutput) -> None:
    """Check the pattern in the file `path` against the contract of patterns.

    For each point (rule of the contract) sends a line `begin` and a line `result`, with `fault` if
    the point is violated. `done`: points of the contract's tests to leave out. Ends after the
    first point that hangs, or if the file cannot be loaded.
    """
    _report_side_effects(path, output)
    pattern = _loaded(path, output)
    if pattern is None:
        return
    _check_source(path, output)
    for point, test in _contract_tests(pattern, pattern_folder_of(path)):
        if point in done:
            continue
        output.send(begin=point)
        fault = _fault_of(test, path, pattern)
        # The test of mirrored scans skips a pattern that does not declare `is_symmetric`.
        is_skipped = point == MIRRORED and not pattern.is_symmetric
        text = NOT_CLAIMED if is_skipped else ""
        output.send(result=point, **{"text": text, **fault})
        if fault.get("is_hang"):
            return


def _loaded(path: Path, output: InspectionOutput) -> type[Pattern[Any]] | None:
    """Check the point LOADING; returns the class of the pattern, or None after a fault."""
    classes: list[type[Pattern[Any]]] = []

    def load() -> None:
        name = pattern_name(path)
        check_module_name(name)
        is_file = True  # not an entry point of a package
        classes.append(PatternLoader({name: (str(path), is_file)})(name))

    # `_fault_of` returns fields of the line, such as `fault` and `is_hang`; empty without a fault.
    output.send(begin=LOADING)
    output.send(result=LOADING, **_fault_of(load, path))
    return classes[0] if classes else None


_RUNS_NODES = b"swarmd.ros2_nodes"


def sources_of(path: Path) -> list[Path]:
    """The files of a pattern: `path`, and the modules of its folder if that is a package.

    Modules beside a pattern that runs nodes of ROS 2 are nodes: they get stand-ins for what they
    import, and are no modules of the pattern.
    """
    if path.name != PATTERN_FILE or _RUNS_NODES in read_regular(path):
        return [path]
    modules = [one for one in modules_of(path.parent) if not one.name.startswith("test_")]
    return [path, *(one for one in modules if one != path)]


def _check_source(path: Path, output: InspectionOutput) -> None:
    """Check the points that the source code of the pattern's files shows: IMPORTS and DROPPED."""
    from swarmd.testing.no_side_effects import forbidden_imports  # in the inspecting child alone

    imports: list[str] = []
    unused: list[str] = []
    for file in sources_of(path):
        source = read_regular(file)
        with suppress(SyntaxError):  # of a module that the pattern has not imported
            found = list(forbidden_imports(source))
            imports += [f"imports {name} ({file.name}:{line})" for line, name in found]
            unused += [
                f"makes {name}(...) {_UNUSED} ({file.name}:{line})"
                for line, name in dropped(source)
            ]
    for point, texts in ((IMPORTS, imports), (DROPPED, unused)):
        output.send(begin=point)
        output.send(result=point, **({"fault": "; ".join(texts)} if texts else {}))


_UNUSED = "and does not use the value; is a return missing?"


def dropped(source: bytes) -> Iterator[tuple[int, str]]:
    """Yields (line, name) of each statement that makes a Twist or Outputs and drops the value.

    Compares names only: the class, or a function of `swarmd.api` that returns such a value.
    """
    makers = {Twist.__name__, Outputs.__name__}
    for name, value in vars(api).items():
        returned = getattr(value, "__annotations__", {}).get("return")
        makers |= {name} if returned in (Twist, Twist.__name__) else set()
    for statement in ast.walk(ast.parse(source)):
        if not isinstance(statement, ast.Expr):
            continue
        value = statement.value
        for branch in (value.body, value.orelse) if isinstance(value, ast.IfExp) else (value,):
            called = branch.func if isinstance(branch, ast.Call) else None
            name = getattr(called, "id", "") or getattr(called, "attr", "")
            if name in makers:
                yield statement.lineno, name


def _contract_tests(
    kind: type[Pattern[Any]], folder: Path
) -> Iterator[tuple[str, Callable[[], None]]]:
    """Each test of the contract with its name in words; the test runs on all platforms."""
    from swarmd.testing.pattern_contract import PatternContract  # in the inspecting child alone

    known = {"pattern": kind, "plugin_dir": folder, "seconds": TEST_TIMEOUT}
    contract = type("Contract", (PatternContract,), known)
    for name in vars(PatternContract):
        if name.startswith("test_"):
            yield name.removeprefix("test_").replace("_", " "), _on_all_platforms(contract, name)


def _on_all_platforms(contract: type[PatternContract], name: str) -> Callable[[], None]:
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


def _fault_of(
    call: Callable[[], None], path: Path, kind: type[Pattern[Any]] | None = None
) -> dict[str, Any]:
    """The exception of the call: `fault` in one line, `on` its notes; {} without an exception."""
    try:
        call()
    except (Exception, SystemExit) as error:  # plugin code may raise anything
        on = ", ".join(reversed(getattr(error, "__notes__", ())))
        is_hang = isinstance(error, TimeoutError)
        return {"fault": _in_one_line(error, path, kind)[:500], "on": on, "is_hang": is_hang}
    return {}


def _in_one_line(error: BaseException, path: Path, kind: type[Pattern[Any]] | None) -> str:
    """The exception with its remedy, and the last line of the pattern's files in its traceback."""
    text = " ".join(str(error).split())
    sources = {str(source): source.name for source in sources_of(path)}
    frames = traceback.extract_tb(error.__traceback__)
    lines = [(sources[f.filename], f.lineno) for f in frames if f.filename in sources]
    if isinstance(error, SyntaxError) and error.filename in sources:
        text = error.msg
        lines = [(sources[error.filename], error.lineno)]
    elif not lines and kind is not None and isinstance(error, PluginError | AssertionError):
        found = _lines_of_default(kind, text, path) or _lines_of_step(kind, path)
        lines = [(path.name, line) for line in found]
    if isinstance(error, AttributeError) and type(error.obj) is Params:
        text += "; is `params_type` missing in the class?"
    else:
        text = with_remedy(text, error)
    place = " ({}:{})".format(*lines[-1]) if lines else ""
    is_worded = isinstance(error, SwarmError) or (isinstance(error, AssertionError) and text)
    if isinstance(error, TimeoutError):
        is_worded = bool(text)
    if not is_worded:
        text = ": ".join(filter(None, (type(error).__name__, text)))
    return text + place


def _lines_of_default(kind: type[Pattern[Any]], text: str, path: Path) -> list[int | None]:
    """The lines at which the file declares the parameter `Params.name` that begins `text`."""
    name, _, field = text.partition(" ")[0].partition(".")
    if name != kind.params_type.__name__:
        return []
    return [
        node.lineno
        for owner in ast.walk(ast.parse(read_regular(path)))
        if isinstance(owner, ast.ClassDef) and owner.name == name
        for node in owner.body
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == field
    ]


def _lines_of_step(kind: type[Pattern[Any]], path: Path) -> list[int | None]:
    """The line of the file that defines `drive`, else `step`, whose value was wrong."""
    for name in ("drive", "step"):
        code = getattr(getattr(kind, name, None), "__code__", None)
        if code is not None and code.co_filename == str(path):
            return [code.co_firstlineno]
    return []


def _report_side_effects(path: Path, answer: InspectionOutput) -> None:
    """Send `{"side_effect": text}` for each side effect of the pattern's code, each text once."""
    from swarmd.testing.no_side_effects import AUDIT_EVENTS  # in the inspecting child alone

    sent: set[str] = set()
    sources = {str(source): source.name for source in sources_of(path)}

    def hook(event: str, args: tuple[Any, ...]) -> None:
        if event not in AUDIT_EVENTS:
            return
        place = _place_in(sources, sys._getframe(1))
        if place is None:
            return
        what = f"{event} {args[0]!r}"[:120] if args else event
        text = f"{what} ({place})"
        if text not in sent:
            sent.add(text)
            answer.send(side_effect=text)

    sys.addaudithook(hook)


def _place_in(sources: Mapping[str, str], frame: FrameType | None) -> str | None:
    """`name:line` of the code that led to this frame; None for an import, or code of other files.

    `sources`: the names of the pattern's files by path.
    """
    while frame is not None:
        name = frame.f_code.co_filename
        if name in sources:
            return f"{sources[name]}:{frame.f_lineno}"
        if name.startswith("<frozen importlib"):
            return None
        frame = frame.f_back
    return None


# mission


def _inspect_mission(
    path: Path, platform: Platform, plugin_dir: Path | None, answer: InspectionOutput
) -> None:
    answer.send(begin=str(path))
    try:
        faults = check_mission(path, platform, plugin_dir)
    except PluginError:
        raise
    except SwarmError as error:
        faults = [str(error)]
    except (Exception, SystemExit) as error:  # plugin code may raise anything
        raise PluginError(f"{path}: a pattern that it names raises {error_text(error)}") from error
    answer.send(result=str(path), faults=faults)


def _other_owner(path: Path, origin: Origin | None) -> str:
    """The file or package of another pattern with the name of the mission `path`; empty if none.

    `origin`: the source of the pattern with this name; None: there is no such pattern. If two
    sources have the name, the second is the `rival`. The mission's own file may be either source.
    """
    if origin is None:
        return ""
    if not origin.rival:
        return "" if is_same_file(str(path), origin.value) else origin.source
    return origin.source if is_same_file(str(path), origin.rival) else origin.rival


def check_mission(path: Path, platform: Platform, plugin_dir: Path | None) -> list[str]:
    """A line for each fault of a mission file, for robots of `platform`; nothing is run.

    `plugin_dir`: the folder with patterns of the user, None without one. ConfigError if the file is
    not YAML.
    """
    document = read_document(path)
    origins = pattern_names(plugin_dir)
    name_fault = _name_fault(document, origins.get(path.stem))
    if name_fault:
        document.faults.append(fault_at(("mission",), name_fault))
    find = PatternLoader({**places_of(origins), path.stem: (str(path.resolve()), True)})
    _check_parts(document, platform, find)
    if not document.faults:  # faulty parts would give faults of the whole mission again
        _check_whole(document, platform, find)
    return fault_lines(path, document.faults)


def _name_fault(document: Document, origin: Origin | None) -> str:
    """Why the file is not a mission with a name of its own; empty if it is.

    The text goes on after the key `mission`. `origin`: as of `_other_owner`.
    """
    path = document.path
    if not is_id(path.stem) or path.suffix != MISSION:
        return (
            "is in a file of a name that no pattern can have; expected a value such as patrol.yaml"
        )
    # A robot looks for the key by lines, which misses some forms that YAML permits.
    if document.description and not is_mission(path):
        return "is not at the start of a line of UTF-8 text, by which robots know a mission's file"
    owner = _other_owner(path, origin)
    return f"has the name of another pattern ({owner}); rename one" if owner else ""


def _check_parts(document: Document, platform: Platform, find: Find) -> None:
    """Check the patterns of a mission, their parameters, and the values of maps."""
    classes = pattern_classes(document, find)
    document.parts = {name: part for name, part in document.parts.items() if name in classes}

    def make(
        inner: str, /, *, part: str = "", private: bool = False, **params: Value
    ) -> Pattern[Any]:
        layers = (("platform", platform.patterns.get(inner, {})), (document.path.stem, params))
        return _made(inner, layers, find, platform, f"{part}-" if private else f"{inner}/")

    builder = PartBuilder(document, make, {}, document.faults)
    parts = build_parts(builder)
    build_setters(builder, parts)
    check_reports(builder, parts)
    for keys, condition in conditions(document.root):
        if lack := lacks_text(needs_of(condition), platform):
            document.faults.append(fault_at(keys, lack))


def _check_whole(document: Document, platform: Platform, find: Find) -> None:
    """Make the mission as a robot does; a further fault is reported for the whole file."""
    try:
        mission_class(document.path, find)
        _made(document.path.stem, (), find, platform)
    except SwarmError as error:
        document.faults.append(((), str(error)))


if __name__ == "__main__":
    main()
