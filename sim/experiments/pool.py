"""Runs in worker processes: a run that crashes or hangs fails alone.

A worker process runs jobs one after the other, each in a fork of its own, and reports progress and
results through a pipe. The parent ends a worker whose run makes no progress.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, TypeAlias

import msgspec

from swarmd.core.errors import SwarmError
from swarmd.core.files import partial_path
from swarmd.core.processes import die_with_parent, how_it_ended, limit_growth
from swarmd.pattern_host.sandbox import confine
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.catalog import measure, metric_of
from swarmd.sim.metrics.own import MetricError
from swarmd.sim.scenarios.scenariofile import scenario_of

STEP_TIMEOUT = 60.0
"""Limit in s of wall time for one step of a simulation, or for its set-up, and for the start of a
worker, which takes 3 s on a busy machine."""
_EXIT_TIMEOUT = 2.0  # s for a worker without work to end by itself
_SHARE_OF_TIMEOUT = 0.8  # of the limit for a run, for each of several processes of it
_POLL_PERIOD = 0.5  # s between two checks of workers that report nothing
_PROGRESS_PERIOD = 0.25  # s between two reports of a worker
OWN_METRICS = 0.999
"""The share of a run before custom metrics: they are under the time-out, as patterns are."""
_MAX_LOG_TAIL = 8192  # bytes of a worker's output that are searched for its last line
_MAX_REASON = 300  # characters
_MAX_REPORT = 1 << 24  # bytes of one report of a worker; the metrics of a run take some kB
_MODULE = "swarmd.sim.experiments.pool"
_GUEST_GROWTH = 1 << 30  # bytes; a run of twelve robots takes less than a tenth
_ONE_THREAD = {
    f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMEXPR", "VECLIB")
}


@dataclass(frozen=True, slots=True)
class Job:
    """A run: its id, a complete scenario as plain values, a seed, and the path of its trace.

    `metrics`: those measured besides the catalog's, by origin, each with the digest of its code.
    `cores` processes share its robots. A process without progress for `timeout` s ends the run.
    `guest`: a folder with patterns of others; the run may read nothing else of the user, write
    nothing, and grow by 1 GB.
    """

    run: str
    effective: Mapping[str, Any]
    seed: int
    trace: Path | None
    cores: int = 1
    timeout: float = STEP_TIMEOUT
    metrics: Mapping[str, str] = field(default_factory=dict)
    guest: Path | None = None


Shares: TypeAlias = Mapping[str, float]
"""The simulated share of each run that is in progress, by run."""


@dataclass(frozen=True, slots=True)
class JobResult:
    """The result of a job: `metrics` by name, or None and the reason in one line.

    `write_error` is set if the trace could not be written; then no other trace can be written
    either. `wall` is the duration in s. `errors`: why custom metrics have no value, by name.
    """

    run: str
    metrics: Mapping[str, float | None] | None = None
    wall: float = 0.0
    reason: str = ""
    write_error: str = ""
    errors: Mapping[str, str] = field(default_factory=dict)


_report = msgspec.msgpack.Decoder(JobResult | float)


def run_job(job: Job, on_progress: Callable[[float], None] | None = None) -> JobResult:
    """Simulate, measure and write the trace, in this process.

    An error in the run is returned as the reason, not raised: patterns may come from anyone.
    `on_progress` receives the simulated share after each step.
    """
    begin = time.perf_counter()
    try:
        limit = _SHARE_OF_TIMEOUT * job.timeout  # so that the run names the process, not the pool
        scenario = scenario_of(job.effective)
        trace = simulate_run(scenario, job.seed, on_progress, cores=job.cores, timeout=limit)
        metrics, errors = measure(trace), dict[str, str]()
        if job.metrics and on_progress is not None:
            on_progress(OWN_METRICS)
        for metric in (metric_of(origin, digest) for origin, digest in job.metrics.items()):
            try:
                metrics |= measure(trace, [metric])
            except MetricError as error:
                metrics[metric.name], errors[metric.name] = None, one_line(str(error))
    except SwarmError as error:
        return JobResult(job.run, reason=one_line(str(error)))
    except Exception as error:
        return JobResult(job.run, reason=one_line(f"{type(error).__name__}: {error}"))
    if job.trace is not None:
        try:
            job.trace.parent.stat()  # a removed folder is not made again
            trace.save(job.trace)
        except OSError as error:
            remove_partial(job.trace)
            return JobResult(job.run, write_error=f"{job.trace.parent}: {error.strerror or error}")
    return JobResult(job.run, metrics, time.perf_counter() - begin, errors=errors)


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
    """The result of each job as it arrives, from `processes` workers, and meanwhile their progress.

    A run that makes no progress for `timeout` s is ended and has failed. Each worker does its runs
    in `cores` processes. Close the iterator (`contextlib.closing`) if it is not exhausted, which
    ends the workers.
    """
    waiting = deque(replace(job, cores=cores, timeout=timeout) for job in jobs)
    workers: dict[Connection, _Worker] = {}

    def start(job: Job) -> None:
        worker = _Worker()
        workers[worker.pipe] = worker
        worker.assign(job)

    try:
        for _ in range(min(processes, len(waiting))):
            start(waiting.popleft())
        before = told = time.monotonic()
        while workers:
            ready = wait(list(workers), _POLL_PERIOD)
            now = time.monotonic()
            # Time in which this process did not run either, as if suspended, does not count.
            passed, before = min(now - before, 2.0 * _POLL_PERIOD), now
            for pipe, worker in list(workers.items()):
                result = worker.receive() if pipe in ready else worker.add_silence(passed, timeout)
                if result is None:
                    continue
                if worker.is_alive and waiting:
                    worker.assign(waiting.popleft())
                else:
                    workers.pop(pipe).end()
                    if waiting:
                        start(waiting.popleft())
                yield result
            if now >= told + _PROGRESS_PERIOD:
                told = now
                yield {worker.run: worker.share for worker in workers.values()}
    finally:
        for worker in workers.values():
            worker.kill()


class _Worker:
    """A worker process, its pipe and its job. `is_alive`: it can take another job.

    `share`: of the job, as last reported.
    """

    def __init__(self) -> None:
        self.is_alive = True
        self.share = 0.0
        self._has_started = False
        self.pipe, theirs = Pipe()
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `kill`
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", _MODULE, str(theirs.fileno()), str(os.getpid())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
                env={**os.environ, **_ONE_THREAD},
                process_group=0,  # Ctrl-C goes to the parent, which ends the workers
            )

    @property
    def run(self) -> str:
        """The run of its job."""
        return self._job.run

    def assign(self, job: Job) -> None:
        """Send it a job; if the worker has ended, `receive` returns that."""
        self._job = job
        self.share = 0.0
        self._silence: float | None = 0.0
        self._begin = os.fstat(self._log.fileno()).st_size
        with suppress(OSError):
            self.pipe.send(job)

    def receive(self) -> JobResult | None:
        """The result of the job, None for a report of progress; the pipe must be readable.

        If the worker has ended instead, the result is a failure.
        """
        try:
            # Values alone: a guest's pattern could write a pickle, which would run in this process.
            received = _report.decode(self.pipe.recv_bytes(_MAX_REPORT))
            if isinstance(received, JobResult) and received.run != self.run:
                raise ValueError(received.run)
        except Exception:  # the worker's end, or bytes that a pattern wrote into the pipe
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_EXIT_TIMEOUT)
            self._end_group()
            code = self._process.returncode
            hint = " (out of memory, or killed by hand)" if code == -signal.SIGKILL else ""
            return self._failed(f"its process {how_it_ended(code)}{hint}")
        if isinstance(received, JobResult):
            return received
        self._has_started = True
        self.share = received
        self._silence = 0.0 if received < 1.0 else None  # from here on only our own code runs
        return None

    def add_silence(self, seconds: float, timeout: float) -> JobResult | None:
        """Add time without a report; at the limit, end the worker and return the failure."""
        if self._silence is None:
            return None
        self._silence += seconds
        if self._silence < (timeout if self._has_started else max(timeout, STEP_TIMEOUT)):
            return None
        self._end_group()
        return self._failed(f"no progress in {timeout:g} s; a pattern or metric may not return")

    def end(self) -> None:
        """Close the pipe, which ends an idle worker, and wait for it."""
        self.pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_EXIT_TIMEOUT)
        self.kill()

    def kill(self) -> None:
        """End it immediately."""
        self._end_group()
        remove_partial(self._job.trace)
        self.pipe.close()
        self._log.close()

    def _end_group(self) -> None:
        """End the worker and every process that it or a pattern has started."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _failed(self, reason: str) -> JobResult:
        self.is_alive = False
        return JobResult(self._job.run, reason=f"{reason}{self._last_line()}")

    def _last_line(self) -> str:
        """The last line of its output since it received its job."""
        end = self._log.seek(0, os.SEEK_END)
        self._log.seek(max(self._begin, end - _MAX_LOG_TAIL))
        lines = self._log.read().decode(errors="replace").split("\n")
        written = [line for line in lines if line.strip()]
        return f": {one_line(written[-1])}" if written else ""


def main(descriptor: int, parent: int) -> None:
    """Run jobs until the pipe is closed. This is the worker process."""
    die_with_parent(parent)
    # Loaded once, for all the forks: what a job imports, and what metrics import lazily. A run of
    # two robots and 2 s takes 0.07 s of CPU, and 0.32 s if its fork has to import scipy.
    import scipy.sparse.csgraph
    import scipy.spatial  # noqa: F401

    import swarmd.sim.experiments.pool  # noqa: F401

    with Connection(descriptor) as connection:
        _send(connection, 0.0)  # started
        while True:
            try:
                job = connection.recv()
            except EOFError:
                return
            _run_in_fork(job, connection)


def _send(connection: Connection, report: JobResult | float) -> None:
    """Report a result, or the share of the job that is done."""
    connection.send_bytes(msgspec.msgpack.encode(report))


def _run_in_fork(job: Job, connection: Connection) -> None:
    """Run the job in a fork; if the fork ends without a result, end in the same way."""
    ours, theirs = os.pipe()
    worker = os.getpid()
    child = os.fork()
    if child == 0:
        die_with_parent(worker)
        # A process that a pattern forks must not write into it.
        os.register_at_fork(after_in_child=connection.close)
        _do(job, connection)
        os.write(theirs, b"1")
        os._exit(0)  # without waiting for threads of a pattern
    os.close(theirs)
    _, status = os.waitpid(child, 0)
    os.set_blocking(ours, False)
    with suppress(BlockingIOError):  # a process that the pattern forked holds the other end
        if os.read(ours, 1):
            os.close(ours)
            return
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        with suppress(OSError, ValueError):  # SIGKILL has no handler
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


def _do(job: Job, connection: Connection) -> None:
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
        confine([job.guest])
    _send(connection, run_job(job, report))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
