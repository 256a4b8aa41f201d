from __future__ import annotations

import msgpack
import pytest

from swarmd.core.codec import encode
from swarmd.core.errors import CodecError
from swarmd.core.messages import Epoch, Request
from swarmd.daemon.reading import RequestReader

EPOCH = Epoch("boot", 1)


def raw(**fields: object) -> bytes:
    packed: bytes = msgpack.packb(fields)
    return b"\x01" + packed


def test_a_request_is_read_as_it_was_sent() -> None:
    request = Request(id="r1", operator="anna", verb="run", targets={"tb3-01": EPOCH})
    assert RequestReader()("run", encode(request)) == request


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_halt_is_taken_however_odd_its_arguments(verb: str) -> None:
    payload = raw(id="e" * 99, operator="a" * 999, verb=verb, args={"reason": "x" * 999, "y": [{}]})
    halt = RequestReader()(verb, payload)
    assert (halt.verb, halt.targets, len(halt.id), len(halt.operator)) == (verb, None, 63, 128)


def test_an_odd_halt_still_means_only_whom_it_names() -> None:
    payload = raw(id="e1", verb="estop", targets={"tb3-02": "rubbish"})
    assert set(RequestReader()("estop", payload).targets or ()) == {"tb3-02"}


@pytest.mark.parametrize(
    ("verb", "payload"),
    [
        ("run", raw(id="r1", operator="a", verb="run", targets=None)),
        ("run", raw(id="r1", operator="a", verb="stop", targets=None)),
        ("estop", raw(id="r1", operator="a", verb="stop", targets=None)),
        ("run", raw(id="r1", operator="a", verb="run", targets={"a": 1}, args={})),
        ("estop", raw(operator="a", verb="estop")),
        ("estop", b"rubbish"),
    ],
)
def test_anything_else_is_unreadable(verb: str, payload: bytes) -> None:
    with pytest.raises(CodecError):
        RequestReader()(verb, payload)
