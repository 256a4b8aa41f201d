"""Requests from the wire, and stops from datagrams."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import msgpack
import msgspec
import pytest

from swarmd.core import codec
from swarmd.core.bounds import Seconds
from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.messages import Code, Epoch, Reply
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import (
    VERBS,
    AuditQuery,
    EstopRequest,
    LinksQuery,
    LogsQuery,
    Request,
    RunRequest,
    StopRequest,
)
from swarmd.daemon.audit import Audit
from swarmd.daemon.requests import MAX_PENDING, RequestServer
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.datagram import MAX_MS, Stop
from tests.support.fake_services import FakeService, fake_services

EPOCH = Epoch("0123456789ab", 1)


def raw(*, version: int = 1, **fields: object) -> bytes:
    packed: bytes = msgpack.packb(fields)
    return bytes([version]) + packed


class RecordingQuery:
    source = "10.0.0.5:40000"

    def __init__(self, payload: bytes, asker: str = "anyone") -> None:
        self.asker = asker
        self.payload = payload
        self.replies: list[Reply] = []
        self.is_dropped = False

    def reply(self, payload: bytes) -> None:
        self.replies.append(Decoder(Reply)(payload))

    def drop(self) -> None:
        self.is_dropped = True


def server_of(
    robot: str,
    on_request: Callable[[Request], None],
    on_audit: Callable[[str], None] = lambda line: None,
    *,
    is_secured: bool = False,
) -> RequestServer:
    return RequestServer(
        robot,
        on_request,
        Audit(on_audit),
        fake_services(),
        drops=DropCounter(),
        is_secured=is_secured,
    )


def run_request(id: str = "r1") -> RunRequest:
    return RunRequest(id=id, operator="anna", targets={"tb3-01": EPOCH}, pattern="drive")


@pytest.mark.parametrize("verb", ["run", "param", "reload", "reset"])
def test_a_request_arrives_as_it_was_sent(verb: str) -> None:
    fields: dict[str, dict[str, Any]] = {
        "run": {"pattern": "drive", "params": {"speed": "0.1"}, "until": ("done",)},
        "param": {"params": {"speed": 0.1, "name": None}},
        "reload": {"pattern": "drive", "is_rerun": True},
        "reset": {"ids": ("e1",), "reason": "drill"},
    }
    targets: dict[str, Epoch | None] = {"tb3-01": EPOCH}
    request = VERBS[verb].asked(id="r1", operator="anna", targets=targets, **fields[verb])
    taken: list[Request] = []
    server_of("tb3-01", taken.append).handle(verb, RecordingQuery(encode(request)))
    assert request.verb == verb
    assert taken == [request]


def test_a_stop_is_carried_out_by_the_robots_that_it_is_for() -> None:
    taken: list[Request] = []
    server = server_of("tb3-01", taken.append)
    estop = Stop(id="e1", verb="estop", operator="", scope="robots", reason="drill")
    for stop in (
        estop,
        Stop(id="s1", verb="stop", operator="anna", targets=("tb3-02", "tb3-01")),
        Stop(id="s2", verb="stop", operator="anna", targets=("tb3-02",)),
    ):
        server.stop(stop, "10.0.0.5", lambda reply: None)
    assert taken == [
        EstopRequest(id="e1", operator="unknown", scope="robots", reason="drill"),
        StopRequest(id="s1", operator="anna", targets={"tb3-02": None, "tb3-01": None}),
    ]


@pytest.mark.parametrize(
    "payload",
    [
        raw(id="r1", operator="a", verb="run", pattern="x", targets=None),
        raw(id="r1", operator="a", verb="run", pattern="x"),
        raw(id="r1", operator="a", verb="run", targets={"tb3-01": None}),
        raw(id="r1", operator="a", verb="stop", targets=None),
        raw(id="r1", operator="a", verb="run", pattern="x", targets={"tb3-01": 1}),
        b"rubbish",
        b"",
    ],
)
def test_a_malformed_request_is_not_carried_out(payload: bytes) -> None:
    taken: list[Request] = []
    server_of("tb3-01", taken.append).handle("run", RecordingQuery(payload))
    assert taken == []


@pytest.mark.parametrize("version", [0, 2])
def test_a_request_of_another_version_is_refused_by_name(version: int) -> None:
    lines: list[str] = []
    taken: list[Request] = []
    server = server_of("tb3-01", taken.append, lines.append)
    fields: dict[str, Any] = {"id": "r1", "operator": "anna", "verb": "run", "version": version}
    mine = RecordingQuery(raw(**fields, targets={"tb3-01": None}, novelty=[1, {"a": 2}]))
    other = RecordingQuery(raw(**fields, targets={"tb3-02": None}))
    for query in (mine, mine, other):
        server.handle("run", query)
    assert taken == []
    assert {(one.code, one.refusal) for one in mine.replies} == {
        (Code.REFUSED, Refusal.OTHER_VERSION)
    }
    assert mine.replies[0].text == f"tb3-01 speaks {codec.VERSION}, this swarmctl {version}"
    assert (other.replies, other.is_dropped) == ([], True)
    [line] = lines
    assert line.startswith(
        "run, by anna from 10.0.0.5:40000: refused (other_version): tb3-01 speaks "
    )


def test_a_malformed_request_is_refused_by_the_robots_that_it_targets() -> None:
    taken: list[Request] = []
    server = server_of("tb3-01", taken.append)
    fields: dict[str, Any] = {"id": "r1", "operator": "a", "verb": "run", "pattern": 5}
    mine = RecordingQuery(raw(**fields, targets={"tb3-01": None}))
    other = RecordingQuery(raw(**fields, targets={"tb3-02": None}))
    rubbish = RecordingQuery(b"rubbish")
    for query in (mine, other, rubbish):
        server.handle("run", query)
    assert taken == []
    assert [(one.id, one.code, one.refusal) for one in mine.replies] == [
        ("r1", Code.REFUSED, Refusal.INVALID_REQUEST)
    ]
    assert (other.replies, other.is_dropped) == ([], True)
    assert (rubbish.replies, rubbish.is_dropped) == ([], True)


@pytest.mark.parametrize("targets", [None, ("tb3-01",), ("tb3-02",)])
@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_of_a_program_asks_for_what_the_datagram_asks_for(
    verb: Literal["stop", "estop"], targets: tuple[str, ...] | None
) -> None:
    """A named emergency stop latches the named robots alone: no other one takes the latch over."""
    taken: list[Request] = []
    server = server_of("tb3-01", taken.append)
    scope: Literal["robots", "swarm"] = "swarm" if targets is None else "robots"
    stop = Stop(id="s1", verb=verb, operator="anna", targets=targets, scope=scope)
    named: dict[str, Any] = {} if targets is None else {"targets": dict.fromkeys(targets)}
    server.stop(stop, "10.0.0.5", lambda reply: None)
    server.handle(verb, RecordingQuery(raw(id="s1", verb=verb, operator="anna", **named)))
    assert taken[1:] == taken[:1]
    assert bool(taken) == (targets != ("tb3-02",))


@pytest.mark.parametrize("targets", [{}, {"targets": None}, {"targets": {"tb3-01": None}}])
def test_a_malformed_stop_of_all_is_refused_by_each_robot(targets: dict[str, Any]) -> None:
    taken: list[Request] = []
    nameless = RecordingQuery(raw(id="s1", verb="estop", **targets))
    server_of("tb3-01", taken.append).handle("estop", nameless)
    assert taken == []
    assert [reply.refusal for reply in nameless.replies] == [Refusal.INVALID_REQUEST]


@pytest.mark.parametrize(
    ("fields", "id"),
    [
        ({"targets": ["tb3-01"]}, "s1"),
        ({"targets": "tb3-01"}, "s1"),
        ({"operator": 5}, "s1"),
        ({"id": 5}, "?"),
        ({"id": None}, "?"),
        ({"id": "x" * 64}, "?"),
        ({"targets": ["tb3-02"]}, None),
        ({"targets": 5}, None),
        ({"verb": 5, "targets": ["tb3-01"]}, "s1"),
    ],
)
def test_a_field_of_a_wrong_type_is_refused_with_an_answer(
    fields: dict[str, Any], id: str | None
) -> None:
    taken: list[Request] = []
    query = RecordingQuery(raw(**{"id": "s1", "verb": "stop", "operator": "a"} | fields))
    server_of("tb3-01", taken.append).handle("stop", query)
    assert taken == []
    assert [(one.id, one.refusal) for one in query.replies] == (
        [] if id is None else [(id, Refusal.INVALID_REQUEST)]
    )


class UnreadQuery(RecordingQuery):
    def reply(self, payload: bytes) -> None:
        """Take an answer of any type."""


def test_a_question_without_a_payload_has_the_defaults_of_its_type() -> None:
    service = FakeService()
    audit, services = Audit(lambda line: None), fake_services(service)
    server = RequestServer("tb3-01", lambda request: None, audit, services, drops=DropCounter())
    for verb, asked in (("logs", LogsQuery()), ("audit", AuditQuery()), ("links", LinksQuery())):
        server.ask(verb, UnreadQuery(b""))
        assert service.calls.pop() == (verb, asked)
    with pytest.raises(CodecError):
        server.ask("fetch", UnreadQuery(b""))


def test_pending_requests_are_bounded_and_a_stop_is_always_taken() -> None:
    taken: list[Request] = []
    server = server_of("tb3-01", taken.append)
    for n in range(MAX_PENDING + 1):
        server.handle("run", RecordingQuery(encode(run_request(f"r{n}"))))
    assert len(taken) == MAX_PENDING
    server.stop(Stop(id="e1", verb="estop", operator="anna"), "10.0.0.5", lambda reply: None)
    assert taken[-1].id == "e1"


def test_a_repeated_request_is_carried_out_once_and_gets_the_same_reply() -> None:
    taken: list[Request] = []
    server = server_of("tb3-01", taken.append)
    payload = encode(run_request())
    first, waiting, late = (RecordingQuery(payload) for _ in range(3))
    server.handle("run", first)
    server.handle("run", waiting)
    reply = Reply(id="r1", robot="tb3-01", code=Code.REFUSED, refusal=Refusal.BUSY)
    server.reply(reply)
    server.handle("run", late)
    assert taken == [run_request()]
    assert waiting.replies == late.replies == [reply]


def test_a_repeated_stop_is_carried_out_and_answered_each_time() -> None:
    taken: list[Request] = []
    answers: list[Reply] = []
    server = server_of("tb3-01", taken.append)
    for _ in range(2):
        server.stop(Stop(id="s1", verb="stop", operator="anna"), "10.0.0.5", answers.append)
        server.reply(Reply(id="s1", robot="tb3-01", code=Code.APPLIED))
    assert taken == [StopRequest(id="s1", operator="anna")] * 2
    assert [one.id for one in answers] == ["s1", "s1"]


def test_a_reply_names_the_latches_that_are_not_on_disk() -> None:
    answers: list[Reply] = []
    server = server_of("tb3-01", lambda request: None)
    server.stop(Stop(id="e1", verb="estop", operator="anna"), "10.0.0.5", answers.append)
    reply = Reply(id="e1", robot="tb3-01", code=Code.APPLIED, text="zero")
    server.reply(reply, is_stored=False)
    assert [one.text != "zero" for one in answers] == [True]
    server.reply(reply)
    assert len(answers) == 1


def test_in_a_secured_swarm_the_operator_is_the_asker_of_the_key() -> None:
    taken: list[Request] = []
    lines: list[str] = []
    server = server_of("tb3-01", taken.append, lines.append, is_secured=True)
    server.handle("run", RecordingQuery(encode(run_request()), "bob"))
    assert [request.operator for request in taken] == ["bob"]
    header = raw(id="r2", operator="anna", verb="run", targets={"tb3-01": None})
    server.handle("run", RecordingQuery(header, "bob"))
    assert ["by bob" in line for line in lines] == [True]


def test_each_request_gives_one_line_also_when_it_is_repeated() -> None:
    lines: list[str] = []
    server: RequestServer

    def carry_out(request: Request) -> None:
        server.reply(Reply(id=request.id, robot="tb3-01", code=Code.APPLIED, text="fine"))

    server = server_of("tb3-01", carry_out, lines.append)
    for _ in range(3):
        stop = Stop(id="s1", verb="stop", operator="anna")
        server.stop(stop, "10.0.0.5", lambda reply: None)
    server.handle("run", RecordingQuery(encode(run_request())))
    server.handle("run", RecordingQuery(raw(id="r2", verb="run", targets={"tb3-01": None})))
    server.handle("run", RecordingQuery(b"rubbish"))
    assert lines[:2] == [
        "stop to all robots, by anna from 10.0.0.5: applied: fine",
        "run drive to 1 robot, by anna from 10.0.0.5:40000: applied: fine",
    ]
    assert len(lines) == 3
    assert "refused (invalid_request)" in lines[2]


def test_a_stop_is_audited_also_if_its_ack_cannot_be_sent() -> None:
    lines: list[str] = []
    server = server_of("tb3-01", lambda request: None, lines.append)

    def unsent(reply: Reply) -> None:
        raise OSError("the network is unreachable")

    server.stop(Stop(id="s1", verb="stop", operator="anna"), "10.0.0.5", unsent)
    server.reply(Reply(id="s1", robot="tb3-01", code=Code.APPLIED, text="zero"))
    assert len(lines) == 1
    assert "applied" in lines[0]


def test_a_stop_that_fails_after_its_first_ack_is_audited_as_failed_too() -> None:
    lines: list[str] = []
    server = server_of("r1", lambda request: None, lines.append)
    for code in (Code.APPLIED, Code.APPLIED, Code.FAILED, Code.FAILED, Code.APPLIED):
        server.stop(Stop(id="s1", verb="stop", operator="anna"), "10.0.0.5", lambda reply: None)
        server.reply(Reply(id="s1", robot="r1", code=code))
    assert [Code.FAILED in line for line in lines] == [False, True]


def test_a_refusal_is_audited_also_if_it_cannot_be_sent() -> None:
    lines: list[str] = []

    class Closed(RecordingQuery):
        def reply(self, payload: bytes) -> None:
            raise RuntimeError("the session is closed")

    server = server_of("tb3-01", lambda request: None, lines.append)
    payload = raw(id="r1", operator="anna", verb="run", targets={"tb3-01": None})
    server.handle("run", Closed(payload))
    assert len(lines) == 1


def test_a_query_that_cannot_be_read_takes_no_reply_of_another_request() -> None:
    """The other request may be pending, or its reply kept for repeats."""
    stops: list[Reply] = []
    server = server_of("tb3-01", lambda request: None)
    payload = encode(run_request("r1"))
    waiting, late = RecordingQuery(payload), RecordingQuery(payload)
    server.handle("run", waiting)
    server.stop(Stop(id="s1", verb="stop", operator="anna"), "10.0.0.5", stops.append)
    junk = {
        id: RecordingQuery(raw(id=id, operator="eve", verb="run", targets={"tb3-01": None}))
        for id in ("r1", "s1")
    }
    replies = {id: Reply(id=id, robot="tb3-01", code=Code.APPLIED) for id in junk}
    for id, query in junk.items():
        server.handle("run", query)
        server.reply(replies[id])
        server.handle("run", query)
    server.handle("run", late)
    assert waiting.replies == late.replies == [replies["r1"]]
    assert stops == [replies["s1"]]
    for query in junk.values():
        assert [one.refusal for one in query.replies] == [Refusal.INVALID_REQUEST] * 2


def test_a_fault_of_the_handler_is_a_failure_and_no_refusal() -> None:
    """The request may have been carried out in part; a repeat is not carried out again."""
    taken: list[Request] = []

    def fail(request: Request) -> None:
        taken.append(request)
        raise ZeroDivisionError

    server = server_of("tb3-01", fail)
    first, repeat = RecordingQuery(encode(run_request())), RecordingQuery(encode(run_request()))
    server.handle("run", first)
    server.handle("run", repeat)
    assert [(one.code, one.refusal) for one in first.replies] == [(Code.FAILED, None)]
    assert repeat.replies == first.replies
    assert len(taken) == 1


def test_the_age_of_a_stop_stays_within_that_of_a_request() -> None:
    taken: list[Request] = []
    server = server_of("tb3-01", taken.append)
    server.stop(
        Stop(id="s1", verb="stop", operator="a", age=MAX_MS), "10.0.0.5", lambda reply: None
    )
    server.stop(Stop(id="e1", verb="estop", operator="a", age=MAX_MS), "10.0.0.5", lambda _: None)
    for request in taken:
        assert isinstance(request, StopRequest | EstopRequest)
        assert msgspec.convert(request.age, Seconds) > 3600.0
