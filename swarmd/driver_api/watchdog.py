"""The watchdog: a second process that sends zero to a base when its daemon falls silent.

The watchdog is for bases that keep their last command for ever. It starts before the driver and has
a connection to the base of its own. It detaches from its daemon, so that it survives the daemon's
end.

1. The daemon's tick feeds the watchdog over a socket pair.
2. After 0.4 s without a tick, or at end of file, the watchdog sends zeros for at least 2 s, and
   until the daemon ticks again. A daemon that is back before the zeros end sends zero as well, so
   that the base stands.
3. Before the first tick the watchdog sends nothing.
4. When the daemon has ended, the watchdog sends zeros until it has a reason to end, and for at
   least 2 s. The reasons are a farewell of the daemon, SIGTERM, the end of the process to which the
   watchdog is tied, and the watchdog of a new daemon for this robot, once the new watchdog's sender
   is open. If the daemon has never ticked, the watchdog ends with the daemon.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import select
import signal
import socket
import time
from collections.abc import Callable, Mapping
from hashlib import sha256
from importlib import import_module
from typing import TYPE_CHECKING, NoReturn, cast

from swarmd.core.clock import boottime
from swarmd.core.errors import DriverError, SwarmError

if TYPE_CHECKING:
    import argparse

    from swarmd.core.values import Value
    from swarmd.driver_api.driver import ZeroSender

TICK_TIMEOUT = 0.4
"""Seconds without a tick after which zeros are sent."""
MIN_ZERO_TIME = 2.0
"""Seconds for which zeros are sent, however soon the daemon is back."""
ZERO_PERIOD = 0.05
MAX_HINT = 15
"""Characters of the hint for the sender that may follow a tick."""

TICK = b"t"
FAREWELL = b"f"
READY = b"r"
FAULT = b"e"
ZEROS = b"z"
"""The answer to a tick while zeros are sent; the answer otherwise is a tick.

It is also the answer while the watchdog is not connected: a base that cannot be stopped must not
move. The watchdog sends its answer unasked when it changes.
"""
_RELIEF = b"relief"
_CLAIM_TIMEOUT = 5.0


class WatchdogTimer:
    """Decides when zeros are sent. Pure; times in s on one monotonic clock come with each call.

    The first tick arms the timer: a daemon that never drove must not interrupt another driver.
    """

    def __init__(self) -> None:
        self._ticked_at: float | None = None
        self._zeros_from: float | None = None
        self._is_closed = False
        self._may_end = False

    @property
    def is_closed(self) -> bool:
        """True once the daemon's end of the socket is closed."""
        return self._is_closed

    @property
    def is_relieved(self) -> bool:
        """True if no tick has come since another watchdog took over."""
        return self._may_end

    def tick(self, now: float) -> None:
        """Note a tick of the daemon."""
        self._ticked_at = now
        self._may_end = False

    def close(self, now: float) -> None:
        """Note end of file: the daemon's end of the socket is closed."""
        self._is_closed = True
        if self._zeros_from is None and self._ticked_at is not None and not self._may_end:
            self._zeros_from = now

    def relieve(self) -> None:
        """Note that another watchdog has taken over, or that this watchdog was asked to end."""
        self._may_end = True

    def is_silent(self, now: float) -> bool:
        """True without a tick for TICK_TIMEOUT, or after end of file."""
        return self._is_closed or (
            self._ticked_at is not None and now - self._ticked_at >= TICK_TIMEOUT
        )

    def is_sending(self, now: float) -> bool:
        """True if zeros must be sent at `now`."""
        if self._ticked_at is None:
            return False
        is_wanted = self.is_silent(now) and not self._may_end
        if self._zeros_from is None and is_wanted:
            self._zeros_from = now
        elif (
            self._zeros_from is not None
            and not is_wanted
            and now - self._zeros_from >= MIN_ZERO_TIME
        ):
            self._zeros_from = None
        return self._zeros_from is not None

    def is_done(self, now: float) -> bool:
        """True after end of file, once enough zeros were sent."""
        if not self._is_closed or self._ticked_at is None:
            return self._is_closed
        return self._may_end and not self.is_sending(now)

    def wait(self, now: float) -> float:
        """Seconds until zeros may be due if no tick comes."""
        if self._zeros_from is not None or self._is_closed:
            return ZERO_PERIOD
        return (
            TICK_TIMEOUT
            if self._ticked_at is None
            else max(self._ticked_at + TICK_TIMEOUT - now, 0.0)
        )


class Watchdog:
    """Serves the socket of one daemon, and sends zeros by the rules of the module.

    `name`: the robot's name for its watchdog, None without a name. An earlier watchdog with this
    name ends once its daemon is silent. `tie`: a process whose end makes this process end.
    """

    def __init__(
        self, daemon: socket.socket, sender: ZeroSender, name: str | None, tie: int | None
    ) -> None:
        self._daemon = daemon
        self._sender = sender
        daemon.setblocking(False)
        self._timer = WatchdogTimer()
        self._name = None if name is None else _claimed(name)
        self._tie = -1 if tie is None else _pidfd(tie)
        self._is_sending = False
        self._was_connected = True
        self._hint = b""
        self._next = 0.0
        self._faults = 0
        self._is_asked = False
        # systemd sends SIGABRT to all processes of a service whose main process stops feeding.
        for number in (signal.SIGTERM, signal.SIGABRT):
            signal.signal(number, self._on_sigterm)

    def serve(self) -> None:
        """Run until enough zeros were sent after the daemon's end."""
        self._answer(READY + str(os.getpid()).encode())
        now = boottime()
        while not self._timer.is_done(now):
            self._poll(self._timer.wait(now))
            now = boottime()
            self._act(now)
            self._hand_over()

    def _act(self, now: float) -> None:
        if self._is_asked and self._timer.is_closed:
            self._timer.relieve()
        is_sending = self._timer.is_sending(now)
        if is_sending and now >= self._next:
            self._next = now + ZERO_PERIOD
            try:
                self._sender.send_zero()
            except Exception as error:  # a sender may raise anything; the next zero may succeed
                self._faults += 1
                if self._faults == 1:
                    say(f"a zero could not be sent: {error}")
        if is_sending != self._is_sending:
            self._is_sending = is_sending
            self._answer(TICK if self._may_move() else ZEROS)
            gone = "ended" if self._timer.is_closed else "is silent"
            say(f"the daemon {gone}: sending zeros" if is_sending else "no more zeros")

    def _poll(self, seconds: float) -> None:
        poll = select.poll()
        if not self._timer.is_closed:
            poll.register(self._daemon, select.POLLIN)
        if self._name is not None:
            poll.register(self._name, select.POLLIN)
        if self._tie >= 0:
            poll.register(self._tie, select.POLLIN)
        ready = {fd for fd, _ in poll.poll(1e3 * min(seconds, TICK_TIMEOUT))}
        if self._daemon.fileno() in ready:
            self._read_ticks()
        if self._name is not None and self._name.fileno() in ready:
            self._on_relief(self._name)
        if self._tie in ready:
            os.close(self._tie)
            self._tie = -1
            self._is_asked = True

    def _read_ticks(self) -> None:
        while True:
            try:
                frame = self._daemon.recv(1 + MAX_HINT)
            except BlockingIOError:
                return
            except OSError:
                frame = b""
            if frame.startswith(TICK):
                self._take_hint(frame[1:])
                self._timer.tick(boottime())
                self._answer(TICK if self._may_move() else ZEROS)
                continue
            self._timer.close(boottime())
            self._is_asked |= frame == FAREWELL
            return

    def _take_hint(self, hint: bytes) -> None:
        take_hint = getattr(self._sender, "take_hint", None)
        if hint and hint != self._hint and take_hint is not None:
            self._hint = hint
            take_hint(hint.decode(errors="replace"))

    def _may_move(self) -> bool:
        is_connected = bool(getattr(self._sender, "is_connected", True))
        if is_connected != self._was_connected:
            self._was_connected = is_connected
            say("connected" if is_connected else "not connected yet: commands are zero")
        return is_connected and not self._is_sending

    def _on_relief(self, name: socket.socket) -> None:
        with contextlib.suppress(OSError):
            name.recv(16)
        if self._timer.is_silent(boottime()):
            self._timer.relieve()

    def _hand_over(self) -> None:
        """Release the name after the last zero, since the next watchdog's daemon may then move."""
        if self._name is not None and self._timer.is_relieved and not self._is_sending:
            self._name.close()
            self._name = None

    def _answer(self, frame: bytes) -> None:
        with contextlib.suppress(OSError):  # the daemon is frozen or gone; its silence shows that
            self._daemon.send(frame)

    def _on_sigterm(self, number: int, frame: object) -> None:
        self._is_asked = True


def watchdog_name(swarm: str, robot: str) -> str:
    """The name by which the watchdogs of one robot relieve each other on this machine."""
    digest = sha256(f"{swarm}/{robot}".encode()).hexdigest()[:32]
    return f"swarmd/watchdog/{os.getuid()}/{digest}"


def say(text: str) -> None:
    """Write a line to stderr unless that would block: the reader may be gone."""
    with contextlib.suppress(OSError, ValueError):
        if select.select([], [2], [], 0.0)[1]:
            os.write(2, f"watchdog: {text}\n".encode())


def _claimed(name: str) -> socket.socket:
    """The abstract datagram socket of the robot's name, which only one watchdog can hold.

    DriverError if another watchdog holds the name, and its daemon still ticks.
    """
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    claim.setblocking(False)
    deadline = boottime() + _CLAIM_TIMEOUT
    while True:
        try:
            claim.bind(f"\0{name}")
            return claim
        except OSError as error:
            if error.errno != errno.EADDRINUSE or boottime() >= deadline:
                claim.close()
                raise DriverError(
                    "another daemon on this machine drives this robot and has a watchdog at work;"
                    " end that daemon first"
                ) from error
        with contextlib.suppress(OSError):  # the holder of the name has ended meanwhile
            claim.sendto(_RELIEF, f"\0{name}")
        time.sleep(0.02)


def _pidfd(pid: int) -> int:
    try:
        return os.pidfd_open(pid)
    except OSError as error:
        raise DriverError(f"process {pid}, which the daemon is tied to, has ended") from error


def made_zero_sender(maker: str, options: Mapping[str, Value]) -> ZeroSender:
    """Make the sender of a `ZeroSenderSpec`; not connected yet."""
    module, _, attribute = maker.partition(":")
    make = cast("Callable[..., ZeroSender]", getattr(import_module(module), attribute))
    return make(**options)


def main() -> NoReturn:
    """Entry of `python -m swarmd.driver_api.watchdog`."""
    import argparse  # takes 0.4 MB of a daemon, which imports this module for the watchdog's words

    parser = argparse.ArgumentParser(prog="swarmd.driver_api.watchdog", description=__doc__)
    parser.add_argument("--fd", type=int, required=True, help="the daemon's socket")
    parser.add_argument("--maker", required=True, help="module:callable, gives the ZeroSender")
    parser.add_argument("--options", default="{}", help="its keywords, as JSON")
    parser.add_argument("--name", help="the robot's name, to relieve an earlier watchdog")
    parser.add_argument("--tie", type=int, help="end when this process has ended")
    args = parser.parse_args()
    if os.fork():
        os._exit(0)  # the daemon reaps this process; init reaps the detached fork
    os.set_inheritable(args.fd, False)
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    try:
        _serve(args)
    except BaseException as error:
        say(f"ends with {error!r}")
        os._exit(1)
    os._exit(0)  # the interpreter's own exit may wait for a library's threads, or abort


def _serve(args: argparse.Namespace) -> None:
    with socket.socket(fileno=args.fd) as daemon, contextlib.ExitStack() as left:
        try:
            sender = made_zero_sender(args.maker, json.loads(args.options))
            sender.open()
            left.callback(sender.close)
            watchdog = Watchdog(daemon, sender, args.name, args.tie)
        except (SwarmError, ImportError, AttributeError, TypeError, OSError) as error:
            daemon.send(FAULT + str(error).encode()[:500])
            return
        watchdog.serve()


if __name__ == "__main__":
    main()
