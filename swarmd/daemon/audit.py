"""The requests to this robot: operator, address and result, a line and an entry each. Pure.

The line is for the log of the daemon, and the entry for the audit log.
"""

from __future__ import annotations

from collections.abc import Callable

from msgspec.structs import replace

from swarmd.core.clock import FIRST_WALL
from swarmd.core.messages import Code, Reply
from swarmd.core.token_bucket import TokenBucket
from swarmd.core.verbs import MAX_PART, VERBS, AnyRequest, AuditEntry, shortened

MAX_LINE = 300
MAX_WHAT = 120  # characters of a request

APPLIED_RATE, APPLIED_BURST = 2.0, 20.0
OTHER_RATE, OTHER_BURST = 0.2, 5.0
"""Lines per second: junk that is refused must not push the lines of what was applied out."""
APPLIED_ENTRIES, OTHER_ENTRIES, ENTRY_BURST = 20.0, 2.0, 200.0
"""Entries per second, and at once: the files have room for more than the log that people read."""
PEER_RATE, PEER_BURST = 0.1, 50.0
"""Lines and entries per second of what robots hand on: a stolen robot can invent stops,
latches and goals, which must not push the requests of operators out of the files."""
HANDED_ON = "handed on by "


class Audit:
    """Gives a line and an entry for each request; those beyond the rates are left out and counted.

    `clock` names the clock of `now`; `wall` gives s since 1970.
    """

    def __init__(
        self,
        write: Callable[[str], None],
        keep: Callable[[AuditEntry], None] = lambda entry: None,
        *,
        clock: str = "",
        wall: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self._write, self._keep, self._clock, self._wall = write, keep, clock, wall
        self._lines = _Limits(APPLIED_RATE, APPLIED_BURST, OTHER_RATE, OTHER_BURST)
        self._entries = _Limits(APPLIED_ENTRIES, ENTRY_BURST, OTHER_ENTRIES, ENTRY_BURST)
        self._peer_lines = _Limits(PEER_RATE, PEER_BURST, PEER_RATE, PEER_BURST)
        self._peer_entries = _Limits(PEER_RATE, PEER_BURST, PEER_RATE, PEER_BURST)

    def record(
        self,
        what: str,
        operator: str,
        source: str,
        reply: Reply,
        now: float,
        *,
        targets: int | None = None,
        is_relayed: bool = False,
    ) -> None:
        """Give the line and the entry of a request with its reply, if the rates allow it.

        `what` begins with the verb. `targets`: how many robots; None: all. `now` in s.
        `is_relayed`: another robot handed it on, and nothing proves its operator.
        """
        source = f"{HANDED_ON}{source}" if is_relayed else source
        lines = self._peer_lines if is_relayed else self._lines
        entries = self._peer_entries if is_relayed else self._entries
        result = reply.code if reply.refusal is None else f"{reply.code} ({reply.refusal})"
        is_applied = reply.code is Code.APPLIED
        if (left_out := entries.take(is_applied, now)) is not None:
            entry = self._entry(what, operator, source, result, reply.text, now)
            self._keep(replace(entry, targets=targets, left_out=left_out))
        if (left_out := lines.take(is_applied, now)) is None:
            return
        who = f"by {shortened(operator)} from {shortened(source)}"
        line = f"{shortened(what, MAX_WHAT)}, {who}: {result}: {reply.text}"
        line = _printable(line.removesuffix(": "))
        if left_out:
            line = f"[{left_out} requests left out of this log] {line}"
        self._write(line[:MAX_LINE])

    def note(self, what: str, operator: str, source: str, text: str, now: float) -> None:
        """Give the entry of what came without a request, such as a latch of a peer; no line."""
        if (left_out := self._peer_entries.take(True, now)) is not None:
            entry = self._entry(what, operator, source, "taken", text, now)
            self._keep(replace(entry, left_out=left_out))

    def _entry(
        self, what: str, operator: str, source: str, result: str, text: str, now: float
    ) -> AuditEntry:
        wall = self._wall()
        return AuditEntry(
            boot=round(now, 3),
            clock=self._clock,
            wall=round(wall, 3) if wall >= FIRST_WALL else None,
            operator=_printable(shortened(operator, 128)),
            source=_printable(shortened(source)),
            verb=_printable(what.partition(" ")[0][:MAX_PART]),
            what=_printable(shortened(what, MAX_WHAT)),
            result=result[:MAX_PART],
            text=_printable(text[:MAX_LINE]),
        )


class _Limits:
    """Rates of what was applied and of the rest, and how many were left out."""

    def __init__(self, applied: float, applied_burst: float, others: float, burst: float) -> None:
        self._applied = TokenBucket(applied, applied_burst)
        self._others = TokenBucket(others, burst)
        self._left_out = 0

    def take(self, is_applied: bool, now: float) -> int | None:
        """How many were left out before this one; None: this one is left out."""
        if not (self._applied if is_applied else self._others).take(1.0, now):
            self._left_out += 1
            return None
        left_out, self._left_out = self._left_out, 0
        return left_out


def describe_request(request: AnyRequest) -> str:
    """What a request asks, such as `run drive speed=0.1 to 3 robots`."""
    targets = request.targets
    count = "all robots" if targets is None else f"{len(targets)} robot{'s' * (len(targets) != 1)}"
    return " ".join(filter(None, (request.verb, VERBS[request.verb].audit(request), "to", count)))


def _printable(text: str) -> str:
    """In one line: an operator's name must not begin a line of its own in a log."""
    return "".join(char if char.isprintable() else "?" for char in text)
