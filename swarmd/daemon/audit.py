"""Who asked what of this robot, from where, and the result: one line for each request. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from swarmd.core.messages import (
    AnyRequest,
    Code,
    EstopRequest,
    ForgetRequest,
    ParamRequest,
    RecordRequest,
    ReloadRequest,
    Reply,
    ResetRequest,
    RunRequest,
)
from swarmd.core.token_bucket import TokenBucket

MAX_LINE = 300
MAX_WHAT, MAX_PART = 120, 60  # characters of a request, and of one text that its sender chose

APPLIED_RATE, APPLIED_BURST = 2.0, 20.0
OTHER_RATE, OTHER_BURST = 0.2, 5.0
"""Lines per second: junk that is refused must not push the lines of what was applied out."""


class Audit:
    """Writes a line for each request; those beyond the rates are left out and counted."""

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._applied = TokenBucket(APPLIED_RATE, APPLIED_BURST)
        self._others = TokenBucket(OTHER_RATE, OTHER_BURST)
        self._left_out = 0

    def record(self, what: str, operator: str, source: str, reply: Reply, now: float) -> None:
        """Write the line of a request with its reply, if the rates allow it at `now` (s)."""
        bucket = self._applied if reply.code is Code.APPLIED else self._others
        if not bucket.take(1.0, now):
            self._left_out += 1
            return
        code = reply.code if reply.refusal is None else f"{reply.code} ({reply.refusal})"
        who = f"by {_short(operator)} from {_short(source)}"
        line = f"{_short(what, MAX_WHAT)}, {who}: {code}: {reply.text}"
        line = _printable(line.removesuffix(": "))
        if self._left_out:
            line = f"[{self._left_out} requests left out of this log] {line}"
            self._left_out = 0
        self._write(line[:MAX_LINE])


def describe_request(request: AnyRequest) -> str:
    """What a request asks, such as `run drive speed=0.1 to 3 robots`."""
    words = [request.verb]
    if isinstance(request, RunRequest | ReloadRequest):
        words.append(request.pattern)
    if isinstance(request, RecordRequest):
        words.append(request.action)
    if isinstance(request, ForgetRequest):
        words.append(request.name)
    if isinstance(request, RunRequest | ParamRequest):
        words.append(_assignments(request.params))
    if isinstance(request, RunRequest) and request.seconds is not None:
        words.append(f"for {request.seconds:g} s")
    if isinstance(request, RunRequest) and request.until:
        words.append(f"until {_short(' or '.join(request.until))}")
    if isinstance(request, EstopRequest | ResetRequest) and request.reason:
        words.append(f"({_short(request.reason)})")
    targets = request.targets
    count = "all robots" if targets is None else f"{len(targets)} robot{'s' * (len(targets) != 1)}"
    return " ".join(filter(None, (*words, "to", count)))


def _assignments(values: Mapping[str, object]) -> str:
    return _short(" ".join(f"{name}={value}" for name, value in values.items()))


def _short(text: str, length: int = MAX_PART) -> str:
    return text if len(text) <= length else f"{text[: length - 3]}..."


def _printable(text: str) -> str:
    """In one line: an operator's name must not begin a line of its own in a log."""
    return "".join(char if char.isprintable() else "?" for char in text)
