"""Simulation runs of an experiment on the workers of a Dask cluster (dask.org).

Each run goes to one thread of one worker. The thread does the run in a process of its own, with the
time-outs of a run on one machine. The worker returns metrics and trace, and stores nothing. The
runs of a worker that ends or falls silent are repeated on other workers.

Scheduler and workers need the same software as the client. So each worker sends the versions and
digests of its software before its first run. A worker without swarmd, as other users of the cluster
may have, gets no run and lives on.
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
_UPDATE_PERIOD = 1.0  # s between two queries of the scheduler about its workers
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
    """Connect to the Dask scheduler at `address`, check its workers' software, yield the cluster.

    `manifest`: the experiment, with the software that workers must have. `timeout`: the longest
    silence in s of a worker and of a run. `note` is called with a line when a worker is lost or not
    used. `at_a_time`: the most runs in progress; None: one for each thread of the workers.
    ConfigError if no scheduler answers, or if a worker's software differs from the manifest's.
    SwarmError if no worker answers that has swarmd.
    """
    import dask

    # Dask would log the errors that the code below raises.
    with dask.config.set({"logging": {"distributed": "critical"}}):
        from distributed import Client
        from distributed.comm.addressing import resolve_address

    try:
        # Checked here, since an invalid address makes the client's constructor leave a thread.
        resolve_address(address)
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
        """Made by `connect`. Workers report progress of runs under `_topic`."""
        self.manifest = manifest
        self._client, self._address = client, address
        self._timeout = timeout
        self._note = note
        self._at_a_time = at_a_time
        self._folders = plugin_folders(manifest.plan)
        self._metric_origins = [metric.origin for metric in manifest.metrics]  # of custom metrics
        self._topic = f"swarmd-{uuid.uuid4().hex}"
        self._workers: dict[str, _Worker] = {}  # by address
        self._worker_by_query: dict[str, str] = {}  # of open queries for software, by their key
        self._answers: queue.Queue[tuple[str, Any]] = queue.Queue()  # key and result of a call
        self._shares: dict[str, float] = {}  # simulated share 0..1 of a run, by run
        # s, monotonic: when the scheduler was last asked for its workers.
        self._last_update = -math.inf
        self._refusal = ""  # why a worker with other software is not used
        self._is_open = False  # whether `await_workers` has ended
        self._software: list[Manifest] = []  # of the workers that are fit
        # An event is (time, shares): `_perform` logs the shares on the worker.
        client.subscribe_topic(self._topic, lambda event: self._shares.update(event[1]))

    def await_workers(self) -> None:
        """Wait for the answers of all workers about their software, for `timeout` s at most.

        ConfigError if a worker's software differs. SwarmError if no worker with swarmd answered.
        """
        deadline = time.monotonic() + self._timeout
        while time.monotonic() < deadline:
            self._update_workers()
            if self._software and all(w.is_fit is not None for w in self._workers.values()):
                break
            self._receive()
            if self._refusal:
                raise ConfigError(f"{self._refusal}; install the same software there")
        # Workers that answer after the deadline are used later, if their software fits.
        if not self._software:
            answers = {worker.is_fit for worker in self._workers.values()}
            fault = "none answers" if None in answers else "none has swarmd"
            text = f"{len(self._workers)} workers, and {fault}" if self._workers else "no worker"
            raise SwarmError(f"the cluster at {self._address} has {text}; start some: dask worker")
        # This machine does no runs, so the manifest names the processors of the workers alone.
        manifest = reduce(joined, self._software)
        self.manifest = structs.replace(self.manifest, made_with=manifest.made_with)
        self._is_open = True

    def run_jobs(self, jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        """Run jobs on the workers; yield the result of each job as it arrives.

        Between results, yield the simulated share (0..1) of each run in progress, by run.
        SwarmError if the scheduler or all workers are lost. Runs in progress are cancelled when the
        client closes.
        """
        waiting, attempt_counts = deque(jobs), Counter[str]()
        attempts: dict[str, _Attempt] = {}  # in progress, by key of the call
        last_usable = time.monotonic()  # when a worker last had a run, or was free for one
        while waiting or attempts:
            self._update_workers()
            for key, attempt in [*attempts.items()]:  # a copy, since the loop removes attempts
                if not self._is_alive(attempt.worker):
                    yield from self._repeat(attempts.pop(key), waiting, attempt_counts)
            free_workers = self._free(attempts)
            now = time.monotonic()
            if attempts or free_workers:
                last_usable = now
            if now > last_usable + self._timeout:
                raise SwarmError(
                    f"the cluster at {self._address} has no worker left; finished runs are"
                    " kept: start workers and give the same command again"
                )
            for worker in free_workers:
                if waiting:
                    job = waiting.popleft()
                    call = partial(_perform, job, self._timeout, self._topic)
                    key, future = self._submit(call, worker)
                    attempts[key] = _Attempt(job, worker, future)
            running = {attempt.job.run for attempt in attempts.values()}
            # A copy of the items, since a thread of the client adds shares meanwhile.
            yield {run: share for run, share in [*self._shares.items()] if run in running}
            key, answer = self._receive()
            if key in attempts:  # else no run ended, or the attempt was given up before
                yield from self._ended(attempts.pop(key), answer, waiting, attempt_counts)

    def _ended(
        self, attempt: _Attempt, answer: Any, waiting: deque[Job], attempt_counts: Counter[str]
    ) -> Iterator[JobResult]:
        """Yield the result of a run; if its call failed on the worker, repeat the run.

        `answer`: the result of `_perform`, or an exception. `waiting`: the jobs that wait for a
        worker. `attempt_counts`: the number of failed attempts by run.
        """
        if isinstance(answer, BaseException):
            self._check_scheduler()
            self._note(f"worker {attempt.worker}: {one_line(str(answer))}")
            yield from self._repeat(attempt, waiting, attempt_counts)
        else:
            result, trace_bytes = answer
            yield _write_trace(attempt.job, result, trace_bytes)

    def _repeat(
        self, attempt: _Attempt, waiting: deque[Job], attempt_counts: Counter[str]
    ) -> Iterator[JobResult]:
        """Put the run of a lost worker first into `waiting`, and count the loss by run.

        After MAX_ATTEMPTS losses the run is not repeated, and its failure is yielded.
        """
        attempt.future.cancel()
        run = attempt.job.run
        attempt_counts[run] += 1
        self._shares.pop(run, None)
        if attempt_counts[run] < MAX_ATTEMPTS:
            self._note(f"worker {attempt.worker} is lost; run {run} is repeated")
            waiting.appendleft(attempt.job)
        else:
            reason = f"lost with its worker {MAX_ATTEMPTS} times, the last was {attempt.worker}"
            yield JobResult(run, reason=reason)

    def _update_workers(self) -> None:
        """Update `_workers` from the scheduler's list, once a second; ask new workers for software.

        SwarmError if the scheduler is lost.
        """
        now = time.monotonic()
        since_update = now - self._last_update
        if since_update < _UPDATE_PERIOD:
            return
        self._last_update = now
        # Limited: while this process or the scheduler was suspended, workers were not silent.
        elapsed = min(since_update, 2.0 * _UPDATE_PERIOD)
        self._check_scheduler()
        descriptions = self._worker_descriptions()
        for name in [name for name in self._workers if name not in descriptions]:
            del self._workers[name]
        for name, description in descriptions.items():
            worker = self._workers.get(name)
            if worker is None:
                self._workers[name] = _Worker(description["nthreads"], description["last_seen"])
                key, _ = self._submit(software_query(self._folders, self._metric_origins), name)
                self._worker_by_query[key] = name
            else:
                is_silent = worker.seen == description["last_seen"]
                worker.seen = description["last_seen"]
                worker.silence = worker.silence + elapsed if is_silent else 0.0

    def _worker_descriptions(self) -> dict[str, Any]:
        """The scheduler's description of each worker, by name; SwarmError without an answer.

        The query runs in a thread, since it never returns if the scheduler is silent.
        """
        answers: queue.SimpleQueue[Any] = queue.SimpleQueue()

        def query() -> None:
            try:
                answers.put(self._client.scheduler_info(n_workers=-1)["workers"])
            except Exception as error:
                answers.put(error)

        threading.Thread(target=query, daemon=True).start()
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
        """Let one worker call a function; returns a key and the future of the call.

        A thread puts the key and the answer into `_answers`, from which `_receive` takes them. The
        answer is the returned value of the function, or its exception.
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
        """The key and the answer of the next finished run; ("", None) if none ends in time.

        Waits for _POLL_PERIOD at most. The next answer may be that of a query for a worker's
        software. Then the answer decides whether the worker gets runs (`is_fit`), and ("", None) is
        returned.
        """
        try:
            key, answer = self._answers.get(timeout=_POLL_PERIOD)
        except queue.Empty:
            return "", None
        name = self._worker_by_query.pop(key, None)
        worker = self._workers.get(name or "")
        if name is None or worker is None:  # of a run, or of the query for a worker that is gone
            return key, answer
        difference = self._difference(answer)
        worker.is_fit = difference is None
        if difference is not None:
            refusal = f"worker {name} is not used: {difference}"
            if self._is_open or isinstance(answer, ModuleNotFoundError):
                self._note(refusal)
            else:
                self._refusal = refusal
        return "", None

    def _difference(self, answer: Any) -> str | None:
        """Why a worker's software excludes the worker; None for a usable worker.

        `answer`: the result of `software` on the worker, or an exception. Adds the software of a
        usable worker to `self._software`.
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


_QUERY = f"__import__('{__name__}', fromlist=['software']).software(folders, metrics)"


def software_query(folders: Sequence[str], metrics: Sequence[str]) -> Callable[[], Any]:
    """A call of `software` that any Python can unpickle; ModuleNotFoundError without swarmd.

    A worker that cannot unpickle a call closes. So the call is a text, and the import in it fails
    as a run does, which leaves the worker alive.
    """
    return partial(eval, _QUERY, {"folders": list(folders), "metrics": list(metrics)})


def software(
    folders: Sequence[str], metrics: Sequence[str]
) -> tuple[dict[str, str], dict[str, str]]:
    """A worker's software: versions by name, and digests of its plugins and custom metrics."""
    own = digests_of_metrics(map(metric_of, metrics))
    return made_with(), {**digests_of_folders(folders), **own}


def _perform(job: Job, timeout: float, topic: str) -> tuple[JobResult, bytes | None]:
    """Run a job in this worker; returns the result, and the bytes of the trace file or None.

    `timeout`: the longest time in s without progress of the run. Progress is reported to the client
    under `topic`. RuntimeError if the client has cancelled the job or is gone.
    """
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()
    # Dask removes this folder also after a crash.
    with TemporaryDirectory(prefix="swarmd-", dir=worker.local_directory) as folder:
        trace = None if job.trace is None else Path(folder) / "trace.npz"
        with closing(run_jobs([replace(job, trace=trace)], 1, timeout)) as results:
            for report in results:  # shares of the run, then its result
                if isinstance(report, JobResult):
                    return _for_client(report, trace)
                task = worker.state.tasks.get(key)
                if task is None or task.state != "executing":
                    break  # the client has cancelled the job, or is gone
                worker.log_event(topic, dict(report))
    raise RuntimeError("cancelled")


def _for_client(result: JobResult, trace: Path | None) -> tuple[JobResult, bytes | None]:
    """The result of a run on this worker, and the bytes of its `trace`, or None without a trace."""
    if result.write_error:
        # A write error ends the experiment. But only this worker's disk is full, so the run counts
        # as failed.
        return replace(result, reason=result.write_error, write_error=""), None
    if trace is None or result.metrics is None:
        return result, None
    return result, trace.read_bytes()


def _write_trace(job: Job, result: JobResult, trace: bytes | None) -> JobResult:
    """Write the trace to the path of its job; return `result`, or a result with `write_error`."""
    if job.trace is None or trace is None:
        return result
    try:
        with whole_file(job.trace) as partial:
            partial.write_bytes(trace)
    except OSError as error:
        return JobResult(job.run, write_error=f"{job.trace.parent}: {error.strerror or error}")
    return result
