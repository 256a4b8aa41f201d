"""Runs of an experiment on the workers of a Dask cluster (dask.org).

A thread of a worker does one run at a time, in a process of its own, with the time-outs of a run on
one machine. It returns metrics and trace; workers keep nothing. Runs of a lost worker are repeated.

A worker gets runs if its software equals that of the client, so that results have equal bits. A
worker with other software, or without swarmd, is named once and keeps its other work.
"""

from __future__ import annotations

import pickle
import queue
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from logging import getLogger
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, cast

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.files import write_whole
from swarmd.sim.experiments.pool import (
    STEP_TIMEOUT,
    ClusterShares,
    Job,
    JobResult,
    Shares,
    one_line,
    run_jobs,
)
from swarmd.sim.experiments.provenance import digests_of_folders, made_with
from swarmd.sim.experiments.store import translated_errors
from swarmd.sim.metrics.catalog import metric_of

if TYPE_CHECKING:
    from distributed import Client, Future

    from swarmd.sim.experiments.simulate import Runner

MAX_ATTEMPTS = 3
"""A run has failed if its workers were lost this many times: the run may be the cause."""
_CONNECT_TIMEOUT = 10.0  # s
_POLL_PERIOD = 0.25  # s between two queries of the scheduler, unless a run ends
_log = getLogger(__name__)


@contextmanager
def connect(
    address: str, timeout: float = STEP_TIMEOUT, at_a_time: int | None = None, cores: int = 1
) -> Iterator[Runner]:
    """Connect to the Dask scheduler at `address`; yield a function that does jobs on its workers.

    `timeout`: the longest time in s without progress of a run, without an answer of the scheduler,
    and without a worker that fits. `at_a_time`: the most runs in progress; None: one for each
    thread of the workers. `cores`: the number of processes that share the robots of a run.
    ConfigError if no scheduler answers.

    The function raises SwarmError if the scheduler ends, or if no worker fits. Runs in progress are
    cancelled when its iterator is closed. The log names lost workers, and those that do not fit.
    """
    import dask

    # Dask would log, with its stack, each loss that is reported below in one line.
    levels = dict.fromkeys(("distributed", "distributed.client"), "critical")
    with dask.config.set({"logging": levels}):
        from distributed import Client
        from distributed.comm.addressing import resolve_address
    try:
        resolve_address(address)  # the constructor of a client leaves a thread after its ValueError
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            f"scheduler {address}: {one_line(str(error))}; expected the address of a Dask scheduler"
        ) from error
    with client:
        cluster = _Cluster(client, address, timeout, at_a_time, cores)
        # An event is (time, shares), which `perform` logs on the worker.
        client.subscribe_topic(client.id, lambda event: cluster.shares.update(event[1]))
        yield cluster.run


@dataclass(frozen=True, slots=True)
class _Call:
    """A call in progress on a worker: of `perform` for a job, or of `software` without one."""

    worker: str
    future: Future[Any]
    job: Job | None


@dataclass(slots=True)
class _Cluster:
    client: Client
    address: str
    timeout: float
    at_a_time: int | None
    cores: int
    shares: dict[str, float] = field(default_factory=dict)
    """The simulated share 0..1 by run, as workers reported it last."""
    calls: dict[object, _Call] = field(default_factory=dict)
    """The calls in progress, by key."""
    ended: queue.Queue[Future[Any]] = field(default_factory=queue.Queue)
    waiting: deque[Job] = field(default_factory=deque)
    losses: Counter[str] = field(default_factory=Counter)
    """How often a run was lost with its worker."""

    def run(self, jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        """Yield the result of each job as it arrives, and between results the shares."""
        folders = {job.effective["plugin_dir"] for job in jobs if job.effective.get("plugin_dir")}
        request = pickle.dumps((sorted(folders), jobs[0].metrics if jobs else {}))
        own_software = software(request)
        is_fit: dict[str, bool | None] = {}  # by worker; None before its answer
        last_usable = time.monotonic()  # when a worker last had a run, or was free for one
        self.waiting = deque(jobs)
        try:
            while self.waiting or self._worker_by_run():
                threads = self._threads()
                for lost in [call for call in self.calls.values() if call.worker not in threads]:
                    yield from self._lose(lost, "is lost")
                for worker in threads.keys() - is_fit.keys():
                    self._submit(worker, software, request)
                is_fit = {worker: is_fit.get(worker) for worker in threads}
                free = self._free({worker: threads[worker] for worker in threads if is_fit[worker]})
                if free or self._worker_by_run():
                    last_usable = time.monotonic()
                elif time.monotonic() > last_usable + self.timeout:
                    raise SwarmError(
                        f"none of {len(threads)} workers at {self.address} has reported the"
                        f" software of this machine; start one: dask worker {self.address}"
                    )
                for worker in free[: len(self.waiting)]:
                    job = self.waiting.popleft()
                    work = (job, self.timeout, self.cores, self.client.id)
                    self._submit(worker, perform, pickle.dumps(work), job)
                workers = self._worker_by_run()
                yield ClusterShares({run: self.shares.get(run, 0.0) for run in workers}, workers)
                for call, answer in self._ended():
                    if call.job is None:
                        difference = software_difference(own_software, answer)
                        is_fit[call.worker] = not difference
                        if difference:
                            _log.warning("worker %s gets no runs: %s", call.worker, difference)
                    elif isinstance(answer, Exception):
                        yield from self._lose(call, f"failed ({one_line(str(answer))})")
                    else:
                        result, trace = pickle.loads(answer)
                        if call.job.trace is not None and trace is not None:
                            with translated_errors(call.job.trace.parent):
                                write_whole(call.job.trace, trace)
                        yield result
        finally:
            self.calls.clear()  # Dask cancels a call without a future

    def _worker_by_run(self) -> dict[str, str]:
        """The worker of each run in progress."""
        return {call.job.run: call.worker for call in self.calls.values() if call.job is not None}

    def _threads(self) -> dict[str, int]:
        """The number of threads by worker; SwarmError if the scheduler does not answer."""
        with suppress(OSError, AttributeError):  # AttributeError of a client that closes
            # A client that connects again has lost its calls.
            if self.client.status == "running":
                return dict(
                    self.client.sync(
                        cast("Any", self.client.scheduler).ncores,
                        callback_timeout=max(self.timeout, _CONNECT_TIMEOUT),
                    )
                )
        raise SwarmError(
            f"the scheduler at {self.address} is gone; finished runs are kept: start it and give"
            " the same command again"
        )

    def _free(self, threads: Mapping[str, int]) -> list[str]:
        """Workers, once for each run that they can take; those with the fewest runs first.

        `threads`: their number by worker that fits.
        """
        busy = Counter(self._worker_by_run().values())
        slots = [(n, worker) for worker in threads for n in range(busy[worker], threads[worker])]
        limit = len(slots) if self.at_a_time is None else self.at_a_time - busy.total()
        return [worker for _, worker in sorted(slots)[: max(limit, 0)]]

    def _submit(
        self, worker: str, function: Callable[[bytes], Any], request: bytes, job: Job | None = None
    ) -> None:
        """Let a worker call a function of this module; the future goes into `ended`.

        The call is a text and bytes, which every Python unpickles: scheduler and workers may lack
        swarmd. An import that fails in the text fails as a run does, and the worker lives on.
        """
        text = f"__import__({__name__!r}, fromlist=['*']).{function.__name__}(request)"
        future = self.client.submit(
            eval, text, {"request": request}, key=uuid.uuid4().hex, workers=[worker], pure=False
        )
        self.calls[future.key] = _Call(worker, future, job)
        future.add_done_callback(self.ended.put)

    def _ended(self) -> Iterator[tuple[_Call, Any]]:
        """The next ended call, and what it returned or raised; nothing if none ends in time.

        SwarmError if the scheduler is gone.
        """
        with suppress(queue.Empty):
            future = self.ended.get(timeout=_POLL_PERIOD)
            if (call := self.calls.pop(future.key, None)) is not None:  # else given up before
                try:
                    answer = future.result(self.timeout)
                except Exception as error:
                    self._threads()
                    answer = error
                yield call, answer

    def _lose(self, call: _Call, how: str) -> Iterator[JobResult]:
        """Put the run of a lost call first into `waiting`; after MAX_ATTEMPTS yield its failure."""
        self.calls.pop(call.future.key, None)
        if call.job is None:
            return
        run = call.job.run
        self.shares.pop(run, None)
        self.losses[run] += 1
        if self.losses[run] < MAX_ATTEMPTS:
            self.waiting.appendleft(call.job)
            _log.warning("worker %s %s; run %s is repeated", call.worker, how, run)
        else:
            yield JobResult(run, reason=f"lost {MAX_ATTEMPTS} times; worker {call.worker} {how}")


def software(request: bytes) -> dict[str, str]:
    """Versions of this machine's software by name, and digests of plugins by path.

    `request`: the folders of the plugins, and the digests of custom metrics by origin. ConfigError
    if the file of a metric is missing or has another digest.
    """
    folders, digests = pickle.loads(request)
    for origin, digest in digests.items():
        metric_of(origin, digest)
    return {**made_with(), **digests_of_folders(folders)}


def software_difference(own: Mapping[str, str], answer: Mapping[str, str] | Exception) -> str:
    """Why results of a worker may differ; empty if they have the same bits.

    `own`: the software of the client. `answer`: that of the worker, or the error of its query. Two
    processors may have different names: `simd` and `libm` tell what they compute.
    """
    if isinstance(answer, Exception):
        return one_line(f"{type(answer).__name__}: {answer}")
    return next(
        (
            f"{name} is {answer.get(name, 'missing')} there, {own.get(name, 'missing')} here"
            for name in {**own, **answer}
            if name != "processor" and own.get(name) != answer.get(name)
        ),
        "",
    )


def perform(request: bytes) -> bytes:
    """Do a run in this worker: pickled result, and the bytes of the trace or None.

    `request`: job, time-out in s, cores of a run, and the topic of its shares. An error of the
    worker is raised: OSError without room for the trace, RuntimeError after a cancellation.
    """
    from distributed import get_worker

    job, timeout, cores, topic = pickle.loads(request)
    worker = get_worker()
    with TemporaryDirectory(prefix="swarmd-", dir=worker.local_directory) as folder:
        trace = None if job.trace is None else Path(folder) / "trace.npz"
        with closing(run_jobs([replace(job, trace=trace)], 1, timeout, cores)) as reports:
            for report in reports:
                if isinstance(report, JobResult):
                    if report.write_error:
                        raise OSError(report.write_error)
                    is_kept = report.metrics is not None
                    return pickle.dumps((report, trace.read_bytes() if trace and is_kept else None))
                task = worker.state.tasks.get(worker.get_current_task())
                if task is None or task.state != "executing":
                    break  # the client has cancelled the call, or is gone
                worker.log_event(topic, dict(report))
    raise RuntimeError("cancelled")
