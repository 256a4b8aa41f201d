"""A pool of `Operator` objects for one program; each carries out one verb at a time."""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable, Collection, Hashable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import count
from typing import TYPE_CHECKING, Any

from swarmd.core.closing import is_program_ended
from swarmd.core.errors import R, SwarmError

if TYPE_CHECKING:
    from swarmd.operator.client.loop_life import LoopLife
    from swarmd.operator.session.operator import Operator

MAX_REQUESTS = 8
"""Requests under way at a time: a request that waits for others would start motion late."""
MAX_IDLE = 2
"""Operators that are kept open for the next verb; each has sockets of its own."""


class RequestLimit:
    """Limits the number of requests under way; stops are not limited."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = 0

    @contextmanager
    def request(self) -> Iterator[None]:
        """Count a request as under way within the block; SwarmError if too many are under way."""
        with self._lock:
            if self._count >= MAX_REQUESTS:
                raise SwarmError(
                    f"not sent: {self._count} requests wait for answers; repeat it when they ended"
                )
            self._count += 1
        try:
            yield
        finally:
            with self._lock:
                self._count -= 1


class LookTurns:
    """Lets one look at a time query the swarm, so that a flood of looks has one operator.

    Calls that wait for their turn share a look that began after them.
    """

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._order = count()  # of calls and of looks
        self._last: tuple[Hashable, int, Any] = (None, -1, None)

    def share(self, kind: Hashable, look: Callable[[], R], timeout: float | None = None) -> R:
        """The result of `look`, or of an equal one of the same `kind` that began after this call.

        SwarmError if the turn does not come within `timeout` s.
        """
        called = next(self._order)
        if not self._turn.acquire(timeout=-1.0 if timeout is None else timeout):
            raise SwarmError(f"no look within {timeout:g} s: another look is under way; repeat it")
        try:
            last_kind, begun, result = self._last
            if last_kind != kind or begun < called:
                begun = next(self._order)
                result = look()
                self._last = (kind, begun, result)
            return result  # type: ignore[no-any-return]  # a result of `look`, by its kind
        finally:
            self._turn.release()


class OperatorPool:
    """Lends operators that `make` creates, an idle one or a new one: no stop or request waits.

    The end of the program closes the pool, and the end of the main thread ends its leases. `life`:
    of the event loop on which the connection was opened; None without one.
    """

    def __init__(self, make: Callable[[], Operator], life: LoopLife | None = None) -> None:
        self._make = make
        self.life = life
        self._lock = threading.Lock()
        self._idle: list[Operator] = []
        self._leases: list[tuple[frozenset[str], ExitStack]] = []
        self.requests = RequestLimit()
        self.looks = LookTurns()
        self._is_closed = False
        self._process = os.getpid()
        self._of_forks: dict[int, OperatorPool] = {}
        atexit.register(self._end)

    def here(self) -> OperatorPool:
        """The pool for this process: a process that was forked has operators of its own.

        The fork has the sockets of its parent's operators without their threads, perhaps with a
        lock that a thread held. What the parent holds stays the parent's: its leases are neither
        renewed nor ended here, and its operators are not closed.
        """
        process = os.getpid()
        if process == self._process:
            return self
        pool = self._of_forks.get(process)
        if pool is None:
            pool = self._of_forks.setdefault(process, OperatorPool(self._make))
            if self._is_closed:
                pool.close()
        return pool

    def close(self) -> None:
        """End leases and close idle operators, within 0.2 s each; then no operator is lent.

        An operator that is in use is closed when it is given back.
        """
        atexit.unregister(self._end)
        with self._lock:
            self._is_closed = True
            idle = self._idle
            self._idle = []
        self._end_leases()
        for operator in idle:
            operator.close()
        if self.life is not None:
            self.life.close()

    def _end(self) -> None:
        """At the end of the program: close; a child process of `os.fork` has nothing to close."""
        if os.getpid() == self._process:
            self.close()

    def _end_leases(self) -> None:
        with self._lock:
            leases = self._leases
            self._leases = []
        for _, lease in leases:
            lease.close()

    def is_over_for(self, thread: threading.Thread) -> bool:
        """True once a call in this thread commands for nobody.

        That is so from the end of the main thread on. Of a connection that was opened on an event
        loop it is so from the shutdown of the loop on, but not for the main thread or for the
        thread that ran the loop: they may go on.
        """
        if is_program_ended():
            return True
        if self.life is None or thread in (threading.main_thread(), self.life.thread):
            return False
        return self.life.is_over

    @contextmanager
    def lend(self, *, also_closed: bool = False) -> Iterator[Operator]:
        """Lend an operator for one verb; the operator is closed if the verb raises.

        SwarmError after `close` of the pool. `also_closed`: a new operator then, for the stop of a
        robot that a call before `close` has let move.
        """
        if is_program_ended():  # a loop that is over ends its own leases, and not those of others
            self._end_leases()  # for a stop at exit: a new operator may get no thread then
        with self._lock:
            if self._is_closed and not also_closed:
                raise SwarmError("the connection to the swarm is closed; connect again")
            operator = self._idle.pop() if self._idle else None
        operator = operator or self._make()
        is_kept = False
        try:
            yield operator
            with self._lock:
                is_kept = not self._is_closed and len(self._idle) < MAX_IDLE
                if is_kept:
                    self._idle.append(operator)
        finally:
            if not is_kept and os.getpid() == self._process:
                operator.close()

    def keep_lease(self, robots: Collection[str], lease: ExitStack) -> None:
        """Close `lease` with the pool, or once a later lease covers all of its `robots`.

        The lease is closed at once if the pool is closed: no lease outlives the connection.
        """
        with self._lock:
            ended = [entry for entry in self._leases if entry[0] <= frozenset(robots)]
            self._leases = [entry for entry in self._leases if entry not in ended]
            if self._is_closed:
                ended.append((frozenset(robots), lease))
            else:
                self._leases.append((frozenset(robots), lease))
        for _, entry in ended:
            entry.close()

    @contextmanager
    def lend_for_request(self) -> Iterator[Operator]:
        """As `lend`, for a request that is no stop; SwarmError if too many are under way."""
        with self.requests.request(), self.lend() as operator:
            yield operator
