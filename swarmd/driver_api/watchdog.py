"""The stopper: a second process that says zero to a base when its guardian falls silent.

For bases that keep their last command for ever. It is started before the driver, with a connection
of its own that is already open, and fed by the guardian's tick over a socket pair. End of file, or
0.4 s of silence: it sends zeros until the guardian is back, for at least 2 s. A guardian that is
back before they end says zero as well, so that the base stands.

Before the first tick it sends nothing. After a farewell, SIGTERM, or when a new guardian's stopper
relieves it, the 2 s are enough; the new one is ready when they are over. It detaches from its
guardian, whose end must not be its own.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import json
import os
import select
import signal
import socket
import time
from collections.abc import Callable
from hashlib import sha256
from importlib import import_module
from typing import TYPE_CHECKING, NoReturn, cast

from swarmd.core.clock import boottime
from swarmd.core.errors import DriverError, SwarmError

if TYPE_CHECKING:
    from swarmd.driver_api.driver import ZeroSender

SILENCE = 0.4
"""Seconds without a tick after which zeros are sent."""
AT_LEAST = 2.0
"""Seconds for which zeros are sent, however soon the guardian is back."""
PERIOD = 0.05

TICK, FAREWELL = b"t", b"f"
READY, FAULT = b"r", b"e"
ZEROS = b"z"
"""The answer to a tick, and what is said unasked, while zeros are sent; else a tick itself.

Also the answer while no zero could be sent: what cannot be stopped must not move.
"""
_RELIEF = b"relief"
_CLAIM_WITHIN = 5.0


class CommandTimeout:
    """When zeros are sent; pure. Times in s on one monotonic clock, handed in, never falling.

    Armed by the first tick: whoever never drove must not stop who does.
    """

    def __init__(self) -> None:
        self._heard: float | None = None
        self._began: float | None = None
        self._has_left = False
        self._may_end = False

    @property
    def has_left(self) -> bool:
        """True once the guardian's end is closed."""
        return self._has_left

    @property
    def is_relieved(self) -> bool:
        """True if nothing was heard since another took over."""
        return self._may_end

    def tick(self, now: float) -> None:
        """The guardian lives."""
        self._heard = now
        self._may_end = False

    def leave(self, now: float) -> None:
        """The guardian's end is closed: end of file."""
        self._has_left = True
        if self._began is None and self._heard is not None and not self._may_end:
            self._began = now

    def relieve(self) -> None:
        """Another watches over the base from now on, or somebody asked for the end."""
        self._may_end = True

    def is_silent(self, now: float) -> bool:
        """True if nothing was heard for SILENCE, or never will be again."""
        return self._has_left or (self._heard is not None and now - self._heard >= SILENCE)

    def is_sending(self, now: float) -> bool:
        """True if zeros are to be sent at `now`."""
        if self._heard is None:
            return False
        is_wanted = self.is_silent(now) and not self._may_end
        if self._began is None and is_wanted:
            self._began = now
        elif self._began is not None and not is_wanted and now - self._began >= AT_LEAST:
            self._began = None
        return self._began is not None

    def is_done(self, now: float) -> bool:
        """True once nobody can be heard any more and enough zeros were sent."""
        if not self._has_left or self._heard is None:
            return self._has_left
        return self._may_end and not self.is_sending(now)

    def wait(self, now: float) -> float:
        """Seconds until there may be something to do, if nothing is heard meanwhile."""
        if self._began is not None or self._has_left:
            return PERIOD
        return SILENCE if self._heard is None else max(self._heard + SILENCE - now, 0.0)


class Watchdog:
    """Serves one guardian's socket until it has gone and enough zeros were sent.

    `name` (None: none) is the robot's: its last holder is relieved, once its guardian is silent.
    `tie` is a process whose end ends this one, as if somebody had asked.
    """

    def __init__(
        self, daemon: socket.socket, sender: ZeroSender, name: str | None, tie: int | None
    ) -> None:
        self._daemon, self._sender = daemon, sender
        daemon.setblocking(False)
        self._command_timeout = CommandTimeout()
        self._name = None if name is None else _claimed(name)
        self._tie = -1 if tie is None else _pidfd(tie)
        self._is_sending = False
        self._was_connected = True
        self._next = 0.0
        self._faults = 0
        self._is_asked = False
        signal.signal(signal.SIGTERM, self._on_sigterm)

    def serve(self) -> None:
        """Run to the end."""
        self._answer(READY + str(os.getpid()).encode())
        now = boottime()
        while not self._command_timeout.is_done(now):
            self._poll(self._command_timeout.wait(now))
            now = boottime()
            self._act(now)
            self._hand_over()

    def _act(self, now: float) -> None:
        if self._is_asked and self._command_timeout.has_left:
            self._command_timeout.relieve()
        is_sending = self._command_timeout.is_sending(now)
        if is_sending and now >= self._next:
            self._next = now + PERIOD
            try:
                self._sender.send_zero()
            except Exception as error:  # a sender may raise anything; the next may get through
                self._faults += 1
                if self._faults == 1:
                    say(f"a zero could not be sent: {error}")
        if is_sending != self._is_sending:
            self._is_sending = is_sending
            self._answer(TICK if self._may_move() else ZEROS)
            gone = "ended" if self._command_timeout.has_left else "is silent"
            say(f"the guardian {gone}: sending zeros" if is_sending else "no more zeros")

    def _poll(self, seconds: float) -> None:
        poll = select.poll()
        if not self._command_timeout.has_left:
            poll.register(self._daemon, select.POLLIN)
        if self._name is not None:
            poll.register(self._name, select.POLLIN)
        if self._tie >= 0:
            poll.register(self._tie, select.POLLIN)
        ready = {fd for fd, _ in poll.poll(1e3 * min(seconds, SILENCE))}
        if self._daemon.fileno() in ready:
            self._hear()
        if self._name is not None and self._name.fileno() in ready:
            self._on_relief(self._name)
        if self._tie in ready:
            os.close(self._tie)
            self._tie, self._is_asked = -1, True

    def _hear(self) -> None:
        while True:
            try:
                frame = self._daemon.recv(16)
            except BlockingIOError:
                return
            except OSError:
                frame = b""
            if frame == TICK:
                self._command_timeout.tick(boottime())
                self._answer(TICK if self._may_move() else ZEROS)
                continue
            self._command_timeout.leave(boottime())
            self._is_asked |= frame == FAREWELL
            return

    def _may_move(self) -> bool:
        is_connected = bool(getattr(self._sender, "is_connected", True))
        if is_connected != self._was_connected:
            self._was_connected = is_connected
            say("connected" if is_connected else "not connected yet: until then it is zero")
        return is_connected and not self._is_sending

    def _on_relief(self, name: socket.socket) -> None:
        with contextlib.suppress(OSError):
            name.recv(16)
        if self._command_timeout.is_silent(boottime()):
            self._command_timeout.relieve()

    def _hand_over(self) -> None:
        """The name is given up only after the last zero: who has it next may move the base."""
        if self._name is not None and self._command_timeout.is_relieved and not self._is_sending:
            self._name.close()
            self._name = None

    def _answer(self, frame: bytes) -> None:
        with contextlib.suppress(OSError):  # frozen or gone: seen by its silence
            self._daemon.send(frame)

    def _on_sigterm(self, number: int, frame: object) -> None:
        self._is_asked = True


def name_of(swarm: str, robot: str) -> str:
    """The name under which one robot's stoppers relieve each other on this machine."""
    digest = sha256(f"{swarm}/{robot}".encode()).hexdigest()[:32]
    return f"swarmd/stopper/{os.getuid()}/{digest}"


def say(text: str) -> None:
    """One line on stderr if that does not block: nobody may be there to read it any more."""
    with contextlib.suppress(OSError, ValueError):
        if select.select([], [2], [], 0.0)[1]:
            os.write(2, f"stopper: {text}\n".encode())


def _claimed(name: str) -> socket.socket:
    """The robot's name, an abstract datagram socket; DriverError if a guardian at work has it."""
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    claim.setblocking(False)
    deadline = boottime() + _CLAIM_WITHIN
    while True:
        try:
            claim.bind(f"\0{name}")
            return claim
        except OSError as error:
            if error.errno != errno.EADDRINUSE or boottime() >= deadline:
                claim.close()
                raise DriverError(
                    "another daemon on this machine drives this robot, its stopper is at work;"
                    " end that one first"
                ) from error
        with contextlib.suppress(OSError):  # it has gone meanwhile, or is about to
            claim.sendto(_RELIEF, f"\0{name}")
        time.sleep(0.02)


def _pidfd(pid: int) -> int:
    try:
        return os.pidfd_open(pid)
    except OSError as error:
        raise DriverError(f"process {pid}, which the daemon is tied to, has ended") from error


def _made(maker: str, options: str) -> ZeroSender:
    module, _, attribute = maker.partition(":")
    make = cast("Callable[..., ZeroSender]", getattr(import_module(module), attribute))
    return make(**json.loads(options))


def main() -> NoReturn:
    """Entry of `python -m swarmd.driver_api.watchdog`."""
    parser = argparse.ArgumentParser(prog="swarmd.driver_api.watchdog", description=__doc__)
    parser.add_argument("--fd", type=int, required=True, help="the guardian's socket")
    parser.add_argument("--maker", required=True, help="module:callable, gives the ZeroSender")
    parser.add_argument("--options", default="{}", help="its keywords, as JSON")
    parser.add_argument("--name", help="the robot's, to relieve an earlier stopper")
    parser.add_argument("--tie", type=int, help="end when this process has ended")
    args = parser.parse_args()
    if os.fork():
        os._exit(0)  # the guardian reaps this one at once, and none is left to be reaped later
    os.set_inheritable(args.fd, False)
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    try:
        _serve(args)
    except BaseException as error:
        say(f"ends with {error!r}")
        os._exit(1)
    os._exit(0)  # the interpreter's own end may wait for a library's threads, or abort over them


def _serve(args: argparse.Namespace) -> None:
    with socket.socket(fileno=args.fd) as daemon, contextlib.ExitStack() as left:
        try:
            sender = _made(args.maker, args.options)
            sender.open()
            left.callback(sender.close)
            watchdog = Watchdog(daemon, sender, args.name, args.tie)
        except (SwarmError, ImportError, AttributeError, TypeError, OSError) as error:
            daemon.send(FAULT + str(error).encode()[:500])
            return
        watchdog.serve()


if __name__ == "__main__":
    main()
