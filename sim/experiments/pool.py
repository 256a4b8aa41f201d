"""One run as a job: what it takes, what comes of it, and the doing itself.

Many jobs in several processes: what kills or hangs one process costs one run.

A process that does one job after another: `python -m swarmd.sim.experiments.pool FD PARENT`.

Jobs come and run_jobs go by the connection of descriptor FD; on the way to an outcome it says now
and then which share has been simulated. It is a program of its own rather than a multiprocessing
child, so that a script needs no `if __name__ == "__main__"`. Each job is done by a fork of it: what
one run does to its process, no other run sees.
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
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from swarmd.core.errors import SwarmError
from swarmd.core.processes import die_with_parent, how_it_ended
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.scenarios.scenariofile import scenario_of


@dataclass(frozen=True, slots=True)
class Job:
    """A run to be done: a whole scenario in plain values, a seed, and where its trace goes."""

    run: str
    effective: Mapping[str, Any]
    seed: int
    trace: Path | None


@dataclass(frozen=True, slots=True)
class JobResult:
    """The result of a job: `metrics` by name, or None and the reason in one line.

    `write_error` is set if the trace could not be written; then no other trace can be written
    either. `wall` is the duration in s.
    """

    run: str
    metrics: Mapping[str, float | None] | None = None
    wall: float = 0.0
    reason: str = ""
    write_error: str = ""


def run_job(job: Job, on_progress: Callable[[float], None] | None = None) -> JobResult:
    """Simulate, measure, and write the trace down, in this process.

    Nothing is raised for what goes wrong in the run: patterns and metrics may be anyone's.
    `on_progress` is told after each step which share has been simulated.
    """
    begin = time.perf_counter()
    try:
        trace = simulate_run(scenario_of(job.effective), job.seed, on_progress)
        metrics = measure(trace)
    except SwarmError as error:
        return JobResult(job.run, reason=one_line(str(error)))
    except Exception as error:
        return JobResult(job.run, reason=one_line(f"{type(error).__name__}: {error}"))
    if job.trace is not None:
        try:
            job.trace.parent.stat()  # a folder that was taken away is not made anew
            trace.save(job.trace)
        except OSError as error:
            remove_partial(job.trace)
            return JobResult(job.run, write_error=f"{job.trace.parent}: {error.strerror or error}")
    return JobResult(job.run, metrics, time.perf_counter() - begin)


def remove_partial(trace: Path) -> None:
    """Remove what is left of a trace that was not written to its end, if it can be."""
    with suppress(OSError):
        trace.with_name(f".{trace.name}.partial").unlink(missing_ok=True)


def one_line(text: str) -> str:
    """The text on one line of at most 300 characters."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))
    return line if len(line) <= 300 else f"{line[:297]}..."


WORKER = "swarmd.sim.experiments.pool"
GRACE = 2.0  # s in which a worker without work ends by itself
TIMEOUT = 60.0  # s on the clock for one step of a simulation, or for setting it up
_LOOK = 0.5  # s between two looks at workers that say nothing
_TAIL = 8192  # bytes of what a worker has said last
_ONE_THREAD = {
    f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMEXPR", "VECLIB")
}


def run_jobs(
    jobs: Iterable[Job], processes: int, timeout: float = TIMEOUT
) -> Generator[JobResult, None, None]:
    """The outcome of each job as it comes; `processes` of them are done at a time.

    One that gets no further in its simulation for `timeout` s is ended and has failed. Close the
    iterator (`contextlib.closing`) if it is not exhausted: the workers end with it.
    """
    waiting = deque(jobs)
    workers: dict[Connection, _Worker] = {}
    try:
        for _ in range(min(processes, len(waiting))):
            _employ(workers, waiting.popleft())
        before = time.monotonic()
        while workers:
            ready = wait(list(workers), _LOOK)
            now = time.monotonic()
            # Time in which this process stood still too, as a suspended one does, does not count.
            passed, before = min(now - before, 2.0 * _LOOK), now
            for pipe, worker in list(workers.items()):
                outcome = worker.outcome() if pipe in ready else worker.silent(passed, timeout)
                if outcome is None:
                    continue
                if worker.is_alive and waiting:
                    worker.give(waiting.popleft())
                else:
                    workers.pop(pipe).end()
                    if waiting:
                        _employ(workers, waiting.popleft())
                yield outcome
    finally:
        for worker in workers.values():
            worker.kill()
            worker.clean()


def _employ(workers: dict[Connection, _Worker], job: Job) -> None:
    worker = _Worker()
    workers[worker.pipe] = worker
    worker.give(job)


class _Worker:
    """One process, the pipe to it, and the job it is at. `is_alive`: it can take another."""

    def __init__(self) -> None:
        self.is_alive = True
        self.pipe, theirs = Pipe()
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `kill`
        with theirs:
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-P",
                    "-m",
                    "swarmd.sim.experiments.pool",
                    *self._arguments(theirs),
                ],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
                env={**os.environ, **_ONE_THREAD},
                process_group=0,  # Ctrl-C is for the parent, which ends them
            )

    @staticmethod
    def _arguments(theirs: Connection) -> tuple[str, str]:
        return str(theirs.fileno()), str(os.getpid())

    def give(self, job: Job) -> None:
        """Let it do a job; if it has gone, `outcome` will say so."""
        self._job = job
        self._silence: float | None = 0.0
        self._begin = os.fstat(self._log.fileno()).st_size
        with suppress(OSError):
            self.pipe.send(job)

    def outcome(self) -> JobResult | None:
        """What came of the job, None if it was but a word on the way; it must have said something.

        If it has ended instead, that is the outcome.
        """
        try:
            word: JobResult | float = self.pipe.recv()
        except Exception:  # its end, or what a pattern has written into the pipe
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(GRACE)
            self._end_group()
            code = self._process.returncode
            hint = " (the memory was full, or someone did it)" if code == -signal.SIGKILL else ""
            return self._lost(f"its process {how_it_ended(code)}{hint}")
        if isinstance(word, JobResult):
            return word
        self._silence = 0.0 if word < 1.0 else None  # what is left is up to nobody's pattern
        return None

    def silent(self, seconds: float, timeout: float) -> JobResult | None:
        """It has said nothing for so long again: ended, and the outcome, if that is too long."""
        if self._silence is None:
            return None
        self._silence += seconds
        if self._silence < timeout:
            return None
        self._end_group()
        return self._lost(f"it got no further in {timeout:g} s, as if a pattern never returned")

    def end(self) -> None:
        """Let it end, as it does when nothing more can come."""
        self.pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(GRACE)
        self.kill()

    def kill(self) -> None:
        """End it now, whatever it is at."""
        self._end_group()
        self.pipe.close()
        self._log.close()

    def clean(self) -> None:
        """Remove what it has left of the trace it was at; it must have ended."""
        if self._job.trace is not None:
            remove_partial(self._job.trace)

    def _end_group(self) -> None:
        """End it and all that it or a pattern has started."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _lost(self, reason: str) -> JobResult:
        self.is_alive = False
        self.clean()
        return JobResult(self._job.run, reason=f"{reason}{self._last_words()}")

    def _last_words(self) -> str:
        """The last line it has said since it was given its job."""
        end = self._log.seek(0, os.SEEK_END)
        self._log.seek(max(self._begin, end - _TAIL))
        lines = self._log.read().decode(errors="replace").split("\n")
        said = [line for line in lines if line.strip()]
        return f": {one_line(said[-1])}" if said else ""


BEAT = 0.25  # s between two words of progress


def main(descriptor: int, parent: int) -> None:
    """Do jobs until there are no more."""
    die_with_parent(parent)
    # Loaded once, for all the forks: what a job imports, and what metrics import lazily.

    import swarmd.sim.experiments.pool  # noqa: F401

    with Connection(descriptor) as connection:
        while True:
            try:
                job = connection.recv()
            except EOFError:
                return
            _do_apart(job, connection)


def _do_apart(job: Job, connection: Connection) -> None:
    """Do the job in a fork; if that ends before it has an outcome, end in the same way."""
    ours, theirs = os.pipe()
    worker = os.getpid()
    child = os.fork()
    if child == 0:
        die_with_parent(worker)
        os.register_at_fork(after_in_child=connection.close)  # a pattern's fork has no say
        _do(job, connection)
        os.write(theirs, b"1")
        os._exit(0)  # whatever a pattern has left to be waited for
    os.close(theirs)
    _, status = os.waitpid(child, 0)
    os.set_blocking(ours, False)
    with suppress(BlockingIOError):  # what the pattern forked has the other end still
        if os.read(ours, 1):
            os.close(ours)
            return
    _end_with(os.waitstatus_to_exitcode(status))


def _do(job: Job, connection: Connection) -> None:
    from swarmd.sim.experiments.pool import run_job

    next_beat = 0.0

    def tell(share: float) -> None:
        nonlocal next_beat
        now = time.monotonic()
        if now >= next_beat or share == 1.0:
            next_beat = now + BEAT
            connection.send(share)

    connection.send(run_job(job, tell))


def _end_with(code: int) -> None:
    if code < 0:
        with suppress(OSError, ValueError):  # SIGKILL knows no handler
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
