"""Files that a worker reads when it runs them give the tests that all files give at once."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.read_when_run import (
    MARKING,
    PROCESS_FIXTURES,
    Progress,
    ReadWhenRun,
    UnnamedMark,
    is_wanted,
    may_be_selected,
)

ROOT = Path(__file__).resolve().parent.parent
CONFTEST = """
import os
from pathlib import Path
import pytest
from tests.support.read_when_run import Progress, ReadWhenRun
from tests.support.scheduling import MixedScheduling

READ = Path(os.environ["READ"])

def note(word):
    with READ.open("a") as file:
        print(word, file=file)

def pytest_configure(config):
    if "workerinput" in config.__dict__:
        if READ.name == "when_run":
            config.pluginmanager.register(ReadWhenRun(lambda config: None))
    elif READ.name == "when_run":
        config.pluginmanager.register(Progress())

def pytest_xdist_make_scheduler(config, log):
    return MixedScheduling(config, log) if READ.name == "when_run" else None

@pytest.fixture(scope="session")
def shared():
    yield os.getpid()
    note("shared ended")
    assert "broken" not in READ.read_text()
"""
FILES = {
    "test_a.py": """
import pytest, os
from conftest import note
note("read a")
@pytest.mark.parametrize("number", range(3))
def test_number(shared, number): assert number != 1
def test_other(shared): pytest.skip("a reason")
@pytest.mark.slow
def test_slow(): ...
""",
    "inner/test_b.py": """
import pytest
from conftest import note
note("read b")
@pytest.fixture(scope="module", autouse=True)
def module():
    yield
    note("module b ended")
class TestB:
    def test_one(self): ...
    @pytest.mark.xfail
    def test_two(self): assert False
""",
    "test_empty.py": "from conftest import note\nnote('read empty')\n",
    "test_broken.py": "import no_such_module\n",
    "test_skipped.py": "import pytest\npytest.skip('all', allow_module_level=True)\n",
}


def run(folder: Path, how: str, *words: str) -> tuple[int, list[str], str]:
    """The exit code, what was read and ended, and the lines of results, of a run in a folder."""
    place = folder / how
    for name, text in {
        **FILES,
        "conftest.py": CONFTEST,
        "pytest.ini": "[pytest]\nmarkers =\n slow\n long\n",
    }.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text)
    read = folder / "read" / how
    read.parent.mkdir(exist_ok=True)
    environ = {
        **os.environ,
        "READ": str(read),
        "PYTHONPATH": os.pathsep.join([str(place), str(ROOT)]),
    }
    command = [sys.executable, "-m", "pytest", "-n", "2", "--dist", "loadfile", "-rA", *words]
    command += ["-p", "no:cacheprovider", "-c", "pytest.ini", "--rootdir", "."]
    done = subprocess.run(command, cwd=place, env=environ, capture_output=True, text=True)
    lines = re.findall(r"^(?:PASSED|FAILED|ERROR|SKIPPED|XFAIL)[^-\n]*", done.stdout, re.MULTILINE)
    return done.returncode, read.read_text().splitlines(), "\n".join(sorted(lines))


@pytest.mark.integration
def test_results_are_those_of_a_collection_of_all_files(tmp_path: Path) -> None:
    usual = run(tmp_path, "usual", "-m", "not slow", "--continue-on-collection-errors")
    code, read, lines = run(tmp_path, "when_run", "-m", "not slow")
    assert code == usual[0] == 1
    assert lines == usual[2]
    assert "test_a.py::test_number[1]" in lines
    assert sorted(read) == sorted({*usual[1]})  # each file once, where two workers read each
    assert len(usual[1]) > len(read)


def test_no_test_is_told_as_pytest_tells_it() -> None:
    """By its exit code, although files were dealt out."""
    session: Any = SimpleNamespace(testscollected=14)
    loop = Progress().pytest_runtestloop(session)
    next(loop)
    with pytest.raises(StopIteration):
        loop.send(True)
    assert session.testscollected == 0


@pytest.mark.parametrize(
    ("text", "mark", "is_error"),
    [
        ("@marked\ndef test(): ...", "long", True),
        ("@marked\ndef test(): ...", "integration", True),
        ("@marked\ndef test(): ...", "slow", False),
        ("@pytest.mark.long\ndef test(): ...", "long", False),
    ],
)
def test_a_mark_that_its_file_does_not_name_is_an_error(
    tmp_path: Path, text: str, mark: str, is_error: bool
) -> None:
    """The lane of that mark would not read the file."""
    (tmp_path / "test_a.py").write_text(text)
    test: Any = SimpleNamespace(
        path=tmp_path / "test_a.py", nodeid="test_a.py::test", get_closest_marker={mark: True}.get
    )
    config: Any = SimpleNamespace(option=SimpleNamespace(markexpr=""))
    read = ReadWhenRun(lambda config: None).pytest_collection_modifyitems(config, [test])
    next(read)
    with pytest.raises(UnnamedMark if is_error else StopIteration):
        next(read)


@pytest.mark.integration
def test_such_an_error_is_one_of_its_file_alone(tmp_path: Path) -> None:
    place = tmp_path / "when_run"
    place.mkdir()
    marked = "import pytest\n@getattr(pytest.mark, 'long')\ndef test_long(): ...\n"
    (place / "test_marked.py").write_text(marked)
    code, _, lines = run(tmp_path, "when_run", "--ignore", "test_broken.py", "-m", "not long")
    assert code == 1
    assert "ERROR test_marked.py::tests" in lines
    assert "PASSED inner/test_b.py::TestB::test_one" in lines


@pytest.mark.integration
def test_the_test_that_ends_its_worker_is_named(tmp_path: Path) -> None:
    """And the files that wait behind it are done."""
    place = tmp_path / "when_run" / "inner"
    place.mkdir(parents=True)
    ends = "import os\ndef test_first(): ...\ndef test_ends(): os._exit(3)\n"
    (place / "test_ends.py").write_text(ends)
    code, read, lines = run(tmp_path, "when_run", "--ignore", "test_broken.py", "-m", "not slow")
    assert code == 1
    assert "FAILED inner/test_ends.py::test_ends" in lines
    assert "PASSED inner/test_ends.py::test_first" in lines
    assert "PASSED inner/test_b.py::TestB::test_one" in lines
    assert {"read a", "read b", "read empty"} <= {*read}


@pytest.mark.parametrize(
    ("options", "args", "expected"),
    [
        ({"dist": "loadfile"}, ["tests"], True),
        ({"dist": "loadfile"}, ["tests/test_a.py"], True),
        ({"dist": "loadfile"}, ["tests/test_a.py::test_b"], False),
        ({"dist": "load"}, ["tests"], False),
        ({"dist": "no"}, ["tests"], False),
        ({"dist": "loadfile", "lf": True}, ["tests"], False),
        ({"dist": "loadfile", "collectonly": True}, ["tests"], False),
    ],
)
def test_who_names_tests_or_asks_for_those_of_an_earlier_run_collects_all(
    options: dict[str, Any], args: list[str], expected: bool
) -> None:
    config: Any = SimpleNamespace(option=SimpleNamespace(**options), args=args)
    assert is_wanted(config) == expected


SHORT = "not (integration or long) or smoke"


@pytest.mark.parametrize(
    ("text", "expression", "expected"),
    [
        ("def test(): ...", SHORT, True),
        ("def test(): ...", f"not ({SHORT})", False),
        ("@pytest.mark.long\ndef test(): ...", f"not ({SHORT})", True),
        ("def test(a_browser): ...", f"not ({SHORT})", True),
        ("def test(): ...", "", True),
        ("def test(): ...", "evidence", True),
        ("def test(): ...", f"not ({SHORT}) and evidence", True),
        ("def test(): ...", "smoke", False),
    ],
)
def test_a_file_without_marks_is_not_read_for_a_lane_of_marks(
    tmp_path: Path, text: str, expression: str, expected: bool
) -> None:
    (tmp_path / "test_a.py").write_text(text)
    assert may_be_selected(tmp_path / "test_a.py", expression) == expected


def test_the_lanes_are_those_of_the_makefile() -> None:
    makefile = (ROOT / "Makefile").read_text()
    assert f"SHORT = {SHORT}\n" in makefile
    assert 'not ($(SHORT))"' in makefile


@pytest.mark.parametrize("name", sorted(PROCESS_FIXTURES))
def test_a_fixture_that_marks_is_found(name: str) -> None:
    assert MARKING.search(f"def test({name}): ...")
