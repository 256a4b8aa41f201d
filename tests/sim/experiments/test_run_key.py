"""The key of a run has all that its result follows from, and nothing else."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import swarmd
from swarmd.plugins import Origin, pattern_folders
from swarmd.sim.experiments import provenance, run_key
from swarmd.sim.experiments.pool import Job
from swarmd.sim.experiments.provenance import NOT_IN_RUNS, OF_EXPERIMENTS, digest_of_code
from swarmd.sim.experiments.run_key import RunKeys
from tests.support.shape import import_closure

PACKAGE = Path(swarmd.__file__).parent
MADE = {
    "swarmd": "0.2.0",
    "numpy": "2.4.0",
    "mujoco": "3.4.0",
    "pinned": "yes",
    "processor": "A",
    "code": digest_of_code(PACKAGE),
}
SWIRL = "from swarmd.api import Inputs\nTURN = 1.0\n"
METRIC = "def far(trace): return 1.0\n"
LEFT = {"platform": "burger", "count": 2, "pattern": "swirl"}
RIGHT = {"platform": "waffle_pi", "count": 1, "pattern": "dispersion"}


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A folder with a plugin."""
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "swirl.py").write_text(SWIRL)
    return folder


@pytest.fixture
def job(mine: Path, tmp_path: Path) -> Job:
    metric = tmp_path / "far.py"
    metric.write_text(METRIC)
    effective = {
        "name": "duo",
        "duration": 2.0,
        "groups": {"left": LEFT, "right": RIGHT},
        "plugin_dir": str(mine),
    }
    metrics = {f"{metric}:far": run_key._digest_of_file(str(metric)), "report:turn": ""}
    return Job("s0000", effective, 3, tmp_path / "s0000.npz", metrics=metrics)


def key(job: Job, **made: str) -> str:
    found = RunKeys({**MADE, **made}).key(job)
    assert found.reason == ""
    return found.text


def reason(job: Job) -> str:
    found = RunKeys(MADE).key(job)
    assert found.text == ""
    return found.reason


def scenario(job: Job, **changes: Any) -> Job:
    return replace(job, effective={**job.effective, **changes})


def test_equal_runs_have_one_key(job: Job) -> None:
    first = key(job)
    assert len(first) == 64
    assert int(first, 16) >= 0
    assert key(replace(job, run="s0009", trace=None, cores=2, timeout=5.0)) == first


CHANGES: dict[str, Callable[[Job], Job]] = {
    "seed": lambda job: replace(job, seed=4),
    "simulated time": lambda job: replace(job, seconds=1.0),
    "a value": lambda job: scenario(job, duration=2.5),
    "the kind of a value": lambda job: scenario(job, duration=2),
    "the name, which the trace has": lambda job: scenario(job, name="trio"),
    # Layouts such as row place robots in the order of the file.
    "the order of groups": lambda job: scenario(job, groups={"right": RIGHT, "left": LEFT}),
    "no metrics": lambda job: replace(job, metrics={}),
    "the order of metrics": lambda job: replace(
        job, metrics=dict(reversed(list(job.metrics.items())))
    ),
    "the code of a metric": lambda job: replace(
        job, metrics={origin: digest and "f" * 64 for origin, digest in job.metrics.items()}
    ),
    "confined": lambda job: replace(job, guest=Path(job.effective["plugin_dir"])),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_another_run_has_another_key(job: Job, change: Callable[[Job], Job]) -> None:
    assert key(change(job)) != key(job)


@pytest.mark.parametrize("name", [*MADE, "libc"])
def test_other_software_gives_another_key(job: Job, name: str) -> None:
    if name != "pinned":
        assert key(job, **{name: "other"}) != key(job)
    assert RunKeys({**MADE, "pinned": "no"}).key(job).text == ""


def test_other_kernels_give_another_key(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    first = key(job)
    monkeypatch.setattr(run_key, "digest_of_kernels", lambda folder: "0")
    assert key(job) != first


def test_variables_that_act_at_the_start_give_another_key(
    job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = key(job)
    monkeypatch.setenv("SWARMD_RUN_STORE", "/elsewhere")
    monkeypatch.setenv("SWARMD_RUN_STORE_GB", "1")
    monkeypatch.setenv("EDITOR", "vi")
    assert key(job) == first
    monkeypatch.setenv("NPY_DISABLE_CPU_FEATURES", "X86_V4")
    assert key(job) != first


def test_a_byte_of_any_file_of_the_folder_gives_another_key(job: Job, mine: Path) -> None:
    keys = [key(job)]
    (mine / "swirl.py").write_text(SWIRL.replace("1.0", "1.1"))
    keys.append(key(job))
    (mine / "weights.txt").write_text("1")
    keys.append(key(job))
    (mine / "weights.txt").write_text("2")
    keys.append(key(job))
    (mine / "parts").mkdir()
    (mine / "weights.txt").rename(mine / "parts" / "weights.txt")
    keys.append(key(job))
    assert len(set(keys)) == 5


def test_what_is_no_part_of_the_plugins_keeps_the_key(job: Job, mine: Path, tmp_path: Path) -> None:
    first = key(job)
    for folder in ("__pycache__", ".git", "runs/gather", "runs/tuned"):
        (mine / folder).mkdir(parents=True)
        (mine / folder / "x.bin").write_bytes(b"1")
    (mine / "__pycache__" / "swirl.pyc").write_bytes(b"1")
    (mine / "runs" / "gather" / "manifest.json").write_text("{}")
    (mine / "runs" / "tuned" / "tune.json").write_text("{}")
    (tmp_path / "notes.txt").write_text("beside the folder")
    assert key(job) == first


@pytest.mark.parametrize("result", ["manifest.json", "tune.json"])
@pytest.mark.parametrize(
    "name", ["swirl.py", "twirl/pattern.py", "twirl/runs/part.py", "trip.yaml"]
)
def test_code_beside_results_is_part_of_the_key(
    job: Job, mine: Path, result: str, name: str
) -> None:
    """Such as of `exp run --out .`, or of a pupil who hands in a folder with both."""
    file = mine / name
    file.parent.mkdir(parents=True, exist_ok=True)
    for folder in {mine, file.parent}:
        (folder / result).write_text("{}")
    (mine / "traces").mkdir()
    file.write_text(SWIRL)
    first = key(job)
    file.write_text(SWIRL.replace("1.0", "2.0"))
    assert key(job) != first
    file.write_text(SWIRL)
    (mine / "traces" / "s0000.npz").write_bytes(b"1")
    assert key(job) == first


def test_the_key_does_not_know_where_files_lie(job: Job, mine: Path, tmp_path: Path) -> None:
    other = tmp_path / "copy" / "of_mine"
    shutil.copytree(mine, other)
    metric = tmp_path / "copy" / "far.py"
    metric.write_text(METRIC)
    digest, *others = job.metrics.values()
    moved = replace(
        scenario(job, plugin_dir=str(other)), metrics={f"{metric}:far": digest, "report:turn": ""}
    )
    assert others == [""]
    assert key(moved) == key(job)


def test_without_plugins_there_is_a_key(job: Job) -> None:
    groups = {"right": RIGHT}
    plain = replace(scenario(job, groups=groups, plugin_dir=None), metrics={})
    assert key(plain) != key(job)


def compiled(mine: Path) -> str:
    (mine / "swirl.abi3.so").write_bytes(b"\x7fELF")
    return "swirl.abi3.so"


def bytecode(mine: Path) -> str:
    (mine / "helper.pyc").write_bytes(b"1")
    return "helper.pyc"


def reads(mine: Path) -> str:
    (mine / "swirl.py").write_text("x = open('weights.txt')\n")
    return "swirl.py:1"


def makes_one_that_reads(mine: Path) -> str:
    (mine / "swirl.py").write_text("OTHER = 'whirl'\n")
    (mine / "whirl.py").write_text("import os\n")
    return "whirl.py:1"


def mission(mine: Path) -> str:
    (mine / "swirl.py").rename(mine / "whirl.py")
    (mine / "whirl.py").write_text("import os\n")
    (mine / "swirl.yaml").write_text("mission: two parts\n")
    return "whirl.py:1"


def pipe(mine: Path) -> str:
    os.mkfifo(mine / "pipe")
    return "pipe"


def many(mine: Path) -> str:
    for number in range(30):
        (mine / f"{number}.txt").touch()
    return "30 files"


def large(mine: Path) -> str:
    (mine / "large.bin").touch()
    os.truncate(mine / "large.bin", run_key.MAX_BYTES + 1)
    return "large.bin"


def link_to_nothing(mine: Path) -> str:
    (mine / "link").symlink_to("nowhere")
    return "link"


def link_out(mine: Path) -> str:
    """The modules beside the target are no files of the folder."""
    outside = mine.parent / "outside" / "swirl"
    outside.mkdir(parents=True)
    (mine / "swirl.py").rename(outside / "pattern.py")
    (mine / "swirl").mkdir()
    (mine / "swirl" / "pattern.py").symlink_to(outside / "pattern.py")
    return "swirl/pattern.py"


FAULTS = (link_out, compiled, bytecode, reads, makes_one_that_reads, mission, pipe, many, large)


@pytest.mark.parametrize("make", [*FAULTS, link_to_nothing])
def test_a_folder_of_which_more_may_matter_has_no_key(
    job: Job, mine: Path, make: Callable[[Path], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_key, "MAX_FILES", 30)
    assert make(mine) in reason(job)


def test_a_plugin_that_nothing_runs_may_read(job: Job, mine: Path) -> None:
    (mine / "other.py").write_text("import os\n")
    assert key(job)


def test_a_metric_that_reads_has_no_key(job: Job, tmp_path: Path) -> None:
    (tmp_path / "far.py").write_text("import os\n")
    assert "far.py:1" in reason(job)


def test_a_metric_of_another_package_has_no_key(job: Job) -> None:
    assert "warm" in reason(replace(job, metrics={"warm": "f" * 64}))


def test_a_pattern_of_another_package_has_no_key(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    origins = {"swirl": Origin("theirs.swirl:Swirl", "theirs 1.0")}
    monkeypatch.setattr(run_key, "pattern_names", lambda folder: origins)
    assert "theirs 1.0" in reason(job)


def test_a_picture_has_no_key(job: Job) -> None:
    floor = {"kind": "floor", "patches": [{"rectangle": [0, 0, 1, 1], "image": "/a/b.png"}]}
    assert "picture" in reason(scenario(job, fields=[floor]))


def test_a_file_that_the_scenario_names_has_no_key(job: Job) -> None:
    assert "tb9.yaml" in reason(scenario(job, platforms={"a": {"extends": "/a/tb9.yaml"}}))


def test_a_folder_that_is_missing_has_no_key(job: Job, tmp_path: Path) -> None:
    assert reason(scenario(job, plugin_dir=str(tmp_path / "none")))


def test_keys_hold_until_a_file_changes(job: Job, mine: Path, tmp_path: Path) -> None:
    keys = RunKeys(MADE)
    assert keys.key(job).text
    assert keys.still_hold()
    (mine / "swirl.py").write_text(SWIRL + "\n")
    assert not keys.still_hold()
    (mine / "swirl.py").write_text(SWIRL)
    assert keys.still_hold()
    (tmp_path / "far.py").write_text(METRIC + "\n")
    assert not keys.still_hold()
    (tmp_path / "far.py").unlink()
    assert not keys.still_hold()


def test_keys_of_code_that_has_changed_do_not_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also not those of code that has changed since this process began: a worker may be as old."""
    assert RunKeys(MADE).still_hold()
    assert not RunKeys({**MADE, "code": "other"}).still_hold()
    later = RunKeys({**MADE, "code": "new"})
    monkeypatch.setattr(run_key, "digest_of_code", lambda folder: "new")
    assert not later.still_hold()


def test_keys_made_after_a_change_of_the_code_do_not_hold(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`made_with`, which is asked before runs that are not stored, counts as the begin."""
    provenance.code_at_first.cache_clear()
    monkeypatch.setattr(provenance, "digest_of_code", lambda folder: "old")
    provenance.made_with({})
    monkeypatch.setattr(provenance, "digest_of_code", lambda folder: "new")
    monkeypatch.setattr(run_key, "digest_of_code", lambda folder: "new")
    keys = RunKeys({**MADE, "code": "new"})
    holds = keys.still_hold()
    provenance.code_at_first.cache_clear()
    assert not holds


def test_no_run_imports_what_the_key_leaves_out() -> None:
    """Within functions, too; `test_provenance.py` asks a process."""
    patterns = [f"swarmd.patterns.{name}.pattern" for name in pattern_folders()]
    known = set().union(*map(import_closure, ["swarmd.sim.experiments.pool", *patterns]))
    assert {"swarmd.sim.lockstep.lockstep", "swarmd.sim.metrics.catalog"} <= known
    assert not [name for name in known if NOT_IN_RUNS & set(name.split("."))]
    package = "swarmd.sim.experiments."
    of_experiments = {name.removeprefix(package) for name in known if name.startswith(package)}
    assert {f"{name}.py" for name in of_experiments} == OF_EXPERIMENTS - {"executor.py"}
    folders = {path.name for path in PACKAGE.rglob("*") if path.is_dir()}
    linked = {path.name for path in (PACKAGE / "sim").resolve().iterdir()}
    assert folders | linked >= NOT_IN_RUNS
