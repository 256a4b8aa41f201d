"""The kept runs of a table: their file, the draw of a check, and what it tells of a change."""

from __future__ import annotations

import json
import shutil
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pytest

from studies.night import check, kept_runs
from studies.night.check import State, look_at
from studies.night.jobs import JOBS, PatternJob
from studies.night.kept_runs import (
    RULE_FILES,
    Found,
    KeptRun,
    Made,
    count_of_draw,
    drawn,
    listed,
    read_made,
    read_runs,
    rules_in,
    write,
)
from studies.night.sources import ROOT
from swarmd.core.errors import SwarmError
from swarmd.core.messages import Reason
from swarmd.sim import behaviour
from swarmd.sim.experiments.pool import Job, JobResult, run_jobs
from swarmd.sim.scenarios.scenariofile import load_scenario

BITS = "0123456789ab"
COMMIT = "5f" * 20


def a_run(seed: int, *rules: str, scenario: str = "drive") -> KeptRun:
    return KeptRun(scenario=scenario, set={"duration": 1.0}, seed=seed, bits=BITS, rules=rules)


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files of kept runs lie in a folder of the test."""
    monkeypatch.setattr(kept_runs, "ROOT", tmp_path)
    return tmp_path


# The file


def test_a_file_has_a_line_about_its_table_and_one_for_each_run(root: Path) -> None:
    made = Made(table="drive", command="python x", made_with={"commit": "0a", "day": "2026-11-29"})
    task = {"speed": float("inf")}
    other = KeptRun(run="studies.faults:perform", task=task, bits=BITS, rules=("barrier",))
    write(made, [other, a_run(10), a_run(9)])
    head, *lines = (root / "docs/evidence/runs/drive.jsonl").read_text().splitlines()
    assert json.loads(head)["made_with"] == {"commit": "0a", "day": "2026-11-29"}
    assert lines[0] == (
        '{"scenario": "drive", "set": {"duration": 1.0}, "seed": 9, "bits": "0123456789ab",'
        ' "rules": []}'
    )
    assert json.loads(lines[1])["seed"] == 10
    assert json.loads(lines[2])["task"] == task
    assert read_made("drive") == made
    assert read_runs("drive") == [a_run(9), a_run(10), other]
    assert read_made("dispersion") is None
    assert read_runs("dispersion") == []


def test_a_damaged_line_is_named(root: Path) -> None:
    write(Made(table="drive"), [a_run(0)])
    file = root / "docs/evidence/runs/drive.jsonl"
    for line in (b'{"scenario": "drive"}\n', b"{\n", b'{"bits": "0", "odd": 1}\n'):
        file.write_bytes(file.read_bytes().splitlines(keepends=True)[0] + line)
        with pytest.raises(SwarmError, match=r"drive\.jsonl:2: "):
            read_runs("drive")


def test_a_run_that_is_listed_twice_counts_once_and_a_torn_line_not_at_all(tmp_path: Path) -> None:
    lines = [json.dumps({**one.how, "bits": one.bits}) for one in (a_run(0), a_run(1), a_run(0))]
    file = tmp_path / "listed"
    file.write_text("\n".join(lines) + '\n{"scenario": "dri')
    assert [run.seed for run in listed(file)] == [0, 1]
    assert listed(tmp_path / "none") == []


def test_a_listed_path_in_this_checkout_becomes_relative(tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    # The root of these tests is tmp_path.
    run = {"scenario": "s", "set": {"plugin_dir": f"{tmp_path}/studies"}, "seed": 0, "bits": BITS}
    file.write_text(json.dumps(run) + "\n")
    assert [one.set for one in listed(file)] == [{"plugin_dir": "studies"}]


# The draw


@pytest.mark.parametrize(
    ("runs", "count"), [(0, 0), (2, 2), (3, 3), (20, 3), (60, 3), (61, 4), (600, 30), (601, 31)]
)
def test_five_in_a_hundred_are_drawn_and_at_least_three(runs: int, count: int) -> None:
    assert count_of_draw(runs) == count
    assert len(drawn("t", [a_run(seed) for seed in range(runs)], COMMIT, frozenset())) == count


def test_another_commit_draws_others_and_the_same_one_the_same() -> None:
    runs = [a_run(seed) for seed in range(200)]
    first = drawn("t", runs, COMMIT, frozenset())
    assert drawn("t", [*reversed(runs)], COMMIT, frozenset()) == first
    assert len({run.seed for run in first}) == 10
    seen = {run.seed for n in range(60) for run in drawn("t", runs, f"{n:040x}", frozenset())}
    # 600 draws of 200 runs: each is missed by all of them with 0.95 ** 60.
    assert len(seen) > 0.9 * 200


def test_half_of_a_draw_is_of_runs_in_which_rules_of_the_changed_files_acted() -> None:
    runs = [a_run(seed, *["recovery"] * (seed >= 190)) for seed in range(200)]
    draw = drawn("t", runs, COMMIT, frozenset({"recovery", "fence"}))
    assert len(draw) == len({run.seed for run in draw}) == 10
    assert sum(run.seed >= 190 for run in draw) >= 5
    few = [a_run(seed, *["recovery"] * (seed == 7)) for seed in range(60)]
    assert a_run(7, "recovery") in drawn("t", few, COMMIT, frozenset({"recovery"}))


def test_the_files_of_rules_exist_and_the_names_are_those_of_runs() -> None:
    constants = {text for name, text in vars(behaviour).items() if name.isupper()}
    modes = {"barrier", "potential_field"}
    assert RULE_FILES.keys() <= {*constants, *modes, *map(str, Reason)}
    missing = [
        name for files in RULE_FILES.values() for name in files if not (ROOT / name).exists()
    ]
    assert missing == []


@pytest.mark.parametrize(
    ("name", "rules"),
    [
        ("swarmd/robot/steering/recovery.py", {"recovery"}),
        ("swarmd/robot/protection/fence/fence.py", {"barrier", "protection", "fence", "no_pose"}),
        ("patterns/drive/pattern.py", set()),
    ],
)
def test_a_changed_file_has_rules(name: str, rules: set[str]) -> None:
    assert rules_in([name]) == rules


# What is known of a table

AT = Found(commit="c1", day="2026-11-30", digest="now", drawn=3, runs=20)


@dataclass(frozen=True)
class Table:
    """A job whose sources have the digest `now`."""

    made: Made | None
    name: str = "drive"
    digest: str = "now"
    sources: tuple[Path, ...] = ()

    def lacks(self) -> str:
        return ""


def made(digest: str = "then", **more: object) -> Made:
    known = Made(table="drive", made_with={"digest": digest, "commit": "c0", "day": "2026-11-29"})
    return msgspec.structs.replace(known, **more)


@pytest.mark.parametrize(
    ("about", "state"),
    [
        (None, State.NEVER_MADE),
        (made("now"), State.SAME_SOURCES),
        (made(current=AT), State.CHECKED),
        (made(current=msgspec.structs.replace(AT, digest="then")), State.OPEN),
        (made(changed=AT), State.CHANGED),
        (made(changed=msgspec.structs.replace(AT, digest="then")), State.OPEN),
        (made(is_same=False), State.CHANGED),
        (made(is_same=False, current=AT), State.CHANGED),
    ],
)
def test_what_is_known_without_a_run(
    about: Made | None, state: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check, "changed_since", lambda commit, paths: ["swarmd/robot/robot.py"])
    if about is not None:
        write(about, [a_run(0)])
    assert look_at(Table(about)).state is state  # type: ignore[arg-type]  # has what is asked


@pytest.mark.parametrize(
    ("names", "runs", "state"),
    [
        (["swarmd/robot/robot.py"], 1, State.OPEN),
        (["swarmd/robot/robot.py"], 0, State.NO_RUNS),
        (["studies/faults.py"], 1, State.OTHER_FORMULAS),
        (["sim/metrics/gap.py", "swarmd/robot/robot.py"], 1, State.OTHER_FORMULAS),
        (["patterns/drive/outcomes.yaml"], 1, State.OTHER_FORMULAS),
        (["patterns/drive/pattern.py"], 1, State.OPEN),
        (["studies/keeper.py", "studies/point_swarm.py"], 1, State.OPEN),
        (["sim/experiments/benchmark.py"], 1, State.OTHER_FORMULAS),
        (["sim/experiments/compare.py"], 1, State.OTHER_FORMULAS),
        (["sim/experiments/tune.py"], 1, State.OTHER_FORMULAS),
        (None, 1, State.UNKNOWN),
    ],
)
def test_bits_say_nothing_of_formulas(
    names: list[str] | None, runs: int, state: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check, "changed_since", lambda commit, paths: names)
    write(made(), [a_run(seed) for seed in range(runs)])
    assert look_at(Table(made())).state is state  # type: ignore[arg-type]  # has what is asked


def test_of_files_of_no_commit_nobody_knows_the_formulas(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check, "changed_since", lambda commit, paths: [])
    about = made(made_with={"digest": "then", "commit": "c0, with changes", "day": "2026-11-29"})
    write(about, [a_run(0)])
    assert look_at(Table(about)).state is State.UNKNOWN  # type: ignore[arg-type]  # has what is asked


# A check


class Checks:
    """The runs of a check by hand.

    - `asked`: the folder and the seeds of each call.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **other: str) -> None:
        """`other`: the bits that a folder gives, by its name; the kept ones without."""
        self.asked: list[tuple[str, list[int]]] = []
        self.there = ""
        self._other = other
        monkeypatch.setattr(check, "changed_since", lambda commit, paths: ["swarmd/robot/x.py"])
        monkeypatch.setattr(check, "head", lambda: COMMIT)
        monkeypatch.setattr(check, "commit_of", lambda paths: COMMIT[:10])
        monkeypatch.setattr(check, "software", dict)
        monkeypatch.setattr(check, "other_machine", lambda there, here: self.there or None)
        monkeypatch.setattr(check, "built", lambda commit: Path("/builds") / commit)
        monkeypatch.setattr(check, "done_again", self._done)
        monkeypatch.setattr(check, "tell_pages", lambda job, made: None)

    def _done(self, folder: Path, runs: list[KeptRun]) -> list[dict[str, str]]:
        name = "here" if folder == ROOT else folder.name
        self.asked.append((name, [run.seed for run in runs]))
        return [{"bits": self._other.get(name, run.bits)} for run in runs]


def checked(*, is_again: bool = False) -> State:
    return check.check(Table(read_made("drive")), is_again=is_again).state  # type: ignore[arg-type]  # has what is asked


def test_a_draw_with_equal_bits_makes_a_table_current(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [a_run(seed) for seed in range(20)]
    write(made(), runs)
    does = Checks(monkeypatch)
    assert checked() is State.CHECKED
    seeds = [run.seed for run in drawn("drive", runs, COMMIT, frozenset())]
    assert does.asked == [("here", seeds)]
    kept = read_made("drive")
    assert kept is not None
    assert kept.current is not None
    assert (kept.current.commit, kept.current.digest) == (COMMIT[:10], "now")
    assert (kept.current.drawn, kept.current.runs) == (3, 20)
    assert kept.changed is None
    assert checked() is State.CHECKED
    assert len(does.asked) == 1  # these sources are known


def test_other_bits_make_a_table_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    write(made(current=msgspec.structs.replace(AT, digest="then")), [a_run(0), a_run(1)])
    Checks(monkeypatch, here="another")
    assert checked() is State.CHANGED
    kept = read_made("drive")
    assert kept is not None
    assert kept.current is None
    assert kept.changed is not None
    assert (kept.changed.differing, kept.changed.drawn, kept.changed.runs) == (2, 2, 2)
    assert kept.origin.endswith("2 of 2 of 2 runs done again differ.")


def test_runs_of_another_table_make_none_current(monkeypatch: pytest.MonkeyPatch) -> None:
    write(made(is_same=False), [a_run(0)])
    does = Checks(monkeypatch)
    assert checked() is State.CHANGED
    assert checked(is_again=True) is State.CHANGED
    assert does.asked == []


def test_known_sources_are_checked_again_on_demand(monkeypatch: pytest.MonkeyPatch) -> None:
    write(made("now"), [a_run(0)])
    does = Checks(monkeypatch)
    assert checked() is State.SAME_SOURCES
    assert does.asked == []
    assert checked(is_again=True) is State.CHECKED
    assert does.asked == [("here", [0])]


def test_on_other_libraries_both_sides_are_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    write(made(), [a_run(0)])
    does = Checks(monkeypatch, here="of these", c0="of these")
    does.there = "numpy: 2.4.6, here 2.5.0"
    assert checked() is State.CHECKED
    assert [name for name, _ in does.asked] == ["c0", "here"]
    assert does.asked[0][1] == does.asked[1][1]


def test_a_commit_with_changes_cannot_be_built(monkeypatch: pytest.MonkeyPatch) -> None:
    known = made(made_with={"digest": "now", "commit": "c0, with changes", "day": "2026-11-29"})
    write(known, [a_run(0)])
    Checks(monkeypatch).there = "numpy: 2.4.6, here 2.5.0"
    with pytest.raises(SwarmError, match="ARGS=drive"):
        checked(is_again=True)


# A change of one gain


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout of links to this one, but for the patterns, which are copied."""
    folder = tmp_path / "checkout"
    (folder / "swarmd").mkdir(parents=True)
    for path in (ROOT / "swarmd").iterdir():
        if path.name not in ("patterns", "__pycache__"):
            (folder / "swarmd" / path.name).symlink_to(path.resolve())
    left_out = shutil.ignore_patterns("__pycache__", "*.json", "*.md", "*.png", "*.gif", "*.svg")
    shutil.copytree(ROOT / "patterns", folder / "patterns", ignore=left_out)
    (folder / "swarmd" / "patterns").symlink_to(folder / "patterns")
    return folder


def replaced(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


@pytest.mark.integration
def test_a_gain_changes_the_runs_of_its_pattern_and_a_refactor_none(checkout: Path) -> None:
    runs = [
        KeptRun(scenario=name, set={"duration": 1.0}, seed=seed, bits="")
        for name in ("flocking", "dispersion")
        for seed in range(2)
    ]
    jobs = [
        Job(str(number), load_scenario(str(run.scenario), run.set).effective, run.seed, None)
        for number, run in enumerate(runs)
    ]
    with closing(run_jobs(jobs, 1)) as reports:
        results = {one.run: one for one in reports if isinstance(one, JobResult)}
    before = [{"bits": results[job.run].bits} for job in jobs]
    assert len({answer["bits"] for answer in before}) == 4
    gain = "_COMPRESSED_STIFFNESS = 2.0"
    replaced(checkout / "patterns/flocking/pattern.py", gain, "_COMPRESSED_STIFFNESS = 2.1")
    dispersion = checkout / "patterns/dispersion/pattern.py"
    replaced(dispersion, "_STOP_PUSH", "_PUSH_OF_REST")
    replaced(dispersion, "_PUSH_OF_REST = 0.12", "_PUSH_OF_REST = 0.12  # of a robot that moves")
    after = check.done_again(checkout, runs, processes=1)
    is_same = [was == now for was, now in zip(before, after, strict=True)]
    assert is_same == [False, False, True, True]


@pytest.mark.parametrize(
    "job", [job for job in JOBS if isinstance(job, PatternJob)], ids=lambda job: job.name
)
def test_the_page_of_a_pattern_says_what_checks_have_found(
    job: PatternJob, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_runs, "ROOT", ROOT)
    about = job.made
    assert about is not None
    found = about.checked or check.NOT_CHECKED
    part = f"<!-- results: check_{job.name} -->\n\n{found}\n\n<!-- end of results -->"
    assert part in (ROOT / "patterns" / job.name / "page.md").read_text()
