"""`swarmd hub`: runs the hub of a base so that the hub outlives the daemon's last zeros.

A signal that ends a robot often reaches the daemon and its hub at once: Ctrl-C in a terminal or on
`ros2 launch`, a hang-up, the end of a service or of a session. A hub (a Zenoh bridge or router)
ends within milliseconds, before a zero has passed it. A base without a command timeout then keeps
its last velocity.

Three processes solve this. The first is the one that was started. It ignores nothing: on a signal
it writes to a pipe, and it ends when the second has ended. The second, the keeper, reads the pipe,
which ends if the first process was killed. The keeper then waits for OUTLIVES s and kills the
third, the hub. Keeper and hub ignore the signals, and have a session of their own.
"""

from __future__ import annotations

import os
import select
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress

import click

from swarmd.core.errors import ConfigError

OUTLIVES = 3.0
"""Seconds for which the hub outlives the signal: the watchdog sends zeros for 2 s.

`ros2 launch` sends SIGTERM 5 s after Ctrl-C, and SIGKILL after 10 s.
"""

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@click.command(
    context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False},
)
@click.argument("command", nargs=-1, required=True, type=click.UNPROCESSED, metavar="COMMAND...")
def hub(command: tuple[str, ...]) -> None:
    """Run the hub of a base, such as zenoh-bridge-ros2dds, for 3 s longer than it is asked to.

    The zeros of a daemon that ends at the same time pass the hub: by Ctrl-C, by `ros2 launch`, with
    the terminal or with a service. A base without a command timeout needs these zeros. The exit
    code is that of COMMAND, or 0 after a signal.
    """
    if shutil.which(command[0]) is None:
        raise ConfigError(f"{command[0]}: no such program on PATH; install it, or give its path")
    sys.exit(run_hub(command))


def run_hub(command: Sequence[str], outlives: float = OUTLIVES) -> int:
    """Run the program to its end, or until `outlives` s after a signal; returns the exit code."""
    # A signal that comes before the handlers are there waits for them.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    reader, writer = os.pipe()
    if (keeper := os.fork()) == 0:
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)  # the hub inherits this
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
        os.close(writer)
        os.setsid()
        os._exit(_keep(command, reader, outlives))
    os.close(reader)
    for number in _SIGNALS:
        signal.signal(number, lambda *_: os.write(writer, b"."))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    _, status = os.waitpid(keeper, 0)
    return os.waitstatus_to_exitcode(status)


def _keep(command: Sequence[str], reader: int, outlives: float) -> int:
    """Run the hub until it ends, or until `outlives` s after a byte, or the end, of the pipe."""
    process = subprocess.Popen(command, start_new_session=True)
    ended = os.pidfd_open(process.pid)
    select.select([reader, ended], [], [])
    is_asked = process.poll() is None
    if is_asked:
        select.select([ended], [], [], outlives)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)  # with what it has started, such as by `ros2 run`
    code = process.wait()
    if is_asked:
        return 0
    return code if code >= 0 else 128 - code
