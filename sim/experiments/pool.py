"""Simulation runs in worker processes: a run that crashes or hangs does not disturb other runs.

A worker process takes one job after another. It runs each job in a forked process, which sends
progress and result through a pipe. The parent process ends a worker whose run makes no progress.

Workers are pinned (`swarmd.core.pin`): their results have equal bits on every x86-64 with the same
software. A process keeps one worker that has no job, for its next call.
"""

from __future__ import annotations

import atexit
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.util import find_spec
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NoReturn, TypeAlias

import msgspec

from swarmd.core.errors import SwarmError
from swarmd.core.files import partial_path
from swarmd.core.pin import functions_here, pinned_environment
from swarmd.core.processes import (
    MAX_OUTPUT,
    die_with_parent,
    how_it_ended,
    limit_files,
    limit_growth,
)
from swarmd.core.python_path import replaced_text
from swarmd.pattern_host.sandbox import confine
from swarmd.sim.behaviour import hash_of, rules_of
from swarmd.sim.experiments.cores import core_share
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.catalog import measure, metric_of
from swarmd.sim.metrics.own import MetricError
from swarmd.sim.metrics.protection import FAILED_PATTERNS
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace

STEP_TIMEOUT = 60.0
"""Limit in s of wall time for one step of a simulation, for the set-up of a simulation, and for the
start of a worker, which takes 3 s on a busy machine."""
_EXIT_TIMEOUT = 2.0  # s for a worker without work to end by itself
_SHARE_OF_TIMEOUT = 0.8  # the limit of each process of a run, as a share of the run's time-out
_POLL_PERIOD = 0.5  # s between two checks of workers that report nothing
_PROGRESS_PERIOD = 0.25  # s between two reports of a worker
OWN_METRICS = 0.999
"""The reported share of a run while custom metrics are measured, which the time-out also limits."""
_MAX_LOG_TAIL = 8192  # bytes of a worker's output that are searched for its last line
_MAX_REASON = 300  # characters
_MAX_REPORT = 1 << 24  # bytes of one report of a worker; the metrics of a run take some kB
_SIZE_BYTES = 4  # before each report: its size, as multiprocessing's Connection sends it
_MODULE = "swarmd.sim.experiments.pool"
_GUEST_GROWTH = 1 << 30  # bytes; a run of twelve robots takes less than a tenth of that
_ONE_THREAD = {
    f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMEXPR", "VECLIB")
}

_ONE_ORDER = {"PYTHONHASHSEED": "0"}
"""A pattern may add in the order of a set of names, which else differs between processes."""


@dataclass(frozen=True, slots=True)
class Job:
    """A run to do."""

    run: str
    """The id of the run."""
    effective: Mapping[str, Any]
    """The complete scenario as plain values."""
    seed: int
    trace: Path | None
    """The path of the trace to write; None: no trace."""
    cores: int = 1
    """The number of processes that share the robots."""
    timeout: float = STEP_TIMEOUT
    """The time in s without progress of a process after which the run fails."""
    metrics: Mapping[str, str] = field(default_factory=dict)
    """Metrics beyond the catalog: the digest of the code (or "") by origin."""
    seconds: float = math.inf
    """The simulated time in s, if shorter than the scenario's duration."""
    guest: Path | None = None
    """A folder with a stranger's patterns.

    The run may read none of the user's other files, write nothing, grow by 1 GB, and print
    MAX_OUTPUT bytes."""


Shares: TypeAlias = Mapping[str, float]
"""The simulated share 0..1 of each run in progress, by run."""


@dataclass(frozen=True, slots=True)
class JobResult:
    """The result of a job."""

    run: str
    metrics: Mapping[str, float | None] | None = None
    """By name; None if the run failed or its trace could not be written."""
    wall: float = 0.0
    """The duration in s."""
    reason: str = ""
    """Why the run failed, in one line."""
    write_error: str = ""
    """Why the trace could not be written; the experiment then ends."""
    errors: Mapping[str, str] = field(default_factory=dict)
    """Why custom metrics have no value, by name; under FAILED_PATTERNS the first error of a
    pattern, with its line of code."""
    stored: str = ""
    """The day on which the run was made, if it was taken from the store of runs; empty: it was done
    now."""
    bits: str = ""
    """The hash of what the robots did (`behaviour.hash_of`); empty if the run failed."""
    rules: tuple[str, ...] = ()
    """The rules of protection and steering that acted (`behaviour.rules_of`)."""


_Functions: TypeAlias = Mapping[str, str]
"""What a worker computes with, by name: `functions_here`."""

_report = msgspec.msgpack.Decoder(JobResult | float)
_functions = msgspec.msgpack.Decoder(dict[str, str])


def run_job(job: Job, on_progress: Callable[[float], None] | None = None) -> JobResult:
    """Simulate a run, measure its metrics and write its trace, in this process.

    Any exception of the run is returned as `reason` of the result, since a pattern may raise any
    exception. `on_progress` is called with the simulated share 0..1 after each step.
    """
    start_time = time.perf_counter()
    failures: list[str] = []
    try:
        # Less than the pool's time-out: the error of `simulate_run`, which names the process of the
        # run that hangs, then comes before the error of the pool.
        timeout = _SHARE_OF_TIMEOUT * job.timeout
        scenario = scenario_of(job.effective)
        trace = simulate_run(
            scenario,
            job.seed,
            on_progress,
            cores=job.cores,
            timeout=timeout,
            seconds=job.seconds,
            on_failure=failures.append,
        )
        metrics = measure(trace)
        if job.metrics and on_progress is not None:
            on_progress(OWN_METRICS)  # from here on the time-out also limits custom metrics
        custom_metrics, errors = _custom_metrics(trace, job.metrics)
        bits = hash_of(trace)
        rules = rules_of(trace)
    except SwarmError as error:
        return JobResult(job.run, reason=one_line(str(error)))
    except Exception as error:
        return JobResult(job.run, reason=one_line(f"{type(error).__name__}: {error}"))
    if job.trace is not None:
        try:
            job.trace.parent.stat()  # OSError if the user has removed the folder of the traces
            trace.save(job.trace)
        except OSError as error:
            remove_partial(job.trace)
            return JobResult(job.run, write_error=f"{job.trace.parent}: {error.strerror or error}")
    errors.update((FAILED_PATTERNS, one_line(failure)) for failure in failures)
    wall = time.perf_counter() - start_time
    return JobResult(
        job.run,
        {**metrics, **custom_metrics},
        wall,
        errors=errors,
        bits=bits,
        rules=rules,
    )


def _custom_metrics(
    trace: Trace, digests: Mapping[str, str]
) -> tuple[dict[str, float | None], dict[str, str]]:
    """Custom metrics of a trace by name, None after an error; and the errors by name.

    `digests`: of the code by origin.
    """
    metrics = dict[str, float | None]()
    errors = dict[str, str]()
    for metric in (metric_of(origin, digest) for origin, digest in digests.items()):
        try:
            metrics |= measure(trace, [metric])
        except MetricError as error:
            metrics[metric.name] = None
            errors[metric.name] = one_line(str(error))
    return metrics, errors


def remove_partial(trace: Path | None) -> None:
    """Remove a partly written trace, if there is one."""
    with suppress(OSError):
        if trace is not None:
            partial_path(trace).unlink(missing_ok=True)


def one_line(text: str) -> str:
    """The text on one line of at most 300 characters."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))
    return line if len(line) <= _MAX_REASON else f"{line[: _MAX_REASON - 3]}..."


def run_jobs(
    jobs: Iterable[Job], processes: int, timeout: float = STEP_TIMEOUT, cores: int = 1
) -> Generator[JobResult | Shares, None, None]:
    """Run jobs in `processes` worker processes; yield the result of each job as it arrives.

    Between results, yield the simulated share (0..1) of each run in progress, by run. `cores`: the
    number of processes that share the robots of one run. A run without progress for `timeout` s
    fails, and its processes are killed; at a load above the cores of the machine these seconds
    count less (`core_share`). Close the iterator if it is not exhausted
    (`contextlib.closing`), since this ends the workers.
    """
    waiting = deque(replace(job, cores=cores, timeout=timeout) for job in jobs)
    workers: dict[Connection, _Worker] = {}  # by pipe
    kept = _kept_workers()

    def start_worker(job: Job) -> None:
        worker = kept.take() or _Worker()
        workers[worker.pipe] = worker
        worker.assign(job)

    try:
        for _ in range(min(processes, len(waiting))):
            start_worker(waiting.popleft())
        last_poll = last_report = time.monotonic()
        while workers:
            readable_pipes = wait(list(workers), _POLL_PERIOD)
            now = time.monotonic()
            # Limited: while this process and its workers were suspended, no worker was silent.
            silence = min(now - last_poll, 2.0 * _POLL_PERIOD) * core_share()
            last_poll = now
            for pipe, worker in list(workers.items()):
                worker.trim_log()
                if pipe in readable_pipes:
                    result = worker.receive(silence, timeout)  # None without the result of a run
                else:
                    result = worker.add_silence(silence, timeout)  # None before the time-out
                if result is None:
                    continue
                if worker.is_alive and waiting:
                    worker.assign(waiting.popleft())
                elif worker.is_alive:
                    kept.give(workers.pop(pipe))
                else:
                    workers.pop(pipe).end()
                    if waiting:
                        start_worker(waiting.popleft())
                yield result
            if workers and now >= last_report + _PROGRESS_PERIOD:
                last_report = now
                yield {worker.run: worker.share for worker in workers.values()}
    finally:
        for worker in workers.values():
            worker.kill()


def has_workers() -> bool:
    """Whether this system has worker processes; Windows has none, and lockstep runs without."""
    return find_spec("fcntl") is not None


def worker_functions() -> _Functions:
    """What a worker of this process computes with, as the worker itself found it.

    Without workers: this process. SwarmError if the worker does not start.
    """
    return _kept_workers().functions() if has_workers() else functions_here()


class _KeptWorkers:
    """The worker that this process keeps between two calls, so that a loop of calls starts one.

    A kept worker ends with this process, at the latest. Each job gets the present folder and
    environment; a change of a variable that acts at the start of a process takes a new worker.
    """

    def __init__(self) -> None:
        self._worker: _Worker | None = None
        self._lock = threading.Lock()
        # With the variables that a worker had at its start.
        self._functions: tuple[Mapping[str, str], _Functions] | None = None

    def take(self) -> _Worker | None:
        """The kept worker if it may be used here and now; else None."""
        with self._lock:
            worker = self._worker
            self._worker = None
        if worker is None or worker.is_ready():
            return worker
        worker.kill()
        return None

    def give(self, worker: _Worker) -> None:
        """Keep a worker without a job, or end it if another one is kept."""
        with self._lock:
            if self._worker is None:
                self._worker = worker
                return
        worker.end()

    def functions(self) -> _Functions:
        """What a worker of this process computes with; starts a worker if that is not known."""
        at_start = _surroundings().at_start
        with self._lock:
            known = self._functions
        if known is not None and known[0] == at_start:
            return known[1]
        worker = self.take() or _Worker()
        functions = worker.functions()
        self.give(worker)
        with self._lock:
            self._functions = at_start, functions
        return functions

    def end(self) -> None:
        """End the kept worker at once."""
        with self._lock:
            worker = self._worker
            self._worker = None
        if worker is not None:
            worker.kill()


_AT_START = ("PYTHON", "SWARMD_", "LD_", "GLIBC_", "NPY_", "OPENBLAS_", "OMP_", "MKL_", "MUJOCO_")


def _acts_at_start(name: str) -> bool:
    """Whether libraries read a variable of the environment once, as the process starts."""
    return name.startswith(_AT_START)


def variables_at_start() -> dict[str, str]:
    """The variables of the environment that act as a worker starts, by name."""
    return {name: text for name, text in os.environ.items() if _acts_at_start(name)}


@dataclass(frozen=True, slots=True)
class _Surroundings:
    """The folder and the environment that a process has at a time."""

    folder: str
    """Empty if it was removed."""
    environment: Mapping[str, str]
    at_start: Mapping[str, str]
    """The variables that act only at the start of a process; `environment` has the others."""


def _surroundings() -> _Surroundings:
    folder = ""
    with suppress(FileNotFoundError):
        folder = os.getcwd()
    at_start = variables_at_start()
    others = {name: text for name, text in os.environ.items() if name not in at_start}
    return _Surroundings(folder, others, at_start)


def _kept_workers() -> _KeptWorkers:
    """The kept workers of this process: a fork has its own."""
    return _kept_workers_of(os.getpid())


# A process has one such object, as it has one set of children: `simulate` is a function that a
# script calls in a loop, and no object lives between its calls.
@cache
def _kept_workers_of(pid: int) -> _KeptWorkers:
    kept = _KeptWorkers()

    def end() -> None:
        if os.getpid() == pid:  # not in a fork, which ends by itself
            kept.end()

    atexit.register(end)
    return kept


_Start: TypeAlias = Callable[[], subprocess.Popen[bytes]]


def _in_lasting_thread(start: _Start) -> subprocess.Popen[bytes]:
    """Start a process from a thread that lasts as long as this process.

    A worker ends with the thread that started it (`die_with_parent`), and threads of a caller end,
    such as those of a server or of an executor's worker.
    """
    if threading.current_thread() is threading.main_thread():
        return start()
    started: Future[subprocess.Popen[bytes]] = Future()
    _starts_of(os.getpid()).put((started, start))
    return started.result()


@cache
def _starts_of(pid: int) -> SimpleQueue[tuple[Future[subprocess.Popen[bytes]], _Start]]:
    """What the starting thread of this process is to start: a fork has no thread of its parent."""
    starts = SimpleQueue[tuple[Future[subprocess.Popen[bytes]], _Start]]()

    def serve() -> None:
        while True:
            started, start = starts.get()
            try:
                started.set_result(start())
            except BaseException as error:  # of the caller
                started.set_exception(error)

    threading.Thread(target=serve, name=f"swarmd-workers-{pid}", daemon=True).start()
    return starts


class _Worker:
    """A worker process, its pipe and its job."""

    def __init__(self) -> None:
        import fcntl  # not on Windows, where lockstep runs without workers

        self.is_alive = True  # can take another job
        self.share = 0.0  # simulated share of the job, as last reported
        self._at_start = _surroundings().at_start
        self._job: Job | None = None  # the last one
        self._begin = 0  # where the output of the job begins
        self._silence: float | None = 0.0  # s since the last report; None: no time-out any more
        self._has_started = False
        self._functions: _Functions = {}  # of the first report
        self.pipe, theirs = Pipe()
        self._received = bytearray()  # a part of a report
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `kill`
        fcntl.fcntl(self._log, fcntl.F_SETFL, os.O_APPEND)  # also behind `trim_log`
        with theirs:
            self._process = _in_lasting_thread(
                lambda: subprocess.Popen(
                    [sys.executable, "-P", "-m", _MODULE, str(theirs.fileno()), str(os.getpid())],
                    pass_fds=(theirs.fileno(),),
                    stdin=subprocess.DEVNULL,
                    stdout=self._log,
                    stderr=self._log,
                    env={**pinned_environment(), **_ONE_THREAD, **_ONE_ORDER},
                    process_group=0,  # Ctrl-C goes to the parent, which ends the workers
                )
            )

    @property
    def run(self) -> str:
        """The id of the present job's run."""
        return "" if self._job is None else self._job.run

    def is_ready(self) -> bool:
        """Whether the worker can take a job, and started as it would start now."""
        return self._at_start == _surroundings().at_start and self._process.poll() is None

    def functions(self) -> _Functions:
        """What the worker computes with: waits for its start. SwarmError if it does not start."""
        silence = 0.0
        last_look = time.monotonic()
        while not self._functions:
            is_readable = bool(wait([self.pipe], _POLL_PERIOD))
            now = time.monotonic()
            silence += min(now - last_look, 2.0 * _POLL_PERIOD) * core_share()
            last_look = now
            failure = self.receive(0.0, math.inf) if is_readable else None
            if failure is None and silence >= STEP_TIMEOUT:
                self._end_group()
                failure = self._failed(f"no sign of life in {STEP_TIMEOUT:g} s")
            if failure is not None:
                self.kill()
                raise SwarmError(f"a worker process did not start: {failure.reason}")
        return self._functions

    def assign(self, job: Job) -> None:
        """Send a job to the worker; if the worker has ended, `receive` returns the failure."""
        self._job = job
        self.share = 0.0
        self._silence = 0.0
        self._begin = os.fstat(self._log.fileno()).st_size
        with suppress(OSError):
            self.pipe.send((job, _surroundings()))

    def receive(self, silence: float, timeout: float) -> JobResult | None:
        """Read what the pipe holds, which must be readable.

        Returns the result of the job, or None without it. A guest's pattern may write a part of a
        report, for whose rest this process does not wait: without a whole report, `silence` s count
        as of `add_silence`. If the worker has ended, the result is a failure.
        """
        try:
            piece = os.read(self.pipe.fileno(), _MAX_REPORT)
            if not piece:
                raise EOFError
            self._received += piece
            reports = [*self._reports()]
        except Exception:  # the worker's end, or bytes that a pattern wrote into the pipe
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_EXIT_TIMEOUT)
            self._end_group()
            code = self._process.returncode
            hint = " (out of memory, or killed by hand)" if code == -signal.SIGKILL else ""
            if not self._has_started and (replaced := replaced_text()):  # it imports before that
                hint = f" ({replaced} swarmctl)"
            return self._failed(f"its process {how_it_ended(code)}{hint}")
        for report in reports:
            if isinstance(report, JobResult):
                return report
            self._has_started = True
            self.share = report
            self._silence = 0.0 if report < 1.0 else None  # from here on only our own code runs
        return None if reports else self.add_silence(silence, timeout)

    def _reports(self) -> Iterator[JobResult | float]:
        """The whole reports that are received; ValueError for bytes that are no report."""
        while len(self._received) >= _SIZE_BYTES:
            size = int.from_bytes(self._received[:_SIZE_BYTES])
            end = _SIZE_BYTES + size
            if size > _MAX_REPORT:
                raise ValueError(size)
            if len(self._received) < end:
                return
            if not self._functions:  # before any job, so before any code of others
                self._functions = _functions.decode(self._received[_SIZE_BYTES:end])
                del self._received[:end]
                yield 0.0
                continue
            # Values alone: a guest's pattern could write a pickle, which would run in this process.
            report = _report.decode(self._received[_SIZE_BYTES:end])
            if isinstance(report, JobResult) and report.run != self.run:
                raise ValueError(report.run)
            del self._received[:end]
            yield report

    def add_silence(self, seconds: float, timeout: float) -> JobResult | None:
        """Add seconds without a report; at the limit, end the worker and return the failure."""
        if self._silence is None:
            return None
        self._silence += seconds
        if self._silence < (timeout if self._has_started else max(timeout, STEP_TIMEOUT)):
            return None
        self._end_group()
        return self._failed(f"no progress in {timeout:g} s; a pattern or metric may not return")

    def trim_log(self) -> None:
        """Empty the log if it is long: a pattern may print in each step."""
        if os.fstat(self._log.fileno()).st_size > MAX_OUTPUT:
            os.truncate(self._log.fileno(), 0)
            self._begin = 0

    def end(self) -> None:
        """Close the pipe, which ends an idle worker, and wait for the end of the process."""
        self.pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_EXIT_TIMEOUT)
        self.kill()

    def kill(self) -> None:
        """End the worker with SIGKILL, and remove a partly written trace."""
        self._end_group()
        remove_partial(None if self._job is None else self._job.trace)
        self.pipe.close()
        self._log.close()

    def _end_group(self) -> None:
        """End the worker and all processes that the worker or a pattern has started."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _failed(self, reason: str) -> JobResult:
        self.is_alive = False
        return JobResult(self.run, reason=f"{reason}{self._last_line()}")

    def _last_line(self) -> str:
        """The last line of the worker's output since the assignment of the job, after ": "."""
        end = self._log.seek(0, os.SEEK_END)
        self._log.seek(max(self._begin, end - _MAX_LOG_TAIL))
        lines = self._log.read().decode(errors="replace").split("\n")
        written = [line for line in lines if line.strip()]
        return f": {one_line(written[-1])}" if written else ""


def main(descriptor: int, parent: int) -> None:
    """The main function of a worker process: run jobs from the pipe until the pipe is closed.

    `descriptor`: the file descriptor of the pipe. `parent`: the process id of the pool, with whose
    end this process ends.
    """
    die_with_parent(parent)
    # Imported once, before the forks: modules of jobs, and lazy imports of metrics. A run of two
    # robots and 2 s takes 0.07 s of CPU, and 0.32 s if its fork has to import scipy.
    import scipy.sparse.csgraph
    import scipy.spatial  # noqa: F401

    import swarmd.sim.experiments.pool  # noqa: F401

    with Connection(descriptor) as connection:
        connection.send_bytes(msgspec.msgpack.encode(functions_here()))  # started
        while True:
            try:
                job, surroundings = connection.recv()
            except EOFError:
                return
            _run_in_fork(job, surroundings, connection)


def _send(connection: Connection, report: JobResult | float) -> None:
    """Report a result, or the share of the job that is done."""
    connection.send_bytes(msgspec.msgpack.encode(report))


def _run_in_fork(job: Job, surroundings: _Surroundings, connection: Connection) -> None:
    """Run the job in a forked child process of this worker, and wait for the end of the child.

    A fork is a fresh process for each run that has all imports of the worker. The child sends
    progress and result through `connection`. If the child ends without a result, this worker ends
    with the same exit code or by the same signal, which tells the pool the reason.
    """
    # A second pipe: the child writes one byte once the result is sent.
    read_end, write_end = os.pipe()
    worker_pid = os.getpid()
    child_pid = os.fork()
    if child_pid == 0:
        die_with_parent(worker_pid)
        # A process that a pattern forks must not write into the pipe of results.
        os.register_at_fork(after_in_child=connection.close)
        _enter(surroundings)
        _do(job, connection)
        os.write(write_end, b"1")
        os._exit(0)  # without waiting for threads of a pattern
    os.close(write_end)
    _, status = os.waitpid(child_pid, 0)
    if not _has_byte(read_end):
        _end_like(os.waitstatus_to_exitcode(status))
    os.close(read_end)


def _enter(surroundings: _Surroundings) -> None:
    """Give this fork the folder and the environment that its user has now.

    What libraries read at the start of the worker stays.
    """
    with suppress(OSError):  # the folder was removed
        os.chdir(surroundings.folder)
    for name in [name for name in os.environ if not _acts_at_start(name)]:
        del os.environ[name]
    os.environ.update(surroundings.environment)


def _has_byte(read_end: int) -> bool:
    """True if a pipe holds a byte; called when the child that writes the byte has ended.

    A process that the child's pattern has forked may still hold the writing end. Then a read of an
    empty pipe would block, so the read end is set to raise BlockingIOError.
    """
    os.set_blocking(read_end, False)
    with suppress(BlockingIOError):
        return os.read(read_end, 1) == b"1"
    return False


def _end_like(exit_code: int) -> NoReturn:
    """End this process with an exit code, or by the signal that a negative exit code means."""
    if exit_code < 0:
        with suppress(OSError, ValueError):  # SIGKILL has no handler
            signal.signal(-exit_code, signal.SIG_DFL)
        os.kill(os.getpid(), -exit_code)
    os._exit(exit_code)


def _do(job: Job, connection: Connection) -> None:
    """Run the job in this fork, confined if its patterns are a stranger's, and send the reports."""
    from swarmd.sim.experiments.pool import run_job

    next_report = 0.0

    def report(share: float) -> None:
        nonlocal next_report
        now = time.monotonic()
        if now >= next_report or share in (OWN_METRICS, 1.0):
            next_report = now + _PROGRESS_PERIOD
            _send(connection, share)

    if job.guest is not None:
        limit_growth(_GUEST_GROWTH)
        limit_files()
        confine([job.guest])
    _send(connection, run_job(job, report))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
