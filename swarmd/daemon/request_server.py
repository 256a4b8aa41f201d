"""Reads the requests of operators, hands them to the robot, and sends the robot's replies.

The daemon obeys a stop or estop of which only the id, the verb and the targets can be read. It
refuses any other request with a field that is missing, of a wrong type or out of bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import msgspec

from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.messages import (
    REQUEST_TYPES,
    AnyRequest,
    Code,
    EstopRequest,
    ForgetRequest,
    Refusal,
    Reply,
    Request,
    RequestHeader,
    StopRequest,
)
from swarmd.daemon.audit import Audit, describe_request
from swarmd.network.bus import Query, ZenohBus

MAX_PENDING = 64
MAX_REPLIES = 64  # kept for repeats; the epoch refuses what was carried out before those
MAX_ID = 63
MAX_OPERATOR = 128
MAX_TEXT = 300

_DECODERS = {verb: Decoder(kind) for verb, kind in REQUEST_TYPES.items()}
_header = Decoder(RequestHeader)


@dataclass(frozen=True, slots=True)
class _Pending:
    request: AnyRequest
    query: Query
    source: str


class RequestServer:
    """Answers the requests to one robot. `on_request` carries one out; its reply may follow later.

    An operator repeats a request until it has the reply. A repeat is not carried out again: it gets
    the reply of its id, now or once there is one. Only a stop or estop is carried out each time.
    Beyond MAX_PENDING requests without a reply further ones are dropped, never a stop or estop.
    `on_audit` takes one line for each request that was answered: who, from where, what, result.
    """

    def __init__(
        self,
        robot: str,
        on_request: Callable[[Request], None],
        on_audit: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._robot = robot
        self._on_request = on_request
        self._audit = Audit(on_audit)
        self._bus: ZenohBus | None = None
        self._pending: dict[str, _Pending] = {}
        self._replies: dict[str, bytes] = {}  # the last MAX_REPLIES, by request id

    def serve(self, bus: ZenohBus, verbs: Iterable[str]) -> None:
        """Answer requests with these verbs."""
        self._bus = bus
        for verb in verbs:
            bus.serve(_plane(verb), verb, partial(self.handle, verb))

    def reply(self, reply: Reply, *, is_stored: bool = True) -> None:
        """Send a reply. `is_stored` False: the latches could not be written to disk."""
        pending = self._pending.pop(reply.id, None)
        if pending is None:
            return
        is_repeat = reply.id in self._replies
        if not is_stored:
            text = f"{reply.text}; not on disk, so a restart would forget it: see the log"
            reply = msgspec.structs.replace(reply, text=text)
        payload = self._replies[reply.id] = encode(reply)
        if len(self._replies) > MAX_REPLIES:
            del self._replies[next(iter(self._replies))]
        pending.query.reply(payload)
        if not is_repeat:
            request = pending.request
            what = describe_request(request)
            self._audit.record(what, request.operator, pending.source, reply, boottime())

    def handle(self, verb: str, query: Query, source: str = "zenoh") -> None:
        """Carry out or refuse the request in a query that came on the key of `verb`.

        `source` is where it came from, for the log.
        """
        try:
            request = read_request(verb, query.payload)
        except CodecError as error:
            if self._bus is not None:
                self._bus.drop(f"{_plane(verb)}/{verb}:malformed")
            self._refuse_malformed(query, str(error), source)
            return
        is_for_this = request.targets is None or self._robot in request.targets
        is_stop = isinstance(request, StopRequest | EstopRequest)
        is_pending = request.id in self._pending
        is_full = not is_pending and len(self._pending) >= MAX_PENDING
        if not is_for_this or (is_full and not is_stop):
            query.drop()
        elif request.id in self._replies and not is_stop:
            query.reply(self._replies[request.id])
        else:
            # The newest query of an id gets the reply: the link of an older one may be closed.
            self._pending[request.id] = _Pending(request, query, source)
            if isinstance(request, ForgetRequest):
                self._forget(request)
            elif is_stop or not is_pending:
                self._on_request(request)

    def _refuse_malformed(self, query: Query, text: str, source: str) -> None:
        try:
            header = _header(query.payload)
        except CodecError:
            header = RequestHeader(id="", verb="")
        if 0 < len(header.id) <= MAX_ID and self._robot in (header.targets or ()):
            reply = Reply(
                id=header.id,
                robot=self._robot,
                code=Code.REFUSED,
                refusal=Refusal.INVALID_REQUEST,
                text=f"{header.verb[:MAX_ID]}: {text}"[:MAX_TEXT],
            )
            query.reply(encode(reply))
            verb, operator = header.verb[:MAX_ID], header.operator[:MAX_OPERATOR]
            self._audit.record(verb, operator, source, reply, boottime())
        else:
            query.drop()

    def _forget(self, request: ForgetRequest) -> None:
        assert self._bus is not None
        name = request.name
        if not self._bus.forget(name) and name in self._bus.members:
            code, refusal, text = Code.REFUSED, Refusal.MEMBER_ALIVE, f"{name} is alive"
        else:
            code, refusal, text = Code.APPLIED, None, f"forgot {name}"
        self.reply(Reply(id=request.id, robot=self._robot, code=code, refusal=refusal, text=text))


def read_request(verb: str, payload: bytes) -> AnyRequest:
    """Decode a request that came on the key of `verb`.

    Raises CodecError if the payload is malformed or has another verb. A stop or estop is accepted
    whatever its other fields hold, if its id, verb and targets can be read.
    """
    try:
        return _DECODERS[verb](payload)
    except CodecError:
        if verb not in ("stop", "estop"):
            raise
    header = _header(payload)
    if header.verb != verb:
        raise CodecError(f"a request to {header.verb} came on the key of {verb}")
    kind = StopRequest if verb == "stop" else EstopRequest
    return kind(
        id=header.id[:MAX_ID] or "unnamed",
        operator=header.operator[:MAX_OPERATOR] or "unknown",
        targets=None if header.targets is None else dict.fromkeys(header.targets),
    )


def _plane(verb: str) -> str:
    return "safety" if verb == "estop" else "control"
