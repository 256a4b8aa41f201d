"""`swarmctl exp` as a user runs it: from a scenario to answers, and every way it can be ended."""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from swarmd.core.errors import ConfigError
from swarmd.settings.platforms import load_platform
from swarmd.sim.cli.exp import exp
from swarmd.sim.cli.options import new_folder
from swarmd.sim.experiments.results import load_results
from swarmd.sim.trace import TraceBuilder
from tests.sim.conftest import MAIN, Refusal, Swarmctl, swarmctl_in, write_duo
from tests.support.processes import children, wait_until

HEAVY = {"numpy", "mujoco", "matplotlib", "rich", "yaml", "swarmd.patterns"}
END = "groups.all.parameters.end"
RUNS = 12  # of about 0.1 s: enough for something to happen after the first and before the last


def rows(folder: Path) -> list[dict[str, str]]:
    """What runs.csv says, but for how long the runs took."""
    with (folder / "runs.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k != "wall"} for row in csv.DictReader(file)]


def traces(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / "traces").iterdir())}


def started(*words: object, cwd: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", MAIN, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        start_new_session=True,  # so that a signal can reach all, as from a terminal
    )


def finished(folder: Path) -> int:
    path = folder / "runs.csv"
    return max(path.read_bytes().count(b"\n") - 1, 0) if path.exists() else 0


@pytest.mark.integration
def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom swarmd.operator.cli.swarmctl import cli\n"
        "for words in (['exp', '--help'], ['exp', 'run', '--help']):\n"
        "    cli.main(words, standalone_mode=False)\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.count("Usage: ") == 2
    assert not set(done.stderr.split()) & HEAVY


ONE = "one_cluster_at_end >= 0.5"
SWEEP = ("--seeds", "3,1,7", "--sweep", "groups.all.parameters.speed=0.2,0.1")


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a sweep of six runs, which no test changes, and its output."""
    folder = tmp_path_factory.mktemp("swept")
    done = swarmctl_in(folder)("exp", "run", write_duo(folder), *SWEEP, "-j", 1)
    assert done.returncode == 0, done.stderr
    return folder / "experiments" / "duo-1", done.stderr


@pytest.fixture
def x(tmp_path: Path, swept: tuple[Path, str]) -> Path:
    """A copy of the sweep in the test's folder."""
    return shutil.copytree(swept[0], tmp_path / "x")


@pytest.mark.integration
@pytest.mark.long
def test_a_sweep_leaves_rows_traces_a_summary_and_a_manifest(swept: tuple[Path, str]) -> None:
    folder, told = swept
    assert "results: experiments/duo-1/" in told
    names = [f"speed={speed}_s000{seed}" for speed in ("0.2", "0.1") for seed in (3, 1, 7)]
    assert [row["run"] for row in rows(folder)] == names
    speeds = [row["groups.all.parameters.speed"] for row in rows(folder)]
    assert speeds == ["0.2"] * 3 + ["0.1"] * 3
    assert sorted(traces(folder)) == sorted(f"{name}.npz" for name in names)
    summary = json.loads((folder / "summary.json").read_text())
    assert [variant["metrics"]["path_length"]["n"] for variant in summary["variants"]] == [3, 3]
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["command"][:3] == ["swarmctl", "exp", "run"]
    assert not (folder / "failures.json").exists()


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.long
@pytest.mark.parametrize("what", ["traces", ".", "runs.csv"])
def test_removed_results_are_one_line_and_the_command_works_again(
    tmp_path: Path, duo: Path, swarmctl: Swarmctl, what: str
) -> None:
    command = ("exp", "run", duo, "--seeds", RUNS, "--out", "x")
    process = started(*command, cwd=tmp_path)
    wait_until(lambda: finished(tmp_path / "x") > 0, "a run is finished")
    gone = tmp_path / "x" / what
    gone.rename(tmp_path / "away")
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1, errors
    assert "error: x" in errors
    assert what != "." or not gone.exists()
    (tmp_path / "away").rename(gone)
    done = swarmctl(*command)
    assert (done.returncode, len(rows(tmp_path / "x"))) == (0, RUNS), done.stderr
    assert len(traces(tmp_path / "x")) == RUNS


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.long
def test_a_hanging_run_fails_and_the_others_go_on(
    tmp_path: Path, duo: Path, swarmctl: Swarmctl
) -> None:
    sweep = f"{END}=hang,none"
    done = swarmctl("exp", "run", duo, "--seeds", 1, "--sweep", sweep, "--timeout", 3, "--out", "x")
    assert done.returncode == 3
    assert [row["run"] for row in rows(tmp_path / "x")] == ["end=none_s0000"]
    for one in (done, swarmctl("exp", "show", "x")):
        assert "1 of 2 runs, 1 failed" in one.stdout
        assert "failed: end=hang_s0000: no progress in 3 s" in one.stderr
        assert "only 1 run" in one.stderr


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.long
def test_a_rerun_with_another_hash_seed_finds_the_run_that_differs(
    tmp_path: Path, x: Path, swept: tuple[Path, str], swarmctl: Swarmctl
) -> None:
    shutil.copy(x / "traces/speed=0.2_s0001.npz", x / "traces/speed=0.2_s0007.npz")
    manifest = json.loads((x / "manifest.json").read_text())
    manifest["made_with"]["kernels"] = "of another kind"
    (x / "manifest.json").write_text(json.dumps(manifest))
    words = ("exp", "rerun", x, "--out", "b", "-j", 1, "-o", "json")
    done = swarmctl(*words, PYTHONHASHSEED="2")
    assert done.returncode == 3, done.stderr
    assert "5 of 6 runs identical" in done.stderr
    assert "warning: kernels was of another kind, now " in done.stderr
    assert traces(tmp_path / "b") == traces(swept[0])
    found = {run["run"]: run["identical"] for run in json.loads(done.stdout)["runs"]}
    assert len(found) == 6
    assert [run for run, is_identical in found.items() if not is_identical] == ["speed=0.2_s0007"]


PROGRESS = r"[0-9]+ of [0-9]+ runs(, [0-9]+ failed)?(, about [0-9.]+ (s|min|h) left)?"


def first_words(done: subprocess.CompletedProcess[str]) -> str:
    """The first line on stderr that is not about the progress, which a slow machine estimates."""
    lines = done.stderr.splitlines()
    return next(line for line in lines if not re.fullmatch(PROGRESS, line))


LATER = "if inputs.now > 1.2 and 1 / self.params.speed:"


@pytest.mark.integration
@pytest.mark.long
def test_a_pattern_that_raises_is_told_first_with_its_line(
    tmp_path: Path, duo: Path, swarmctl: Swarmctl
) -> None:
    moody = duo.parent / "plugins" / "moody.py"
    moody.write_text(moody.read_text().replace("if inputs.now > 0.5:", LATER))
    line = moody.read_text()[: moody.read_text().index(LATER)].count("\n") + 1
    fault = f"ZeroDivisionError: float division by zero (moody.py:{line}), of r-"
    words = ("exp", "run", duo, "--no-traces", "--out", "x", "-j", 1)
    done = swarmctl(*words, "--seeds", 1, "--sweep", "groups.all.parameters.speed=0.1,0")
    assert done.returncode == 3, done.stderr
    assert first_words(done).startswith(fault)
    assert "speed=0_s0000" in first_words(done)
    [entry] = json.loads((tmp_path / "x" / "failures.json").read_text())["metrics"]
    assert (entry["run"], entry["metric"]) == ("speed=0_s0000", "failed_patterns")
    assert entry["reason"].startswith(fault)
    assert len(load_results(tmp_path / "x").rows) == 2  # what the robots did is kept


@pytest.mark.integration
@pytest.mark.long
def test_a_pattern_that_raises_in_the_first_second_begins_no_run(
    tmp_path: Path, duo: Path, swarmctl: Swarmctl
) -> None:
    moody = duo.parent / "plugins" / "moody.py"
    moody.write_text(moody.read_text().replace("if inputs.now > 0.5:", "if 1 / 0:"))
    words = ("exp", "run", duo, "--no-traces", "--out", "x", "-j", 1)
    done = swarmctl(*words, "--seeds", 2)
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("error: ZeroDivisionError: division by zero (moody.py:")
    assert not (tmp_path / "x").exists()
    alone = swarmctl(*words, "--seeds", 1, "--cores", 2)  # is its own trial
    assert alone.returncode == 1, alone.stderr
    fault = done.stderr.partition(" of run")[0].removeprefix("error: ")
    assert first_words(alone).startswith(f"{fault} of run s0000")


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.parametrize(
    "signals",
    [
        [(signal.SIGKILL, -9), (signal.SIGTERM, 143)],
        pytest.param([(signal.SIGINT, 130)], marks=pytest.mark.evidence),
    ],
)
def test_a_sweep_that_is_ended_keeps_finished_runs_and_leaves_no_worker(
    tmp_path: Path, duo: Path, swarmctl: Swarmctl, signals: list[tuple[signal.Signals, int]]
) -> None:
    folder, begin, end = tmp_path / "x", "", "2 of 4 runs kept; to go on: swarmctl exp run "
    words = ("exp", "run", duo, "--seeds", 2, "--sweep", f"{END}=none,hang", "--out", folder,
             "--metrics", "path_length")  # fmt: skip
    for number, code in signals:
        process = started(*words, "-j", 1, cwd=tmp_path)
        wait_until(lambda: finished(folder) == 2, "two runs are done")
        wait_until(lambda one=process: len(hanging_runs_of(one)) == 1, "one hangs")  # type: ignore[misc]
        running = [*children(process.pid), *hanging_runs_of(process)]
        os.killpg(process.pid, number)
        _, told = process.communicate(timeout=60)
        assert process.returncode == code
        wait_until(lambda pids=running: not any(map(is_there, pids)), "all are gone")  # type: ignore[misc]
        assert told.startswith(begin)
        assert (end in told) is (number is not signal.SIGKILL)
        assert "Traceback" not in told
        shown = json.loads(swarmctl("exp", "show", folder, "-o", "json").stdout)
        assert (shown["finished"], len(rows(folder))) == (2, 2)
        begin = "2 of 4 runs\n"
    assert f"--jobs 1 --out {folder} --metrics path_length\n" in told
    assert json.loads((folder / "summary.json").read_text())["finished"] == 2
    assert not list((folder / "traces").glob(".*"))
    assert not (folder / "failures.json").exists()


def hanging_runs_of(process: subprocess.Popen[str]) -> list[int]:
    """The processes that simulate, each a fork of a worker, after 0.5 s of CPU time."""
    runs = [run for worker in children(process.pid) for run in children(worker)]
    return [run for run in runs if ticks_of(run) > 50]


def ticks_of(pid: int) -> int:
    """The CPU time of a process in hundredths of a second, 0 if it has ended."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().split()[13])
    except OSError:
        return 0


def is_there(pid: int) -> bool:
    return Path(f"/proc/{pid}/exe").exists()


@pytest.mark.integration
@pytest.mark.long
def test_a_sweep_goes_on_where_it_was(x: Path, swept: tuple[Path, str], swarmctl: Swarmctl) -> None:
    duo = swept[0].parents[1] / "duo" / "duo.yaml"
    lines = (x / "runs.csv").read_text().splitlines(keepends=True)
    (x / "runs.csv").write_text("".join(lines[:4]) + lines[4][:9])  # ended while it wrote
    kept = {line.partition(",")[0] for line in lines[1:4]}
    for run in {path.stem for path in (x / "traces").iterdir()} - kept:
        (x / "traces" / f"{run}.npz").unlink()
    done = swarmctl("exp", "run", duo, *SWEEP, "-j", 1, "--out", x)
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("3 of 6 runs\n")
    assert rows(x) == rows(swept[0])
    assert traces(x) == traces(swept[0])


@pytest.mark.integration
@pytest.mark.parametrize(
    ("args", "subject"),
    [
        (["run", "agregation"], "'aggregation'"),
        (["run", "none.yaml"], "none.yaml"),
        (["run", "DUO", "--seeds", "5-3"], "'5-3'"),
        (["run", "DUO", "--set", "duraton=3"], "'duration'"),
        (["run", "DUO", "--sweep", "duration=3,x"], "'x'"),
        (["run", "DUO", "--set", "duration=1", "--sweep", "duration=3"], "duration"),
        (["run", "DUO", "--metrics", "path_lenght"], "'path_length'"),
        (["run", "DUO", "--metrics", "contacts"], "'robot_contacts'"),
        (["run", "DUO", "--set", "arena.size=[0.2, 0.2]"], "start"),
        (["run", "DUO", "--out", "."], "it holds duo"),
        (["run", "DUO", "--out", "duo/duo.yaml"], "duo/duo.yaml"),
        (["run", "DUO", "-j", "0"], "--jobs"),
        (["run", "DUO", "--cores", "0"], "--cores"),
        (["run", "DUO", "--shard", "0/40", "--out", "x"], "'0/40'"),
        (["run", "DUO", "--shard", "41/40", "--out", "x"], "'41/40'"),
        (["run", "DUO", "--shard", "1/2"], "--out"),
        (["run", "DUO", "--until", "gather_time <= 5"], "gather_time has no known range"),
        (["run", "DUO", "--until", "runs >= 5"], "'runs'"),
        (["run", "DUO", "--until", ONE, "--sweep", "duration=1,2"], "--sweep"),
        (["run", "DUO", "--until", ONE, "--shard", "1/2", "--out", "x"], "--shard"),
        (["run", "DUO", "--until", ONE, "--alpha", "0"], "--alpha"),
        (["run", "DUO", "--most", "9"], "--until"),
        (["merge", "nowhere", "--out", "x"], "nowhere"),
        (["merge", "."], "--out"),
        (["rerun", "."], "manifest.json"),
        (["show", "nowhere"], "nowhere"),
        (["report", "DUO"], "exp run"),
        (["run", "DUO", "--metrics", "warm"], "FILE.py:warm"),
        (["compare", "a", "b"], "a: "),
        (["plot", "nowhere"], "nowhere"),
        (["runn"], "'runn'"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_made(
    duo: Path, refusal: Refusal, args: list[str], subject: str
) -> None:
    assert subject in refusal("exp", *(str(duo) if word == "DUO" else word for word in args))


@pytest.mark.integration
@pytest.mark.long
def test_runs_until_a_requirement_is_decided(tmp_path: Path, duo: Path, swarmctl: Swarmctl) -> None:
    words = ("exp", "run", duo, "--set", "duration=0.5", "--until", ONE, "--out")
    done = swarmctl(*words, "one", "-j", 1, "-o", "json")
    assert done.returncode == 1, done.stderr
    answer = json.loads(done.stdout)["until"]
    assert (answer["requirement"], answer["verdict"]) == (ONE, "not met")
    assert f"{ONE}: not met after {answer['runs']} runs" in done.stderr
    undecided = swarmctl(*words, "two", "-j", 2, "--most", 2)
    assert undecided.returncode == 0, undecided.stderr
    assert "undecided after 2 runs" in undecided.stderr
    assert [row["seed"] for row in rows(tmp_path / "two")] == ["0", "1"]
    assert swarmctl(*words, "two", "-j", 2).returncode == 1
    assert rows(tmp_path / "one") == rows(tmp_path / "two")
    assert len(rows(tmp_path / "one")) == answer["runs"]
    assert traces(tmp_path / "one") == traces(tmp_path / "two")
    summary = json.loads((tmp_path / "two" / "summary.json").read_text())
    assert (summary["until"], summary["runs"]) == (answer, answer["runs"])


@pytest.mark.integration
@pytest.mark.long
def test_parts_are_run_apart_and_joined(tmp_path: Path, duo: Path, swarmctl: Swarmctl) -> None:
    command = ("exp", "run", duo, "--seeds", 2, "--set", "duration=0.5")
    for part in ("1/3", "3/3"):  # the third of two runs is empty, as in an array of a fixed size
        done = swarmctl(*command, "--shard", part, "--out", f"part-{part[0]}")
        assert done.returncode == 0, done.stderr
    again = swarmctl(*command, "--shard", "2/3", "--out", "part-1")
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
    assert "shard was 1/3, now 2/3" in again.stderr
    joined = swarmctl("exp", "merge", "part-1", "part-3", "--out", "m", "-o", "json")
    assert joined.returncode == 3
    assert "missing: part 2/3, in no folder: s0001\n" in joined.stderr
    assert json.loads(joined.stdout)["finished"] == 1
    command_of_m = json.loads((tmp_path / "m" / "manifest.json").read_text())["command"]
    # With which the joined folder goes on as that of one machine.
    assert command_of_m == [*map(str, ("swarmctl", *command)), "--out", "m"]


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.long
def test_the_job_script_of_the_documentation_runs_every_part(
    tmp_path: Path, duo: Path, swarmctl: Swarmctl
) -> None:
    text = (Path(__file__).parents[3] / "docs" / "cluster.md").read_text()
    (script,) = [block for block in text.split("```") if block.lstrip().startswith("#!/bin/bash")]
    assert script.count("aggregation --seeds 2000") == 1
    job = tmp_path / "gather.sh"
    small = script.lstrip().replace("$part/40", "$part/2")
    job.write_text(small.replace("aggregation --seeds 2000", f"{duo} --seeds 3 --set duration=0.5"))
    activate = tmp_path / "swarmd" / ".venv" / "bin" / "activate"
    activate.parent.mkdir(parents=True)
    activate.write_text(
        f'swarmctl() {{ {shlex.join([sys.executable, "-P", "-c", MAIN])} "$@"; }}\n'
    )
    # As `--array=1-2` and then `--array=2`, of one task, which goes on with part 2.
    environ = {"HOME": str(tmp_path), "SLURM_ARRAY_TASK_COUNT": "1"}
    loop = "for SLURM_ARRAY_TASK_ID in 1 2 2; do export SLURM_ARRAY_TASK_ID; bash gather.sh; done"
    done = subprocess.run(
        ["bash", "-ec", loop], cwd=tmp_path, env={**os.environ, **environ}, timeout=120, check=False
    )
    assert done.returncode == 0
    parts = sorted(path.name for path in (tmp_path / "runs").iterdir())
    assert parts == ["gather-part-1", "gather-part-2"]
    joined = swarmctl("exp", "merge", *(f"runs/{part}" for part in parts), "--out", "runs/gather")
    assert joined.returncode == 0, joined.stderr
    assert len(rows(tmp_path / "runs" / "gather")) == 3


@pytest.mark.integration
@pytest.mark.long
def test_the_summary_tells_the_speed_and_which_code_ran(
    tmp_path: Path, duo: Path, swarmctl: Swarmctl
) -> None:
    words = ("exp", "run", duo, "--seeds", 1, "--set", "duration=0.1", "--no-traces", "--out", "x")
    done = swarmctl(*words, SWARMD_COMPILED="0")
    assert done.returncode == 0, done.stderr
    assert " times real time (" in done.stdout
    assert "kernels: interpreted" in done.stdout
    assert "1 of 1 run done after " in done.stderr
    summary = json.loads((tmp_path / "x" / "summary.json").read_text())
    walls = [
        float(line.split(",")[-1]) for line in (tmp_path / "x/runs.csv").read_text().split()[1:]
    ]
    assert summary["wall"] == pytest.approx(sum(walls))
    assert summary["times_real_time"]["min"] == pytest.approx(0.1 / max(walls))


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ("compare", "x"),
        ("compare", "x:speed=0.2", "x:speed=0.1", "--metrics", "path_length"),
        ("compare", "x", "-o", "json"),
        ("plot", "x", "--only", "intervals", "--metrics", "path_length"),
        ("report", "x", "--metrics", "path_length"),
        ("check", "x", "path_length > 0"),
    ],
)
def test_an_answer_of_an_incomplete_experiment_says_so(
    x: Path, swarmctl: Swarmctl, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The figures of a report take 3 s; tests/sim/report has them.
    monkeypatch.setattr("swarmd.sim.report.html.figures_of", lambda *_: [])
    lines = (x / "runs.csv").read_text().splitlines(keepends=True)
    (x / "runs.csv").write_text("".join(lines[:-1]))
    done = swarmctl("exp", *words)
    assert (done.returncode, "5 of 6 runs done" in done.stderr) == (1, True), done
    assert done.stdout


@pytest.mark.integration
@pytest.mark.long
def test_plots_are_of_the_metrics_of_the_run(tmp_path: Path, duo: Path, swarmctl: Swarmctl) -> None:
    words = ("--seeds", 2, "--set", "duration=0.5", "--metrics", "path_length", "--out", "y")
    assert swarmctl("exp", "run", duo, *words).returncode == 0
    (tmp_path / "own.py").write_text("def early(trace):\n    return -trace.t\n")
    for more, wanted in (
        ((), "path_length"),
        (("--metrics", "mean_speed"), "mean_speed"),
        (("--metrics", "own.py:early"), "own_early"),  # LaTeX takes `.py:early` for a format
    ):
        done = swarmctl("exp", "plot", "y", "--only", "over_time", *more)
        made = [Path(line).name for line in done.stdout.splitlines()]
        assert made == [f"over_time_{wanted}.png"], done


@pytest.mark.integration
@pytest.mark.long
def test_what_the_run_was_asked_for_is_compared(
    tmp_path: Path, duo: Path, swarmctl: Swarmctl
) -> None:
    words = ("--seeds", 2, "--set", "duration=0.5", "--out", "y", "--sweep", "start.radius=0.6,0.8")
    assert swarmctl("exp", "run", duo, *words, "--metrics", "path_length").returncode == 0
    assert swarmctl("exp", "run", duo, *words[:5], "z").returncode == 0
    for sides in (("y:radius=0.6", "y:radius=0.8"), ("z", "y:radius=0.6"), ("y",)):
        for more, wanted in (((), "path_length"), (("--metrics", "mean_speed"), "mean_speed")):
            done = swarmctl("exp", "compare", *sides, *more, "-o", "json")
            found = json.loads(done.stdout)
            tested = [one["metrics"] for one in found.get("comparisons", ())]
            tested += found.get("variants", {}).values()
            assert [[*metrics] for metrics in tested] == [[wanted]], done


@pytest.mark.integration
@pytest.mark.long
def test_compare_finds_what_a_sweep_has_changed(x: Path, swarmctl: Swarmctl) -> None:
    words = ("exp", "compare", "x:speed=0.1", "x:speed=0.2")
    done = swarmctl(*words)
    assert done.returncode == 0, done.stderr
    assert "paired by seed" in done.stdout
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("path_length")]
    assert " 3     differs" in line
    (found,) = json.loads(swarmctl(*words, "-o", "json").stdout)["comparisons"]
    assert found["metrics"]["path_length"]["differs"] is True
    same = swarmctl("exp", "compare", "x", "x", "--metrics", "path_length")
    assert same.stdout.count("no difference shown") == 2
    wanted = ("--metrics", "minimum_gap,path_length")
    shown = json.loads(swarmctl("-o", "json", "exp", "show", "x", *wanted).stdout)
    assert (shown["apiVersion"], shown["kind"]) == ("swarm/v1", "ExperimentSummary")
    assert sorted(shown["variants"][0]["metrics"]) == ["minimum_gap", "path_length"]


@pytest.mark.integration
@pytest.mark.long
def test_plot_draws_the_runs_asked_for(tmp_path: Path, x: Path, swarmctl: Swarmctl) -> None:
    done = swarmctl("exp", "plot", "x", "--seeds", "7", "--metrics", "minimum_gap")
    assert done.returncode == 0, done.stderr
    made = [tmp_path / line for line in done.stdout.splitlines()]
    assert made
    assert all(path.parent == x / "plots" / "seeds-7" for path in made)
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in made)
    other = swarmctl("exp", "plot", "x", "--seeds", "6", "--out", "y")
    assert (other.returncode, other.stderr.count("\n")) == (2, 1)
    assert not (tmp_path / "y").exists()


def test_list_and_metrics_in_json(swarmctl: Swarmctl) -> None:
    listed = json.loads(swarmctl("exp", "list", "-o", "json").stdout)["scenarios"]
    (one,) = [scenario for scenario in listed if scenario["name"] == "aggregation"]
    assert one["robots"] > 1
    assert one["duration"] == 120.0
    assert one["description"]
    assert "benchmark/doorway" in {scenario["name"] for scenario in listed}
    metrics = json.loads(swarmctl("exp", "metrics", "-o", "json").stdout)["metrics"]
    assert {"path_length", "minimum_gap"} <= {metric["name"] for metric in metrics}


@pytest.mark.integration
def test_a_home_that_cannot_be_written_gives_no_lines_of_matplotlib() -> None:
    code = "from swarmd.sim.cli.options import need; need('matplotlib'); import matplotlib"
    environ = {name: text for name, text in os.environ.items() if name[:4] not in ("XDG_", "MPLC")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environ | {"HOME": "/proc"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""


def test_a_new_folder_has_the_first_free_name(tmp_path: Path) -> None:
    (tmp_path / "base" / "x-1").mkdir(parents=True)
    names = ("x-1", "x-2")
    assert new_folder(tmp_path / "base", names) == tmp_path / "base" / "x-2"
    assert (tmp_path / "base" / "x-2").is_dir()
    with pytest.raises(ConfigError, match=str(tmp_path / "base")):
        new_folder(tmp_path / "base", names)


def test_a_new_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "base").write_text("")
    for base in (tmp_path / "base", tmp_path / "base" / "below"):
        with pytest.raises(ConfigError, match=str(base / "x")):
            new_folder(base, ("x",))


@pytest.fixture
def live(tmp_path: Path) -> Path:
    """What a real-time world records: poses and commands, and no word of the robots'."""
    recorder = TraceBuilder(
        ("a", "b"), [load_platform("burger")] * 2, {"thresholds": {"burger": 0.5}}
    )
    for k in range(11):
        pose = np.zeros((2, 3))
        pose[1, 0] = 3.0 - 0.1 * k
        recorder.add(0.1 * k, pose, np.zeros((2, 3)))
    recorder.trace().save(tmp_path / "live.npz")
    return tmp_path / "live.npz"


def test_a_live_trace_is_measured_and_what_it_lacks_is_left_empty(live: Path) -> None:
    names = "mean_distance_to_centroid_end,robot_contacts,protection_duty"
    done = CliRunner().invoke(exp, ["measure", str(live), "--metrics", names, "-o", "json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.output)["traces"][str(live)]
    assert found == {
        "mean_distance_to_centroid_end": pytest.approx(1.0),
        "robot_contacts": 0.0,
        "protection_duty": None,
    }


def test_traces_of_one_name_are_shown_with_their_folders(live: Path) -> None:
    again, other = live.with_name("again.npz"), live.parent / "other" / live.name
    other.parent.mkdir()
    for path in (again, other):
        path.write_bytes(live.read_bytes())
    for second, heads in ((again, ["LIVE", "AGAIN"]), (other, [str(live), str(other)])):
        words = ["measure", str(live), str(second), "--metrics", "path_length"]
        done = CliRunner().invoke(exp, words)
        assert done.exit_code == 0, done.output
        assert [line.split() for line in done.output.splitlines()] == [
            ["METRIC", "UNIT", *heads],
            ["path_length", "m", "0.5", "0.5"],
        ]


@pytest.mark.parametrize(
    ("names", "subject"),
    [("path_lenght", "path_length"), (",", "--metrics"), ("path_length", "none.npz")],
)
def test_an_unknown_metric_and_a_file_that_is_no_trace_are_named(
    live: Path, names: str, subject: str
) -> None:
    (live.parent / "none.npz").write_text("no trace")
    words = ["measure", str(live.with_name("none.npz")), "--metrics", names]
    with pytest.raises(ConfigError, match=subject):
        CliRunner().invoke(exp, words, catch_exceptions=False)


def test_a_mission_is_checked_for_the_robots_of_a_scenario(
    tmp_path: Path, swarmctl: Swarmctl
) -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "missions.md"
    (machine,) = [
        text for text in re.findall(r"```yaml\n(.*?)```", page.read_text(), re.S) if "slope" in text
    ]
    path = tmp_path / "machine.yaml"
    path.write_text(machine)
    words = "exp", "check-mission", path
    done = swarmctl(*words, "shelter_choice")
    assert (done.returncode, done.stderr) == (0, "")
    assert "ok on burger" in done.stdout
    document = json.loads(swarmctl(*words, "shelter_choice", "-o", "json").stdout)
    assert (document["kind"], document["faults"]) == ("Mission", [])
    no_kin = "--set", "platforms.burger.protection.mode=potential_field"
    done = swarmctl(*words, "shelter_choice", "--set", "radio.range_and_bearing=false", *no_kin)
    assert done.returncode == 2
