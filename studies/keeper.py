"""The keeper of studies: what was computed is not computed again.

A study has runs of two kinds.

1. **Runs of a scenario** go through `simulate(..., out=experiment_folder(STUDY) / NAME)`. The
   folder of the experiment keeps each run when it has ended, and the same call goes on. The store
   of runs of the user is a second, bounded source of the same runs. Outcomes of patterns have no
   such folder: after a kill they go on by the store alone.
2. **Runs of a Python function** (lockstep with a judge, swarms of points, debates, searches,
   theory) go through `records(perform, tasks, file)`. `perform` takes a task and gives what was
   found, both structs, dataclasses or plain values. A line of JSON with the record is written when
   a run has ended. A task that has a record of the same code is not done again. `each` is `records`
   for studies that want what was found alone; it keeps it in a job of a night only.

A record counts if its `code` is that of now: the digest of the sources of the module of `perform`
(`studies.night.sources`) and of the libraries and functions of this process. Thus `perform` may
depend on nothing but its task, these sources, and records of other tasks.

What is no record counts as not there, and its run is done again: the end of a file that a kill has
cut off, a line of other code, a line of another shape (told in one line on the standard error). Two
processes never write one file: the second one ends with a ConfigError.

A record has `bits`, 12 hexadecimal digits of how the run went, and `rules`, the names of the rules
of protection and steering that fired in it. `traced` takes both from a trace, by the functions that
runs of `simulate` use. Without a trace the bits are a digest of the found value. A run of real time
has no bits, since it never repeats.

A process with the variable VARIABLE does a job whose runs are listed (`run_list.py`): for each
record that a call gives, known or new, the file of that name gets a line (two calls may give one
record)

    {"run": "studies.faults:perform", "task": ..., "bits": "0123456789ab", "rules": [...]}

by which `again(run, task)` does the run once more. Local functions and runs without bits are not
listed.
"""

from __future__ import annotations

import errno
import hashlib
import importlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import date
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints, overload

import msgspec
import numpy as np

from studies.night.sources import digest_of, sources_of
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.files import lock_file, read_regular
from swarmd.core.pin import functions_here
from swarmd.core.processes import die_with_parent
from swarmd.sim.behaviour import RUN_DIGITS, hash_of, rules_of
from swarmd.sim.experiments.provenance import deciding, git_state, made_with
from swarmd.sim.experiments.run_list import VARIABLE
from swarmd.sim.trace import Trace

T = TypeVar("T")
R = TypeVar("R")

_DIGITS_OF_CODE = 12
_BEGIN = b'{"task": '  # of each record
_EVERY = 1.0  # s between two lines of progress
_NOT_DECIDING = frozenset({"swarmd", "code"})
"""What `made_with` names beside libraries and functions: the sources have a digest of their own."""


# Without slots, since typing sets an attribute of what is made as Traced[R](...).
@dataclass(frozen=True)
class Traced(Generic[R]):
    """What `perform` found in a trace, with the behaviour of its robots.

    `bits`: empty for a run of real time, which never repeats.
    """

    found: R
    bits: str = ""
    rules: tuple[str, ...] = ()


@dataclass(frozen=True)
class Record(Generic[T, R]):
    """A finished run."""

    task: T
    found: R
    cpu: float = 0.0
    """The processor time in s."""
    day: str = ""
    """When it was made, such as 2026-11-30."""
    commit: str = ""
    """The checkout's, with `(changed)` if tracked files differed from it."""
    code: str = ""
    """The digest of the sources and of the software."""
    bits: str = ""
    """RUN_DIGITS hexadecimal digits of how it went; empty: it never repeats."""
    rules: tuple[str, ...] = ()
    """The rules of protection and steering that fired, sorted."""

    def __str__(self) -> str:
        return f"{_text(self.task)}: {self.cpu:.1f} s"


def experiment_folder(study: str) -> Path:
    """The folder of the experiments of a study: another one for other sources."""
    return Path("build") / study / digest_of([f"studies.{study}"])[:8]


def records_file(perform: Callable[..., Any]) -> Path:
    """The file of the records of a function, such as build/studies.faults/perform.jsonl."""
    module, _, name = name_of(perform).partition(":")
    return Path("build") / module / f"{name}.jsonl"


@overload
def records(
    perform: Callable[[T], Traced[R]],
    tasks: Iterable[T],
    file: Path | None = ...,
    *,
    jobs: int = ...,
    told: Callable[[Record[T, R]], str] | None = ...,
    code: str | None = ...,
) -> list[Record[T, R]]: ...


@overload
def records(
    perform: Callable[[T], R],
    tasks: Iterable[T],
    file: Path | None = ...,
    *,
    jobs: int = ...,
    told: Callable[[Record[T, R]], str] | None = ...,
    code: str | None = ...,
) -> list[Record[T, R]]: ...


def records(
    perform: Callable[[Any], Any],
    tasks: Iterable[Any],
    file: Path | None = None,
    *,
    jobs: int = 1,
    told: Callable[[Record[Any, Any]], str] | None = None,
    code: str | None = None,
) -> list[Record[Any, Any]]:
    """The records of all tasks, in their order; what `file` has is not done again.

    `perform`: a function of a module, with annotations, which runs in one of `jobs` processes. With
    one job it runs in this process, and may be a local function. `file`: None for `records_file`.
    `told`: the line of progress of each record on the standard error; None: a line every second.
    `code`: None for `code_of(perform)`.

    An error of a run ends the call; finished runs are kept. ConfigError if the file cannot be read
    or another process writes it, SwarmError if it cannot be written or a worker is killed.
    """
    all_tasks = [*tasks]
    wanted = {_text(task): task for task in all_tasks}
    kept = _File(file or records_file(perform), perform, code or code_of(perform))
    known = kept.read()
    if not wanted.keys() <= known.keys():
        with kept.appended() as append:
            known = kept.read()  # another process may have written until now
            missing = {key: task for key, task in wanted.items() if key not in known}
            keys = [*missing]
            progress = _Progress(len(wanted), len(wanted) - len(missing), told)
            for number, result in _done(perform, [*missing.values()], jobs):
                key = keys[number]
                known[key] = append(missing[key], result)
                progress.add(replace(known[key], task=missing[key]))
    found = [replace(known[_text(task)], task=task) for task in all_tasks]
    _list_runs(perform, found)
    return found


@overload
def each(perform: Callable[[T], Traced[R]], tasks: Iterable[T], jobs: int = ...) -> list[R]: ...


@overload
def each(perform: Callable[[T], R], tasks: Iterable[T], jobs: int = ...) -> list[R]: ...


def each(perform: Callable[[Any], Any], tasks: Iterable[Any], jobs: int = 1) -> list[Any]:
    """What `perform` finds for each task, in the order of the tasks, in `jobs` processes.

    Records are kept, read and listed in a process with the variable VARIABLE alone: a test, and a
    study that changes the code of its process (`unlisted`), compute what they ask for.
    """
    if os.environ.get(VARIABLE):
        return [record.found for record in records(perform, tasks, jobs=jobs)]
    results = dict(_done(perform, [*tasks], jobs))
    return [results[number].traced.found for number in range(len(results))]


def traced(found: R, trace: Trace) -> Traced[R]:
    """What was found in a trace, with the bits and the rules of the trace."""
    return Traced(found, hash_of(trace), rules_of(trace))


def again(run: str, task: Any) -> Traced[Any]:
    """Do a run that was listed once more, in this process; nothing is kept.

    `run` and `task`: of the line of the run. SwarmError if there is no such function, if the task
    is not one of its tasks, and for any error of the run: code that has changed may raise anything.
    """
    module, _, name = run.partition(":")
    try:
        perform = getattr(importlib.import_module(module), name)
        typed = msgspec.convert(task, _kinds_of(perform).task, dec_hook=_decoded)
    except (ImportError, AttributeError, msgspec.ValidationError) as error:
        raise SwarmError(
            f"run {run} of task {json.dumps(task)} is of other code: {error}"
        ) from error
    try:
        return _perform(perform, typed).traced
    except Exception as error:
        text = f"run {run} of task {json.dumps(task)}: {type(error).__name__}: {error}"
        raise SwarmError(text) from error


def code_of(perform: Callable[..., Any]) -> str:
    """The digest of all that decides what a function finds, beside its task.

    SwarmError if the function is of no module of this project, such as of a script.
    """
    module = name_of(perform).partition(":")[0]
    if not sources_of([module]):
        raise SwarmError(f"{module} has no known sources; start it as `python -m MODULE`")
    made = deciding(made_with(functions_here()))
    software = {name: text for name, text in made.items() if name not in _NOT_DECIDING}
    text = json.dumps([digest_of([module]), software], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS_OF_CODE]


def name_of(perform: Callable[..., Any]) -> str:
    """The name of a function with that of its module, also of the module that was started."""
    module = perform.__module__
    spec = getattr(sys.modules[module], "__spec__", None)
    return f"{module if spec is None else spec.name}:{perform.__qualname__}"


def commit() -> str:
    """The commit of the checkout, such as `1a2b3c4 (changed)`; `unknown` without a checkout."""
    state = git_state(Path(__file__).parent)
    return "unknown" if state is None else state.commit[:7] + " (changed)" * state.is_dirty


@dataclass(frozen=True, slots=True)
class _Kinds:
    """The types of a function: of its task, and of what it finds."""

    task: Any
    found: Any


@dataclass(frozen=True, slots=True)
class _Result:
    """What a worker gives."""

    traced: Traced[Any]
    cpu: float


class _Progress:
    """Tells how many of all records there are, in lines on the standard error."""

    def __init__(
        self, total: int, known: int, told: Callable[[Record[Any, Any]], str] | None
    ) -> None:
        self._total = total
        self._count = known
        self._told = told
        self._last = time.monotonic()

    def add(self, record: Record[Any, Any]) -> None:
        """Count a record."""
        self._count += 1
        now = time.monotonic()
        is_due = now >= self._last + _EVERY or self._count == self._total
        if self._told is None and not is_due:
            return
        self._last = now
        text = str(record) if self._told is None else self._told(record)
        print(f"{self._count}/{self._total} {text}", file=sys.stderr, flush=True)


class _Line(msgspec.Struct, frozen=True, kw_only=True):
    """A record in a file."""

    task: Any
    code: str
    cpu: float
    bits: str
    rules: tuple[str, ...]
    day: str
    commit: str
    found: Any


class _File:
    """A file of records of one function."""

    def __init__(self, path: Path, perform: Callable[[Any], Any], code: str) -> None:
        self._path = path
        self._kind = _kinds_of(perform).found
        self._code = code
        self._commit = commit()
        self._is_told = False

    def read(self) -> dict[str, Record[Any, Any]]:
        """The records of this code, by key, with tasks as they are in JSON.

        A last line without its end is left out: it is being written, or power was cut meanwhile.
        """
        found = {}
        odd = 0
        for written in self._content().split(b"\n")[:-1]:
            try:
                line = msgspec.convert(json.loads(written), _Line)
                if line.code == self._code:
                    found[json.dumps(line.task)] = self._record(line)
            except ValueError:
                odd += 1
        if odd and not self._is_told:
            self._is_told = True
            text = f"{self._path}: {odd} {'line is' if odd == 1 else 'lines are'} no records"
            print(f"{text}, and count as not there", file=sys.stderr, flush=True)
        return found

    @contextmanager
    def appended(self) -> Iterator[Callable[[Any, _Result], Record[Any, Any]]]:
        """A function that writes the record of a task and gives it as it will be read.

        While it is open no other process writes the file.
        """
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            out = self._path.open("ab", buffering=0)
        except OSError as error:
            raise SwarmError(f"{self._path}: {error.strerror}") from error
        with out:
            try:
                lock_file(out.fileno(), waits=False)
            except BlockingIOError as error:
                raise ConfigError(
                    f"{self._path}: another process does runs of this file; wait for its end"
                ) from error
            content = self._content()
            whole = content.rfind(b"\n") + 1
            if not _is_begun(content[whole:]):
                raise ConfigError(
                    f"{self._path}: its end is no record that was cut off; name another file, or"
                    " end its last line"
                )
            out.truncate(whole)

            def append(task: Any, result: _Result) -> Record[Any, Any]:
                line = self._line(task, result)
                text = json.dumps(msgspec.to_builtins(line)).encode() + b"\n"
                try:
                    if out.write(text) < len(text):
                        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                except OSError as error:
                    raise SwarmError(
                        f"{self._path}: {error.strerror}; finished runs are kept: give the same"
                        " command again"
                    ) from error
                return self._record(line)

            yield append

    def _content(self) -> bytes:
        try:
            return read_regular(self._path, sys.maxsize)
        except FileNotFoundError:
            return b""
        except OSError as error:
            text = f"{self._path}: {error.strerror}; expected a file with the records of runs"
            raise ConfigError(text) from error

    def _line(self, task: Any, result: _Result) -> _Line:
        found = _plain(result.traced.found)
        return _Line(
            task=_plain(task),
            code=self._code,
            cpu=round(result.cpu, 3),
            bits=result.traced.bits,
            rules=result.traced.rules,
            day=date.today().isoformat(),
            commit=self._commit,
            found=found,
        )

    def _record(self, line: _Line) -> Record[Any, Any]:
        return Record(
            task=line.task,
            found=msgspec.convert(line.found, self._kind, dec_hook=_decoded),
            bits=line.bits,
            rules=line.rules,
            cpu=line.cpu,
            code=line.code,
            day=line.day,
            commit=line.commit,
        )


def _kinds_of(perform: Callable[[Any], Any]) -> _Kinds:
    hints = get_type_hints(perform)
    found = hints.pop("return")
    task = next(iter(hints.values()))
    is_traced = get_origin(found) is Traced
    return _Kinds(task, get_args(found)[0] if is_traced else found)


def _perform(perform: Callable[[Any], Any], task: Any) -> _Result:
    """Do a run in this process."""
    begin = time.process_time()
    result = perform(task)
    if not isinstance(result, Traced):
        result = Traced(result, _digest(_text(result)))
    return _Result(result, time.process_time() - begin)


def _done(
    perform: Callable[[Any], Any], tasks: Sequence[Any], jobs: int
) -> Iterator[tuple[int, _Result]]:
    """The results of tasks with their numbers, as they come."""
    if jobs == 1 or len(tasks) < 2:
        for number, task in enumerate(tasks):
            yield number, _perform(perform, task)
        return
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # else two processes would want four processors
    processes = min(jobs, len(tasks))
    with ProcessPoolExecutor(
        processes,
        mp_context=get_context("spawn"),
        initializer=die_with_parent,
        initargs=(os.getpid(),),
    ) as pool:
        try:
            futures: dict[Future[_Result], int] = {
                pool.submit(_perform, perform, task): number for number, task in enumerate(tasks)
            }
            for future in as_completed(futures):
                yield futures.pop(future), future.result()
        except BrokenProcessPool as error:
            raise SwarmError(
                "a worker process was killed (out of memory, or by hand); finished runs are kept:"
                " give the same command again"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)


def _list_runs(perform: Callable[[Any], Any], found: Sequence[Record[Any, Any]]) -> None:
    """Append the runs to the file of VARIABLE, if there is one."""
    name = name_of(perform)
    file = os.environ.get(VARIABLE, "")
    if not file or "<locals>" in name:
        return
    lines = [
        {"run": name, "task": _plain(one.task), "bits": one.bits, "rules": one.rules}
        for one in found
        if one.bits
    ]
    try:
        with Path(file).open("a") as out:
            out.write("".join(f"{json.dumps(line)}\n" for line in lines))
    except OSError as error:
        text = f"{file}: {error.strerror}; the runs are kept, and not listed"
        raise SwarmError(f"{text}: mend it, or unset {VARIABLE}") from error


def _is_begun(end: bytes) -> bool:
    """Whether the end of a file may be a record that was cut off, by a kill or with the power."""
    begin = end.rstrip(b"\0")[: len(_BEGIN)]
    return _BEGIN.startswith(begin)


def _text(value: Any) -> str:
    """A value as text, by which the records of a task are found."""
    return json.dumps(_plain(value))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:RUN_DIGITS]


def _plain(value: Any) -> Any:
    """A value as the module json writes it, numbers that are not finite included."""
    return msgspec.to_builtins(value, str_keys=True, enc_hook=_encoded)


def _encoded(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return {"shape": value.shape, "values": value.ravel().tolist()}
    raise NotImplementedError(f"a record cannot hold a {type(value).__name__}")


def _decoded(kind: Any, value: Any) -> Any:
    if (get_origin(kind) or kind) is np.ndarray:
        (dtype,) = get_args(get_args(kind)[1]) or (np.float64,)
        return np.array(value["values"], dtype=dtype).reshape(value["shape"])
    raise NotImplementedError(f"a record cannot hold a {kind}")
