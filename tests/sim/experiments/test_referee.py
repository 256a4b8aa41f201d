"""`exp referee`: what a controller is, the cases of a task, verdicts, and bits that repeat."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from swarmd.core.errors import ConfigError
from swarmd.settings import yamlfile
from swarmd.sim.cli import exp_referee
from swarmd.sim.cli.exp import exp
from swarmd.sim.experiments import referee
from swarmd.sim.experiments.compare import Difference
from swarmd.sim.experiments.referee import (
    BETTER,
    OPEN,
    SOUND,
    STAND,
    WORSE,
    Case,
    bits_of,
    cases_of,
    controller_of,
    digest_of,
    findings_of,
    parse_until,
)
from swarmd.sim.experiments.simulate import run_here
from swarmd.sim.metrics.catalog import metric_of

TURN = """
from swarmd.api import Inputs, MovementPattern, Params, Twist


class Turn(MovementPattern[Params]):
    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.0, 1.0)
"""
LAUNCH = "nodes: [{run: 'one:One'}]\n"
TASK = {
    "extends": "benchmark/doorway",
    "duration": 0.6,
    "groups": {"team": {"count": 2}},
    "patterns": {"random_walk": {}, "drive": {"turn": 0.1, "recovery": True}},
}


@pytest.fixture
def task(tmp_path: Path) -> str:
    """The file of a short task with two robots."""
    path = tmp_path / "short.yaml"
    path.write_text(yamlfile.text_of(TASK))
    return str(path)


@pytest.fixture
def turn(tmp_path: Path) -> Path:
    """A folder with one pattern, whose robots turn."""
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "turn.py").write_text(TURN)
    return folder


@pytest.mark.parametrize(
    ("files", "pattern"),
    [
        ({"pattern.py": TURN}, "given"),
        ({"turn.py": TURN, "test_turn.py": ""}, "turn"),
        ({"nodes.yaml": LAUNCH, "one.py": "", "params.yaml": "/**: {}"}, "ros2_nodes"),
        ({"gather.onnx": ""}, "gather"),
        ({"gather.npz": "", "train.py": ""}, "gather"),
    ],
)
def test_a_folder_holds_one_controller(tmp_path: Path, files: dict[str, str], pattern: str) -> None:
    folder = tmp_path / "given"
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)
    assert controller_of(str(folder)).pattern == pattern


def test_nodes_of_ros_2_come_with_their_launch_file(tmp_path: Path) -> None:
    path = tmp_path / "nodes.yaml"
    path.write_text(LAUNCH)
    found = controller_of(str(path))
    assert found == controller_of(str(tmp_path))
    assert found.plugin_dir == tmp_path
    assert found.values == {"parameters.ros2_nodes.launch": str(path)}


def test_the_digest_is_of_the_files_of_the_controller_alone(tmp_path: Path) -> None:
    """Neither the runs below the folder count, nor a note, nor hidden folders."""
    (tmp_path / "nodes.yaml").write_text(LAUNCH)
    runs = tmp_path / "runs"

    def now() -> str:
        return digest_of(controller_of(str(tmp_path)), runs)

    before = now()
    for name in ("runs/a.py", "note.txt", ".git/x.py", "__pycache__/x.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
    assert now() == before
    (tmp_path / "one.py").write_text("x")
    assert now() != before
    assert digest_of(controller_of("random_walk"), runs) == ""


@pytest.mark.parametrize(
    ("files", "named"),
    [
        ((), "pattern.py"),
        (("a.onnx", "b.onnx"), "a.onnx, b.onnx"),
        (("a.py", "b.py"), "a.py, b.py"),
    ],
)
def test_a_folder_with_none_or_several_is_refused(
    tmp_path: Path, files: tuple[str, ...], named: str
) -> None:
    for name in files:
        (tmp_path / name).write_text("")
    with pytest.raises(ConfigError, match=named):
        controller_of(str(tmp_path))


def test_a_task_has_a_case_without_a_fault_three_with_one_and_the_control(
    task: str, turn: Path
) -> None:
    cases = cases_of(task, [0], controller_of(str(turn)))
    assert [case.case for case in cases] == [
        SOUND, "scan_frozen", "dead_wheel", "radio_mute", STAND,
    ]  # fmt: skip
    by_case = {case.case: case.plan.variants[0].effective for case in cases}
    assert not by_case[SOUND].get("events")
    (event,) = by_case["dead_wheel"]["events"]
    assert event["at"] == pytest.approx(0.06)
    assert event["fault"]["base"] == "dead_wheel"
    group = by_case[STAND]["groups"]["team"]
    assert group["pattern"] == "drive"
    assert group["parameters"] == {
        "speed": 0.0,
        "turn": 0.0,
        "lateral": 0.0,
        "recovery": False,
    }
    assert {case.task for case in cases} == {"short"}


def test_a_task_that_does_not_fit_has_no_case_and_one_line(task: str) -> None:
    lines: list[str] = []
    assert cases_of(task, [0], controller_of("foraging"), on_misfit=lines.append) == []
    assert len(lines) == 1
    assert "foraging" in lines[0]
    with pytest.raises(ConfigError, match="radio_mute"):
        cases_of(task, [0], controller_of("random_walk"), ["radio_mut"])


@pytest.mark.parametrize(
    ("metric", "difference", "p", "verdict"),
    [
        ("one_cluster_at_end", 0.2, 0.01, OPEN),
        ("protection_duty", 0.2, 0.049, WORSE),
        ("protection_duty", -0.2, 0.049, BETTER),
        ("protection_duty", -0.2, 0.05, OPEN),
        ("network_area:1:1", 0.2, 0.01, BETTER),
        ("network_area:1:1", -0.2, 0.01, WORSE),
        ("network_area:1:1", 0.2, None, OPEN),
        ("network_area:1:1", None, 0.01, OPEN),
    ],
)
def test_a_verdict_follows_from_the_direction_of_the_metric(
    metric: str, difference: float | None, p: float | None, verdict: str
) -> None:
    """A metric of which neither more nor less is better gives none."""
    found = Difference(metric, "", 9, 9, difference=difference, p=p, p_holm=p)
    assert referee.verdict_of(found, metric_of(metric)) == verdict


def test_bits_are_a_digest_of_all_runs_in_their_order() -> None:
    assert bits_of(["a", "b"]) == hashlib.sha256(b"a\nb").hexdigest()[:12]
    assert bits_of(["b", "a"]) != bits_of(["a", "b"])


def test_cases_of_which_no_run_finished_are_open() -> None:
    """They have the same bits: none."""
    metric = metric_of("protection_duty")
    plan: Any = None

    def failed(case: str) -> tuple[Case, Any]:
        results = SimpleNamespace(
            rows=[], failures={"0": "boom"}, pattern_faults={}, variants=["a"]
        )
        return Case("task", case, plan, metric), results

    found = findings_of([failed(case) for case in (SOUND, "scan_frozen", STAND)])
    assert [(one.verdict, one.runs, one.failed) for one in found] == [(OPEN, 0, 1)] * 3


def test_a_requirement_names_a_task() -> None:
    until = parse_until("doorway >= 0.3")
    assert until.task == "doorway"
    assert until.requirement(metric_of("protection_duty")) == "protection_duty >= 0.3"
    for text in ("doorway", ">= 0.3", "doorway == 1", "door way >= 1"):
        with pytest.raises(ConfigError, match="TASK >= VALUE"):
            parse_until(text)


def test_each_requirement_has_a_folder_of_its_own() -> None:
    """So that the runs and the manifest of one are not those of another."""
    texts = ["doorway >= 0.3", "doorway <= 0.3", "doorway > 0.3", "doorway < 0.3", "doorway >= 0.4"]
    folders = [parse_until(text).folder for text in texts]
    assert len(set(folders)) == len(texts)
    assert parse_until("doorway>=0.3").folder == folders[0]


def test_two_people_get_the_same_bits_in_one_html(
    task: str, turn: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their runs are done in this process, without a worker."""

    @contextmanager
    def here(*_: Any) -> Iterator[Any]:
        yield run_here

    monkeypatch.setattr(exp_referee, "engine", here)
    words = ["referee", str(turn), "--task", task, "--fault", "radio_mute", "--seeds", "3"]
    ends = []
    for person in ("a", "b"):
        out = tmp_path / person
        done = CliRunner().invoke(exp, [*words, "--fresh", "--out", str(out)])
        assert done.exit_code == 0, done.output
        rows = [line.split()[:2] for line in done.stdout.splitlines()]
        assert rows[1:] == [["short", "sound"], ["short", "radio_mute"]]
        ends.append(done.stderr.rpartition("bits of all runs: ")[2].partition(";")[0])
        page = (out / "referee.html").read_text()
        assert ends[-1] in page
        for case in ("sound", "radio_mute", "stand"):
            head, *lines = (out / "short" / case / "runs.csv").read_text().splitlines()
            column = head.split(",").index("bits")
            assert len(lines) == 3
            assert all(line.split(",")[column] in page for line in lines)
    assert ends[0] == ends[1]
    assert len(ends[0]) == 12


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["random_walk", "--task", "dorway"], "benchmark/doorway"),
        (["random_walk", "--task", "doorway", "--task", "doorway"], "twice"),
        (["random_walk", "--task", "doorway", "--until", "shelter >= 1"], "shelter"),
        (["random_walk", "--task", "doorway", "--until", "doorway >= x"], "'x'"),
        (["random_walk", "--task", "doorway", "--until", "doorway >= 7"], "between 0 and 1"),
        (["random_walk", "--until", "doorway > 1", "--until", "doorway>1"], "twice"),
        (["random_walk", "--task", "doorway", "--fault", "smoke"], "smoke"),
        (["foraging", "--task", "doorway"], "fits none"),
        (["no/such.onnx"], "no such file"),
    ],
)
def test_a_wrong_line_is_refused_before_anything_runs(
    tmp_path: Path, words: list[str], named: str
) -> None:
    out = tmp_path / "out"
    done = CliRunner().invoke(exp, ["referee", *words, "--out", str(out)])
    assert isinstance(done.exception, ConfigError), done.output
    assert named in str(done.exception)
    assert not out.exists()
