"""Jobs in processes: each is done once, and a process that ends costs its own job alone."""

from __future__ import annotations

import os
from collections.abc import Generator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.processes import MAX_OUTPUT
from swarmd.sim.experiments.pool import (
    STEP_TIMEOUT,
    Job,
    JobResult,
    Shares,
    _kept_workers,
    _Worker,
    run_job,
    run_jobs,
)
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.lockstep.processes import RunProcess
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of
from tests.sim.conftest import MOODY
from tests.support.processes import children

END = "groups.all.parameters.end"

pytestmark = [pytest.mark.integration, pytest.mark.long]


def job(
    duo: Path, seed: int, trace: Path | None = None, changes: Mapping[str, Any] | None = None
) -> Job:
    effective = load_scenario(duo, {"duration": 1, **(changes or {})}).effective
    return Job(f"s{seed}", effective, seed, trace)


def results(jobs: Generator[JobResult | Shares, None, None]) -> list[JobResult]:
    with closing(jobs) as found:
        return [item for item in found if isinstance(item, JobResult)]


def done(jobs: list[Job], processes: int, timeout: float = STEP_TIMEOUT) -> dict[str, JobResult]:
    listed = results(run_jobs(jobs, processes, timeout))
    assert sorted(result.run for result in listed) == sorted(job.run for job in jobs)
    return {result.run: result for result in listed}


@pytest.mark.usefixtures("real_starts")
def test_every_job_is_done_once_whatever_the_others_do(duo: Path, tmp_path: Path) -> None:
    """They end, hang, leave something behind, find no room: in one worker, and its successor."""
    (tmp_path / ".s5.npz.partial").write_bytes(b"half")  # ended while it wrote
    jobs = [
        job(duo, 0, None, {END: "exit"}),
        job(duo, 1, None, {END: "kill"}),
        job(duo, 2, None, {"arena.size": [0.2, 0.2]}),  # no room
        job(duo, 3, None, {END: "remember"}),
        job(duo, 4),
        job(duo, 5, tmp_path / "s5.npz", {END: "freeze"}),
        job(duo, 6),
    ]
    found = done(jobs, 1, timeout=6.0)
    assert [i for i in range(7) if found[f"s{i}"].metrics is not None] == [3, 4, 6]
    assert found["s0"].reason == "its process ended with code 7: moody has had enough"
    assert found["s1"].reason.startswith("its process was killed by SIGKILL")
    assert "start" in found["s2"].reason
    assert not found["s2"].reason.startswith("its process")
    assert "\n" not in found["s2"].reason
    assert found["s4"].metrics == run_job(job(duo, 4)).metrics
    assert found["s5"].reason.startswith("no progress in 6 s")
    assert list(tmp_path.glob(".*")) == []


def test_an_exception_becomes_a_reason_in_one_line(duo: Path) -> None:
    broken = Job("s0", {"groups": None}, 0, None)
    assert run_job(broken).reason
    unhashable = Job("s0", 3, 0, None)  # type: ignore[arg-type]
    assert ": " in run_job(unhashable).reason


def test_a_trace_that_cannot_be_written_is_a_write_error(duo: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for name, subject in (("file/s0.npz", "file"), ("s0.npz", "No space left on device")):
        (tmp_path / ".s0.npz.partial").unlink(missing_ok=True)
        (tmp_path / ".s0.npz.partial").symlink_to("/dev/full")
        result = run_job(job(duo, 0, tmp_path / name))
        assert result.metrics is None
        assert subject in result.write_error
    assert list(tmp_path.glob(".*")) == []


@pytest.mark.usefixtures("real_starts")
def test_several_processes_for_a_run_give_its_metrics(duo: Path) -> None:
    before = set(children(os.getpid()))
    forking = job(duo, 2, None, {END: "fork"})
    several = {r.run: r for r in results(run_jobs([job(duo, 0), job(duo, 1), forking], 1, cores=2))}
    for seed in (0, 1):
        assert several[f"s{seed}"].metrics == run_job(job(duo, seed)).metrics is not None
    assert several["s2"].metrics is not None
    _kept_workers().end()
    assert set(children(os.getpid())) <= before


@pytest.mark.parametrize(
    ("end", "words"),
    [
        pytest.param("kill", "SIGKILL", marks=pytest.mark.evidence),
        ("freeze", "no progress in 8 s"),
    ],
)
def test_a_process_of_a_run_that_fails_is_named(duo: Path, end: str, words: str) -> None:
    last = {
        "platform": "burger",
        "count": 1,
        "prefix": "z",
        "pattern": "moody",
        "parameters": {"end": end},
        "start": {"layout": "list", "poses": [[2.0, 2.0, 0.0]]},
    }
    before = set(children(os.getpid()))
    plain = job(duo, 0).effective
    faulty = Job(
        "s0", {**plain, "groups": {"first": plain["groups"]["all"], "last": last}}, 0, None
    )
    process, last_row = RunProcess(0, 3), 2
    Lockstep(scenario_of(faulty.effective), 0, process)
    [at] = [index for index, rows in enumerate(process.rows_of) if last_row in rows]
    found = {r.run: r for r in results(run_jobs([faulty, job(duo, 1)], 1, timeout=10.0, cores=3))}
    assert found["s0"].reason.startswith(f"process {at + 1} of the 3 of this run")
    assert words in found["s0"].reason
    assert found["s1"].metrics is not None
    _kept_workers().end()
    assert set(children(os.getpid())) <= before


@pytest.mark.usefixtures("real_starts")
def test_the_start_of_a_worker_does_not_count_as_a_step(duo: Path) -> None:
    worker = _Worker()
    try:
        worker.assign(job(duo, 0))
        assert worker.add_silence(5.0, timeout=3.0) is None
        assert worker.receive(0.0, timeout=3.0) is None  # started
        assert worker.add_silence(5.0, timeout=3.0) is not None
    finally:
        worker.kill()


@pytest.mark.usefixtures("real_starts")
def test_a_worker_that_a_module_of_python_path_ends_names_it(
    duo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scipy").mkdir()
    (tmp_path / "scipy" / "__init__.py").write_text('raise ImportError("of another Python")\n')
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (result,) = done([job(duo, 0)], 1).values()
    assert f"scipy ({tmp_path})" in result.reason
    assert "of another Python" in result.reason


def test_a_slow_run_reports_progress_and_may_take_longer_than_the_limit(duo: Path) -> None:
    slow = job(duo, 0, None, {END: "slow", "duration": 1.2})
    with closing(run_jobs([slow], 1, timeout=3.0)) as found:
        *told, result = found
    shares = [item["s0"] for item in told if not isinstance(item, JobResult)]
    assert len(shares) == len(told)
    assert shares == sorted(shares)
    assert any(0.0 < share < 1.0 for share in shares)
    assert isinstance(result, JobResult)
    assert result.metrics is not None, result.reason
    assert result.wall > 3.0


@pytest.mark.evidence
def test_a_pattern_that_forks_has_one_result(duo: Path) -> None:
    before = set(children(os.getpid()))
    jobs = [job(duo, 0, None, {END: "fork"}), job(duo, 1), job(duo, 2)]
    found = results(run_jobs(jobs, 1, timeout=20.0))
    assert [result.run for result in found] == ["s0", "s1", "s2"]
    assert all(result.metrics is not None for result in found), found
    _kept_workers().end()
    assert set(children(os.getpid())) <= before


@pytest.mark.evidence
def test_a_pattern_that_closes_all_files_costs_its_own_run(duo: Path) -> None:
    found = done([job(duo, 0, None, {END: "close"}), job(duo, 1)], 1)
    assert found["s0"].reason.startswith("its process ended with code")
    assert found["s1"].metrics is not None


@pytest.mark.usefixtures("real_starts")
def test_closing_ends_all_processes(duo: Path) -> None:
    _kept_workers().end()
    before = set(children(os.getpid()))
    long = [job(duo, seed, None, {"duration": 3600}) for seed in (1, 2)]
    with closing(run_jobs([job(duo, 0), *long], 2)) as found:
        assert next(item.run for item in found if isinstance(item, JobResult)) == "s0"
        assert len(set(children(os.getpid())) - before) == 2
    _kept_workers().end()
    assert set(children(os.getpid())) <= before


FORGED = """
import os
import pickle
import struct


class Hostile:
    def __reduce__(self):
        return os.system, ("touch {canary}",)


data = pickle.dumps(Hostile())
for number in os.listdir("/proc/self/fd"):
    if int(number) > 2:
        try:
            os.write(int(number), struct.pack("!i", len(data)) + data)
        except OSError:
            pass
"""


def of_guest(duo: Path, tmp_path: Path, code: str) -> Job:
    """The job of a guest whose pattern is imported behind `code`."""
    plain = job(duo, 0).effective
    guest = tmp_path / "guest"
    guest.mkdir()
    (guest / "moody.py").write_text(code + MOODY)
    return Job("s0", {**plain, "plugin_dir": str(guest)}, 0, None, guest=guest)


def test_what_a_guest_writes_into_the_pipe_runs_nothing(duo: Path, tmp_path: Path) -> None:
    canary = tmp_path / "canary"
    forged = of_guest(duo, tmp_path, FORGED.replace("{canary}", str(canary)))
    (result,) = done([forged], 1).values()
    assert not canary.exists()
    assert result.metrics is None


def test_a_guest_that_writes_a_part_of_a_report_ends_with_the_time(
    duo: Path, tmp_path: Path
) -> None:
    """It announces more bytes than follow, and waits."""
    part = FORGED.replace("len(data)) + data", "1 << 20)") + "import time\ntime.sleep(600)\n"
    (result,) = done([of_guest(duo, tmp_path, part)], 1, timeout=1.5).values()
    assert result.reason.startswith("no progress in 1.5 s")


PRINTS = """
while True:
    print("x" * (1 << 20))
"""


def test_what_a_guest_prints_is_bounded(duo: Path, tmp_path: Path) -> None:
    (result,) = done([of_guest(duo, tmp_path, PRINTS)], 1).values()
    assert "File too large" in result.reason


def test_a_log_that_is_cut_goes_on_at_its_end(duo: Path) -> None:
    worker = _Worker()
    try:
        worker.assign(job(duo, 0))
        os.write(worker._log.fileno(), bytes(MAX_OUTPUT))
        worker.trim_log()
        assert worker._log.seek(0, os.SEEK_END) == MAX_OUTPUT
        os.write(worker._log.fileno(), b"one more\n")
        worker.trim_log()
        os.write(worker._log.fileno(), b"last words\n")
        assert worker._log.seek(0, os.SEEK_END) == len("last words\n")
        assert worker._last_line() == ": last words"
    finally:
        worker.kill()
