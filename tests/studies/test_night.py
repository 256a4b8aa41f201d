"""The night: which sources decide a job, what runs again, and what pages get."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from studies.night import pages, sources
from studies.night.jobs import JOBS, STORED_RUNS, Job, PatternJob, share, stored_runs
from studies.night.kept_runs import FOLDER, Made
from studies.night.sources import ROOT, digest_of, sources_of
from swarmd.sim.experiments.run_store import OFF, VARIABLE, RunStore
from tests.support.processes import wait_until

pytestmark = [pytest.mark.long, pytest.mark.integration]

BETA = """
import sys
from pathlib import Path
from studies.gamma import VALUE
if Path("wait").exists():
    print("waits", file=sys.stderr, flush=True)
    sys.stdin.read()
print("<!-- results: beta_left -->", "| a |", "|---|", f"| {VALUE} |", sep="\\n")
print("<!-- results: beta_right -->", "right", sep="\\n")
sys.exit(Path("fail").exists())
"""
PAGE = """# Page
<!-- results: beta_left (of a job) -->
old
<!-- end of results -->
Between.
<!-- results: beta_right --><!-- end of results -->
<!-- results: beta_right -->
<!-- end of results -->
"""


def git(folder: Path, *words: str) -> None:
    who = ("-c", "user.name=n", "-c", "user.email=e@example.org")
    subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with the night, and with the job `beta` alone."""
    for folder in ("studies/night", "studies/outcomes", "studies/behaviour"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    (tmp_path / "benchmarks").mkdir()
    for name in ("studies/__init__.py", "benchmarks/table.py", "benchmarks/__init__.py"):
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "studies/beta.py").write_text(BETA)
    (tmp_path / "studies/gamma.py").write_text("VALUE = 1\n")
    with (tmp_path / "studies/night/jobs.py").open("a") as file:
        file.write('\nJOBS = (Job("beta", ("-m", "studies.beta"), 1.0),)\n')
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/page.md").write_text(PAGE)
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "one")
    return tmp_path


CLUSTER = """
from contextlib import contextmanager

@contextmanager
def executor_on(address):
    print("asked for", address)
    yield None
"""


def made_in(folder: Path, table: str = "beta") -> dict[str, Any]:
    """What the file of a table says of it."""
    made: dict[str, Any] = msgspec.json.decode(file_in(folder, table).read_bytes().splitlines()[0])
    return made


def file_in(folder: Path, table: str = "beta") -> Path:
    return folder / FOLDER / f"{table}.jsonl"


def night(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "studies.night", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_a_night_runs_what_has_changed_and_writes_files_and_pages(checkout: Path) -> None:
    assert night(checkout).returncode == 0
    head = subprocess.check_output(["git", "rev-parse", "HEAD"], cwd=checkout, text=True)[:10]
    made = made_in(checkout)
    assert made["parts"] == ["beta_left", "beta_right"]
    assert made["made_with"]["commit"] == head
    page = (checkout / "docs/page.md").read_text()
    assert page.startswith(
        "# Page\n<!-- results: beta_left (of a job) -->\n\n| a |\n|---|\n| 1 |\n"
    )
    assert "\nBetween.\n" in page
    assert page.count("\nright\n") == 1
    assert page.count(f"with commit {head} by `python -m studies.beta`.") == 2
    assert "old" not in page

    (checkout / "docs/page.md").write_text(PAGE)
    (checkout / "studies/gamma.py").write_text('"""Text."""\nVALUE = 1  # one\n')
    assert "0 jobs to do" in night(checkout, "--plan").stdout
    assert night(checkout).stdout == ""
    assert (checkout / "docs/page.md").read_text() == PAGE

    (checkout / "studies/gamma.py").write_text("VALUE = 2\n")
    shown = night(checkout, "--plan", "beta").stdout
    assert "1 jobs to do" in shown
    assert "studies/gamma.py, changed" in shown
    assert "studies/beta.py\n" in shown
    assert night(checkout).returncode == 0
    made = made_in(checkout)
    assert "| 2 |" in (checkout / "docs/page.md").read_text()
    assert made["made_with"]["commit"] == f"{head}, with changes"
    assert "1 jobs to do" in night(checkout, "--plan", "--all").stdout


def test_a_plan_needs_no_git_and_no_history_and_results_do(checkout: Path) -> None:
    assert night(checkout).returncode == 0
    file = file_in(checkout)
    made = made_in(checkout)
    made["made_with"] |= {"commit": "0123456789", "digest": "of others"}
    file.write_bytes(msgspec.json.encode(made))
    assert "git does not know" in night(checkout, "--plan", "beta").stdout
    shutil.rmtree(checkout / ".git")
    assert "git does not know" in night(checkout, "--plan", "beta").stdout
    refused = night(checkout)
    assert refused.returncode == 1
    assert refused.stderr.startswith("error: git")
    assert len(refused.stderr.splitlines()) == 1
    file.write_bytes(file.read_bytes()[:40])
    refused = night(checkout, "--plan")
    assert refused.returncode == 1
    assert "beta.jsonl:1:" in refused.stderr
    assert len(refused.stderr.splitlines()) == 1


def test_a_bad_verdict_is_kept_and_what_is_not_whole_is_not(checkout: Path) -> None:
    (checkout / "fail").touch()
    with (checkout / "studies/night/jobs.py").open("a") as file:
        file.write('JOBS = (Job("beta", ("-m", "studies.beta"), 1.0, (), True),)\n')
    done = night(checkout)
    assert done.returncode == 1
    assert "beta: its table has a fault" in done.stderr
    assert (checkout / "docs/page.md").read_text().count("\nright\n") == 1
    file_in(checkout).unlink()
    (checkout / "studies/beta.py").write_text("")
    assert "beta failed" in night(checkout).stderr
    assert not file_in(checkout).exists()
    (checkout / "studies/beta.py").write_text('print("no page has it")')
    assert night(checkout).returncode == 1


def test_pages_have_the_parts_before_the_file_exists(checkout: Path) -> None:
    (checkout / FOLDER).parent.mkdir()
    (checkout / FOLDER).write_text("no folder")
    assert f"{checkout}/{FOLDER}" in night(checkout).stderr
    assert "\nright\n" in (checkout / "docs/page.md").read_text()


def test_a_plan_without_a_reader_ends_quietly(checkout: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "studies.night", "--plan"]
    done = subprocess.run(
        command, cwd=checkout, stdout=writer, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (-signal.SIGPIPE, "")


def test_a_job_that_fails_or_is_killed_keeps_nothing_and_runs_again(checkout: Path) -> None:
    (checkout / "fail").touch()
    failed = night(checkout)
    assert failed.returncode == 1
    assert "beta failed" in failed.stderr
    (checkout / "fail").unlink()
    (checkout / "wait").touch()
    command = [sys.executable, "-m", "studies.night"]
    log = checkout / "build/night/beta.log"
    with subprocess.Popen(
        command, cwd=checkout, stdin=subprocess.PIPE, start_new_session=True
    ) as running:
        wait_until(lambda: log.exists() and "waits" in log.read_text(), "the job")
        second = night(checkout)
        assert second.returncode == 1
        assert "another night" in second.stderr
        os.killpg(running.pid, signal.SIGKILL)
    assert not file_in(checkout).exists()
    assert (checkout / "docs/page.md").read_text() == PAGE
    (checkout / "wait").unlink()
    assert night(checkout).returncode == 0
    assert file_in(checkout).exists()


def test_a_job_whose_sources_change_meanwhile_keeps_nothing(checkout: Path) -> None:
    (checkout / "wait").touch()
    log = checkout / "build/night/beta.log"
    with subprocess.Popen(
        [sys.executable, "-m", "studies.night"],
        cwd=checkout,
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        wait_until(lambda: log.exists() and "waits" in log.read_text(), "the job")
        (checkout / "studies/gamma.py").write_text("VALUE = 2\n")
        _, told = running.communicate()
    assert running.returncode == 1
    assert "changed while it ran" in told
    assert not file_in(checkout).exists()


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["atraction"], "attraction"),
        (["--shard", "0/2"], "K/N"),
        (["--shard", "3/2"], "K/N"),
        (["--shard", "half"], "K/N"),
    ],
)
def test_bad_words_start_nothing(words: list[str], wanted: str) -> None:
    done = night(ROOT, *words, "--plan")
    assert (done.returncode, done.stdout) == (1, "")
    assert wanted in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_sources_hold_every_file_that_a_run_imports() -> None:
    program = """
import sys
import studies.outcomes.rows
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import load_scenario
simulate_run(load_scenario("aggregation", {"duration": 1.0}), 0)
print(*sys.modules, sep="\\n")
"""
    job = next(job for job in JOBS if job.name == "drive")
    # Interpreted, since a compiled library hides the modules that are in it.
    interpreted = {**os.environ, "SWARMD_COMPILED": "0"}
    command = [sys.executable, "-c", program]
    used = subprocess.check_output(command, cwd=ROOT, text=True, env=interpreted).split()
    files = {ROOT.joinpath(*name.split(".")).with_suffix(".py").resolve() for name in used}
    ours = {path.relative_to(ROOT).as_posix() for path in files if path.is_file()}
    known = {path.relative_to(ROOT).as_posix() for path in job.sources}
    assert {"swarmd/robot/protection/barrier.py", "patterns/attraction/pattern.py"} <= ours
    assert {
        f"patterns/drive/{name}" for name in ("pattern.py", "scenario.yaml", "metrics.py")
    } <= known
    assert "patterns/drive/outcomes.yaml" in known
    # What finds the sources, or a module by its former name, decides no value.
    finding = {name for name in ours - known if name.startswith("studies/night/")}
    assert ours - known - finding == {"swarmd/core/former_names.py"}


def test_a_platform_a_scenario_and_a_pattern_that_a_study_names_are_sources() -> None:
    names = {path.relative_to(ROOT).as_posix() for path in sources_of(["studies.paper"])}
    assert {
        "config/scenarios/paper_exp1_burger.yaml",
        "config/platforms/burger.yaml",
        "patterns/attraction/pattern.py",
        "swarmd/robot/protection/barrier.py",
        "swarmd/robot/sensing/ray_memory.py",
    } <= names
    assert "config/scenarios/paper_exp1_jackal.yaml" in names
    assert "patterns/foraging/pattern.py" not in names
    assert not [
        name for name in names if name.startswith(("swarmd/operator/cli", "swarmd/daemon", "tests"))
    ]


def test_tasks_that_a_study_lists_and_its_control_are_sources() -> None:
    names = {path.relative_to(ROOT) for path in sources_of(["studies.benchmark_suite"])}
    tasks = ROOT.glob("config/scenarios/benchmark/*.yaml")
    assert {path.relative_to(ROOT) for path in tasks} <= names
    assert {Path("patterns/foraging/pattern.py"), Path("studies/stand.py")} <= names
    assert ROOT / "studies/stand.py" in sources_of(["studies.tuning"])


def test_no_job_takes_runs_of_a_folder_that_other_sources_share() -> None:
    assert [job.command for job in JOBS if "build/" in job.command] == []


def test_imports_for_types_alone_are_no_sources_and_those_in_their_place_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "ROOT", tmp_path)
    (tmp_path / "studies").mkdir()
    text = "if TYPE_CHECKING:\n    import studies.three\nelse:\n    import studies.four\n"
    for name in ("two", "three", "four"):
        (tmp_path / f"studies/{name}.py").write_text(text if name == "two" else "")
    sources.forget()
    names = {path.name for path in sources_of(["studies.two"])}
    sources.forget()
    assert names == {"two.py", "four.py"}


def test_a_digest_follows_code_and_not_its_comments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "ROOT", tmp_path)
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies/one.py").write_text("import studies.two\n")
    digests = []
    for text in ("A = 1\n", "# Why.\nA = 1\n", '"""Text."""\nA = 1\n', "A = 2\n", "B = 1\n"):
        (tmp_path / "studies/two.py").write_text(text)
        sources.forget()
        digests.append(digest_of(["studies.one"]))
    assert digests[0] == digests[1] == digests[2]
    assert len(set(digests)) == 3
    sources.forget()


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_shards_have_each_job_once_and_like_loads(count: int) -> None:
    jobs = [Job(f"j{n}", ("-m", "x"), minutes) for n, minutes in enumerate([9, 1, 4, 4, 2, 2, 8])]
    shards = [share(jobs, number, count) for number in range(1, count + 1)]
    assert sorted(job.name for shard in shards for job in shard) == [job.name for job in jobs]
    loads = [sum(job.minutes for job in shard) for shard in shards]
    assert max(loads) <= sum(loads) / count + 9


class Measured(Job, frozen=True):
    """A job that took another time than was thought."""

    @property
    def estimate(self) -> float:
        return 20.0 - self.minutes


def test_shards_stay_the_same_once_jobs_are_measured() -> None:
    shards = [
        [job.name for job in share([kind(f"j{n}", (), float(n)) for n in range(7)], 1, 2)]
        for kind in (Job, Measured)
    ]
    assert shards[0] == shards[1]
    assert share(JOBS, 10**12, 10**12) == []


class Cheap(Job, frozen=True):
    """A job that has taken half a CPU-minute."""

    @property
    def made(self) -> Made | None:
        stored = {STORED_RUNS: "7"} if self.has_verdict else {}
        return Made(made_with={"cpu_minutes": "0.5", **stored})


def test_minutes_without_runs_that_were_stored_are_no_estimate() -> None:
    assert Cheap("a", (), 3.0).estimate == 0.5
    assert Cheap("a", (), 3.0, has_verdict=True).estimate == 3.0


def test_stored_runs_are_counted(tmp_path: Path) -> None:
    store = RunStore(tmp_path, free=0)
    tmp_path.chmod(0o700)
    store.keep("a" * 64, {}, None, "2026-11-29")
    os.utime(tmp_path / ("a" * 64), (100.0, 100.0))
    os.utime(tmp_path / ("a" * 64) / "result", (300.0, 300.0))
    environ = {VARIABLE: str(tmp_path)}
    assert stored_runs(200.0, environ) == {STORED_RUNS: "1"}
    assert stored_runs(400.0, environ) == {}
    assert stored_runs(200.0, {VARIABLE: OFF}) == {}


def test_each_kept_part_stands_on_a_page_as_its_file_says() -> None:
    written = {
        part[2]: part[0]
        for path in pages.pages()
        for part in pages.PART.finditer(path.read_text())
        if part[2] not in ("outcomes", "still")
    }
    for job in JOBS:
        if job.made is not None and not isinstance(job, PatternJob):
            for name in job.made.parts:
                assert job.made.origin in written[name], "`python -m studies.night` writes it"


def test_a_cluster_does_the_runs_of_jobs_that_take_an_executor(checkout: Path) -> None:
    (checkout / "studies/kept.py").write_text(CLUSTER)
    (checkout / "studies/beta.py").write_text("import sys\nprint(sys.argv[1:])\n")
    jobs = (
        (checkout / "studies/night/jobs.py")
        .read_text()
        .replace(
            "1.0),)\n",
            '1.0), Job("delta", ("-m", "studies.beta"), 1.0, takes_executor=True))\n',
        )
    )
    (checkout / "studies/night/jobs.py").write_text(jobs)
    page = checkout / "docs/page.md"
    parts = (f"<!-- results: {name} -->\n<!-- end of results -->\n" for name in ("beta", "delta"))
    page.write_text("".join(parts))

    done = night(checkout, "--on", "tcp://127.0.0.1:8786")

    assert done.returncode == 0, done.stderr
    told = done.stdout.splitlines()
    assert "asked for tcp://127.0.0.1:8786" in told
    assert [line.partition(":")[0] for line in told if "runs here" in line] == ["beta"]
    shown = page.read_text().partition("<!-- results: delta -->")
    assert "\n[]\n" in shown[0]
    assert "\n['--on', 'tcp://127.0.0.1:8786']\n" in shown[2]


SHORT = """
duration: 0.5
arena: {size: [4, 4]}
groups: {tb3: {platform: burger, count: 2, pattern: drive}}
"""
LISTS = """
import swarmd
found = swarmd.simulate("config/scenarios/short.yaml", 5, set={"start.spacing": 1.0})
print("<!-- results: beta_left -->", found.metric("path_length").mean(), sep="\\n")
"""


@pytest.fixture
def with_runs(checkout: Path) -> Path:
    """A checkout whose job has made its table by five runs of a scenario of its own."""
    (checkout / "config/scenarios").mkdir(parents=True)
    (checkout / "config/scenarios/short.yaml").write_text(SHORT)
    (checkout / "studies/beta.py").write_text(LISTS)
    git(checkout, "add", ".")
    git(checkout, "commit", "-q", "-m", "two")
    done = night(checkout)
    assert done.returncode == 0, done.stderr
    return checkout


def changed(folder: Path, text: str) -> None:
    (folder / "config/scenarios/short.yaml").write_text(text)
    git(folder, "commit", "-q", "-a", "-m", "three")


def test_a_table_is_current_while_its_robots_drive_as_they_drove(with_runs: Path) -> None:
    file = file_in(with_runs)
    kept = [msgspec.json.decode(line) for line in file.read_bytes().splitlines()[1:]]
    assert [run["seed"] for run in kept] == [0, 1, 2, 3, 4]
    assert {run["scenario"] for run in kept} == {"config/scenarios/short.yaml"}
    assert all(len(run["bits"]) == 12 for run in kept)
    assert night(with_runs, "--check").stdout.startswith("beta: current, of the same sources")

    # Another file that gives the same runs.
    changed(with_runs, SHORT.replace("[4, 4]", "[4.0, 4.0]"))
    assert "1 jobs to do" in night(with_runs, "--plan").stdout
    done = night(with_runs, "--check")
    assert (done.returncode, done.stderr) == (0, "")
    assert "3 of 5 runs done again, with equal bits" in done.stdout
    assert "with equal bits" in (with_runs / "docs/page.md").read_text()
    assert "0 jobs to do" in night(with_runs, "--plan").stdout
    assert night(with_runs).stdout == ""

    changed(with_runs, SHORT.replace("0.5", "0.6"))
    done = night(with_runs, "--check")
    assert (done.returncode, done.stderr) == (1, "")
    assert "3 of 3 of 5 runs done again differ" in done.stdout
    assert "differ." in (with_runs / "docs/page.md").read_text()
    assert "1 jobs to do" in night(with_runs, "--plan").stdout

    changed(with_runs, SHORT)
    done = night(with_runs, "--check")
    assert (done.returncode, done.stderr) == (0, "")
    assert "differ." not in (with_runs / "docs/page.md").read_text()


def test_runs_alone_are_kept_and_compared_with_the_table(with_runs: Path) -> None:
    changed(with_runs, SHORT.replace("[4, 4]", "[4.0, 4.0]"))
    done = night(with_runs, "--runs")
    assert (done.returncode, done.stderr) == (0, "")
    assert "5 runs are kept, which give the table of the page" in done.stdout
    assert "5 of 5 runs done again, with equal bits" in (with_runs / "docs/page.md").read_text()
    assert "0 jobs to do" in night(with_runs, "--plan").stdout
    changed(with_runs, SHORT.replace("0.5", "0.6"))
    assert "ANOTHER table" in night(with_runs, "--runs").stdout
    assert "its runs give another table." in (with_runs / "docs/page.md").read_text()
    assert "1 jobs to do" in night(with_runs, "--plan").stdout
    assert night(with_runs, "--check").returncode == 1


def test_a_table_whose_formulas_have_changed_is_to_be_made_again(with_runs: Path) -> None:
    program = with_runs / "studies/beta.py"
    program.write_text("# A comment.\n" + program.read_text())
    assert "0 jobs to do" in night(with_runs, "--plan").stdout
    program.write_text(program.read_text().replace(".mean()", ".min()"))
    done = night(with_runs, "--check")
    assert done.returncode == 0
    assert "beta: its formulas have changed" in done.stdout
    assert "studies/beta.py" in done.stdout
    assert "1 jobs to do" in night(with_runs, "--plan").stdout


def test_a_job_without_the_sources_of_others_is_left_out_by_name(tmp_path: Path) -> None:
    job = next(one for one in JOBS if one.name == "ros2swarm")
    assert "SWARMD_ROS2SWARM" in job.lacks({})
    assert "SWARMD_ROS2SWARM" in job.lacks({"SWARMD_ROS2SWARM": str(tmp_path / "none")})
    assert job.lacks({"SWARMD_ROS2SWARM": str(tmp_path)}) == ""
    assert not any(one.lacks({}) for one in JOBS if one is not job)
