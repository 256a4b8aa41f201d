"""`swarmctl view` on a real pseudo-terminal stops a living swarm, and leaves no trace."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import termios
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner

from swarmd.core.clock import boottime
from swarmd.core.messages import State
from swarmd.operator.cli.swarmctl import cli
from swarmd.operator.session.clocks import MAX_INPUT_GAP
from swarmd.operator.view.source import CommandProgress
from swarmd.operator.view.terminal_view import HELP, answer_lines
from tests.support.processes import CAP, stop_process, wait_until
from tests.support.swarmctl import SWARMCTL

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

SEQUENCE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
ALTERNATE, NORMAL = "\x1b[?1049h", "\x1b[?1049l"


class Terminal:
    """A `swarmctl` on a pseudo-terminal; `text` is all that it wrote so far."""

    def __init__(self, *words: str, size: tuple[int, int], environ: dict[str, str]) -> None:
        self.main, self.child = pty.openpty()
        self.resize(*size)
        self.before = termios.tcgetattr(self.child)
        self.process = subprocess.Popen(
            [*SWARMCTL, *words],
            stdin=self.child,
            stdout=self.child,
            stderr=self.child,
            start_new_session=True,
            env={**os.environ, "TERM": "xterm-256color", **environ},
        )
        self.text = ""
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait(CAP)
        os.close(self.child)
        self._reading.join(CAP)
        os.close(self.main)

    def resize(self, columns: int, rows: int) -> None:
        fcntl.ioctl(self.main, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def press(self, keys: str) -> None:
        os.write(self.main, keys.encode())

    def until(self, words: str, since: int = 0) -> int:
        """Wait until it shows the words; how much it has written by then."""
        wait_until(lambda: words in SEQUENCE.sub("", self.text[since:]), f"shows {words!r}")
        return len(self.text)

    def end(self) -> int:
        return self.process.wait(CAP)

    def _read(self) -> None:
        with contextlib.suppress(OSError):  # the other end was closed
            while data := os.read(self.main, 65536):
                self.text += data.decode(errors="replace")


@contextlib.contextmanager
def viewed(swarm: Swarm, **environ: str) -> Iterator[Terminal]:
    """`swarmctl view` for the swarm, 80 by 24."""
    shown = Terminal("view", size=(80, 24), environ={"SWARM": swarm.name, **environ})
    try:
        yield shown
    finally:
        shown.close()


@pytest.mark.integration
def test_keys_stop_three_robots_and_answers_are_counted(swarm: Swarm) -> None:
    names = ["tb3-01", "tb3-02", "tb3-03"]
    daemons = [swarm.spawn(name, swarm.resting(name)) for name in names]
    for daemon in daemons:
        daemon.wait_ready()
    with viewed(swarm, NO_COLOR="1") as shown:
        shown.until("3 robots: 3 idle")
        shown.press("e")
        shown.until("estop: 3 targeted, 3 applied")
        for name in names:
            swarm.await_state(name, State.ESTOPPED)
        # A stop that waited for a frozen view is carried out.
        frozen_at, so_far = boottime(), len(shown.text)
        stop_process(shown.process.pid)
        shown.press("s")
        wait_until(lambda: boottime() - frozen_at > 2 * MAX_INPUT_GAP, "the view was away")
        shown.process.send_signal(signal.SIGCONT)
        shown.until("stop: 3 targeted, 3 applied", so_far)
        # Other keys, sequences and pasted text do nothing.
        shown.press("xy\r\x1b[1;5e\x1b[200~q\x1b[201~")

        daemons[2].freeze()
        shown.until("3 robots: 2 estopped, 1 silent")
        so_far = len(shown.text)
        shown.press("\x05")
        shown.until("estop: 1 not acknowledged (tb3-03)", so_far)
        shown.press("q")
        shown.until("the estop is still sent", so_far)
        daemons[2].thaw()
        shown.until("estop: 3 targeted, 3 applied", so_far)

        so_far = len(shown.text)
        shown.resize(120, 40)
        shown.process.send_signal(signal.SIGWINCH)
        shown.until("┌", so_far)
        shown.press("q")
        assert shown.end() == 0
        assert termios.tcgetattr(shown.child) == shown.before
        wait_until(lambda: NORMAL in shown.text, "all is read")
        assert shown.text.count(ALTERNATE) == shown.text.count(NORMAL) == 1
        assert not re.search(r"\x1b\[(?:\d+;)*(?:3[0-7]|9[0-7]|38)[;m]", shown.text)


@pytest.mark.integration
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_terminal_is_restored_after_a_signal(swarm: Swarm, number: signal.Signals) -> None:
    with viewed(swarm) as shown:
        shown.until("no robot is heard")
        shown.process.send_signal(number)
        assert shown.end() == 128 + number
        assert termios.tcgetattr(shown.child) == shown.before
        wait_until(lambda: NORMAL in shown.text, "all is read")
        assert shown.text.count(ALTERNATE) == shown.text.count(NORMAL) == 1


def test_without_a_terminal_it_is_one_line() -> None:
    done = CliRunner().invoke(cli, ["view"])
    assert done.exit_code == 2
    assert "needs a terminal" in done.output


def test_answers_of_one_text_are_one_line() -> None:
    replies = [("a", "applied", "x"), ("b", "refused", "busy"), ("c", "refused", "busy")]
    lines = answer_lines(CommandProgress("run: 3 targeted, 1 applied", replies, is_final=True))
    assert lines == ["run: 3 targeted, 1 applied", "  b, c refused: busy"]
    assert answer_lines(CommandProgress("estop: 1 not acknowledged", missing=["d"])) == [
        "estop: 1 not acknowledged (d)"
    ]


def test_a_terminal_of_40_columns_shows_all_keys() -> None:
    assert HELP[:40].startswith("e ESTOP  s stop  q quit")
