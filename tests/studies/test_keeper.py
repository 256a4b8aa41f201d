"""The keeper of studies: no run is done twice or lost by a kill, and none of other code counts."""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest

from studies import keeper
from studies.keeper import Record, Traced, again, each, records
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.run_list import VARIABLE, unlisted

HERE = "tests.studies.test_keeper"


class Task(msgspec.Struct, frozen=True):
    """What the functions of this file get."""

    number: int
    share: float = 0.5


@dataclass(frozen=True)
class Found:
    """What the functions of this file find."""

    at: float
    opinion: int | None
    sums: Array


done: list[int] = []
"""The tasks that `double` did in this process."""


@pytest.fixture(autouse=True)
def _nothing_done() -> None:
    done.clear()


def double(task: Task) -> float:
    done.append(task.number)
    return 2.0 * task.number


def odd_values(task: tuple[int, Mapping[str, float]]) -> Found:
    number, shares = task
    return Found(math.inf, None, np.array([[-0.0, math.nan, number / shares["share"]]]))


def fails_at_2(task: Task) -> float:
    return 1.0 / (task.number - 2)


def no_run(task: Task) -> float:
    raise AssertionError(task)


def of_real_time(task: Task) -> Traced[float]:
    return Traced(1.0)


def driven(task: Task) -> Traced[float]:
    return Traced(1.0, "0123456789ab", ("creep", "hold"))


def tasks(*numbers: int) -> list[Task]:
    return [Task(number) for number in numbers]


def lines(file: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in file.read_text().splitlines()]


def test_a_run_is_done_once_and_records_come_in_the_order_of_the_tasks(tmp_path: Path) -> None:
    file = tmp_path / "some" / "runs.jsonl"
    records(double, tasks(3), file, code="a")
    found = records(double, tasks(1, 3, 1, 2), file, code="a")
    assert done == [3, 1, 2]
    assert [(one.task, one.found) for one in found] == [
        (Task(1), 2.0), (Task(3), 6.0), (Task(1), 2.0), (Task(2), 4.0),
    ]  # fmt: skip
    assert [line["task"] for line in lines(file)] == [
        {"number": number, "share": 0.5} for number in (3, 1, 2)
    ]


def test_a_record_is_read_as_it_was_made(tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    one = (7, {"share": 0.1})
    for _ in range(2):
        (record,) = records(odd_values, [one], file, code="a")
        assert (record.task, record.found.at, record.found.opinion) == (one, math.inf, None)
        assert record.found.sums.tobytes() == np.array([[-0.0, math.nan, 7 / 0.1]]).tobytes()
    assert len(lines(file)) == 1


def test_records_of_other_code_are_done_again_and_those_of_before_stay(tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    for code in ("a", "b", "a"):
        records(double, tasks(1), file, code=code)
    assert done == [1, 1]
    assert [line["code"] for line in lines(file)] == ["a", "b"]


def test_an_error_of_a_run_keeps_the_runs_before_it(tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    with pytest.raises(ZeroDivisionError):
        records(fails_at_2, tasks(0, 1, 2, 3), file, code="a")
    assert [line["found"] for line in lines(file)] == [-0.5, -1.0]
    assert len(records(fails_at_2, tasks(0, 1, 3), file, code="a")) == 3
    assert len(lines(file)) == 3


def test_a_line_that_was_cut_off_is_done_again_and_the_file_is_whole(tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    records(double, tasks(1, 2), file, code="a")
    file.write_bytes(file.read_bytes()[:-20])
    assert len(records(double, tasks(1, 2), file, code="a")) == 2
    assert done == [1, 2, 2]
    assert [line["found"] for line in lines(file)] == [2.0, 4.0]


@pytest.mark.parametrize("end", ['{"ta', '{"task": {"number": 2', "\0" * 40])
def test_an_end_of_a_power_cut_is_left_out(end: str, tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    records(double, tasks(1), file, code="a")
    file.write_bytes(file.read_bytes() + end.encode())
    assert len(records(double, tasks(1, 2), file, code="a")) == 2
    assert [line["found"] for line in lines(file)] == [2.0, 4.0]


def test_a_file_of_others_without_a_last_line_end_stays_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / "notes.json"
    file.write_text('{"notes": "the only copy"}')
    with pytest.raises(ConfigError, match=r"notes\.json"):
        records(double, tasks(1), file, code="a")
    assert file.read_text() == '{"notes": "the only copy"}'
    assert not done


@pytest.mark.parametrize(
    "odd",
    [
        "robots",
        "{}",
        "[1, 2]",
        "",
        '{"task": {"number": 1, "share": 0.5}, "code": "a", "cpu": 1.0}',
        '{"task": {"number": 1, "share": 0.5}, "code": "a", "cpu": 1.0, "bits": "", "rules": [],'
        ' "day": "", "commit": "", "found": "two"}',
        "\\x80",
    ],
)
def test_a_line_of_another_shape_is_told_and_its_run_is_done(
    odd: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "runs.jsonl"
    file.write_bytes(odd.encode().replace(b"\\x80", b"\x80") + b"\n")
    (record,) = records(double, tasks(1), file, code="a")
    assert record.found == 2.0
    told = [line for line in capsys.readouterr().err.splitlines() if str(file) in line]
    assert len(told) == 1
    records(no_run, tasks(1), file, code="a")


def test_what_is_no_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="records of runs") as error:
        records(double, tasks(1), tmp_path, code="a")
    assert str(tmp_path) in str(error.value)
    assert not done


def test_two_writers_of_one_file_do_no_run_twice(tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"

    def nested(task: Task) -> float:
        with pytest.raises(ConfigError, match="another process"):
            records(double, tasks(9), file, code="a")
        return 0.0

    records(nested, tasks(1), file, code="a")
    assert not done


@pytest.mark.parametrize("beyond", [0, 10])
def test_a_file_that_cannot_grow_is_told_in_one_line_and_keeps_its_runs(
    tmp_path: Path, beyond: int
) -> None:
    file = tmp_path / "runs.jsonl"
    records(double, tasks(1), file, code="a")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (file.stat().st_size + beyond, before[1]))
    try:
        with pytest.raises(SwarmError, match=r"runs\.jsonl: .*finished runs are kept"):
            records(double, tasks(1, 2), file, code="a")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [one.found for one in records(double, tasks(1, 2), file, code="a")] == [2.0, 4.0]
    assert done == [1, 2, 2]


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/full"])
def test_a_device_is_no_file_of_records(path: str) -> None:
    with pytest.raises(ConfigError, match=path):
        records(double, tasks(1), Path(path), code="a")


def test_the_code_of_a_function_is_that_of_its_module_and_its_software(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: list[list[str]] = []

    def digest(modules: list[str]) -> str:
        seen.append(modules)
        return "1"

    with pytest.raises(SwarmError, match="json has no known sources"):
        keeper.code_of(json.dumps)
    monkeypatch.setattr(keeper, "sources_of", lambda modules: modules)
    monkeypatch.setattr(keeper, "digest_of", digest)
    code = keeper.code_of(double)
    assert seen == [[HERE]]
    assert code == keeper.code_of(odd_values)
    monkeypatch.setattr(keeper, "functions_here", lambda: {"libm": "other"})
    other = keeper.code_of(double)
    assert other != code
    monkeypatch.setattr(keeper, "digest_of", lambda modules: "2")
    assert keeper.code_of(double) not in (code, other)


def test_experiments_of_other_sources_have_another_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keeper, "digest_of", lambda modules: f"{modules[0][8:10]}0123456789")
    assert keeper.experiment_folder("paper") == Path("build/paper/pa012345")
    assert keeper.experiment_folder("learning") == Path("build/learning/le012345")


def test_runs_of_a_job_are_listed_by_which_they_are_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def local(task: Task) -> float:
        return 1.0

    listed = tmp_path / "listed.jsonl"
    monkeypatch.setenv(VARIABLE, str(listed))
    records(double, tasks(4), tmp_path / "a", code="a")
    records(double, tasks(4), tmp_path / "a", code="a")  # known, and so listed too
    records(driven, tasks(5), tmp_path / "b", code="a")
    records(of_real_time, tasks(6), tmp_path / "c", code="a")
    records(local, tasks(7), tmp_path / "d", code="a")
    found = lines(listed)
    assert [line["run"] for line in found] == [
        f"{HERE}:{n}" for n in ("double", "double", "driven")
    ]
    assert found[2] == {
        "run": f"{HERE}:driven",
        "task": {"number": 5, "share": 0.5},
        "bits": "0123456789ab",
        "rules": ["creep", "hold"],
    }
    once_more = again(str(found[0]["run"]), found[0]["task"])
    assert (once_more.found, once_more.bits) == (8.0, found[0]["bits"])
    assert len(once_more.bits) == 12
    assert again(str(found[0]["run"]), {"number": 3}).bits != once_more.bits


@pytest.mark.parametrize(
    ("run", "task"),
    [
        (f"{HERE}:gone", {"number": 1}),
        ("tests.studies.gone:double", {"number": 1}),
        (f"{HERE}:double", {"name": 1}),
        (f"{HERE}:double", "one"),
        (f"{HERE}:no_run", {"number": 1}),
    ],
)
def test_a_run_of_other_code_is_refused_by_name(run: str, task: object) -> None:
    with pytest.raises(SwarmError, match=run):
        again(run, task)


def test_each_keeps_runs_in_a_job_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(keeper, "code_of", lambda perform: "a")
    assert each(double, tasks(2, 1)) == [4.0, 2.0]
    assert [*tmp_path.iterdir()] == []
    monkeypatch.setenv(VARIABLE, str(tmp_path / "listed"))
    for _ in range(2):
        assert each(double, tasks(2, 1)) == [4.0, 2.0]
    assert done == [2, 1, 2, 1]
    assert len(lines(tmp_path / f"build/{HERE}/double.jsonl")) == 2
    with unlisted():
        assert each(double, tasks(3)) == [6.0]
    assert len(lines(tmp_path / "listed")) == 4
    assert os.environ[VARIABLE] == str(tmp_path / "listed")


def test_progress_that_a_study_words_is_a_line_for_each_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def told(record: Record[Task, float]) -> str:
        return f"{record.task.number} gave {record.found}"

    records(double, tasks(1), tmp_path / "runs", code="a")
    records(double, tasks(1, 2, 3), tmp_path / "runs", code="a", told=told)
    assert capsys.readouterr().err.splitlines()[1:] == ["2/3 2 gave 4.0", "3/3 3 gave 6.0"]


def test_the_last_of_many_runs_has_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    records(double, tasks(*range(50)), tmp_path / "runs", code="a")
    lines_told = capsys.readouterr().err.splitlines()
    assert len(lines_told) < 50
    assert lines_told[-1].startswith('50/50 {"number": 49')


SLOW = """
import os
import sys
import time
from pathlib import Path

from studies.keeper import records

FOLDER = Path(os.environ["FOLDER"])


def perform(number: int) -> int:
    with (FOLDER / "begun").open("a") as begun:
        begun.write(f"{number}\\n")
    while number >= 3 and not (FOLDER / "goes_on").exists():
        time.sleep(0.01)
    return number * number


if __name__ == "__main__":
    jobs = int(sys.argv[1])
    found = records(perform, range(8), FOLDER / "runs.jsonl", jobs=jobs, code="a", told=str)
    print([one.found for one in found])
"""


@pytest.mark.integration
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_killed_study_goes_on_without_a_run_twice(tmp_path: Path, jobs: str) -> None:
    program = tmp_path / "slow.py"
    program.write_text(SLOW)
    command = [sys.executable, str(program), jobs]
    root = Path(__file__).parents[2]
    environment = {**os.environ, "FOLDER": str(tmp_path), "PYTHONPATH": str(root)}
    with subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    ) as first:
        assert first.stderr is not None
        for _ in range(3):  # runs 0 to 2 are written; a run from 3 on does not end
            first.stderr.readline()
        first.send_signal(signal.SIGKILL)
        try:
            first.communicate(timeout=60.0)  # its workers have ended, too: nobody holds the pipe
        finally:
            (tmp_path / "goes_on").touch()
    second = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True, timeout=120.0
    )
    assert second.stdout.strip() == str([number * number for number in range(8)])
    begun = [int(line) for line in (tmp_path / "begun").read_text().split()]
    assert [begun.count(number) for number in (0, 1, 2)] == [1, 1, 1]
    written = [line["task"] for line in lines(tmp_path / "runs.jsonl")]
    assert {*written[:3]} == {0, 1, 2}
    assert len(written) == 8
