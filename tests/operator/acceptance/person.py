"""A person at a terminal in front of a dialogue, such as `swarmctl acceptance`."""

from __future__ import annotations

import os
import pty
import select
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress

from tests.support.processes import CAP, wait_until
from tests.support.swarmctl import SWARMCTL

QUESTION = "[y/N]"
READ_TIME = 1.5  # s that a person reads a question


class Person:
    """What a person sees and types: a verb of `swarmctl` in a process with a terminal.

    `prefix`: a command that becomes the program, such as that of a network namespace. `environ` is
    added to the environment.
    """

    def __init__(
        self,
        swarm: str,
        robot: str,
        *words: str,
        prefix: Sequence[str] = (),
        environ: Mapping[str, str] | None = None,
        verb: str = "acceptance",
    ) -> None:
        self.text = ""
        self._read_to = 0
        self.pid, self.keyboard = pty.fork()
        if self.pid == 0:
            os.environ.update({"SWARM": swarm, "COLUMNS": "40", **(environ or {})})
            command = [*prefix, *SWARMCTL, verb, robot, *words]
            os.execvp(command[0], command)

    def see(self, seconds: float) -> None:
        """Take what comes within `seconds`."""
        if select.select([self.keyboard], [], [], seconds)[0]:
            try:
                self.text += os.read(self.keyboard, 4096).decode(errors="replace")
            except OSError:  # the process has ended
                time.sleep(seconds)

    def read_on(self, word: str, cap: float = CAP) -> None:
        """Read until a word comes that was not read before."""
        end = time.monotonic() + cap
        while (place := self.text.find(word, self._read_to)) < 0:
            assert time.monotonic() < end, self.text
            self.see(0.1)
        self._read_to = place + len(word)

    def restore(self, cap: float = CAP) -> None:
        """Press Enter once the test asks whether all is as before."""
        self.read_on("press Enter", cap)
        time.sleep(6.0)
        self.press(b"\n")

    @property
    def words(self) -> str:
        """What was read so far, without breaks of lines."""
        return " ".join(self.text.split())

    def answer(self, text: str) -> None:
        """Read the next question, and answer it."""
        self.read_on(QUESTION)
        time.sleep(READ_TIME)
        os.write(self.keyboard, f"{text}\n".encode())

    def press(self, key: bytes) -> None:
        os.write(self.keyboard, key)

    def end(self) -> int:
        """The exit code."""
        found: list[int] = []

        def has_ended() -> bool:
            self.see(0.05)
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                found.append(os.waitstatus_to_exitcode(status))
            return bool(pid)

        wait_until(has_ended, "the test ends")
        os.close(self.keyboard)
        return found[0]


@contextmanager
def person(
    swarm: str,
    robot: str,
    *words: str,
    prefix: Sequence[str] = (),
    environ: Mapping[str, str] | None = None,
    verb: str = "acceptance",
) -> Iterator[Person]:
    one = Person(swarm, robot, *words, prefix=prefix, environ=environ, verb=verb)
    try:
        yield one
    finally:
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(one.pid, signal.SIGKILL)
            os.waitpid(one.pid, 0)
