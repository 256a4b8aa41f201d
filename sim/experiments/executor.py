"""Runs of an experiment on an executor: a Dask cluster, MPI, SLURM by submitit, a process pool.

`run_job` is a pure function of a job that pickles, so each executor with the interface of
`concurrent.futures` is a runner. The executor keeps the queue, and repeats what a lost worker held.
"""

from __future__ import annotations

import pickle
import socket
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future, as_completed
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from ipaddress import ip_address
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.files import read_regular, write_whole
from swarmd.sim.experiments.pool import (
    STEP_TIMEOUT,
    Job,
    JobResult,
    Shares,
    one_line,
    run_jobs,
    worker_functions,
)
from swarmd.sim.experiments.provenance import deciding, digests_of_folders, made_with
from swarmd.sim.experiments.store import translated_errors
from swarmd.sim.metrics.catalog import metric_of

if TYPE_CHECKING:
    from swarmd.sim.experiments.simulate import Runner

_CONNECT_TIMEOUT = 10.0  # s
_POLL_PERIOD = 0.25  # s between two looks at calls that cannot be waited for
_ENCRYPTED = ("tls://", "wss://", "inproc://")  # or within this process
_KEPT = "finished runs are kept: give the same command again"


class _SchedulerFile(msgspec.Struct):
    address: str


class Call(Protocol):
    """A call that an executor has taken: a `concurrent.futures.Future`, or a job of submitit."""

    def result(self) -> Any:
        """What the call has returned; raises what the call has raised."""

    def done(self) -> bool:
        """Whether the call has ended."""

    def cancel(self) -> Any:
        """Cancel the call."""


class Executor(Protocol):
    """The part of `concurrent.futures.Executor` that a runner needs."""

    def submit(self, function: Callable[..., Any], /, *words: Any) -> Call:
        """Let a worker call `function(*words)`."""


@dataclass(frozen=True, slots=True)
class _Request:
    """What a worker gets for a run."""

    job: Job
    timeout: float  # s
    cores: int
    software: Mapping[str, str]  # of the client, by name


# A text, which every Python unpickles: the scheduler and a wrong worker may lack swarmd.
_CALL = f"__import__({__name__!r}, fromlist=['*']).perform(request)"


def on_executor(executor: Executor, timeout: float = STEP_TIMEOUT, cores: int = 1) -> Runner:
    """A function that does runs by `executor.submit`, each in a process of its own on a worker.

    `timeout`: a run fails after this time in s without progress. `cores`: the number of processes
    that share the robots of a run. The function yields a result once its run has ended; the
    traces come back to the folder of the caller.

    The function raises SwarmError, after which finished runs are kept, if a worker has other
    software (`software_of`), if it lacks swarmd, or if the executor ends. Calls that have not begun
    are cancelled when its iterator is closed.
    """

    def run(jobs: Sequence[Job]) -> Generator[JobResult | Shares, None, None]:
        own = software_of(jobs)
        calls: dict[Call, Job] = {}
        try:
            for job in jobs:
                request = pickle.dumps(_Request(job, timeout, cores, own))
                calls[executor.submit(eval, _CALL, {"request": request})] = job
            for call, job in _ended(calls):
                try:
                    refusal, result, trace = pickle.loads(call.result())
                except (BrokenExecutor, CancelledError) as error:
                    text = one_line(f"{type(error).__name__} {error}".strip())
                    raise SwarmError(f"the executor has ended ({text}); {_KEPT}") from error
                except ImportError as error:
                    raise SwarmError(
                        f"a worker lacks software: {one_line(str(error))}; install the versions of"
                        f" this machine there; {_KEPT}"
                    ) from error
                except Exception as error:  # a run whose workers were lost, or an error of a worker
                    yield JobResult(job.run, reason=one_line(f"{type(error).__name__}: {error}"))
                    continue
                if refusal:
                    raise SwarmError(f"{refusal}; {_KEPT}")
                if job.trace is not None and trace is not None:
                    with translated_errors(job.trace.parent):
                        write_whole(job.trace, trace)
                yield result
        finally:
            for call in calls:
                with suppress(Exception):  # of an executor that has ended
                    call.cancel()

    return run


def _ended(calls: Mapping[Call, Job]) -> Iterator[tuple[Call, Job]]:
    """The calls in the order in which they end, each with its job."""
    futures: dict[Future[Any], Job] = {
        call: job for call, job in calls.items() if isinstance(call, Future)
    }
    if len(futures) == len(calls):
        for future in as_completed(futures):
            yield future, futures[future]
        return
    waiting = dict(calls)
    while waiting:
        ended = [call for call in waiting if call.done()]
        for call in ended:
            yield call, waiting.pop(call)
        if waiting and not ended:
            time.sleep(_POLL_PERIOD)


def software_of(jobs: Sequence[Job]) -> dict[str, str]:
    """The software of this machine that decides the bits of `jobs`, by name.

    Versions, kernels, the functions of a pinned worker, the digests of swarmd's code, of the files
    in folders of plugins, and of custom metrics. ConfigError if the file of a metric is missing or
    has another digest; SwarmError if a plugin cannot be read.
    """
    folders = {job.effective["plugin_dir"] for job in jobs if job.effective.get("plugin_dir")}
    for job in jobs[:1]:
        for origin, digest in job.metrics.items():
            metric_of(origin, digest)
    return {**made_with(worker_functions()), **digests_of_folders(sorted(folders))}


def difference(own: Mapping[str, str], there: Mapping[str, str]) -> str:
    """The first difference between the software of two machines; empty if their bits are equal.

    The processor counts only if a worker of one of them is not pinned: it may then compute other
    last bits.
    """
    if own.get("pinned") == there.get("pinned"):
        own = deciding(own)
        there = deciding(there)
    names = (name for name in {**own, **there} if own.get(name) != there.get(name))
    return next(
        (f"{n} is {there.get(n, 'missing')} there, {own.get(n, 'missing')} here" for n in names),
        "",
    )


def perform(request: bytes) -> bytes:
    """On a worker: do a run in a process of its own.

    `request`: a pickled `_Request`. Returns, pickled: why this worker does no runs of the request
    (empty if it does), the result, and the bytes of the trace or None.
    """
    wanted: _Request = pickle.loads(request)
    host = socket.gethostname()
    try:
        text = difference(wanted.software, software_of([wanted.job]))
    except SwarmError as error:
        text = str(error)
    if text:
        remedy = "install the same software there, or end that worker"
        return pickle.dumps((f"worker on {host}: {one_line(text)}; {remedy}", None, None))
    with TemporaryDirectory(prefix="swarmd-") as folder:
        trace = None if wanted.job.trace is None else Path(folder) / "trace.npz"
        job = replace(wanted.job, trace=trace)
        with closing(run_jobs([job], 1, wanted.timeout, wanted.cores)) as reports:
            result = next(report for report in reports if isinstance(report, JobResult))
        if result.write_error:
            reason = f"worker on {host}: {result.write_error}"
            result = replace(result, metrics=None, write_error="", reason=one_line(reason))
        is_written = trace is not None and result.metrics is not None
        return pickle.dumps(("", result, trace.read_bytes() if is_written and trace else None))


@contextmanager
def dask_cluster(address: str, *, warn: Callable[[str], object] = str) -> Iterator[Executor]:
    """The executor of a Dask cluster.

    `address`: of its scheduler: `tls://HOST:8786`, with the certificates that Dask's configuration
    names, or `tcp://HOST:8786`. `warn` is called with a line if others may reach the cluster
    without a key, and if it has no worker. ConfigError if no scheduler answers.
    """
    import dask

    # Dask would log, with its stack, each loss that is reported in one line.
    names = ("distributed", "distributed.client", "tornado.application")
    levels = dict.fromkeys(names, "critical")
    with dask.config.set({"logging": levels}):
        from distributed import Client, Security
        from distributed.comm.addressing import resolve_address
    try:
        # A client that these errors end in its constructor would wait for 20 s.
        resolve_address(address)
        words = Security().get_connection_args("client")
        is_encrypted = address.startswith(_ENCRYPTED)
        if is_encrypted and words.get("ssl_context") is None:
            raise ValueError("Dask's configuration names no certificates (distributed.comm.tls)")
        if words.get("require_encryption") and not is_encrypted:
            raise ValueError("Dask's configuration requires encryption; expected tls://HOST:PORT")
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise ConfigError(
            f"scheduler {address}: {one_line(str(error))}; expected the address of a Dask scheduler"
        ) from error
    with client:
        if is_open(address):
            warn(
                f"{address} is plain tcp: whoever reaches the scheduler or a worker runs code on"
                " all machines of the cluster; use tls:// or a tunnel"
            )
        if not client.scheduler_info()["workers"]:
            warn(f"no worker has joined yet; start some: dask worker {address}")
        yield client.get_executor(pure=False)


def address_in(scheduler_file: Path) -> str:
    """The address in the file of `dask scheduler --scheduler-file`; ConfigError for another."""
    try:
        return msgspec.json.decode(read_regular(scheduler_file), type=_SchedulerFile).address
    except (OSError, msgspec.MsgspecError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(
            f"{scheduler_file}: {why}; expected the file that `dask scheduler --scheduler-file`"
            " has written"
        ) from error


def is_open(address: str) -> bool:
    """Whether an address of Dask is neither encrypted nor on loopback: `tcp://10.0.0.4:8786`."""
    if address.startswith(_ENCRYPTED):
        return False
    place = address.rpartition("://")[2]
    host = place.rpartition(":")[0].strip("[]")
    with suppress(ValueError):
        return not ip_address(host).is_loopback
    return host != "localhost"
