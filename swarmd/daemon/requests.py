"""Decodes the requests of operators, hands them to the robot or a service, and sends the replies.

The table of `core/verbs.py` names the part of the daemon that answers a verb. The daemon refuses a
request of another version, or with a missing, mistyped or out-of-bounds field. The daemon drops a
payload that is no map, and a request that does not target the robot.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from swarmd.core import codec, verbs
from swarmd.core.bounds import MAX_SECONDS, keep_newest
from swarmd.core.clock import Clock, boottime
from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.keys import CONTROL
from swarmd.core.messages import Code, Reply
from swarmd.core.refusal import Refusal
from swarmd.daemon.audit import Audit, describe_request
from swarmd.link.carriers.bus import Query, ZenohBus
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.datagram import Stop
from swarmd.link.keys.key_permit import Denial

if TYPE_CHECKING:
    from swarmd.daemon.incidents import IncidentService
    from swarmd.daemon.pattern_transfer import PatternIntake, PatternPull
    from swarmd.daemon.recording_service import RecordingService
    from swarmd.daemon.roster_service import RosterService
    from swarmd.daemon.tools import FieldTools

MAX_PENDING = 64  # requests without a reply
# Replies kept for repeated requests. A repeat of an older request is refused by its epoch: the
# count of a robot's changes (`core/messages.Epoch`) that the operator saw and the request quotes.
MAX_REPLIES = 64
# characters
MAX_ID = 63
MAX_OPERATOR = 128
MAX_TEXT = 300
UNREADABLE = "?"
"""The id in the refusal of a request without a readable id."""

MAX_ANSWERS = 8
"""Answers to one verb that threads make at a time. A further question is dropped; the operator
repeats the question."""

_DECODERS = {row.name: Decoder(row.asked) for row in verbs.VERBS.values()}
_header = Decoder(verbs.RequestHeader, any_version=True)
_NO_FIELDS = encode(verbs.Nothing())


@dataclass(frozen=True, slots=True)
class _Pending:
    request: verbs.AnyRequest
    answer: Callable[[Reply], None]
    source: Callable[[], str]
    is_relayed: bool = False
    query: Query | None = None  # None if the request came as a datagram or from the own system


Judge = Callable[[verbs.AnyRequest], verbs.AnyRequest | Denial]
"""The request as its permit permits it, or why it is refused."""


class SendReply(Protocol):
    """Sends the reply to a request, at once or later; `RequestServer.reply`."""

    def __call__(self, reply: Reply, *, is_stored: bool = True, is_audited: bool = True) -> None:
        """Send the reply. `is_stored`: latches and goals are on disk. `is_audited`: log it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Services:
    """The services of a daemon that answer verbs.

    The table of core/verbs.py names for each verb a field of this class. The method `on_<verb>` of
    the service in this field handles the verb. A verb is a request or a question:

    - `on_<verb>(request, answer)` carries out a request, which changes the robot.
    - `on_<verb>(question)` returns the answer to a question, or a function that makes the answer in
      a thread.
    """

    recording: RecordingService
    incidents: IncidentService
    rosters: RosterService
    pushes: PatternIntake
    pushed: PatternPull
    tools: FieldTools

    def handler(self, row: verbs.Verb[Any, Any]) -> Callable[..., Any]:
        """The method that answers a verb. AttributeError if its service has none."""
        handler: Callable[..., Any] = getattr(getattr(self, row.handler.value), f"on_{row.name}")
        return handler


class RequestServer:
    """Answers the requests and questions to one robot. `on_request` hands a request to the robot.

    1. An operator repeats a request until a reply comes. A repeat is not carried out again: it gets
       the reply to the first request with its id. Stop and estop are carried out each time.
    2. Beyond MAX_PENDING requests without a reply, further requests are dropped, except stop and
       estop.
    3. `audit` takes each answered request.
    4. A request whose handler raises gets the reply REFUSED (after a CodecError) or FAILED, and is
       counted in `drops`.
    5. If the swarm `is_secured`, the operator of a request is the name in the certificate of the
       Zenoh link, whatever name the request has.
    6. `judge` judges each request by the permit of its name, whatever way it came: it returns the
       request as it may be carried out, or a `Denial`, with which the request is refused.
    """

    def __init__(
        self,
        robot: str,
        on_request: Callable[[verbs.Request], None],
        audit: Audit,
        services: Services,
        *,
        drops: DropCounter,
        is_secured: bool = False,
        judge: Judge = lambda request: request,
        clock: Clock = boottime,
    ) -> None:
        """Look up the handler of each verb: a method of a service, or else `on_request`.

        `audit` takes each answered request. `drops` counts requests whose handler failed.
        """
        self._clock = clock
        self._judge = judge
        self._drops = drops
        self._is_secured = is_secured
        self._robot = robot
        self._on_request = on_request
        self._handlers: dict[str, Callable[..., Any]] = {}  # the handler of each verb
        for row in verbs.VERBS.values():
            if row.handler is verbs.Handler.NETWORK:
                continue  # the bus itself answers these verbs
            if row.handler.is_service:
                self._handlers[row.name] = services.handler(row)
            else:
                # `answer` is not used: the robot's answer is a later action, which reaches `reply`.
                self._handlers[row.name] = lambda request, answer: on_request(request)
        # By verb: the tasks that wait for an answer, which a thread makes.
        self._answer_tasks: dict[str, set[asyncio.Task[None]]] = defaultdict(set)
        self._audit = audit
        self._pending: dict[str, _Pending] = {}  # by id, the requests without a reply so far
        self._replies: dict[str, Reply] = {}  # by id of the request, the last MAX_REPLIES replies

    def serve(self, bus: ZenohBus) -> None:
        """Answer all verbs on a newly opened bus, except verbs that the bus itself answers."""
        for row in verbs.VERBS.values():
            if row.handler is not verbs.Handler.NETWORK:
                handle = self.handle if row.is_request else self.ask
                bus.serve(CONTROL, row.name, partial(handle, row.name))

    def reply(self, reply: Reply, *, is_stored: bool = True, is_audited: bool = True) -> None:
        """Send a reply to the request that waits for it, and audit the request.

        A reply without such a request is dropped. `is_stored` False: the latches or the goals could
        not be written to disk, and the text of the reply says so. `is_audited` False: the reply
        answers only a part of a request, such as a piece of a pushed pattern.
        """
        pending = self._pending.pop(reply.id, None)
        if pending is None:
            return
        if not is_stored:
            text = f"{reply.text}; not on disk, so a restart would forget it: see the log"
            reply = msgspec.structs.replace(reply, text=text)
        is_told_before = self._is_told_before(reply)
        keep_newest(self._replies, reply.id, reply, MAX_REPLIES)
        with self._drops.refusing("control/reply"):  # a request is audited also if this fails
            pending.answer(reply)
        if is_audited and not is_told_before:
            with self._drops.refusing("control/audit"):
                self._record(pending, reply)

    def _is_told_before(self, reply: Reply) -> bool:
        """True if an earlier reply to the request has told the result, as for a copy of a stop.

        A failure after an earlier success is a new result, which the audit log must have.
        """
        earlier = self._replies.get(reply.id)
        if earlier is None:
            return False
        is_new_failure = reply.code is Code.FAILED and earlier.code is not Code.FAILED
        return not is_new_failure

    def _record(self, pending: _Pending, reply: Reply) -> None:
        request = pending.request
        self._audit.record(
            describe_request(request),
            request.operator,
            pending.source(),
            reply,
            self._clock(),
            targets=None if request.targets is None else len(request.targets),
            is_relayed=pending.is_relayed,
        )

    def stop(self, stop: Stop, source: str, answer: Callable[[Reply], None]) -> None:
        """Carry out a stop or emergency stop that came as a datagram, if it targets this robot.

        `source`: the address of the sender. `answer` sends the ack. An operator repeats a stop with
        one id: each copy is carried out and answered, and `reply` audits only the first copy.
        """
        if stop.targets is not None and self._robot not in stop.targets:
            return
        request = _request_of(stop)
        # The audit notes `is_relayed` for both verbs.
        self._pending[stop.id] = _Pending(
            request, answer, lambda: source, is_relayed=stop.is_relayed
        )
        self._hand_on(request)

    def deny_stop(
        self, stop: Stop, source: str, text: str, answer: Callable[[Reply], None]
    ) -> None:
        """Refuse and audit a stop that came as a datagram, and that no permit permits here."""
        if stop.id in self._pending:
            return  # an earlier copy was permitted
        self._pending[stop.id] = _Pending(
            _request_of(stop), answer, lambda: source, is_relayed=stop.is_relayed
        )
        self.reply(self._denial(stop.id, text))

    def _hand_on(self, request: verbs.Request) -> None:
        """Hand the robot a pending request that came past Zenoh, as far as its permit permits."""
        judged = self._judge(request)
        if isinstance(judged, Denial):
            self.reply(self._denial(request.id, judged.text))
            return
        assert isinstance(judged, verbs.Request)
        self._on_request(judged)

    def _denial(self, id: str, text: str) -> Reply:
        """The reply to a request that the permit of its name does not permit."""
        return Reply(
            id=id,
            robot=self._robot,
            code=Code.REFUSED,
            refusal=Refusal.NOT_PERMITTED,
            text=verbs.shortened(text, MAX_TEXT),
        )

    def take(self, request: verbs.Request, source: str, answer: Callable[[Reply], None]) -> None:
        """Carry out a request for this robot that came from the robot's own system.

        `source`: where the request came from, for the audit. `answer` sends the reply. Each copy of
        a stop is carried out and answered, and `reply` audits only the first copy.
        """
        is_stop = isinstance(request, verbs.StopRequest | verbs.EstopRequest)
        if not is_stop and len(self._pending) >= MAX_PENDING:
            text = "too many requests wait for their replies"
            self.refuse(request, source, answer, Refusal.BUSY, text)
            return
        self._pending[request.id] = _Pending(request, answer, lambda: source)
        self._hand_on(request)

    def refuse(
        self,
        request: verbs.Request,
        source: str,
        answer: Callable[[Reply], None],
        refusal: Refusal,
        text: str,
    ) -> None:
        """Refuse and audit a request of `take` that must not reach the robot."""
        self._pending[request.id] = _Pending(request, answer, lambda: source)
        code = Code.REFUSED
        self.reply(Reply(id=request.id, robot=self._robot, code=code, refusal=refusal, text=text))

    def handle(self, verb: str, query: Query) -> None:
        """Carry out or refuse the request in a query that came on the key of `verb`."""
        with self._drops.refusing(f"control/{verb}", partial(self._refuse, verb, query)):
            self._carry_out(_DECODERS[verb](query.payload), query)

    def ask(self, verb: str, query: Query) -> None:
        """Answer the question in a query that came on the key of `verb`."""
        question = (
            verbs.Nothing()
            if verbs.VERBS[verb].asked is verbs.Nothing
            else _DECODERS[verb](query.payload or _NO_FIELDS)
        )
        answer = self._handlers[verb](question)  # or a function that makes the answer in a thread
        if not callable(answer):
            query.reply(encode(answer))
            return
        tasks = self._answer_tasks[verb]
        if len(tasks) >= MAX_ANSWERS:
            query.drop()
            return
        task = asyncio.get_running_loop().create_task(self._answer_from_thread(verb, answer, query))
        tasks.add(task)
        task.add_done_callback(tasks.discard)

    async def _answer_from_thread(
        self, verb: str, make: Callable[[], msgspec.Struct], query: Query
    ) -> None:
        with self._drops.refusing(f"control/{verb}", lambda code, text: query.drop()):
            query.reply(encode(await asyncio.to_thread(make)))

    def _carry_out(self, request: verbs.AnyRequest, query: Query) -> None:
        if self._is_secured:
            request = msgspec.structs.replace(request, operator=query.asker)
        is_for_this = request.targets is None or self._robot in request.targets
        is_pending = request.id in self._pending
        is_stop = isinstance(request, verbs.StopRequest | verbs.EstopRequest)
        if isinstance(request, verbs.EstopRequest):
            # As in `swarmctl`: a latch of an estop of named robots does not spread to other robots.
            scope = request.scope if request.targets is None else "robots"
            request = msgspec.structs.replace(request, is_relayed=False, scope=scope)
        is_dropped = not is_pending and not is_stop and len(self._pending) >= MAX_PENDING
        if not is_for_this or is_dropped:
            query.drop()
        elif request.id in self._replies and not is_stop:
            query.reply(encode(self._replies[request.id]))
        elif is_pending and self._pending[request.id].request.operator != request.operator:
            query.drop()  # the reply belongs to the operator whose request waits
        else:
            # The newest query of an id gets the reply: the link of an older query may be closed.
            self._pending[request.id] = _Pending(
                request, lambda reply: query.reply(encode(reply)), lambda: query.source, query=query
            )
            if is_stop or not is_pending:
                judged = self._judge(request)
                if isinstance(judged, Denial):
                    self.reply(self._denial(request.id, judged.text))
                else:
                    self._handlers[judged.verb](judged, self.reply)

    def _refuse(self, verb: str, query: Query, code: Code, text: str) -> None:
        """Reply to a request that could not be decoded, or whose handler failed; audit it.

        `code`: REFUSED or FAILED. `text`: the error. Only the header of the request is read, and
        its fields may have wrong types. A request without a readable header is dropped, and so is a
        request for other robots.
        """
        try:
            header = _header(query.payload)
        except CodecError:
            query.drop()
            return
        if not self._is_addressed(verb, header.targets):
            query.drop()
            return
        has_id = isinstance(header.id, str) and 0 < len(header.id) <= MAX_ID
        id = str(header.id) if has_id else UNREADABLE
        reply = self._refusal(id, verb, codec.version_of(query.payload), code, text)
        is_repeat = has_id and id in self._replies
        if has_id:
            # `_end_pending` removes only a request that came in this `query`. If the id is pending
            # afterwards, another request has the same id and waits for its own reply.
            self._end_pending(id, query)
            is_id_of_other = id in self._pending
            if not is_repeat and not is_id_of_other:
                keep_newest(self._replies, id, reply, MAX_REPLIES)  # repeats get this reply
        with self._drops.refusing("control/reply"):
            query.reply(encode(reply))
        if not is_repeat:
            operator = query.asker if self._is_secured else str(header.operator)[:MAX_OPERATOR]
            count = len(_names_of(header.targets))
            self._audit.record(verb, operator, query.source, reply, self._clock(), targets=count)

    def _is_addressed(self, verb: str, targets: Any) -> bool:
        """True if a request with these targets is for this robot; only a stop may omit targets."""
        if targets is None:
            return verb in ("stop", "estop")
        return self._robot in _names_of(targets)

    def _end_pending(self, id: str, query: Query) -> None:
        """Remove the pending request `id` if it came in `query`, since its handler has failed."""
        pending = self._pending.get(id)
        if pending is not None and pending.query is query:
            del self._pending[id]

    def _refusal(self, id: str, verb: str, version: int | None, code: Code, text: str) -> Reply:
        """The reply to a request that `_refuse` refuses; `version`: of the request's payload."""
        refusal = Refusal.INVALID_REQUEST if code is Code.REFUSED else None
        text = f"{verb}: {text}"
        if version != codec.VERSION:  # the likely cause: a field has another form in that version
            refusal = Refusal.OTHER_VERSION
            text = f"{self._robot} speaks {codec.VERSION}, this swarmctl {version}"
        return Reply(
            id=id,
            robot=self._robot,
            code=code,
            refusal=refusal,
            text=verbs.shortened(text, MAX_TEXT),
        )


def _request_of(stop: Stop) -> verbs.StopRequest | verbs.EstopRequest:
    """The request of a stop that came as a datagram."""
    # In a request each target has an epoch. A stop names no epochs: None, for "not compared".
    targets = None if stop.targets is None else dict.fromkeys(stop.targets)
    kind: type[verbs.StopRequest | verbs.EstopRequest]
    kind = verbs.StopRequest if stop.verb == "stop" else verbs.EstopRequest
    # Only an estop has `is_relayed`: a relayed estop does not renew a latch that was reset. A
    # stop leaves no latch, and the robot treats a relayed stop as any other stop.
    return msgspec.structs.replace(
        kind(**verbs.shared_fields(stop, kind)),
        operator=stop.operator or "unknown",
        targets=targets,
        age=min(stop.age / 1000.0, MAX_SECONDS),  # s; `stop.age` is in ms
    )


def _names_of(targets: Any) -> Collection[Any]:
    """The names in the unchecked field `targets`; a value that is no map or list is one name."""
    if targets is None:
        return ()
    return targets if isinstance(targets, dict | list) else (targets,)
