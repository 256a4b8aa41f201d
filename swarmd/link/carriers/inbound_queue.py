"""Bounded queues from Zenoh's threads to the loop.

A flood of one kind of message must not delay another kind: each kind has its own queue. A full
queue drops and counts each new message, which takes little time in a flood. The loop takes BATCH
messages and then pauses, so that its timers stay on time.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from swarmd.core.clock import boottime
from swarmd.core.errors import CodecError
from swarmd.core.messages import Code
from swarmd.core.threads import hand_over
from swarmd.core.token_bucket import TokenBucket

CAPACITY = 256
# Of tokens and emergency stops, which must not be lost in a flood; their queue has no pauses.
URGENT_CAPACITY = 4096
BATCH = 8
BATCH_PAUSE = 0.001  # s
MAX_KIND_LENGTH = 64
MAX_KINDS = 256
FAULT_RATE = 0.1
FAULT_BURST = 5.0
"""Errors that are logged with their traceback: per second, and at once."""
FAILED = "the daemon failed at it; its log has the error"

log = logging.getLogger(__name__)


class DropCounter:
    """Counts dropped messages by kind; safe from every thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: dict[str, int] = {}
        self._faults = TokenBucket(FAULT_RATE, FAULT_BURST)

    @contextmanager
    def refusing(
        self, kind: str, refuse: Callable[[Code, str], object] | None = None
    ) -> Iterator[None]:
        """A context manager that catches and counts errors of a handler; for use on the loop only.

        `kind`: of the message, such as `control/run`. `refuse(code, text)` answers the sender.

        1. CodecError counts as `<kind>:malformed`; `refuse` gets Code.REFUSED and the error's text.
        2. Any other Exception counts as `<kind>:failed`, and is logged at a limited rate. `refuse`
           gets Code.FAILED and the text FAILED, since the handler may have carried out a part.
        3. `CoreFault`, an error of the robot's core, is not caught, since it does not derive from
           Exception: a `CoreFault` ends the daemon.
        """
        try:
            yield
            return
        except CodecError as error:
            code = Code.REFUSED
            text = str(error)
            self.add(f"{kind}:malformed")
        except Exception:
            code = Code.FAILED
            text = FAILED
            self.add(f"{kind}:failed")
            if self._faults.take(1.0, boottime()):  # the limit of the log: FAULT_RATE
                log.exception("%s: refused, since its handler failed", kind)
        if refuse is not None:
            with self.refusing(kind):  # an error of `refuse` itself is counted, too
                refuse(code, text)

    def add(self, kind: str) -> None:
        """Count a drop; beyond MAX_KINDS kinds, new kinds are counted together as `other`."""
        kind = kind[:MAX_KIND_LENGTH]
        with self._lock:
            if kind not in self._counts and len(self._counts) >= MAX_KINDS:
                kind = "other"
            self._counts[kind] = self._counts.get(kind, 0) + 1

    def counts(self) -> dict[str, int]:
        """The counts so far, as a copy."""
        with self._lock:
            return dict(self._counts)


class InboundQueue:
    """The queue of one kind of message; an urgent queue is longer and drains without pauses."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        drops: DropCounter,
        kind: str,
        *,
        is_urgent: bool = False,
    ) -> None:
        self.kind = kind
        self._loop = loop
        self._drops = drops
        self._full = f"{kind[: MAX_KIND_LENGTH - 5]}:full"
        self._capacity = URGENT_CAPACITY if is_urgent else CAPACITY
        self._is_urgent = is_urgent
        self._lock = threading.Lock()
        self._items: deque[tuple[Callable[..., object], tuple[Any, ...]]] = deque()
        self._is_scheduled = False
        self._is_closed = False

    def is_full(self) -> bool:
        """True if the queue is full; counts the message as dropped. Call it before other work."""
        if len(self._items) < self._capacity:
            return False
        self._drops.add(self._full)
        return True

    def offer(self, function: Callable[..., object], *args: Any) -> bool:
        """Queue `function(*args)` for the loop; False if the queue is full or closed."""
        if self.is_full():
            return False
        with self._lock:
            if self._is_closed:
                return False
            self._items.append((function, args))
            if self._is_scheduled:
                return True
            self._is_scheduled = True
        hand_over(self._loop, self._drain)
        return True

    def close(self) -> None:
        """Discard the queued calls and take no more."""
        with self._lock:
            self._is_closed = True
            self._items.clear()

    def _drain(self) -> None:
        try:
            for _ in range(BATCH):
                with self._lock:
                    if not self._items:
                        return
                    function, args = self._items.popleft()
                function(*args)
        finally:
            with self._lock:
                self._is_scheduled = bool(self._items)
                if self._is_scheduled and self._is_urgent:
                    self._loop.call_soon(self._drain)
                elif self._is_scheduled:
                    self._loop.call_later(BATCH_PAUSE, self._drain)
