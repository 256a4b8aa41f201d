"""A Dask cluster of real processes gives what one machine gives, also if a worker is lost."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from swarmd.sim.experiments.cluster import software_difference
from swarmd.sim.experiments.simulate import Progress, simulate
from tests.sim.conftest import Refusal, Swarmctl, write_duo
from tests.support.processes import children, end_process, wait_until

CAP = 120.0  # s; a process of Dask starts in 1 to 2 s of CPU, and may be stopped meanwhile
ROOT = Path(__file__).parents[3]
# Reads a line for each process, and forks it with the imports of Dask and of runs, which take most
# of a start. The forks end with this process, and this process with its standard input.
FORKS = """
import json, os, sys
import distributed.cli.dask_scheduler, distributed.cli.dask_worker
import swarmd.sim.experiments.cluster, swarmd.sim.experiments.pool
from swarmd.core.processes import die_with_parent

def start(program, words, log, lacks):
    sys.stdin.close()
    die_with_parent(parent)
    os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT), 1)
    os.dup2(1, 2)
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
    """A scheduler on loopback, and workers of one thread."""

    def __init__(self, folder: Path, forks: subprocess.Popen[str]) -> None:
        self.folder, self._forks = folder, forks
        about = folder / "scheduler.json"
        words = ("--host", "tcp://127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file")
        self.scheduler = self._start("scheduler", "scheduler", *words, str(about))
        wait_until(lambda: about.exists() and about.read_text().endswith("}"), "it is up", CAP)
        self.address: str = json.loads(about.read_text())["address"]

    def start_worker(self, name: str, lacks: str = "") -> tuple[str, int]:
        """Start a worker, and wait until it has joined; its address and process id.

        `lacks`: a folder that its Python does not search.
        """
        words = ("--host", "127.0.0.1", "--no-nanny", "--no-dashboard", "--nthreads", "1")
        where = ("--local-directory", str(self.folder / name))
        pid = self._start("worker", name, self.address, *words, *where, lacks=lacks)
        log = self.folder / f"{name}.log"
        wait_until(lambda: log.exists() and "Registered to" in log.read_text(), name, CAP)
        (line,) = (line for line in log.read_text().splitlines() if "Start worker at" in line)
        return line.split()[-1], pid

    def _start(self, program: str, name: str, *words: str, lacks: str = "") -> int:
        request = {"program": program, "words": words, "lacks": lacks}
        request["log"] = str(self.folder / f"{name}.log")
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


@pytest.fixture(scope="module")
def fit(cluster: Cluster) -> tuple[str, int]:
    """A worker with the software of this process: its address and process id."""
    return cluster.start_worker("fit")


@pytest.fixture(scope="module")
def bare(cluster: Cluster) -> tuple[str, int]:
    """A worker without swarmd: its address and process id."""
    return cluster.start_worker("bare", lacks=str(ROOT))


def table(folder: Path) -> list[str]:
    """The rows without their durations."""
    return [line.rpartition(",")[0] for line in (folder / "runs.csv").read_text().splitlines()]


def traces(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "traces").iterdir()}


def is_alive(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.timeout(400)
def test_results_are_those_of_one_machine_though_a_worker_is_killed(
    tmp_path: Path,
    cluster: Cluster,
    fit: tuple[str, int],
    bare: tuple[str, int],
    caplog: pytest.LogCaptureFixture,
) -> None:
    from distributed import Client

    duo = write_duo(tmp_path)
    killed, killed_pid = cluster.start_worker("killed")
    progress: list[Progress] = []

    def on_progress(now: Progress) -> None:
        progress.append(now)
        if killed in now.workers:
            end_process(killed_pid)

    runs: dict[str, Any] = {"scenario": duo, "seeds": 2, "set": {"duration": 1}}
    with Client(cluster.address, set_as_default=False) as client:
        of_others = client.submit(sum, [3, 4], workers=[bare[0]])
        far = tmp_path / "far"
        simulate(**runs, out=far, scheduler=cluster.address, on_progress=on_progress)
        assert of_others.result(CAP) == 7
        assert client.submit(sum, [4, 5], workers=[bare[0]]).result(CAP) == 9
    simulate(**runs, out=tmp_path / "near")
    assert len(table(far)) == 3
    assert table(far) == table(tmp_path / "near")
    assert traces(far) == traces(tmp_path / "near")
    assert {worker for now in progress for worker in now.workers} == {killed, fit[0]}
    assert progress[-1].workers == {}
    assert is_alive(bare[1])
    assert not is_alive(killed_pid)
    lines = {worker: [m for m in caplog.messages if worker in m] for worker in (killed, bare[0])}
    (lost,), (refused,) = lines.values()
    assert "is repeated" in lost
    assert "No module named 'swarmd'" in refused


@pytest.mark.integration
@pytest.mark.long
@pytest.mark.timeout(400)
def test_finished_runs_are_kept_by_ctrl_c_and_without_the_scheduler(
    tmp_path: Path, cluster: Cluster, fit: tuple[str, int], swarmctl: Swarmctl
) -> None:
    """The scheduler ends here: this test comes last."""
    far, duration = tmp_path / "far", {"duration": 1}
    _, pid = fit

    def on_first_run(now: Progress) -> None:  # done by this process
        if now.done == 1:
            raise KeyboardInterrupt

    def on_held_run(now: Progress) -> None:
        if now.workers and children(pid):
            raise KeyboardInterrupt

    for where, interrupt in ((None, on_first_run), (cluster.address, on_held_run)):
        with pytest.raises(KeyboardInterrupt):
            simulate(
                "aggregation", 2, set=duration, out=far, scheduler=where, on_progress=interrupt
            )
        assert len(table(far)) == 2
    wait_until(lambda: not children(pid), "the run is cancelled", CAP)

    def end_scheduler() -> None:
        wait_until(lambda: bool(children(pid)), "a run has begun", CAP)
        end_process(cluster.scheduler)

    thread = threading.Thread(target=end_scheduler)
    thread.start()
    words = ("exp", "run", "aggregation", "--seeds", 2, "--set", "duration=1", "--out", far)
    # Of a process of its own: what Dask logs depends on the first import of Dask.
    done = swarmctl(*words, "--scheduler", cluster.address, PYTHONUNBUFFERED="1")
    thread.join()
    assert done.returncode == 1
    expected = (" of 2 runs", "No module named 'swarmd'")  # progress, and the worker `bare`
    told = done.stderr.splitlines()
    (error,) = (line for line in told if not any(text in line for text in expected))
    assert error.startswith("error: ")
    assert cluster.address in error
    assert len(table(far)) == 2


SOFTWARE = {"swarmd": "0.1.0", "kernels": "compiled", "libm": "0c", "libc": "glibc 2.36"}


@pytest.mark.parametrize(
    ("answer", "subject"),
    [
        (SOFTWARE, ""),
        ({**SOFTWARE, "processor": "another name"}, ""),
        ({**SOFTWARE, "swarmd": "0.2.0"}, "swarmd"),
        ({**SOFTWARE, "kernels": "interpreted"}, "kernels"),
        ({**SOFTWARE, "libm": "0d"}, "libm"),
        ({**SOFTWARE, "libc": "musl 1.2"}, "libc"),
        ({**SOFTWARE, "plugins/moody.py": "1f"}, "plugins/moody.py"),
        ({"swarmd": "0.1.0"}, "kernels"),
        (ModuleNotFoundError("No module named 'swarmd'"), "ModuleNotFoundError"),
    ],
)
def test_a_difference_that_may_change_bits_is_named(
    answer: Mapping[str, str] | Exception, subject: str
) -> None:
    difference = software_difference(SOFTWARE, answer)
    assert difference.partition(":")[0].partition(" ")[0] == subject


@pytest.mark.parametrize("address", ["nonsense://x", ""])
def test_an_address_without_a_scheduler_is_refused(
    duo: Path, refusal: Refusal, address: str
) -> None:
    """The empty one is that of an unset variable of a shell."""
    words = ("exp", "run", duo, "--seeds", 1, "--out", "far", "--scheduler", address)
    assert f"scheduler {address}:" in refusal(*words)


def test_a_missing_library_of_clusters_is_named_with_its_extra(
    duo: Path, monkeypatch: pytest.MonkeyPatch, refusal: Refusal
) -> None:
    monkeypatch.setattr(
        "swarmd.sim.cli.options.find_spec", lambda name: name != "distributed" or None
    )
    error = refusal("exp", "run", duo, "--scheduler", "tcp://127.0.0.1:1", "--out", "x")
    assert "pip install 'swarmd[sim,plot,cluster]'" in error
