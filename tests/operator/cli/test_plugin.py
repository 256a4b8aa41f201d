"""`swarmctl plugin new` writes what passes; `plugin check` reports each fault once."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, PluginError, SwarmError
from swarmd.kit.observation import NeighborsPart, PolicySpec, ReadingPart, ScanPart, TwistPart
from swarmd.kit.policy_network import from_text, network_of, parameter_count
from swarmd.operator.cli.plugin_check import (
    NO_OUTPUT,
    NO_SIDE_EFFECTS,
    SKIPPED,
    Point,
    check_file,
    describe_patterns,
    used_by,
)
from swarmd.operator.cli.swarmctl import cli, run_cli
from swarmd.operator.verbs.push.ask import read_source
from swarmd.pattern_host.loader import PatternLoader, import_file
from swarmd.pattern_host.plugin_inspector import (
    DROPPED,
    IMPORTS,
    LOADING,
    MIRRORED,
    readable_beside,
)
from swarmd.plugins import pattern_names
from swarmd.settings.platforms import platform_names
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.testing.pattern_contract import PatternContract
from tests.support.examples import part
from tests.support.processes import wait_until

pytestmark = [pytest.mark.integration, pytest.mark.long, pytest.mark.usefixtures("forked_starts")]

CODE = """
from swarmd.api import *
{top}

class Own(MovementPattern[Params]):
    '''A test's.'''
    {declared}

    def __init__(self, params, context):
        super().__init__(params, context)
        {made}

    def drive(self, inputs: Inputs) -> Twist:
        {body}
        return Twist()
"""
PARAMS = """
class OwnParams(Params, frozen=True):
    speed: Annotated[float, about("how fast", ge=0.0, le=1.0, unit="m/s")] = {}
"""
POINTS = [
    name.removeprefix("test_").replace("_", " ")
    for name in vars(PatternContract)
    if name.startswith("test_")
]
EDITS = {
    "movement": ("linear=self.params.speed", "angular=-0.2 * self.params.speed"),
    "voting": (
        "return majority(votes.values(),",
        "return self.opinion or majority(votes.values(),",
    ),
    "pattern": ("else 0.0", "else 0.1"),
}
STEPS = "steps give outputs and nothing else"


def swarmctl(*words: str) -> int:
    def code_of(error: SwarmError) -> int:
        raise error

    return run_cli(cli, list(words), "swarmctl", code_of)


def written(folder: Path, **lines: str) -> Path:
    """The file of a pattern with these lines."""
    path = folder / "own.py"
    blank = {"top": "", "declared": "", "made": "pass", "body": "pass"}
    path.write_text(CODE.format(**blank | lines))
    return path


def checked(folder: Path, timeout: float = 60.0, **lines: Any) -> dict[str, Point]:
    """The points of a pattern with these lines."""
    return {point.name: point for point in check_file(written(folder, **lines), timeout)}


def point_of(folder: Path, name: str, **lines: Any) -> Point:
    """One point of a pattern with these lines; the points after it are not checked."""
    return next(one for one in check_file(written(folder, **lines), 60.0) if one.name == name)


def faults(points: dict[str, Point]) -> dict[str, str]:
    """Those of each point; imports have a test of their own."""
    rows = {name: point.text for name, point in points.items() if point.result == "fault"}
    return {name: text for name, text in rows.items() if name != IMPORTS}


@pytest.mark.usefixtures("real_starts")
def test_a_new_plugin_of_each_kind_passes_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, kinds = tmp_path / "mine", ("movement", "voting", "pattern")
    for kind in kinds:
        assert swarmctl("plugin", "new", f"my_{kind}", "--dir", str(folder), "--kind", kind) == 0
        file = folder / f"my_{kind}.py"
        said = capsys.readouterr().out
        assert f"swarmctl plugin check {file}" in said
        assert f"{sys.executable} -m pytest {folder / f'test_my_{kind}.py'}" in said
        assert swarmctl("plugin", "check", str(file)) == 0
        *lines, last = capsys.readouterr().out.splitlines()
        assert [line[:4] for line in lines] == ["ok  "] * (5 + len(POINTS))
        assert last.startswith(str(5 + len(POINTS)))
        assert f"my_{kind}" in pattern_names(folder, {})
    files = {f"{before}my_{kind}.py" for before in ("", "test_") for kind in kinds}
    assert {path.name for path in folder.iterdir()} == files
    others = " or ".join({*platform_names()} - {"waffle_pi"})
    for command in (
        ["ruff", "check", "--isolated", "--select", "E,F,I"],
        ["pytest", "-q", "-p", "no:cacheprovider", "-k", f"not ({others})"],
    ):
        if "pytest" in command:  # another behaviour: the tests are none of the template's
            for kind, (was, now) in EDITS.items():
                file = folder / f"my_{kind}.py"
                assert was in file.read_text()
                file.write_text(file.read_text().replace(was, now))
        done = subprocess.run(
            [sys.executable, "-m", *command, str(folder)],
            capture_output=True,
            text=True,
            cwd=folder,
            check=False,
        )
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("my-own", "'my-own' is no name"),
        ("../own", "'../own' is no name"),
        ("lambda", "'lambda' is no name"),
        ("test_own", "'test_own' is no name"),
        ("random", "'random' is the name of a Python module"),
        ("drive", "has a pattern 'drive'"),
    ],
)
def test_an_unusable_name_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, text: str
) -> None:
    assert swarmctl("plugin", "new", name, "--dir", str(tmp_path)) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_new_folder_has_a_pattern_its_test_a_scenario_and_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert swarmctl("plugin", "new", "swirl", "--dir", str(tmp_path), "--folder") == 0
    folder = tmp_path / "swirl"
    wanted = {"__init__.py", "pattern.py", "test_swirl.py", "scenario.yaml", "page.md"}
    assert {path.name for path in folder.iterdir()} == wanted
    assert "from swirl.pattern import Swirl" in (folder / "test_swirl.py").read_text()
    assert f"exp run {folder / 'scenario.yaml'}" in capsys.readouterr().out
    assert swarmctl("plugin", "check", str(folder)) == 0
    assert pattern_names(tmp_path, {})["swirl"].value == str(folder / "pattern.py")
    assert read_source(folder / "pattern.py").name == "swirl"
    trace = simulate_run(load_scenario(folder / "scenario.yaml", {"duration": 1.0}), 0)
    assert trace.state is not None
    assert trace.state[-1].tolist() == ["running"] * 5


GAINS = "TURN = 0.4\n"


def test_a_folder_is_a_package_in_its_check(tmp_path: Path) -> None:
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "gains.py").write_text(GAINS)
    (folder / "later.py").write_text("from .gains import TURN\nimport os\nFAST = 2 * TURN\n")
    lines = {"top": "from .gains import TURN", "body": "from .later import FAST"}
    written(folder, **lines).rename(folder / "pattern.py")
    points = {point.name: point for point in check_file(folder / "pattern.py", 60.0)}
    assert faults(points) == {}
    assert "(later.py:2)" in points[IMPORTS].text  # of all modules of the package
    (folder / "later.py").write_text("FAST = 1 / 0\n")
    points = {point.name: point for point in check_file(folder / "pattern.py", 60.0)}
    assert "ZeroDivisionError" in points[STEPS].text
    assert "(later.py:1)" in points[STEPS].text


def test_a_folder_without_a_pattern_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ConfigError, match=r"pattern\.py") as error:
        swarmctl("plugin", "check", str(tmp_path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("there", ["own.py", "test_own.py"])
def test_no_file_is_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], there: str
) -> None:
    (tmp_path / there).write_text("mine")
    assert swarmctl("plugin", "new", "own", "--dir", str(tmp_path)) == 2
    assert f"{tmp_path / there} is there already" in capsys.readouterr().err
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(there, "mine")]


def test_the_class_is_not_named_as_an_import(tmp_path: Path) -> None:
    assert swarmctl("plugin", "new", "twist", "--dir", str(tmp_path)) == 0
    assert "class TwistPattern(MovementPattern" in (tmp_path / "twist.py").read_text()


def test_a_learned_policy_becomes_a_plugin_that_passes_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = PolicySpec((ScanPart(), NeighborsPart(), ReadingPart("light"), TwistPart()))
    parameters = np.random.default_rng(3).normal(0.0, 0.3, parameter_count(spec, (4,)))
    file, network = tmp_path / "gather.npz", network_of(spec, parameters, (4,))
    file.write_bytes(network.to_bytes())
    assert (
        swarmctl("plugin", "new", "my_gather", "--dir", str(tmp_path), "--policy", str(file)) == 0
    )
    assert swarmctl("plugin", "check", str(tmp_path / "my_gather.py")) == 0
    assert "all ok" in capsys.readouterr().out
    kind = import_file(tmp_path / "my_gather.py").MyGather
    assert kind.needs == spec.needs
    assert from_text(kind.network).to_bytes() == network.to_bytes()


def test_a_file_that_holds_no_policy_becomes_no_plugin(tmp_path: Path) -> None:
    file = tmp_path / "gather.npz"
    file.write_bytes(b"none")
    with pytest.raises(ConfigError, match=r"gather\.npz: policy"):
        swarmctl("plugin", "new", "my_gather", "--dir", str(tmp_path), "--policy", str(file))
    assert [path.name for path in tmp_path.iterdir()] == ["gather.npz"]


def test_json_holds_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, top="print('hello')", body="1 / 0")
    assert swarmctl("plugin", "check", str(path), "-o", "json") == 1
    answer = json.loads(capsys.readouterr().out)
    assert (answer["kind"], answer["is_well"]) == ("Check", False)
    points = {point["point"]: point for point in answer["points"]}
    assert list(points) == [LOADING, IMPORTS, DROPPED, *POINTS, NO_OUTPUT, NO_SIDE_EFFECTS]
    assert points[STEPS]["text"].endswith("ZeroDivisionError: division by zero (own.py:14)")
    assert points[NO_OUTPUT] == {"point": NO_OUTPUT, "result": "fault", "text": "hello"}
    assert points[MIRRORED]["text"] == "is_symmetric is not claimed"


@pytest.mark.parametrize(
    ("lines", "point", "text"),
    [
        ({"body": "return None"}, STEPS, "drive gave None"),
        ({"body": "import os; os._exit(3)"}, STEPS, "os._exit"),
        ({"body": "return Twist(self.params.speed)"}, STEPS, "is `params_type` missing"),
        ({"declared": "needs = frozenset({'messages'})"}, STEPS, "no input 'messages'"),
        (
            {
                "declared": "channels = {'word': float}\n"
                "    def step(self, inputs): return Outputs(messages={'word': 'loud'})"
            },
            STEPS,
            "channel 'word' got a str",
        ),
        (
            {"body": "return Twist(float('nan'))"},
            "odd scans give sane commands",
            "command is Twist(linear=nan",
        ),
    ],
)
def test_a_mistake_is_reported_once_with_its_line(
    tmp_path: Path, lines: dict[str, Any], point: str, text: str
) -> None:
    points = checked(tmp_path, **lines)
    (found,) = faults(points).items()
    assert found[0] == point
    assert text in found[1]
    assert "(own.py:" in found[1]


@pytest.mark.parametrize(
    ("default", "base", "text"),
    [
        ("'fast'", "OwnParams", "'fast'; expected a float from 0 to 1 m/s (own.py:5)"),
        ("9.0", "OwnParams", "9.0; expected a float from 0 to 1 m/s (own.py:5)"),
        ("0.1", "Params", "add `params_type = OwnParams`"),
    ],
)
def test_a_wrong_default_or_params_type_is_reported_once(
    tmp_path: Path, default: str, base: str, text: str
) -> None:
    code = CODE.replace("[Params]", "[OwnParams]").format(
        top=PARAMS.format(default), declared=f"params_type = {base}", made="pass", body="pass"
    )
    (tmp_path / "own.py").write_text(code)
    points = {point.name: point for point in check_file(tmp_path / "own.py", 60.0)}
    (found,) = faults(points).values()
    assert text in found


@pytest.mark.parametrize(
    ("taken", "wanted"),
    [("inputs", "self, inputs"), ("self", "self, inputs"), ("", "self, inputs")],
)
def test_a_method_without_self_is_reported_once_with_its_line(
    tmp_path: Path, taken: str, wanted: str
) -> None:
    code = CODE.format(top="", declared="", made="pass", body="return Twist()")
    lines = code.replace("drive(self, inputs: Inputs)", f"drive({taken})").splitlines()
    (tmp_path / "own.py").write_text("\n".join(lines))
    (found,) = faults({p.name: p for p in check_file(tmp_path / "own.py", 60.0)}).values()
    number = 1 + next(i for i, line in enumerate(lines) if f"drive({taken})" in line)
    assert f"def drive({wanted})" in found
    assert f"(own.py:{number})" in found


@pytest.mark.parametrize("taken", ["this, scan", "*arguments", "self, *more"])
def test_a_method_that_takes_its_arguments_by_other_names_is_no_fault(
    tmp_path: Path, taken: str
) -> None:
    code = CODE.format(top="", declared="", made="pass", body="return Twist()")
    (tmp_path / "own.py").write_text(code.replace("drive(self, inputs: Inputs)", f"drive({taken})"))
    loaded = PatternLoader({"own": (str(tmp_path / "own.py"), True)})("own")
    assert loaded.__name__ == "Own"


def test_a_nan_that_is_passed_on_is_no_difference(tmp_path: Path) -> None:
    """Neighbours send NaN on a float channel; a deterministic pattern may repeat it."""
    step = """channels = {'word': float}
    heard = 0.0
    def step(self, inputs):
        for message in inputs.messages: self.heard = message.value
        return Outputs(Twist(), messages={'word': self.heard}, report={'heard': self.heard})"""
    assert faults(checked(tmp_path, declared=step)) == {}


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("x = 1\nimport nothing_of_that_name", "No module named 'nothing_of_that_name' (own.py:2)"),
        ("x = 1\n\ndef broken(:\n", "SyntaxError: invalid syntax (own.py:3)"),
        ("x = 1", "must hold exactly one Pattern"),
        ("raise SystemExit(4)", "SystemExit: 4 (own.py:1)"),
        ("import ctypes\nctypes.string_at(0)", "was killed by SIGSEGV (own.py:2)"),
        ("x = 1\nwhile True: pass", "is not done after 2 s (own.py:2)"),
        ("a = []\nwhile True: a.append(bytes(1 << 26))", "MemoryError"),
    ],
)
def test_a_file_that_cannot_be_loaded_is_not_checked_further(
    tmp_path: Path, text: str, fault: str
) -> None:
    path = tmp_path / "own.py"
    path.write_text(text)
    points = {one.name: one for one in check_file(path, 2.0 if "pass" in text else 60.0)}
    assert next(iter(points)) == LOADING
    assert set(points) <= {LOADING, SKIPPED, NO_OUTPUT, NO_SIDE_EFFECTS}
    assert fault in faults(points)[LOADING]


@pytest.mark.parametrize("name", ["My-Own", "my-own", "test_own", "lambda"])
def test_a_file_name_that_is_no_module_is_a_fault(tmp_path: Path, name: str) -> None:
    path = written(tmp_path).rename(tmp_path / f"{name}.py")
    point = next(check_file(path, 60.0))
    assert (point.result, repr(name) in point.text) == ("fault", True)


@pytest.mark.parametrize(
    ("lines", "modules"),
    [
        ({"top": "import math, cmath\nimport numpy as np\nfrom collections import deque"}, []),
        ({"top": "import os"}, ["os (own.py:3)"]),
        (
            {"top": "from os.path import join", "body": "import socket, swarmd.sim.world"},
            ["os.path.join (own.py:3)", "socket (own.py:14)", "swarmd.sim.world (own.py:14)"],
        ),
        ({"top": "from swarmd import sim"}, ["swarmd.sim (own.py:3)"]),
    ],
)
def test_imports_of_what_a_pattern_may_not_use_are_named(
    tmp_path: Path, lines: dict[str, Any], modules: list[str]
) -> None:
    point = point_of(tmp_path, IMPORTS, **lines)
    assert point.text == "; ".join(f"imports {one}" for one in modules)


@pytest.mark.parametrize(
    ("body", "dropped"),
    [
        ("if inputs.now > 1e9:\n            Twist(angular=0.5)", "Twist(...)"),
        ("Twist() if inputs.now > 1e9 else Twist(0.1)", "Twist(...)"),
        ("steer(0.0, self.context.platform.limits)", "steer(...)"),
        ("stop = Twist()\n        return stop", ""),
        ("self.context.rng.random()", ""),
    ],
)
def test_a_command_that_is_made_and_dropped_is_named(
    tmp_path: Path, body: str, dropped: str
) -> None:
    """The contract alone cannot see it where another `return` follows."""
    point = point_of(tmp_path, DROPPED, top="from swarmd.api import steer", body=body)
    assert point.result == ("fault" if dropped else "ok")
    assert dropped in point.text
    line = 15 if "\n" in body else 14
    assert not dropped or f"(own.py:{line})" in point.text


@pytest.mark.parametrize(
    ("lines", "changed"),
    [
        ({"top": "SEEN = []", "body": "SEEN.append(1)"}, "SEEN"),
        (
            {
                "top": "import numpy as np\nRNG = np.random.default_rng()",
                "body": "return Twist(0.1 * RNG.random() - 0.05)",
            },
            "RNG",
        ),
        ({"top": "COUNT = 0", "body": "global COUNT; COUNT += 1"}, "COUNT"),
        ({"declared": "seen = {}", "body": "self.seen[len(self.seen)] = 1"}, "Own.seen"),
    ],
)
def test_memory_outside_of_self_is_named(
    tmp_path: Path, lines: dict[str, Any], changed: str
) -> None:
    point = point_of(tmp_path, "memory is kept in self", **lines)
    assert point.result == "fault"
    assert f"a run changes {changed} of the module" in point.text


def test_a_reading_that_needs_does_not_name_is_an_error_with_the_remedy(tmp_path: Path) -> None:
    lines: dict[str, Any] = {
        "declared": "needs = frozenset({'reading:temprature'})",
        "body": "inputs.readings['temperature']",
    }
    (found,) = faults(checked(tmp_path, **lines)).values()
    assert "'temperature' is not in `needs`" in found


def test_a_crash_fails_its_point_and_the_others_are_checked(tmp_path: Path) -> None:
    crash = "import ctypes; ctypes.string_at(0)"
    points = checked(tmp_path, body=f"if not len(inputs.scan.ranges): {crash}")
    assert list(points) == [LOADING, IMPORTS, DROPPED, *POINTS, NO_OUTPUT, NO_SIDE_EFFECTS]
    (found,) = faults(points).items()
    assert found[0] == "odd scans give sane commands"
    assert "SIGSEGV (own.py:14)" in found[1]


def test_a_file_that_ends_each_further_process_is_checked_once(tmp_path: Path) -> None:
    top = "import os, sys; os._exit(3) if sys.argv[-1] != '--done' else None"
    crash = "import ctypes; ctypes.string_at(0)"
    points = checked(tmp_path, top=top, body=f"if not len(inputs.scan.ranges): {crash}")
    assert SKIPPED in points
    assert [*faults(points)][:2] == [LOADING, "odd scans give sane commands"]


@pytest.mark.parametrize("hang", ["import threading; threading.Event().wait()", "input_loop()"])
def test_a_hang_is_reported_with_its_line_and_ends_the_check(tmp_path: Path, hang: str) -> None:
    """It waits for what never comes and uses no processor time, or loops for ever."""
    loop = "def input_loop():\n    import select; select.select([], [], [])"
    points = checked(tmp_path, 4.0, top=loop, body=f"if inputs.scan.seq == 9: {hang}")
    assert SKIPPED in points
    (found,) = faults(points).values()
    assert "is not done after 4 s (own.py:" in found


@pytest.mark.parametrize(
    ("lines", "said", "effect"),
    [
        ({"top": "print('loud'); open('/etc/passwd').read()"}, "loud", "(own.py:3)"),
        (
            {"made": "import os, sys; sys.stderr.write('loud'); os.listdir('/etc')"},
            "loud",
            "'/etc' (own.py:11)",
        ),
        ({"made": "import os; os.system('true')"}, "", "os.system"),
        ({"made": "import subprocess; subprocess.run(['true'])"}, "", "subprocess"),
    ],
)
def test_a_side_effect_is_reported_wherever_it_happens(
    tmp_path: Path, lines: dict[str, Any], said: str, effect: str
) -> None:
    found = faults(checked(tmp_path, **lines))
    assert (NO_OUTPUT in found) == bool(said)
    assert said in found.get(NO_OUTPUT, "")
    assert effect in found[NO_SIDE_EFFECTS]


def test_a_process_that_waits_for_its_processor_is_at_work_and_a_sleeping_one_is_not() -> None:
    begun, is_at_work = used_by(os.getpid())
    assert is_at_work
    sum(range(3_000_000))
    assert used_by(os.getpid())[0] > begun
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as child:
        wait_until(lambda: not used_by(child.pid)[1], "cat waits for its input")
    assert used_by(child.pid) == (0.0, False)


def test_reload_wants_a_pattern_and_targets(capsys: pytest.CaptureFixture[str]) -> None:
    assert swarmctl("plugin", "reload", "own") == 2
    assert "plugin reload needs targets" in capsys.readouterr().err
    assert swarmctl("plugin", "reload", "../own", "--all") == 2
    assert "'../own' is no pattern name" in capsys.readouterr().err


WRITES_ALL_OVER = r"""
import os
for number in range(3, 9):
    try:
        os.write(number, b"junk\n[1]\n{}\n")
    except OSError:
        pass
"""


def test_a_file_that_writes_into_the_answer_is_still_checked(tmp_path: Path) -> None:
    assert set(checked(tmp_path, top=WRITES_ALL_OVER)) >= set(POINTS)
    (row,) = describe_patterns(("own",), tmp_path, "burger")
    assert (row["kind"], row["group"], row["report_units"]) == ("movement", "yours", {})


FLOODS = """
import os, threading, time
def flood():
    while True:
        for number in range(3, 9):
            try:
                os.write(number, {line})
            except OSError:
                pass
        {pause}
threading.Thread(target=flood, daemon=True).start()
"""
BLANK = 'b"{}\\n"'
FORGED_ROW = "b'{\"begin\": \"' + str(time.monotonic()).encode() + b'\"}\\n'"
FLOODING = {
    "a line at a time": (BLANK, "time.sleep(0.02)"),
    "begins of items": (FORGED_ROW, "time.sleep(0.02)"),
    "as fast as it can": (f"{BLANK} * 9999", ""),
}


@pytest.mark.parametrize(("line", "pause"), part([*FLOODING.values()][:2], [*FLOODING.values()]))
def test_a_file_that_floods_the_answer_ends_with_the_time(
    tmp_path: Path, line: str, pause: str
) -> None:
    """If the flood covers the row of the first item, the whole check is an error."""
    top = FLOODS.format(line=line, pause=pause)
    try:
        points = checked(tmp_path, 2.0, top=top, made="threading.Event().wait()")
        found = " ".join(faults(points).values())
    except PluginError as error:
        found = str(error)
    assert re.search("is not done after 2 s|has printed more than", found)


def test_what_a_file_prints_is_bounded(tmp_path: Path) -> None:
    points = checked(tmp_path, top="while True: print('x' * (1 << 20))")
    assert "File too large" in faults(points)[LOADING]


def test_a_description_has_the_units_of_reports() -> None:
    rows = describe_patterns(("levy_walk", "discuss_then_disperse"), None, "burger")
    assert [row["report_units"] for row in rows] == [{"left": "m"}, {"distance": "m"}]


@pytest.mark.usefixtures("real_starts")
def test_a_child_that_does_not_begin_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match=r"0\.001 s"):
        checked(tmp_path, 0.001)


@pytest.mark.usefixtures("real_starts")
def test_a_check_reads_the_folder_of_the_file_and_never_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "home" / "anna"
    (home / "mine").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(home))
    beside = {
        file: readable_beside(file)
        for file in (home / "own.py", home.parent / "own.py", home / "mine" / "own.py")
    }
    assert list(beside.values()) == [home / "own.py", home.parent / "own.py", home / "mine"]
