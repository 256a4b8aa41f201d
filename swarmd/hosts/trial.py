"""Tries whether a pattern can be loaded, in a host of its own beside the one in force.

A host in which it was loaded is fresh and warm: it may take the place of the one in force.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from swarmd.errors import CodecError
from swarmd.frames import Event, Failed, Ready, Refused, Tried
from swarmd.hosts.framing import decode_event
from swarmd.hosts.hostprocess import HostProcess, Owner, why_it_ended
from swarmd.robot.hosting import LOAD_TIMEOUT


def outcome(event: Event | None) -> str:
    """What a load's answer says of the code: empty if it was loaded, else why not.

    What takes longer than a run waits for could not be run again.
    """
    if isinstance(event, Ready):
        is_late = event.took >= LOAD_TIMEOUT
        text = f"loading took {event.took:.1f} s; a run waits for {LOAD_TIMEOUT:.0f} s"
        return text if is_late else ""
    return event.text if isinstance(event, Refused | Failed) else "it gave no answer to a load"


class Trial:
    """One Load in a process of its own, which stays until `end` or `hand_over`.

    `tell` is called once, unless `end` comes first; `buried` when its process has been waited for.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        generation: int,
        frame: bytes,
        tell: Callable[[Tried], None],
        buried: Callable[[HostProcess], None],
    ) -> None:
        self.buried = buried
        self._generation = generation
        self._tell = tell
        self._is_told = False
        self._host: HostProcess | None = HostProcess(loop, self)
        with contextlib.suppress(OSError):  # it has just ended: the pidfd is watched
            self._host.socket.send(frame)

    def end(self) -> tuple[HostProcess, ...]:
        """Kill its process; whoever is still to be waited for."""
        host, self._host = self._host, None
        if host is None:
            return ()
        host.kill()
        return (host,)

    def hand_over(self, owner: Owner) -> HostProcess | None:
        """The host, to be `owner`'s from now on; None if it has ended or has not answered."""
        if self._host is None or not self._is_told:
            return None
        host, self._host = self._host, None
        host.owner = owner
        return host

    def on_frame(self, host: HostProcess, frame: bytes) -> None:
        """It answered."""
        try:
            text = outcome(decode_event(frame))
        except CodecError as error:
            text = str(error)
        self._done(text)

    def on_end(self, host: HostProcess, code: int) -> None:
        """It ended by itself, which no load may do."""
        self._host = None
        self._done(f"while it was being loaded {why_it_ended(code)}")

    def _done(self, text: str) -> None:
        if not self._is_told:
            self._is_told = True
            self._tell(Tried(self._generation, text))
