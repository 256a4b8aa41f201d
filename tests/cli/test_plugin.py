"""`swarmctl plugin new` and `check`: what is written passes, and what does not hold is told."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from swarmd.cli.inspect import LEAVES, PRINTS, Point, check_file, describe_patterns
from swarmd.cli.swarmctl import cli, run_cli
from swarmd.core.errors import PluginError, SwarmError
from swarmd.pattern_host.inspect_plugin import LOADING, MIRRORED
from swarmd.plugins import pattern_names
from swarmd.testing.pattern_contract import PatternContract

pytestmark = pytest.mark.integration

CODE = """
from swarmd.api import Inputs, MovementPattern, Params, Twist
{top}

class Own(MovementPattern[Params]):
    '''A test's.'''

    def __init__(self, params, context):
        super().__init__(params, context)
        {made}

    def drive(self, inputs: Inputs) -> Twist:
        {body}
        return Twist()
"""
POINTS = [
    name.removeprefix("test_").replace("_", " ")
    for name in vars(PatternContract)
    if name.startswith("test_")
]


def swarmctl(*words: str) -> int:
    def code_of(error: SwarmError) -> int:
        raise error

    return run_cli(cli, list(words), "swarmctl", code_of)


def checked(folder: Path, patience: float = 60.0, **lines: str) -> Mapping[str, Point]:
    """The points of a pattern with these lines."""
    path = folder / "own.py"
    path.write_text(CODE.format(**{"top": "", "made": "pass", "body": "pass"} | lines))
    return {point.name: point for point in check_file(path, patience)}


def bad(points: Mapping[str, Point]) -> list[str]:
    return [name for name, point in points.items() if not point.is_well]


@pytest.mark.parametrize("kind", ["movement", "voting", "pattern"])
def test_what_is_written_passes_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    folder = tmp_path / "mine"
    assert swarmctl("plugin", "new", "my_own", "--dir", str(folder), "--kind", kind) == 0
    said = capsys.readouterr().out
    assert f"swarmctl plugin check {folder}/my_own.py" in said
    assert sorted(path.name for path in folder.iterdir()) == ["my_own.py", "test_my_own.py"]
    points = check_file(folder / "my_own.py", 60.0)
    assert [point for point in points if not point.is_well] == []
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)],
        capture_output=True,
        text=True,
        cwd=folder,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    command = [sys.executable, "-m", "ruff", "check", "--isolated", "--select", "E,F,I", "."]
    ruff = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    assert ruff.returncode == 0, ruff.stdout
    assert "my_own" in pattern_names(folder, {})


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("my-own", "'my-own' is no name"),
        ("Own", "'Own' is no name"),
        ("1st", "'1st' is no name"),
        ("../own", "'../own' is no name"),
        ("lambda", "'lambda' is no name"),
        ("test_own", "'test_own' is no name"),
        ("random", "'random' is a module that others import"),
        ("numpy", "'numpy' is a module that others import"),
        ("drive", "has a pattern 'drive'"),
    ],
)
def test_a_name_that_will_not_do_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, told: str
) -> None:
    assert swarmctl("plugin", "new", name, "--dir", str(tmp_path)) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", ["own.py", "test_own.py"])
def test_nothing_is_written_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], there: str
) -> None:
    (tmp_path / there).write_text("mine")
    assert swarmctl("plugin", "new", "own", "--dir", str(tmp_path)) == 2
    assert f"{tmp_path / there} is there already" in capsys.readouterr().err
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(there, "mine")]


def test_a_class_is_never_called_as_what_it_imports(tmp_path: Path) -> None:
    assert swarmctl("plugin", "new", "twist", "--dir", str(tmp_path)) == 0
    assert "class TwistPattern(MovementPattern" in (tmp_path / "twist.py").read_text()


def test_each_point_has_a_line_and_a_pattern_that_holds_is_well(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert swarmctl("plugin", "new", "own", "--dir", str(tmp_path)) == 0
    capsys.readouterr()
    assert swarmctl("plugin", "check", str(tmp_path / "own.py")) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert [line[:4] for line in lines] == ["ok  "] * (3 + len(POINTS))
    assert last == f"{3 + len(POINTS)} checked, all well"
    assert lines[0].split("  ")[2] == LOADING


def test_in_json_it_says_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "own.py"
    path.write_text(CODE.format(top="print('hello')", made="pass", body="1 / 0"))
    assert swarmctl("plugin", "check", str(path), "-o", "json") == 1
    answer = json.loads(capsys.readouterr().out)
    assert (answer["kind"], answer["is_well"]) == ("Check", False)
    points = {point["point"]: point for point in answer["points"]}
    assert list(points) == [LOADING, *POINTS, PRINTS, LEAVES]
    assert points["odd scans give sane wishes"]["text"].endswith(
        "ZeroDivisionError: division by zero (own.py:13)"
    )
    assert points[PRINTS] == {"point": PRINTS, "is_well": False, "text": "hello"}
    assert points[MIRRORED]["text"] == "is_symmetric is not claimed"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x = 1\nimport nothing_of_that_name", "No module named 'nothing_of_that_name' (own.py:2)"),
        ("x = 1\n\ndef broken(:\n", "SyntaxError: invalid syntax (own.py:3)"),
        ("x = 1", "must hold exactly one Pattern; it holds none"),
        ("raise SystemExit(4)", "SystemExit: 4 (own.py:1)"),
        ("import os\nos._exit(3)", "the process that checks it ended with code 3"),
        ("import ctypes\nctypes.string_at(0)", "was killed by SIGSEGV"),
        ("import os\nos.kill(os.getpid(), 9)", "was killed by SIGKILL"),
        ("while True: pass", "is not done after 5 s"),
        ("a = []\nwhile True: a.append(bytearray(1 << 26))", "MemoryError"),
    ],
)
def test_a_file_that_cannot_be_loaded_is_told_and_nothing_more_is_tried(
    tmp_path: Path, text: str, told: str
) -> None:
    path = tmp_path / "own.py"
    path.write_text(text)
    patience = 5.0 if "pass" in text else 60.0
    points = check_file(path, patience)
    assert [point.name for point in points] == [LOADING, PRINTS, LEAVES]
    assert not points[0].is_well
    assert told in points[0].text


def test_a_file_whose_name_no_pattern_can_have_is_told(tmp_path: Path) -> None:
    path = tmp_path / "My-Own.py"
    path.write_text(CODE.format(top="", made="pass", body="pass"))
    assert "which is the pattern's, is 'My-Own'" in check_file(path, 60.0)[0].text


@pytest.mark.parametrize("body", ["import os; os._exit(3)", "import os; os.abort()"])
def test_a_step_that_ends_the_process_fails_its_points_and_the_others_are_checked(
    tmp_path: Path, body: str
) -> None:
    points = checked(tmp_path, body=f"if not len(inputs.scan.ranges): {body}")
    assert list(points) == [LOADING, *POINTS, PRINTS, LEAVES]
    found = "odd scans give sane wishes"
    assert bad(points) == [found]
    assert "the process that checks it" in points[found].text


def test_a_step_that_hangs_is_told_and_the_others_are_checked(tmp_path: Path) -> None:
    """It waits for what never comes, and uses no processor time."""
    wait = "import threading; threading.Event().wait()"
    points = checked(tmp_path, 15.0, body=f"if inputs.dt > 1000: {wait}")
    assert bad(points) == ["survives a jump of time"]
    assert points["survives a jump of time"].text.endswith("is not done after 15 s")


@pytest.mark.parametrize(
    ("lines", "name", "told"),
    [
        ({"top": "print('loud')"}, PRINTS, "loud"),
        ({"made": "import sys; sys.stderr.write('loud')"}, PRINTS, "loud"),
        ({"top": "WEIGHTS = open('/etc/passwd').read()"}, LEAVES, "'/etc/passwd' (own.py:3)"),
        ({"made": "import os; os.listdir('/etc')"}, LEAVES, "'/etc' (own.py:10)"),
        ({"made": "import os; os.system('true')"}, LEAVES, "os.system"),
        ({"made": "import subprocess; subprocess.run(['true'])"}, LEAVES, "subprocess.Popen"),
        ({"body": "print('loud')"}, "touches nothing outside", "may not call builtins.print"),
        ({"body": "open('/etc/passwd').close()"}, "touches nothing outside", "builtins.open"),
    ],
)
def test_what_leads_out_of_a_pattern_is_told_wherever_it_is_done(
    tmp_path: Path, lines: dict[str, str], name: str, told: str
) -> None:
    points = checked(tmp_path, 60.0, **lines)
    assert name in bad(points)
    assert told in points[name].text


def test_a_file_that_is_not_there_is_an_error_of_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert swarmctl("plugin", "check", str(tmp_path / "none.py")) == 2
    assert "does not exist" in capsys.readouterr().err


def test_reload_wants_a_pattern_and_targets(capsys: pytest.CaptureFixture[str]) -> None:
    assert swarmctl("plugin", "reload", "own") == 2
    assert "plugin reload needs targets" in capsys.readouterr().err
    assert swarmctl("plugin", "reload", "../own", "--all") == 2
    assert "'../own' is no pattern's name" in capsys.readouterr().err


WRITES_ALL_OVER = r"""
import os
for number in range(3, 9):
    try:
        os.write(number, b"junk\n[1]\n{}\n")
    except OSError:
        pass
"""


def test_a_file_that_writes_into_the_answer_is_checked_all_the_same(tmp_path: Path) -> None:
    points = checked(tmp_path, top=WRITES_ALL_OVER)
    assert set(points) >= set(POINTS)
    (row,) = describe_patterns(("own",), tmp_path, "burger")
    assert row["kind"] == "movement"


def test_a_check_that_does_not_begin_is_told_as_such(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match=r"the process that checks .* is not done after 0\.001 s"):
        checked(tmp_path, 0.001, top="import threading\nthreading.Event().wait(60)")
