"""A user's own outcomes beside her own pattern, by `exp run` and `exp check`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from swarmd.sim.experiments.results import load_results
from tests.sim.conftest import MOODY, swarmctl_in

SCENARIO = """\
description: Two Burgers drive.
duration: 2
realism: ideal
plugin_dir: ..
arena: {size: [5, 5]}
groups:
  all: {platform: burger, count: 2, prefix: r, pattern: moody, start: {layout: random}}
"""
METRICS = """\
from swarmd.sim.metrics.kinematics import path_length
from swarmd.sim.metrics.own import metric


@metric(unit="m", better="more")
def way(trace):
    '''The mean path.'''
    return path_length(trace)
"""
# Two seconds at 0.1 m/s are at most 0.2 m; robots at half the speed have half of the way.
OUTCOMES = """\
scenario: scenario.yaml
seeds: 2
runs:
  own: {}
  slow: {set: {groups.all.parameters.speed: 0.05}}
outcomes:
  - what: way [m]
    runs: own
    requirement: min(metrics.py:way) >= 0.1
    source: "ours: it moves"
  - what: way / of slow ones
    runs: own
    requirement: min(metrics.py:way) >= 1.5
    over: slow
    source: "ours: it obeys its speed"
  - what: contacts
    runs: own
    requirement: max(robot_contacts+arena_contacts) <= 0
    source: docs/safety.md
"""


def mine(folder: Path) -> Path:
    """A plugin folder with a pattern, its scenario, its metrics and its outcomes."""
    place = folder / "plugins" / "moody"
    place.mkdir(parents=True)
    (place / "pattern.py").write_text(MOODY)
    (place / "scenario.yaml").write_text(SCENARIO)
    (place / "metrics.py").write_text(METRICS)
    (place / "outcomes.yaml").write_text(OUTCOMES)
    return place / "outcomes.yaml"


@pytest.mark.integration
def test_outcomes_of_ones_own_are_run_and_judged(tmp_path: Path) -> None:
    file = mine(tmp_path)
    swarmctl = swarmctl_in(tmp_path)
    done = swarmctl("exp", "run", file, "--out", "made", "-j", 1, "--no-traces", "-o", "json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert [one["verdict"] for one in told["requirements"]] == ["met", "met", "met"]
    own = load_results(tmp_path / "made" / "own")
    assert list(own.metric("metrics.py:way")) == pytest.approx([0.2, 0.2], abs=0.05)
    # The folder alone, in which the file is copied, is judged again.
    shutil.rmtree(tmp_path / "plugins")
    checked = swarmctl("exp", "check", "made", "-o", "json")
    assert checked.returncode == 0, checked.stderr
    again = json.loads(checked.stdout)
    assert again["requirements"] == told["requirements"]
    assert again["requirements"][0]["what"] == "way [m]"
    # A bound that is not met, and runs that are missing.
    copy = tmp_path / "made" / "outcomes.yaml"
    copy.write_text(OUTCOMES.replace(">= 0.1", ">= 0.5"))
    missed = swarmctl("exp", "check", "made")
    assert missed.returncode == 1
    assert "not met" in missed.stdout
    copy.write_text(OUTCOMES.replace("metrics.py:way", "metrics.py:other"))
    (tmp_path / "metrics.py").write_text("raise SystemExit(3)")  # no code of the file is imported
    unknown = swarmctl("exp", "check", "made")
    assert unknown.returncode == 2
    assert "metrics.py:other" in unknown.stderr
    copy.write_text(OUTCOMES)
    shutil.rmtree(tmp_path / "made" / "slow")
    partial = swarmctl("exp", "check", "made")
    assert partial.returncode == 1
    assert "slow: no run" in partial.stderr


@pytest.mark.parametrize(
    ("change", "words", "wanted"),
    [
        (("min(metrics.py:way) >= 0.1", "min(metrics.py:wy) >= 0.1"), (), "'way'"),
        (("min(metrics.py:way) >= 0.1", "min(path_lenth) >= 0.1"), (), "'path_length'"),
        (("scenario.yaml", "scenari.yaml"), (), "scenari.yaml"),
        (("all.parameters.speed", "all.parameters.sped"), (), "'speed'"),
        (('    source: "ours: it moves"\n', ""), (), "source is missing"),
        (("  own: {}", "  own: {}\n  own: {}"), (), "line"),
        (("", ""), ("--set", "duration=1"), "--set does not go with"),
        (("", ""), ("--sweep", "duration=1,2"), "--sweep does not go with"),
        (("", ""), ("--pattern", "drive"), "--pattern does not go with"),
        (("", ""), ("--metrics", "path_length"), "--metrics does not go with"),
        (("", ""), ("--seeds", "x"), "--seeds"),
    ],
)
def test_what_is_wrong_is_one_line_and_nothing_runs(
    change: tuple[str, str], words: tuple[str, ...], wanted: str, tmp_path: Path
) -> None:
    file = mine(tmp_path)
    file.write_text(file.read_text().replace(*change) if change[0] else file.read_text())
    done = swarmctl_in(tmp_path)("exp", "run", file, "--out", "made", *words)
    assert done.returncode == 2
    assert done.stdout == ""
    assert wanted in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("plugins/moody/outcomes.yaml",), "expected the folder"),
        (("empty",), "no requirement"),
        (("with_rows", "path_length >= 1"), "leave out 'path_length >= 1'"),
    ],
)
def test_check_says_what_it_wants(words: tuple[str, ...], wanted: str, tmp_path: Path) -> None:
    file = mine(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "with_rows").mkdir()
    shutil.copy(file, tmp_path / "with_rows")
    done = swarmctl_in(tmp_path)("exp", "check", *words)
    assert done.returncode == 2
    assert wanted in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_folder_of_another_experiment_stays_as_it_is(tmp_path: Path) -> None:
    file = mine(tmp_path)
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "manifest.json").write_text("{}")
    done = swarmctl_in(tmp_path)("exp", "run", file, "--out", "made")
    assert done.returncode == 2
    assert "holds another experiment" in done.stderr
    assert sorted(path.name for path in (tmp_path / "made").iterdir()) == ["manifest.json"]


@pytest.mark.integration
def test_a_folder_of_other_runs_keeps_its_rows(tmp_path: Path) -> None:
    file = mine(tmp_path)
    file.write_text(OUTCOMES.replace("seeds: 2", "seeds: 1"))
    swarmctl = swarmctl_in(tmp_path)
    words = ("exp", "run", file, "--out", "made", "-j", 1, "--no-traces")
    done = swarmctl(*words)
    assert done.returncode == 0, done.stderr
    copy = (tmp_path / "made" / "outcomes.yaml").read_text()
    # Runs of another duration, with rows that the runs of before would meet.
    file.write_text(file.read_text().replace("own: {}", "own: {set: {duration: 1}}"))
    other = swarmctl(*words)
    assert other.returncode == 2
    assert "another experiment" in other.stderr
    assert (tmp_path / "made" / "outcomes.yaml").read_text() == copy


@pytest.mark.integration
def test_a_file_in_utf_16_is_copied_as_it_is(tmp_path: Path) -> None:
    file = mine(tmp_path)
    file.write_bytes(OUTCOMES.replace("seeds: 2", "seeds: 1").encode("utf-16"))
    swarmctl = swarmctl_in(tmp_path)
    done = swarmctl("exp", "run", file, "--out", "made", "-j", 1, "--no-traces")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "made" / "outcomes.yaml").read_bytes() == file.read_bytes()
    assert swarmctl("exp", "check", "made").returncode == 0
