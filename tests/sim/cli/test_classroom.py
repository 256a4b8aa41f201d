"""`swarmctl class check`: real runs with the pattern of each pupil."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from swarmd.sim.cli import classroom as classroom_module
from swarmd.sim.cli.classroom import classroom
from swarmd.sim.experiments import lessons
from swarmd.sim.experiments.lessons import Lesson, load_lessons, mark_results
from swarmd.sim.experiments.manifest import manifest_of
from swarmd.sim.experiments.simulate import plan_of, simulate
from swarmd.sim.experiments.store import open_store
from tests.support.examples import part
from tests.support.processes import has_landlock

ROOT = Path(__file__).resolve().parents[3]
BOLD = (ROOT / "docs/tutorial/5-protection.md").read_text().split("```python\n")[1].split("```")[0]
MISTAKES = {
    "colon": BOLD.replace("def step(self, inputs: Inputs) -> Outputs:", "def step(self, inputs)"),
    "nothing": BOLD.replace("return Outputs(", "Outputs("),
    "network": f"import socket\n{BOLD}",
}
"""Files that `plugin check` refuses."""

AFTER_THE_CHECK = {"late": "[0.0][1]", "hog": "[0.0] * 10**10"}
"""Statements that a pattern reaches in its 300th step, and `plugin check` does not reach."""


def bold_until(statement: str) -> str:
    """The reckless pattern, which from its 300th step on comes to a statement."""
    count = "self.steps = getattr(self, 'steps', 0) + 1"
    lines = (count, "while self.steps > 300:", f"    {statement}", "return Outputs(")
    return BOLD.replace("return Outputs(", "\n        ".join(lines))


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> Lesson:
    """Lesson 5 with one robot, one seed and 32 s."""
    scenario = {
        "duration": 32,
        "arena": {"size": [3, 3]},
        "groups": {"r": {"platform": "burger", "count": 1}},
    }
    targets = {"runs/crowd": ["min(path_length) >= 2", "max(arena_contacts) == 0"]}
    lesson = Lesson(title="Short", targets=targets, pattern="bold", scenario=scenario)
    monkeypatch.setattr(lessons, "load_lessons", lambda: {"5": lesson})
    return lesson


def checked(folder: Path, lesson: str, *options: str) -> Result:
    words = ["check", str(folder), "--lesson", lesson, "-j", "1", *options]
    return CliRunner().invoke(classroom, words)


def pupils(result: Result) -> Mapping[str, dict[str, Any]]:
    return {one["pupil"]: one for one in json.loads(result.stdout)["pupils"]}


@pytest.mark.smoke
@pytest.mark.integration
@pytest.mark.long
def test_a_broken_file_fails_its_pupil_alone(tmp_path: Path, short: Lesson) -> None:
    for name, text in {**MISTAKES, "anna": BOLD}.items():
        (tmp_path / f"{name}.py").write_text(text)
    for name in ("yan", "zoe"):
        (tmp_path / name).mkdir()
    (tmp_path / "yan" / "bold.py").write_text(MISTAKES["nothing"])
    result = checked(tmp_path, "5", "-o", "json")
    assert result.exit_code == 1
    found = pupils(result)
    assert list(found) == [*sorted([*MISTAKES, "anna"]), "yan", "zoe"]
    assert json.loads(result.stdout)["same_files"] == [["nothing", "yan"]]
    assert "the same file: nothing, yan" in result.stderr
    assert [name for name, one in found.items() if one["passed"]] == ["anna"]
    assert [one["met"] for one in found["anna"]["requirements"]] == [True, True]
    assert all(found[name]["why"] and not found[name]["requirements"] for name in MISTAKES)
    assert "socket" in found["network"]["why"]
    assert "bold.py" in found["zoe"]["why"]


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.long
def test_what_breaks_in_the_run_fails_its_pupil_alone(tmp_path: Path, short: Lesson) -> None:
    (tmp_path / "anna").mkdir()
    (tmp_path / "anna" / "bold.py").write_text(BOLD)
    for name, statement in AFTER_THE_CHECK.items():
        (tmp_path / f"{name}.py").write_text(bold_until(statement))
    found = pupils(checked(tmp_path, "5", "-o", "json"))
    assert {name: one["passed"] for name, one in found.items()} == {
        "anna": True,
        **dict.fromkeys(AFTER_THE_CHECK, False),
    }
    assert all({row["result"] for row in one["checks"]} == {"ok"} for one in found.values())
    assert "MemoryError" in found["hog"]["why"]


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.skipif(not has_landlock(), reason="this kernel has no Landlock")
def test_a_pattern_cannot_write_a_file(tmp_path: Path, short: Lesson) -> None:
    stolen = tmp_path / "stolen"
    (tmp_path / "file.py").write_text(bold_until(f"open({str(stolen)!r}, 'w').write('x')"))
    assert not pupils(checked(tmp_path, "5", "-o", "json"))["file"]["passed"]
    assert not stolen.exists()


@pytest.mark.integration
@pytest.mark.long
def test_a_pattern_that_hangs_or_is_slow_ends_with_the_time(tmp_path: Path, short: Lesson) -> None:
    (tmp_path / "hang.py").write_text(bold_until("pass"))
    found = pupils(checked(tmp_path, "5", "--timeout", "4", "-o", "json"))
    assert not found["hang"]["passed"]
    assert re.search("no progress in 2 s|too slow: 0 of 1 runs", found["hang"]["why"])


@pytest.mark.integration
@pytest.mark.long
def test_the_table_has_the_targets_the_values_and_a_reason(tmp_path: Path, short: Lesson) -> None:
    (tmp_path / "anna.py").write_text(BOLD)
    (tmp_path / "ben.py").write_text(BOLD.replace("] = 0.2", "] = 0.01"))
    result = checked(tmp_path, "5")
    lines = result.stdout.splitlines()
    assert lines[:2] == ["A  min(path_length) >= 2", "B  max(arena_contacts) == 0"]
    assert lines[3].split() == ["PUPIL", "CHECKS", "A", "B", "VERDICT", "WHY"]
    (_, checks, value, _, verdict, why), ben = lines[4].split(), lines[5].split(maxsplit=5)
    assert (checks.split("/")[0], verdict, why) == (checks.split("/")[1], "passed", "-")
    assert float(value) >= 2.0
    assert ben[2].endswith("!")
    assert ben[4] == "failed"
    assert ben[5].startswith("min(path_length) is ")


@pytest.mark.integration
@pytest.mark.long
def test_handed_in_results_are_compared_with_the_targets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    targets = {"runs/first": ["robot_contacts == 0", "runs >= 2"]}
    monkeypatch.setattr(lessons, "load_lessons", lambda: {"1": Lesson("First", targets)})
    simulate("drive", seeds=2, set={"duration": 2}, out=tmp_path / "anna/runs/first")
    shutil.copytree(tmp_path / "anna", tmp_path / "ben")
    (tmp_path / "ben/runs/first/manifest.json").write_text("{")
    (tmp_path / "cem").mkdir()
    result = checked(tmp_path, "1", "-o", "json")
    assert {name: one["passed"] for name, one in pupils(result).items()} == {
        "anna": True,
        "ben": False,
        "cem": False,
    }
    assert result.exit_code == 1


def test_only_a_target_that_an_interval_excludes_is_missed(
    tmp_path: Path, duo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Five of five runs reach down to 0.566, and none of five up to 0.434 (Wilson)."""
    targets = {"runs/first": ["one_cluster_at_end >= 0.8"]}
    monkeypatch.setattr(lessons, "load_lessons", lambda: {"1": Lesson("First", targets)})
    plan = plan_of(str(duo), range(5))
    for pupil, value in (("anna", 1.0), ("ben", 0.0)):
        folder = tmp_path / "class" / pupil / "runs/first"
        manifest = manifest_of(plan, traces=False, command=[])
        with open_store(folder, manifest, ("one_cluster_at_end",)) as store:
            for run in plan.runs:
                store.add(run, {"one_cluster_at_end": value}, 0.1)
    anna, ben = checked(tmp_path / "class", "1").stdout.splitlines()[-2:]
    assert anna.split()[2:4] == ["1?", "passed"]
    assert ben.split()[2:4] == ["0!", "failed"]


@pytest.mark.integration
@pytest.mark.long
def test_handed_in_results_run_no_code(tmp_path: Path) -> None:
    place = tmp_path / "eve/runs/first"
    (tmp_path / "evil.py").write_text(
        f"open({str(tmp_path / 'told')!r}, 'x')\ndef warm(trace): ...\n"
    )
    simulate("drive", seeds=1, set={"duration": 2}, out=place, traces=True)
    manifest = json.loads((place / "manifest.json").read_text())
    origin = f"{tmp_path / 'evil.py'}:warm"
    manifest["metrics"] = [
        {
            "name": "warm.py:warm",
            "unit": "",
            "better": None,
            "is_time_to_event": False,
            "origin": origin,
        }
    ]
    (place / "manifest.json").write_text(json.dumps(manifest))
    found = mark_results(Lesson("First", {"runs/first": ["warm.py:warm >= 0"]}), tmp_path / "eve")
    assert "have not measured warm.py:warm" in found.why
    assert not (tmp_path / "told").exists()


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.parametrize(("lesson", "name"), part([], [("2", "beeclust"), ("5", "bold")]))
def test_the_pattern_of_the_page_passes_its_lesson(tmp_path: Path, lesson: str, name: str) -> None:
    texts = {"bold": BOLD, "beeclust": (ROOT / "examples/beeclust.py").read_text()}
    (tmp_path / "anna.py").write_text(texts[name])
    result = checked(tmp_path, lesson, "-o", "json")
    assert pupils(result)["anna"]["why"] == ""
    assert result.exit_code == 0


@pytest.mark.parametrize(
    ("lesson", "what"), [("9", "lesson"), ("1", "no folder of a pupil"), ("2", "PUPIL.py")]
)
def test_a_wrong_lesson_and_an_empty_folder_are_refused(
    tmp_path: Path, lesson: str, what: str
) -> None:
    result = checked(tmp_path, lesson)
    assert result.exit_code != 0
    assert what in f"{result.output} {result.exception}"


@pytest.mark.parametrize(
    ("words", "lacking"), [([], "FOLDER"), (["--lesson", "2"], "FOLDER"), (["."], "--lesson")]
)
def test_what_is_missing_is_named_with_a_whole_command(words: list[str], lacking: str) -> None:
    result = CliRunner().invoke(classroom, ["check", *words])
    assert result.exit_code == 2
    assert f"{lacking}" in result.output.rpartition("Error: ")[2].partition(" is missing")[0]
    assert "swarmctl class check FOLDER --lesson 2" in " ".join(result.output.split())


def test_the_folder_of_one_pupil_is_refused(tmp_path: Path) -> None:
    (tmp_path / "beeclust.py").touch()
    result = checked(tmp_path, "2")
    assert result.exit_code == 2
    assert "one pupil" in result.output


def test_lessons_are_listed_with_what_is_handed_in() -> None:
    result = CliRunner().invoke(classroom, ["lessons", "-o", "json"])
    rows = json.loads(result.stdout)["lessons"]
    assert [row["lesson"] for row in rows] == list(load_lessons())
    assert rows[1]["hand_in"] == ["beeclust.py"]
    assert rows[3]["hand_in"] == ["runs/votes", "runs/range"]


def marks_until(stop: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The marks of pupils without runs; at the pupil `stop` somebody presses Ctrl-C."""

    def marked(path: Path, *_: object) -> classroom_module.Work:
        if path.stem == stop:
            raise KeyboardInterrupt
        return classroom_module.Work(path.stem, why=f"{path.stem} forgot a return")

    monkeypatch.setattr(classroom_module, "_marked", marked)
    monkeypatch.setattr(lessons, "plan_of_lesson", lambda lesson: None)


def test_each_pupil_has_a_row_when_it_is_done_also_if_the_rest_is_not(
    tmp_path: Path, short: Lesson, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("anna", "ben", "carla", "d" * 40)
    for name in names:
        (tmp_path / f"{name}.py").write_text(BOLD)
    marks_until("carla", monkeypatch)
    result = checked(tmp_path, "5")
    assert result.exit_code != 0
    head, *rows = result.stdout.splitlines()[3:]
    assert [row.split()[0] for row in rows] == ["anna", "ben"]
    # Columns are aligned, though the later rows are not known.
    assert {row.index("failed") for row in rows} == {head.index("VERDICT")}
    assert f"not done: carla, {'d' * 40}" in result.stderr


def test_json_of_an_interrupted_check_names_who_is_not_done(
    tmp_path: Path, short: Lesson, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("anna", "ben", "carla"):
        (tmp_path / f"{name}.py").write_text(BOLD)
    marks_until("ben", monkeypatch)
    result = checked(tmp_path, "5", "-o", "json")
    assert list(pupils(result)) == ["anna"]
    assert json.loads(result.stdout)["not_done"] == ["ben", "carla"]
    marks_until("", monkeypatch)
    assert json.loads(checked(tmp_path, "5", "-o", "json").stdout)["not_done"] == []
