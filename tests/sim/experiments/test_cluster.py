"""A Dask cluster of real processes gives what one machine gives, also if workers are lost."""

from __future__ import annotations

import json
import os
import pickle
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest

from swarmd.sim.experiments.cluster import software_query
from swarmd.sim.experiments.simulate import simulate
from tests.sim.conftest import MAIN, Swarmctl
from tests.support.processes import children, wait_until

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed"),
]
ENDS = "groups.all.parameters.end"


@contextmanager
def process(*words: object, log: Path, **environ: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process of a cluster; it and its children are gone at the end."""
    with log.open("wb") as file:
        started = subprocess.Popen(
            [sys.executable, *map(str, words)],
            stdout=file,
            stderr=file,
            cwd=log.parent,
            env={**os.environ, **environ},
        )
    try:
        yield started
    finally:
        started.kill()
        started.wait()


class Cluster:
    """A scheduler on loopback, and workers of one thread."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        folder.mkdir()
        self.folder, self._stack = folder, stack
        self.about = folder / "scheduler.json"
        self.workers: list[subprocess.Popen[bytes]] = []
        words = (
            "-m",
            "dask",
            "scheduler",
            "--host",
            "tcp://127.0.0.1",
            "--port",
            0,
            "--no-dashboard",
        )
        self.scheduler = self._start(*words, "--scheduler-file", self.about, name="scheduler")
        wait_until(self._has_address, "the scheduler has an address")
        self.address = json.loads(self.about.read_text())["address"]

    def add_worker(self, code: str = "", **environ: str) -> subprocess.Popen[bytes]:
        """A worker that has joined. `code`: Python that starts it, in place of Dask's program."""
        name = f"worker-{len(self.workers)}"
        start = ("-c", code) if code else ("-m", "dask", "worker")
        words = (*start, self.address, "--host", "127.0.0.1", "--no-nanny")
        more = ("--nthreads", 1, "--no-dashboard", "--local-directory", self.folder / name)
        worker = self._start(*words, *more, "--name", name, name=name, **environ)
        log = self.folder / f"{name}.log"
        wait_until(lambda: "Registered to" in log.read_text(), f"{name} has joined")
        self.workers.append(worker)
        return worker

    def _start(self, *words: object, name: str, **environ: str) -> subprocess.Popen[bytes]:
        log = self.folder / f"{name}.log"
        return self._stack.enter_context(process(*words, log=log, **environ))

    def _has_address(self) -> bool:
        return self.about.exists() and self.about.read_text().rstrip().endswith("}")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with ExitStack() as stack:
        yield Cluster(tmp_path / "cluster", stack)


def table(folder: Path) -> list[str]:
    """The rows without their durations."""
    return [line.rpartition(",")[0] for line in (folder / "runs.csv").read_text().splitlines()]


def traces(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "traces").iterdir()}


def begun(*words: object, cwd: Path) -> subprocess.Popen[str]:
    """A `swarmctl` in the background."""
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", MAIN, *map(str, words)]
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=cwd)


def is_running_one(worker: subprocess.Popen[bytes]) -> bool:
    return bool(children(worker.pid))


@pytest.mark.timeout(300)
def test_all_runs_are_there_though_a_worker_is_killed(
    tmp_path: Path, duo: Path, cluster: Cluster
) -> None:
    command = ("exp", "run", duo, "--seeds", 2, "--set", "duration=1", "--set", f"{ENDS}=slow")
    where = ("--scheduler", cluster.address, "--timeout", 20, "--out", "far")
    killed, _ = (cluster.add_worker() for _ in range(2))
    running = begun(*command, *where, cwd=tmp_path)
    wait_until(lambda: is_running_one(killed), "it works")
    killed.kill()
    _, told = running.communicate(timeout=200)
    assert running.returncode == 0, told
    assert told.count("is repeated") >= 1, told
    simulate(duo, 2, set={"duration": 1}, out=tmp_path / "near")  # not slow: with the same results
    assert len(table(tmp_path / "far")) == 3
    assert table(tmp_path / "far") == table(tmp_path / "near")
    assert traces(tmp_path / "far") == traces(tmp_path / "near")


@pytest.mark.evidence
@pytest.mark.timeout(300)
def test_all_runs_are_there_though_one_worker_is_killed_and_one_hangs(
    tmp_path: Path, duo: Path, cluster: Cluster, swarmctl: Swarmctl
) -> None:
    command = ("exp", "run", duo, "--seeds", 4, "--set", "duration=1.2", "--set", f"{ENDS}=slow")
    where = ("--scheduler", cluster.address, "--timeout", 6, "--out", "far")
    is_refused(swarmctl(*command, *where), 1, "no worker")
    assert not (tmp_path / "far").exists()
    killed, hung, _ = (cluster.add_worker() for _ in range(3))
    running = begun(*command, *where, cwd=tmp_path)
    wait_until(lambda: is_running_one(killed) and is_running_one(hung), "both work")
    killed.kill()
    hung.send_signal(signal.SIGSTOP)
    _, told = running.communicate(timeout=200)
    assert running.returncode == 0, told
    assert told.count("is repeated") >= 2, told
    simulate(duo, 4, set={"duration": 1.2, ENDS: "slow"}, out=tmp_path / "near")
    assert len(table(tmp_path / "far")) == 5
    assert table(tmp_path / "far") == table(tmp_path / "near")
    assert traces(tmp_path / "far") == traces(tmp_path / "near")
    hung.send_signal(signal.SIGCONT)
    wait_until(lambda: not is_running_one(hung), "what it did is cancelled")
    of_worker = cluster.folder / "worker-1"
    wait_until(lambda: not list(of_worker.rglob("swarmd-*")), "its files are removed")


def is_refused(done: subprocess.CompletedProcess[str], code: int, subject: str) -> None:
    """It ended in one line about the subject, and made nothing."""
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    assert subject in done.stderr
    assert done.stderr.count("\n") == 1, done.stderr


@pytest.mark.evidence
@pytest.mark.timeout(300)
def test_runs_that_crash_or_hang_fail_alone(
    tmp_path: Path, duo: Path, cluster: Cluster, swarmctl: Swarmctl
) -> None:
    cluster.add_worker()
    command = ("exp", "run", duo, "--seeds", 1, "--sweep", f"{ENDS}=hang,exit,none", "--no-traces")
    done = swarmctl(*command, "--scheduler", cluster.address, "--timeout", 3, "--out", "far")
    assert done.returncode == 3, done.stderr
    assert "failed: end=hang_s0000: no progress in 3 s" in done.stderr
    assert "failed: end=exit_s0000: its process ended with code 7: moody" in done.stderr
    assert [line.split(",")[0] for line in table(tmp_path / "far")[1:]] == ["end=none_s0000"]


@pytest.mark.evidence
@pytest.mark.timeout(300)
def test_ctrl_c_cancels_what_runs_and_keeps_what_is_finished(
    tmp_path: Path, duo: Path, cluster: Cluster
) -> None:
    worker = cluster.add_worker()
    command = ("exp", "run", duo, "--seeds", 2, "--sweep", "duration=1,1e5", "--no-traces")
    running = begun(*command, "--scheduler", cluster.address, "--out", "far", cwd=tmp_path)
    far = tmp_path / "far"
    wait_until(lambda: (far / "runs.csv").exists() and len(table(far)) == 3, "two runs are done")
    wait_until(lambda: is_running_one(worker), "the next one runs")
    running.send_signal(signal.SIGINT)
    _, told = running.communicate(timeout=60)
    assert running.returncode == 130, told
    assert "2 of 4 runs are kept; to go on: swarmctl exp run" in told
    assert "Traceback" not in told
    wait_until(lambda: not is_running_one(worker), "it is cancelled")


@pytest.mark.evidence
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("number", "words"),
    [(signal.SIGKILL, "is gone"), (signal.SIGSTOP, "has not answered for 5 s")],
)
def test_a_scheduler_that_ends_or_hangs_is_one_line_and_keeps_finished_runs(
    tmp_path: Path, duo: Path, cluster: Cluster, number: signal.Signals, words: str
) -> None:
    cluster.add_worker()
    command = ("exp", "run", duo, "--seeds", 1, "--sweep", "duration=1,900", "--no-traces")
    where = ("--timeout", 2, "--scheduler", cluster.address, "--out", "far")
    running = begun(*command, *where, cwd=tmp_path)
    far = tmp_path / "far"
    wait_until(lambda: (far / "runs.csv").exists() and len(table(far)) == 2, "one run is done")
    cluster.scheduler.send_signal(number)
    _, told = running.communicate(timeout=100)
    assert running.returncode == 1, told
    assert told.splitlines()[-1].startswith(f"error: the scheduler at {cluster.address} {words}")
    assert len(table(far)) == 2


LACKS = "import sys; sys.modules['swarmd'] = None"


def test_the_first_question_to_a_worker_needs_no_swarmd(tmp_path: Path) -> None:
    code = (
        "import pickle, sys\ncall = pickle.load(sys.stdin.buffer)\n"
        "try:\n    call()\nexcept ModuleNotFoundError as error:\n    print(error.name)"
    )
    words = [sys.executable, "-S", "-c", code]  # -S: without installed packages
    question = pickle.dumps(software_query(["p"], []))
    done = subprocess.run(words, input=question, capture_output=True, cwd=tmp_path, check=False)
    assert (done.stdout, done.stderr) == (b"swarmd\n", b"")


@pytest.mark.evidence
@pytest.mark.timeout(300)
def test_a_worker_without_swarmd_is_named_and_lives_on(
    tmp_path: Path, duo: Path, cluster: Cluster, swarmctl: Swarmctl
) -> None:
    bare = cluster.add_worker(code=f"{LACKS}\nfrom distributed.cli.dask_worker import main; main()")
    command = ("exp", "run", duo, "--seeds", 1, "--set", "duration=0.6", "--out", "far")
    where = ("--scheduler", cluster.address, "--timeout")
    done = swarmctl(*command, *where, 10)
    assert done.returncode == 1
    assert "none has swarmd" in done.stderr
    cluster.add_worker()
    done = swarmctl(*command, *where, 90)
    assert done.returncode == 0, done.stderr
    assert re.search("worker tcp://127.0.0.1:[0-9]+ is not used: .*swarmd", done.stderr)
    assert bare.poll() is None
    assert "Registered to" in (cluster.folder / "worker-0.log").read_text()


@pytest.mark.evidence
def test_other_software_of_a_worker_is_refused_by_its_name(
    tmp_path: Path, duo: Path, cluster: Cluster, swarmctl: Swarmctl
) -> None:
    cluster.add_worker(OPENBLAS_CORETYPE="Nehalem", SWARMD_COMPILED="0")
    words = ("exp", "run", duo, "--seeds", 1, "--scheduler", cluster.address, "--out", "far")
    if "compiled" not in (done := swarmctl(*words, SWARMD_COMPILED="1")).stderr:
        pytest.skip("the kernels are not compiled here")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert "worker tcp://127.0.0.1:" in done.stderr
    assert "kernels was" in done.stderr
    assert not (tmp_path / "far").exists()
    alike = swarmctl(*words, SWARMD_COMPILED="0")
    assert alike.returncode == 0, alike.stderr
    made_with = json.loads((tmp_path / "far" / "manifest.json").read_text())["made_with"]
    assert made_with["blas"] == "Nehalem"  # of the worker, and not of this machine


@pytest.mark.parametrize(
    "address", ["nonsense://x", pytest.param("tcp://127.0.0.1:1", marks=pytest.mark.evidence)]
)
def test_a_cluster_that_is_not_there_is_one_line(
    tmp_path: Path, duo: Path, swarmctl: Swarmctl, address: str
) -> None:
    words = ("exp", "run", duo, "--seeds", 1, "--out", "far", "--timeout", 1, "--scheduler")
    is_refused(swarmctl(*words, address), 2, f"--scheduler {address}")
    assert not (tmp_path / "far").exists()
