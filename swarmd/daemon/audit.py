"""The requests to this robot: operator, address and result, a line and an entry each. Pure.

The line is for the log of the daemon, and the entry for the audit log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from msgspec.structs import replace

from swarmd.core.behaviour import Signed, read_entry
from swarmd.core.clock import FIRST_WALL
from swarmd.core.errors import CodecError
from swarmd.core.messages import (
    AnyRequest,
    Code,
    EstopRequest,
    ForgetRequest,
    GoalRequest,
    LabelRequest,
    ParamRequest,
    PushRequest,
    RecordRequest,
    ReloadRequest,
    Reply,
    ResetRequest,
    RunRequest,
)
from swarmd.core.token_bucket import TokenBucket
from swarmd.core.tool_messages import AuditEntry

MAX_LINE = 300
MAX_WHAT, MAX_PART = 120, 60  # characters of a request, and of one text that its sender chose

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
        who = f"by {_short(operator)} from {_short(source)}"
        line = f"{_short(what, MAX_WHAT)}, {who}: {result}: {reply.text}"
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
            operator=_printable(_short(operator, 128)),
            source=_printable(_short(source)),
            verb=_printable(what.partition(" ")[0][:MAX_PART]),
            what=_printable(_short(what, MAX_WHAT)),
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
    return " ".join(filter(None, (request.verb, *_details(request), "to", count)))


def _details(request: AnyRequest) -> Iterator[str]:
    match request:
        case RunRequest():
            yield request.pattern
            yield _assignments(request.params)
            yield "" if request.seconds is None else f"for {request.seconds:g} s"
            yield f"until {_short(' or '.join(request.until))}" if request.until else ""
            yield "" if request.goal is None else f"as goal {request.goal.generation}"
        case GoalRequest():
            yield f"{request.goal.generation}: {request.goal.pattern or 'stand'}"
        case LabelRequest():
            labels = request.labels
            yield "as configured" if labels is None else _short(", ".join(labels) or "none")
        case PushRequest():
            yield _pushed(request)
        case ReloadRequest():
            yield request.pattern
        case RecordRequest():
            yield request.action
        case ForgetRequest():
            yield request.name
        case ParamRequest():
            yield _assignments(request.params)
        case ResetRequest():
            yield f"of {_short('; '.join(request.findings))}" if request.findings else ""
            yield f"({_short(request.reason)})" if request.reason else ""
        case EstopRequest():
            yield f"({_short(request.reason)})" if request.reason else ""


def _pushed(request: PushRequest) -> str:
    try:
        return read_entry(Signed(request.content)).manifest.label
    except CodecError:
        return "what cannot be read"


def _assignments(values: Mapping[str, object]) -> str:
    return _short(" ".join(f"{name}={value}" for name, value in values.items()))


def _short(text: str, length: int = MAX_PART) -> str:
    return text if len(text) <= length else f"{text[: length - 3]}..."


def _printable(text: str) -> str:
    """In one line: an operator's name must not begin a line of its own in a log."""
    return "".join(char if char.isprintable() else "?" for char in text)
