"""Many jobs in several processes: what kills one process costs one run."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Generator, Iterable
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait

from swarmd.processes import how_it_ended
from swarmd.sim.lab.job import Job, Outcome, one_line, remove_partial

GRACE = 2.0  # s in which a worker without work ends by itself
_TAIL = 8192  # bytes of what a worker has said last
_ONE_THREAD = {
    f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMEXPR", "VECLIB")
}


def outcomes(jobs: Iterable[Job], processes: int) -> Generator[Outcome, None, None]:
    """The outcome of each job as it comes; `processes` of them are done at a time.

    Close the iterator (`contextlib.closing`) if it is not exhausted: the workers end with it.
    """
    waiting = deque(jobs)
    workers: dict[Connection, _Worker] = {}
    try:
        for _ in range(min(processes, len(waiting))):
            _employ(workers, waiting.popleft())
        while workers:
            for pipe in wait(list(workers)):
                worker = workers[pipe]  # type: ignore[index]  # what wait was given it returns
                outcome, is_alive = worker.outcome()
                if is_alive and waiting:
                    worker.give(waiting.popleft())
                else:
                    workers.pop(worker.pipe).end()
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
    """One process, the pipe to it, and the job it is at."""

    def __init__(self) -> None:
        self.pipe, theirs = Pipe()
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `kill`
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "swarmd.sim.lab.worker", *self._arguments(theirs)],
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
        self._begin = os.fstat(self._log.fileno()).st_size
        with suppress(OSError):
            self.pipe.send(job)

    def outcome(self) -> tuple[Outcome, bool]:
        """What came of the job, and whether the worker can take another."""
        try:
            outcome: Outcome = self.pipe.recv()
        except (EOFError, OSError):
            self._process.wait()
            reason = f"its process {how_it_ended(self._process.returncode)}{self._last_words()}"
            self.clean()
            return Outcome(self._job.run, reason=reason), False
        return outcome, True

    def end(self) -> None:
        """Let it end, as it does when nothing more can come."""
        self.pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(GRACE)
        self.kill()

    def kill(self) -> None:
        """End it now, whatever it is at."""
        self._process.kill()
        self._process.wait()
        self.pipe.close()
        self._log.close()

    def clean(self) -> None:
        """Remove what it has left of the trace it was at; it must have ended."""
        if self._job.trace is not None:
            remove_partial(self._job.trace)

    def _last_words(self) -> str:
        """The last line it has said since it was given its job."""
        if self._process.returncode == -9:
            return " (the memory was full, or someone did it)"
        end = self._log.seek(0, os.SEEK_END)
        self._log.seek(max(self._begin, end - _TAIL))
        lines = self._log.read().decode(errors="replace").split("\n")
        said = [line for line in lines if line.strip()]
        return f": {one_line(said[-1])}" if said else ""
