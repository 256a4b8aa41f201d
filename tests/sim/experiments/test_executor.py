"""Executors give what one machine gives, also if a worker is lost; other software is refused."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.operator.cli.swarmctl import cli, exit_code_of, run_cli
from swarmd.sim.experiments.executor import (
    Call,
    dask_cluster,
    difference,
    is_open,
    on_executor,
)
from swarmd.sim.experiments.pool import Job, JobResult
from swarmd.sim.experiments.simulate import Progress, plan_of, simulate
from tests.sim.conftest import Refusal, Swarmctl, write_duo
from tests.support.processes import children, end_process, wait_until

CAP = 120.0  # s; a process of Dask starts in 1 to 2 s of CPU, and may be stopped meanwhile
ROOT = Path(__file__).parents[3]
# Reads a line for each process, and forks it with the imports of Dask and of runs, which take most
# of a start. The forks end with this process, and this process with its standard input.
FORKS = """
import json, os, sys
import distributed.cli.dask_scheduler, distributed.cli.dask_worker
import swarmd.sim.experiments.executor, swarmd.sim.experiments.pool
from swarmd.core.processes import die_with_parent

def start(program, words, log, lacks, environment):
    sys.stdin.close()
    die_with_parent(parent)
    os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT), 1)
    os.dup2(1, 2)
    os.environ.update(environment)
    if lacks:
        for name in [name for name in sys.modules if name.split(".")[0] == "swarmd"]:
            del sys.modules[name]
        sys.path[:] = [folder for folder in sys.path if folder != lacks]
    sys.argv[:] = [program, *words]
    sys.exit(getattr(distributed.cli, f"dask_{program}").main())

parent = os.getpid()
for line in sys.stdin:
    pid = os.fork()
    if pid == 0:
        start(**json.loads(line))
    print(pid, flush=True)
"""


class Cluster:
    """A Dask scheduler on loopback, and workers of one thread."""

    def __init__(self, folder: Path, forks: subprocess.Popen[str]) -> None:
        self.folder = folder
        self._forks = forks
        self.file = folder / "scheduler.json"
        words = ("--host", "tcp://127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file")
        self.scheduler = self._start("scheduler", "scheduler", (*words, str(self.file)))
        wait_until(
            lambda: self.file.exists() and self.file.read_text().endswith("}"), "it is up", CAP
        )
        self.address: str = json.loads(self.file.read_text())["address"]

    def start_worker(self, name: str, lacks: str = "", **environment: str) -> int:
        """Start a worker, and wait until it has joined; its process id.

        `lacks`: a folder that its Python does not search.
        """
        words = ("--host", "127.0.0.1", "--no-nanny", "--no-dashboard", "--nthreads", "1")
        where = ("--local-directory", str(self.folder / name))
        pid = self._start("worker", name, (self.address, *words, *where), lacks, environment)
        log = self.folder / f"{name}.log"
        wait_until(lambda: log.exists() and "Registered to" in log.read_text(), name, CAP)
        return pid

    def _start(
        self,
        program: str,
        name: str,
        words: tuple[str, ...],
        lacks: str = "",
        environment: dict[str, str] | None = None,
    ) -> int:
        request = {
            "program": program,
            "words": words,
            "lacks": lacks,
            "environment": environment or {},
            "log": str(self.folder / f"{name}.log"),
        }
        assert self._forks.stdin is not None
        assert self._forks.stdout is not None
        self._forks.stdin.write(f"{json.dumps(request)}\n")
        self._forks.stdin.flush()
        return int(self._forks.stdout.readline())


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    folder = tmp_path_factory.mktemp("cluster")
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", FORKS]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, cwd=folder) as forks:
        try:
            yield Cluster(folder, forks)
        finally:
            forks.kill()


def table(folder: Path) -> list[str]:
    """The rows without their durations."""
    return [line.rpartition(",")[0] for line in (folder / "runs.csv").read_text().splitlines()]


def traces(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "traces").iterdir()}


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_dask_cluster_gives_the_bits_of_one_machine_though_a_worker_is_killed(
    tmp_path: Path, cluster: Cluster, swarmctl: Swarmctl
) -> None:
    duo = write_duo(tmp_path)
    killed = cluster.start_worker("killed")
    others: list[int] = []

    def kill() -> None:
        wait_until(lambda: bool(children(killed)), "a run has begun", CAP)
        os.kill(killed, signal.SIGSTOP)  # so that it reports no result
        others.append(cluster.start_worker("other"))
        end_process(killed)

    thread = threading.Thread(target=kill)
    thread.start()
    far = tmp_path / "far"
    words = ("exp", "run", duo, "--seeds", 2, "--out", far, "--scheduler-file", cluster.file)
    done = swarmctl(*words)
    thread.join()
    end_process(others[0])
    assert done.returncode == 0, done.stderr
    near = tmp_path / "near"
    simulate(duo, 2, out=near)
    assert len(table(far)) == 3
    assert table(far) == table(near)
    assert traces(far) == traces(near)


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_wrong_worker_and_the_end_of_the_scheduler_are_one_line_and_keep_finished_runs(
    tmp_path: Path, cluster: Cluster, swarmctl: Swarmctl
) -> None:
    """The scheduler ends here: this test comes last of the cluster's."""
    far = tmp_path / "far"

    def on_first_run(now: Progress) -> None:
        if now.done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):  # a folder with one finished run, done by this process
        simulate("aggregation", 3, set={"duration": 1}, out=far, on_progress=on_first_run)
    workers: tuple[tuple[str, str, dict[str, str], list[str]], ...] = (
        ("bare", str(ROOT), {}, ["swarmd"]),
        ("old", "", {"SWARMD_COMPILED": "0"}, ["kernels", "interpreted"]),
    )
    with dask_cluster(cluster.address) as executor:
        for name, lacks, environment, subjects in workers:
            worker = cluster.start_worker(name, lacks, **environment)
            with pytest.raises(SwarmError) as raised:
                simulate("aggregation", 3, set={"duration": 1}, out=far, executor=executor)
            end_process(worker)
            assert all(subject in str(raised.value) for subject in subjects)
            assert len(table(far)) == 2
    fit = cluster.start_worker("fit")

    def end_scheduler() -> None:
        wait_until(lambda: bool(children(fit)), "a run has begun", CAP)
        os.kill(fit, signal.SIGSTOP)  # no run ends before the scheduler does
        end_process(cluster.scheduler)

    thread = threading.Thread(target=end_scheduler)
    thread.start()
    words = ("exp", "run", "aggregation", "--seeds", 3, "--set", "duration=1", "--out", far)
    # In a process of its own: what Dask logs depends on the first import of Dask.
    done = swarmctl(*words, "--on", cluster.address, PYTHONUNBUFFERED="1")
    thread.join()
    assert done.returncode == 1
    (error,) = (line for line in done.stderr.splitlines() if " of 3 runs" not in line)
    assert error.startswith("error: the executor has ended")
    assert len(table(far)) == 2
    assert len(simulate("aggregation", 3, set={"duration": 1}, out=far).runs) == 3


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.timeout(600)
def test_submitit_does_runs_on_this_machine_as_slurm_does(tmp_path: Path) -> None:
    import submitit

    duo = write_duo(tmp_path)
    executor = submitit.LocalExecutor(folder=tmp_path / "logs")
    executor.update_parameters(timeout_min=5)
    far = tmp_path / "far"
    near = tmp_path / "near"
    simulate(duo, 1, out=far, executor=executor)
    simulate(duo, 1, out=near)
    assert table(far) == table(near)
    assert traces(far) == traces(near)


class Answered:
    """A call that has ended, and is no `Future`: as those of submitit."""

    def __init__(self, answer: bytes | Exception, looks: int = 0) -> None:
        self.answer = answer
        self.looks = looks  # at which it has not ended
        self.is_cancelled = False

    def done(self) -> bool:
        self.looks -= 1
        return self.looks < 0

    def result(self) -> bytes:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def cancel(self) -> None:
        self.is_cancelled = True


class Fake:
    """Takes calls, and answers them in their order."""

    def __init__(self, *calls: Call) -> None:
        self.calls = iter(calls)

    def submit(self, function: Any, /, *words: Any) -> Call:
        return next(self.calls)


def answer(run: str, refusal: str = "", trace: bytes | None = None) -> bytes:
    return pickle.dumps((refusal, JobResult(run, {"gap": 1.0}), trace))


@pytest.fixture(scope="module")
def jobs(tmp_path_factory: pytest.TempPathFactory) -> list[Job]:
    folder = tmp_path_factory.mktemp("traces")
    plan = plan_of("aggregation", range(2), {"duration": 1})
    return [
        Job(run.id, run.variant.effective, run.seed, folder / f"{run.id}.npz") for run in plan.runs
    ]


def test_results_and_traces_arrive_in_the_order_in_which_calls_end(jobs: list[Job]) -> None:
    late, soon = (
        Answered(answer(job.run, trace=job.run.encode()), 2 - n) for n, job in enumerate(jobs)
    )
    runner = on_executor(Fake(late, soon))
    assert [result.run for result in runner(jobs) if isinstance(result, JobResult)] == [
        jobs[1].run,
        jobs[0].run,
    ]
    assert [job.trace.read_bytes() for job in jobs if job.trace] == [b"s0000", b"s0001"]


def test_a_run_whose_workers_were_lost_fails_alone(jobs: list[Job]) -> None:
    runner = on_executor(Fake(Answered(ValueError("lost 4 times")), Answered(answer(jobs[1].run))))
    failed, finished = (result for result in runner(jobs) if isinstance(result, JobResult))
    assert (failed.run, failed.metrics) == (jobs[0].run, None)
    assert "lost 4 times" in failed.reason
    assert finished.metrics == {"gap": 1.0}


def cancelled() -> Call:
    future: Future[bytes] = Future()
    future.cancel()
    future.set_running_or_notify_cancel()
    return future


@pytest.mark.parametrize(
    ("call", "subject"),
    [
        (Answered(answer("s0000", "numpy is 1.0 there")), "numpy is 1.0 there"),
        (Answered(ModuleNotFoundError("No module named 'swarmd'")), "No module named 'swarmd'"),
        (cancelled(), "has ended"),
    ],
)
def test_a_wrong_worker_and_the_end_of_an_executor_end_the_experiment(
    jobs: list[Job], call: Call, subject: str
) -> None:
    other = Answered(answer(jobs[1].run), 10**9)
    with pytest.raises(SwarmError, match="finished runs are kept") as raised:
        list(
            on_executor(Fake(call, other) if isinstance(call, Answered) else Fake(call))(
                jobs if isinstance(call, Answered) else jobs[:1]
            )
        )
    assert subject in str(raised.value)
    assert other.is_cancelled == isinstance(call, Answered)


SOFTWARE = {"swarmd": "0.1.0", "kernels": "compiled", "processor": "one", "libc": "glibc 2.36"}


@pytest.mark.parametrize(
    ("there", "subject"),
    [
        (SOFTWARE, ""),
        ({**SOFTWARE, "processor": "another name"}, "processor"),
        ({**SOFTWARE, "swarmd": "0.2.0"}, "swarmd"),
        ({**SOFTWARE, "kernels": "interpreted"}, "kernels"),
        ({**SOFTWARE, "libc": "musl 1.2"}, "libc"),
        ({**SOFTWARE, "plugins/moody.py": "1f"}, "plugins/moody.py"),
        ({"swarmd": "0.1.0"}, "kernels"),
    ],
)
def test_a_difference_that_may_change_bits_is_named(there: dict[str, str], subject: str) -> None:
    assert difference(SOFTWARE, there).partition(" ")[0] == subject


@pytest.mark.parametrize(
    ("address", "wanted"),
    [
        ("tcp://127.0.0.1:8786", False),
        ("tcp://localhost:8786", False),
        ("tcp://[::1]:8786", False),
        ("tls://10.0.0.4:8786", False),
        ("inproc://10.0.0.4/1/2", False),
        ("tcp://10.0.0.4:8786", True),
        ("tcp://pc-4.class:8786", True),
        ("10.0.0.4:8786", True),
        ("ws://10.0.0.4:8786", True),
    ],
)
def test_plain_tcp_beyond_this_machine_is_open_to_others(address: str, wanted: bool) -> None:
    assert is_open(address) == wanted


@pytest.mark.parametrize("address", ["nonsense://x", "", "tls://127.0.0.1:1"])
def test_an_address_without_a_scheduler_is_refused(
    duo: Path, refusal: Refusal, address: str
) -> None:
    """The empty one is that of an unset variable of a shell; one of `tls` needs certificates."""
    words = ("exp", "run", duo, "--seeds", 1, "--out", "far", "--on", address)
    assert f"scheduler {address}:" in refusal(*words)


def test_the_option_of_0_2_0_that_names_a_cluster_is_taken_with_a_warning(
    duo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["exp", "run", str(duo), "--seeds", "1", "--scheduler", "nonsense://x", "--out", "far"]
    assert run_cli(cli, words, "swarmctl", exit_code_of) == 2
    warning, error = capsys.readouterr().err.splitlines()
    assert all(word in warning for word in ("--scheduler", "--on nonsense://x", "0.4.0"))
    assert "scheduler nonsense://x:" in error


def test_simulate_takes_the_scheduler_of_0_2_0_with_a_warning() -> None:
    with (
        pytest.warns(DeprecationWarning, match=r"executor=.* 0\.4\.0"),
        pytest.raises(ConfigError, match="scheduler nonsense://x:"),
    ):
        simulate("aggregation", 1, scheduler="nonsense://x")


@pytest.mark.parametrize(
    ("words", "subject"),
    [
        (("--on", "tcp://127.0.0.1:1", "-j", 2), "--jobs"),
        (("--on", "tcp://127.0.0.1:1", "--scheduler-file", "x"), "--scheduler-file"),
        (("--scheduler-file", "absent.json"), "absent.json"),
        (("--scheduler-file", __file__), "test_executor.py"),
    ],
)
def test_a_cluster_that_is_named_wrongly_is_refused(
    duo: Path, refusal: Refusal, words: tuple[object, ...], subject: str
) -> None:
    assert subject in refusal("exp", "run", duo, "--seeds", 1, "--out", "far", *words)


def test_a_missing_library_of_clusters_is_named_with_its_extra(
    duo: Path, monkeypatch: pytest.MonkeyPatch, refusal: Refusal
) -> None:
    monkeypatch.setattr(
        "swarmd.sim.cli.options.find_spec", lambda name: name != "distributed" or None
    )
    error = refusal("exp", "run", duo, "--on", "tcp://127.0.0.1:1", "--out", "x")
    assert "pip install 'swarmd[sim,plot,cluster]'" in error


def test_jobs_beside_an_executor_are_refused() -> None:
    with ThreadPoolExecutor(1) as executor, pytest.raises(SwarmError, match="executor"):
        simulate("aggregation", 1, jobs=2, executor=executor)
