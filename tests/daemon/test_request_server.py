"""Requests from the wire: read strictly, but for a stop."""

from __future__ import annotations

import math
from typing import Any

import msgpack
import pytest

from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.messages import (
    REQUEST_TYPES,
    Code,
    Epoch,
    EstopRequest,
    Refusal,
    Reply,
    Request,
    RunRequest,
    StopRequest,
)
from swarmd.daemon.request_server import MAX_PENDING, RequestServer, read_request

EPOCH = Epoch("0123456789ab", 1)


def raw(**fields: object) -> bytes:
    packed: bytes = msgpack.packb(fields)
    return b"\x01" + packed


class RecordingQuery:
    def __init__(self, payload: bytes) -> None:
        self.payload = payload
        self.replies: list[Reply] = []
        self.is_dropped = False

    def reply(self, payload: bytes) -> None:
        self.replies.append(Decoder(Reply)(payload))

    def drop(self) -> None:
        self.is_dropped = True


def run_request(id: str = "r1") -> RunRequest:
    return RunRequest(id=id, operator="anna", targets={"tb3-01": EPOCH}, pattern="drive")


@pytest.mark.parametrize("verb", REQUEST_TYPES)
def test_a_request_arrives_as_it_was_sent(verb: str) -> None:
    fields: dict[str, dict[str, Any]] = {
        "run": {"pattern": "drive", "params": {"speed": "0.1"}, "until": ("done",)},
        "param": {"params": {"speed": 0.1, "name": None}},
        "reload": {"pattern": "drive", "is_rerun": True},
        "reset": {"ids": ("e1",), "reason": "drill"},
        "estop": {"scope": "robots", "reason": "drill"},
        "forget": {"name": "tb3-02"},
    }
    targets: dict[str, Epoch | None] = {"tb3-01": EPOCH}
    kind = REQUEST_TYPES[verb]
    request = kind(id="r1", operator="anna", targets=targets, **fields.get(verb, {}))
    assert request.verb == verb
    assert read_request(verb, encode(request)) == request


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_with_unreadable_fields_is_obeyed(verb: str) -> None:
    taken: list[Request] = []
    payload = raw(id="e" * 99, operator="a" * 999, verb=verb, reason=math.nan, scope=[{}])
    RequestServer("tb3-01", taken.append).handle(verb, RecordingQuery(payload))
    (request,) = taken
    assert isinstance(request, StopRequest | EstopRequest)
    assert (request.verb, request.targets) == (verb, None)
    assert (len(request.id), len(request.operator)) == (63, 128)


def test_an_unreadable_estop_is_swarm_wide_and_keeps_its_targets() -> None:
    payload = raw(id="e1", verb="estop", scope="nobody", targets={"tb3-02": "rubbish"})
    request = read_request("estop", payload)
    assert isinstance(request, EstopRequest)
    assert (request.scope, set(request.targets or ())) == ("swarm", {"tb3-02"})


@pytest.mark.parametrize(
    ("verb", "payload"),
    [
        ("run", raw(id="r1", operator="a", verb="run", pattern="x", targets=None)),
        ("run", raw(id="r1", operator="a", verb="run", pattern="x")),
        ("run", raw(id="r1", operator="a", verb="run", targets={"a": None})),
        ("run", raw(id="r1", operator="a", verb="stop", targets=None)),
        ("estop", raw(id="r1", operator="a", verb="stop", targets=None)),
        ("run", raw(id="r1", operator="a", verb="run", pattern="x", targets={"a": 1})),
        ("estop", raw(operator="a", verb="estop")),
        ("estop", b"rubbish"),
        ("estop", b""),
    ],
)
def test_any_other_malformed_request_is_rejected(verb: str, payload: bytes) -> None:
    with pytest.raises(CodecError):
        read_request(verb, payload)


def test_a_malformed_request_is_refused_by_the_robots_that_it_targets() -> None:
    taken: list[Request] = []
    server = RequestServer("tb3-01", taken.append)
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


def test_pending_requests_are_bounded_and_a_stop_is_always_taken() -> None:
    taken: list[Request] = []
    server = RequestServer("tb3-01", taken.append)
    for n in range(MAX_PENDING + 1):
        server.handle("run", RecordingQuery(encode(run_request(f"r{n}"))))
    assert len(taken) == MAX_PENDING
    server.handle("estop", RecordingQuery(encode(EstopRequest(id="e1", operator="anna"))))
    assert taken[-1].id == "e1"


def test_a_repeated_request_is_carried_out_once_and_gets_the_same_reply() -> None:
    taken: list[Request] = []
    server = RequestServer("tb3-01", taken.append)
    payload = encode(run_request())
    first, waiting, late = (RecordingQuery(payload) for _ in range(3))
    server.handle("run", first)
    server.handle("run", waiting)
    reply = Reply(id="r1", robot="tb3-01", code=Code.REFUSED, refusal=Refusal.BUSY)
    server.reply(reply)
    server.handle("run", late)
    assert taken == [run_request()]
    assert waiting.replies == late.replies == [reply]


def test_a_repeated_stop_is_carried_out_each_time() -> None:
    taken: list[Request] = []
    server = RequestServer("tb3-01", taken.append)
    stop = StopRequest(id="s1", operator="anna")
    for _ in range(2):
        server.handle("stop", RecordingQuery(encode(stop)))
        server.reply(Reply(id="s1", robot="tb3-01", code=Code.APPLIED))
    assert taken == [stop, stop]


def test_a_reply_names_the_latches_that_are_not_on_disk() -> None:
    server = RequestServer("tb3-01", lambda request: None)
    query = RecordingQuery(encode(EstopRequest(id="e1", operator="anna")))
    server.handle("estop", query)
    reply = Reply(id="e1", robot="tb3-01", code=Code.APPLIED, text="zero")
    server.reply(reply, is_stored=False)
    assert [one.text != "zero" for one in query.replies] == [True]
    server.reply(reply)
    assert len(query.replies) == 1


def test_each_request_gives_one_line_also_when_it_is_repeated() -> None:
    lines: list[str] = []
    server: RequestServer

    def carry_out(request: Request) -> None:
        server.reply(Reply(id=request.id, robot="tb3-01", code=Code.APPLIED, text="fine"))

    server = RequestServer("tb3-01", carry_out, lines.append)
    stop = encode(StopRequest(id="s1", operator="anna"))
    for _ in range(3):
        server.handle("stop", RecordingQuery(stop), "10.0.0.5")
    server.handle("run", RecordingQuery(encode(run_request())))
    server.handle("run", RecordingQuery(raw(id="r2", verb="run", targets={"tb3-01": None})))
    server.handle("run", RecordingQuery(b"rubbish"))
    assert lines[:2] == [
        "stop to all robots, by anna from 10.0.0.5: applied: fine",
        "run drive to 1 robot, by anna from zenoh: applied: fine",
    ]
    assert len(lines) == 3
    assert "refused (invalid_request)" in lines[2]
