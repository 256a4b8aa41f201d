"""`swarmctl` in the process of a test, or as a fork: a cold start costs most of its time."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TextIO
from unittest import mock

import click
import pytest

from swarmd.core.errors import RequestError
from swarmd.core.fork_server import ForkedProcess, fork_main, start_server
from swarmd.core.messages import Code, Status
from swarmd.operator.cli.swarmctl import cli, exit_code_of, run_cli
from swarmd.operator.session.exit_codes import APPLIED, UNREACHABLE
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.sim.live.starting import statuses_of
from tests.support.processes import CAP, FORKED, MODULES, unique_swarm, wait_until

STALLED = re.compile(
    r"by a stall of|loop_stalled|loading took more than|issued [\d.]+ s ago|stood still"
)
"""In a refusal, on a machine that is too busy to be in time."""
SWARMCTL = (sys.executable, "-c", "from swarmd.operator.cli.swarmctl import main; main()")
_FORKING = threading.Lock()


@dataclass(frozen=True, slots=True)
class Finished:
    """The exit code and output of a `swarmctl`, and the seconds from its start to its end."""

    code: int
    out: str
    err: str
    seconds: float = 0.0

    @property
    def outcome(self) -> tuple[int, str]:
        """The exit code and the last line, which counts the robots."""
        return self.code, self.out.splitlines()[-1]

    @property
    def json(self) -> Any:
        """Its answer with `-o json`; None if it printed none."""
        try:
            return json.loads(self.out)
        except ValueError:
            return None


def parse_line(
    command: click.Command, words: list[str], context: click.Context | None = None
) -> None:
    """Parse the words of a command line down to its verb, and run nothing; UsageError if wrong."""
    made = command.make_context(command.name, words, parent=context)
    if isinstance(command, click.Group) and made._protected_args:
        rest = [*made._protected_args, *made.args]
        _, verb, rest = command.resolve_command(made, rest)
        assert verb is not None
        parse_line(verb, rest, made)


def swarmctl(*words: str, environ: Mapping[str, str] | None = None) -> Finished:
    """Run a command to its end, without a terminal; `environ` is added to the environment."""
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch.dict(os.environ, environ or {}),
        mock.patch.object(sys, "stdin", io.StringIO()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        code = run_cli(cli, list(words), "swarmctl", exit_code_of)
    return Finished(code, out.getvalue(), err.getvalue())


def swarmctl_in_time(*words: str, environ: Mapping[str, str] | None = None) -> Finished:
    """`swarmctl`, asked again if robots refused or did not answer while the machine stalled."""
    return ask_in_time(lambda: swarmctl(*words, environ=environ), late=(UNREACHABLE,))


def ask_in_time(ask: Callable[[], Finished], *, late: tuple[int, ...] = ()) -> Finished:
    """Ask for CAP s, as long as a stall refuses it or the exit code is in `late`."""
    deadline = time.monotonic() + CAP
    while True:
        done = ask()
        is_late = STALLED.search(done.out + done.err) or done.code in late
        if done.code == APPLIED or not is_late or time.monotonic() > deadline:
            return done


def typed_in_time(ask: Callable[[], Outcome]) -> Outcome:
    """The outcome of a start; asked again if this process stood still, so that nothing was sent."""
    deadline = time.monotonic() + CAP
    while True:
        try:
            return ask()
        except RequestError as error:
            if not STALLED.search(str(error)) or time.monotonic() > deadline:
                raise


def await_applied(ask: Callable[[], Outcome], what: str) -> None:
    """Ask until all robots have applied it; only a stall of the machine may have refused it."""

    def is_applied() -> bool:
        outcome = ask()
        texts = [one.text for one in outcome.replies.values() if one.code is not Code.APPLIED]
        assert all(map(STALLED.search, texts)), outcome
        return outcome.exit_code == APPLIED

    wait_until(is_applied, what)


def heard_statuses(operator: Operator, robots: Collection[str]) -> dict[str, Status]:
    """The statuses of `robots`, once each has answered: a busy machine loses datagrams."""
    heard = dict[str, Status]()

    def have_all_answered() -> bool:
        heard.update(statuses_of(operator.members()))
        return heard.keys() >= set(robots)

    wait_until(have_all_answered, f"{', '.join(robots)} answered")
    return heard


class Running(ForkedProcess):
    """A `swarmctl` that is under way in a process of its own; a context manager, which ends it.

    `out` and `err` are what it writes. `namespace`: the network namespace in which it runs;
    `program`: `swarmd` to run that one instead.
    """

    def __init__(
        self,
        *words: str,
        environ: Mapping[str, str] | None = None,
        namespace: str = "",
        program: str = "swarmctl",
    ) -> None:
        self.words = words
        self._began = time.monotonic()
        pipes = [os.pipe() for _ in range(2)]
        self.out, self.err = (os.fdopen(reader, encoding="utf-8") for reader, _ in pipes)
        writers = [writer for _, writer in pipes]
        out, err = (Path(f"/proc/{os.getpid()}/fd/{writer}") for writer in writers)
        start_server(MODULES)
        with _FORKING, mock.patch.dict(os.environ, environ or {}):
            arguments = (program, namespace, *words)
            forked = fork_main(program, FORKED, arguments, stdout=out, stderr=err)
        super().__init__(forked._process)
        wait_until(lambda: self._has_opened(writers), "swarmctl writes to the pipes")
        for writer in writers:
            os.close(writer)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        self.wait(CAP)
        for end in (self.out, self.err):
            end.close()

    def goes_on_until(self, condition: Callable[[], bool], what: str) -> bool:
        """Wait until the condition holds or it has ended; True if it goes on."""
        wait_until(lambda: condition() or self.poll() is not None, what)
        return self.poll() is None

    def finish(self, cap: float = CAP) -> Finished:
        """Its answer; a swarmctl that has not ended after `cap` s is aborted and shows where."""
        with self, ThreadPoolExecutor(2) as pool:
            out, err = (pool.submit(_read, end) for end in (self.out, self.err))
            try:
                code = self.wait(cap)
            except subprocess.TimeoutExpired:
                self.send_signal(signal.SIGABRT)  # faulthandler then prints where it hangs
                pytest.fail(f"{self.words} has not ended after {cap:g} s:\n{err.result()}")
            return Finished(code, out.result(), err.result(), time.monotonic() - self._began)

    def _has_opened(self, writers: list[int]) -> bool:
        wanted = [os.readlink(f"/proc/self/fd/{writer}") for writer in writers]
        try:
            return [os.readlink(f"/proc/{self.pid}/fd/{n}") for n in (1, 2)] == wanted
        except OSError:  # it has ended already
            return self.poll() is not None


def fork_command(
    name: str, *words: object, cwd: Path, **environ: str
) -> subprocess.CompletedProcess[str]:
    """Run `swarmctl` or `swarmd` to its end in a fork, in a swarm and with a home of its own."""
    given = {"HOME": str(cwd), "SWARM": unique_swarm(), **environ}
    arguments = [*map(str, words)]
    with contextlib.chdir(cwd):
        running = Running(*arguments, environ=given, program=name)
    done = running.finish()
    return subprocess.CompletedProcess(arguments, done.code, done.out, done.err)


def _read(end: TextIO) -> str:
    return end.read()
