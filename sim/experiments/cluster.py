"""Runs on the workers of a Dask cluster (dask.org).

Each run goes to one thread of one worker. The thread does the run in a process of its own, with the
time-outs of a run on one machine. Metrics and trace come back with the result, and the worker keeps
nothing. The runs of a worker that ends or falls silent are repeated on other workers.

Scheduler and workers need the same software as the client. Before its first run, a worker sends the
versions and digests of its software.
"""

from __future__ import annotations

import math
import queue
import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial, reduce
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, cast

from msgspec import structs

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.files import whole_file
from swarmd.sim.experiments.manifest import (
    Manifest,
    digests_of_metrics,
    joined,
    plugin_folders,
    software_conflict,
)
from swarmd.sim.experiments.pool import Job, JobResult, Shares, one_line, run_jobs
from swarmd.sim.experiments.provenance import digests_of_folders, made_with
from swarmd.sim.metrics.catalog import metric_of

if TYPE_CHECKING:
    from distributed import Client, Future

MAX_ATTEMPTS = 3
"""A run has failed if its workers were lost this many times: the run may be the cause."""
CONNECT_TIMEOUT = 10.0  # s
_LOOK_PERIOD = 1.0  # s between two queries of the scheduler about its workers
_POLL_PERIOD = 0.25  # s
_MIN_SILENCE = 5.0  # s; workers report to the scheduler every 0.5 s, of a large cluster every 5 s

Note = Callable[[str], None]


@dataclass(slots=True)
class _Worker:
    """A worker of the cluster."""

    threads: int
    """The number of runs at a time."""
    seen: float
    """When the scheduler last heard the worker, in s by the scheduler's clock."""
    silence: float = 0.0
    """The time in s since `seen` changed, by this machine's clock."""
    is_fit: bool | None = None
    """Whether the worker has the software of the manifest; None before its answer."""


@dataclass(frozen=True, slots=True)
class _Attempt:
    """A job in progress on a worker."""

    job: Job
    worker: str
    future: Future[Any]


@contextmanager
def connect(
    address: str, manifest: Manifest, timeout: float, note: Note, at_a_time: int | None = None
) -> Iterator[Cluster]:
    """The cluster at the scheduler's address, after a check of its workers' software.

    `timeout`: in s, of workers and runs. `note` is called with a line when a worker is lost or not
    used. `at_a_time`: the most runs in progress; None: one for each thread of the workers.
    ConfigError if there is no scheduler, or if a worker's software differs from the manifest's.
    SwarmError if no worker answers.
    """
    import dask

    with dask.config.set({"logging": {"distributed": "critical"}}):  # the errors below say it
        from distributed import Client
        from distributed.comm.addressing import resolve_address

    try:
        resolve_address(address)  # an error in the client's constructor leaves a thread
        client = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        text = f"--scheduler {address}: {one_line(str(error))}"
        raise ConfigError(f"{text}; expected the address of a Dask scheduler") from error
    with client:
        cluster = Cluster(client, address, manifest, timeout, note, at_a_time)
        cluster.await_workers()
        yield cluster


class Cluster:
    """A Dask cluster that does runs; `manifest` names the processors of its workers."""

    def __init__(
        self,
        client: Client,
        address: str,
        manifest: Manifest,
        timeout: float,
        note: Note,
        at_a_time: int | None,
    ) -> None:
        self.manifest = manifest
        self._client, self._address = client, address
        self._timeout = timeout
        self._note = note
        self._at_a_time = at_a_time
        self._folders = plugin_folders(manifest.plan)
        self._metrics = [metric.origin for metric in manifest.metrics]
        self._topic = f"swarmd-{uuid.uuid4().hex}"
        self._workers: dict[str, _Worker] = {}
        self._asked: dict[str, str] = {}  # worker by key of the question
        self._answers: queue.Queue[tuple[str, Any]] = queue.Queue()
        self._shares: dict[str, float] = {}
        self._next_look = 0.0
        self._refusal = ""
        self._is_open = False
        self._software: list[Manifest] = []  # of the workers that are fit
        client.subscribe_topic(self._topic, lambda event: self._shares.update(event[1]))

    def await_workers(self) -> None:
        """Wait for the answers of all workers about their software, for `timeout` s at most.

        ConfigError if a worker's software differs. SwarmError if no worker answered.
        """
        deadline = time.monotonic() + self._timeout
        while time.monotonic() < deadline:
            self._look()
            if self._workers and all(worker.is_fit for worker in self._workers.values()):
                break
            self._receive()
            if self._refusal:
                raise ConfigError(f"{self._refusal}; install the same software there")
        if not self._software:
            text = (
                f"{len(self._workers)} workers, and none answers" if self._workers else "no worker"
            )
            raise SwarmError(f"the cluster at {self._address} has {text}; start some: dask worker")
        # This machine does no runs, so the manifest names the processors of the workers alone.
        manifest = reduce(joined, self._software)
        self.manifest = structs.replace(self.manifest, made_with=manifest.made_with)
        self._is_open = True

    def run_jobs(self, jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        """Yield the result of each job as it arrives, and meanwhile the progress of all runs.

        SwarmError if the scheduler or all workers are lost. Runs in progress are cancelled when the
        client closes.
        """
        waiting, attempts = deque(jobs), Counter[str]()
        runs: dict[str, _Attempt] = {}
        last_usable = time.monotonic()  # when a worker last had a run, or was free for one
        while waiting or runs:
            self._look()
            now = time.monotonic()
            for key, attempt in [*runs.items()]:
                if not self._is_alive(attempt.worker):
                    yield from self._repeat(runs.pop(key), waiting, attempts)
            free = self._free(runs)
            if runs or free:
                last_usable = now
            if now > last_usable + self._timeout:
                raise SwarmError(
                    f"the cluster at {self._address} has no worker left; finished runs are"
                    " kept: start workers and give the same command again"
                )
            for worker in free:
                if waiting:
                    job = waiting.popleft()
                    call = partial(_perform, job, self._timeout, self._topic)
                    key, future = self._submit(call, worker)
                    runs[key] = _Attempt(job, worker, future)
            ids = {attempt.job.run for attempt in runs.values()}
            yield {run: share for run, share in [*self._shares.items()] if run in ids}
            key, answer = self._receive()
            if key in runs:
                attempt = runs.pop(key)
                if isinstance(answer, BaseException):
                    self._check_scheduler()
                    self._note(f"worker {attempt.worker}: {one_line(str(answer))}")
                    yield from self._repeat(attempt, waiting, attempts)
                else:
                    yield _kept(attempt.job, *answer)

    def _repeat(
        self, attempt: _Attempt, waiting: deque[Job], attempts: Counter[str]
    ) -> Iterator[JobResult]:
        """Queue the run of a lost worker first; after MAX_ATTEMPTS losses yield a failure."""
        attempt.future.cancel()
        run = attempt.job.run
        attempts[run] += 1
        self._shares.pop(run, None)
        if attempts[run] < MAX_ATTEMPTS:
            self._note(f"worker {attempt.worker} is lost; run {run} is repeated")
            waiting.appendleft(attempt.job)
        else:
            reason = f"lost with its worker {MAX_ATTEMPTS} times, the last was {attempt.worker}"
            yield JobResult(run, reason=reason)

    def _look(self) -> None:
        """Update the workers from the scheduler, once a second; ask new workers for their software.

        SwarmError if the scheduler is lost.
        """
        now = time.monotonic()
        if now < self._next_look:
            return
        # Time in which this process or the scheduler was suspended is no silence of a worker.
        passed = min(now - self._next_look, _LOOK_PERIOD) + _LOOK_PERIOD
        self._next_look = now + _LOOK_PERIOD
        self._check_scheduler()
        listed = self._listed()
        for name in [name for name in self._workers if name not in listed]:
            del self._workers[name]
        for name, about in listed.items():
            worker = self._workers.get(name)
            if worker is None:
                self._workers[name] = _Worker(about["nthreads"], about["last_seen"])
                key, _ = self._submit(partial(_software, self._folders, self._metrics), name)
                self._asked[key] = name
            else:
                is_same = worker.seen == about["last_seen"]
                worker.seen = about["last_seen"]
                worker.silence = worker.silence + passed if is_same else 0.0

    def _listed(self) -> dict[str, Any]:
        """The scheduler's description of each worker, by name; SwarmError without an answer."""
        answers: queue.SimpleQueue[Any] = queue.SimpleQueue()

        def ask() -> None:  # waits for ever if the scheduler is silent
            try:
                answers.put(self._client.scheduler_info(n_workers=-1)["workers"])
            except Exception as error:
                answers.put(error)

        threading.Thread(target=ask, daemon=True).start()
        limit = max(self._timeout, _MIN_SILENCE)
        # Short waits: time in which this process was suspended does not count as silence.
        for _ in range(math.ceil(limit / _POLL_PERIOD)):
            with suppress(queue.Empty):
                answer = answers.get(timeout=_POLL_PERIOD)
                if isinstance(answer, Exception):
                    raise self._lost_scheduler() from answer
                return cast("dict[str, Any]", answer)
        raise self._lost_scheduler(f"has not answered for {limit:g} s")

    def _check_scheduler(self) -> None:
        """SwarmError if the connection to the scheduler, and with it each run, is lost."""
        if self._client.status != "running":
            raise self._lost_scheduler()

    def _lost_scheduler(self, what: str = "is gone") -> SwarmError:
        return SwarmError(
            f"the scheduler at {self._address} {what}; finished runs are kept: start it and give"
            " the same command again"
        )

    def _is_alive(self, name: str) -> bool:
        worker = self._workers.get(name)
        return worker is not None and worker.silence < max(self._timeout, _MIN_SILENCE)

    def _free(self, runs: dict[str, _Attempt]) -> list[str]:
        """Names of workers, once for each run that a worker can take; the least busy come first."""
        busy = Counter(attempt.worker for attempt in runs.values())
        slots = [
            (number, name)
            for name, worker in self._workers.items()
            if worker.is_fit and self._is_alive(name)
            for number in range(busy[name], worker.threads)
        ]
        limit = len(slots) if self._at_a_time is None else max(self._at_a_time - len(runs), 0)
        return [name for _, name in sorted(slots)[:limit]]

    def _submit(self, call: Callable[[], object], worker: str) -> tuple[str, Future[Any]]:
        """Let one worker call a function; `_receive` later gives the answer with the returned key.

        The answer is what the function returns, or the exception.
        """
        key = f"swarmd-{uuid.uuid4().hex}"
        future = self._client.submit(call, key=key, workers=[worker], pure=False)

        def fetch() -> None:  # waits for ever if the worker is silent
            try:
                answer: Any = future.result()
            except BaseException as error:
                answer = error
            self._answers.put((key, answer))

        threading.Thread(target=fetch, daemon=True).start()
        return key, future

    def _receive(self) -> tuple[str, Any]:
        """The next answer of a run with its key; an empty key if none came within _POLL_PERIOD.

        An answer about a worker's software sets `is_fit` of the worker, and gives an empty key.
        """
        try:
            key, answer = self._answers.get(timeout=_POLL_PERIOD)
        except queue.Empty:
            return "", None
        name = self._asked.pop(key, None)
        worker = self._workers.get(name or "")
        if name is None or worker is None:
            return key, answer
        difference = self._difference(answer)
        worker.is_fit = difference is None
        if difference is not None:
            self._refusal = f"worker {name} is not used: {difference}"
            if self._is_open:
                self._note(self._refusal)
        return "", None

    def _difference(self, answer: Any) -> str | None:
        """Why a worker cannot be used, after its answer about its software; None if it can be.

        Adds the software of a usable worker to `_software`. `answer`: the result of `_software`, or
        an exception.
        """
        if isinstance(answer, BaseException):
            return one_line(f"{type(answer).__name__}: {answer}")
        made, plugins = answer
        theirs = structs.replace(self.manifest, made_with=made, plugins=plugins)
        difference = software_conflict(self.manifest, theirs)
        if difference is None and self._is_open and joined(self.manifest, theirs) != self.manifest:
            difference = "the manifest does not name its processor"
        if difference is None:
            self._software.append(theirs)
        return difference


def _software(
    folders: Sequence[str], metrics: Sequence[str]
) -> tuple[dict[str, str], dict[str, str]]:
    """A worker's software: versions by name, and digests of its plugins and custom metrics."""
    own = digests_of_metrics(map(metric_of, metrics))
    return made_with(), {**digests_of_folders(folders), **own}


def _perform(job: Job, timeout: float, topic: str) -> tuple[JobResult, bytes | None]:
    """Do a job on a worker: the result, and the bytes of the trace file or None.

    RuntimeError if the client has cancelled the job or is gone.
    """
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()
    # Dask removes this folder also after a crash.
    with TemporaryDirectory(prefix="swarmd-", dir=worker.local_directory) as place:
        trace = None if job.trace is None else Path(place) / "trace.npz"
        with closing(run_jobs([replace(job, trace=trace)], 1, timeout)) as results:
            for item in results:
                if isinstance(item, JobResult):
                    if item.write_error:
                        return replace(item, reason=item.write_error, write_error=""), None
                    has_trace = item.metrics is not None and trace is not None
                    return item, trace.read_bytes() if has_trace and trace else None
                task = worker.state.tasks.get(key)
                if task is None or task.state != "executing":
                    break  # the client has cancelled it, or is gone
                worker.log_event(topic, dict(item))
    raise RuntimeError("cancelled")


def _kept(job: Job, result: JobResult, trace: bytes | None) -> JobResult:
    """Write a trace to the path of its job; the result, with `write_error` if that fails."""
    if job.trace is None or trace is None:
        return result
    try:
        with whole_file(job.trace) as partial:
            partial.write_bytes(trace)
    except OSError as error:
        return JobResult(job.run, write_error=f"{job.trace.parent}: {error.strerror or error}")
    return result
