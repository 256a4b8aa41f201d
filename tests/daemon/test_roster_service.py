"""What a daemon answers to a roster; whole daemons: tests/swarm."""

from __future__ import annotations

import asyncio

import pytest

from swarmd.core.errors import CodecError
from swarmd.core.messages import Code, Epoch, Reply
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import RosterRequest
from swarmd.daemon import roster_service
from swarmd.daemon.roster_service import RosterService
from swarmd.link.carriers.inbound_queue import DropCounter
from tests.link.keyring import Keyring


@pytest.mark.parametrize(
    ("error", "code", "refusal"),
    [
        (CodecError("no roster"), Code.REFUSED, Refusal.INVALID_ROSTER),
        (ZeroDivisionError(), Code.FAILED, None),
    ],
)
async def test_a_fault_of_the_service_is_a_failure_and_no_refusal_of_the_roster(
    monkeypatch: pytest.MonkeyPatch, error: Exception, code: Code, refusal: Refusal | None
) -> None:
    def take(*_: object) -> None:
        raise error

    monkeypatch.setattr(roster_service, "take_roster", take)
    replies: asyncio.Queue[Reply] = asyncio.Queue()
    identity = Keyring(("r1",)).identity("r1")
    service = RosterService("r1", identity, lambda taken: None, DropCounter())
    targets: dict[str, Epoch | None] = {"r1": None}
    request = RosterRequest(id="q", operator="a", targets=targets, roster=b"")
    service.on_roster(request, lambda reply, **_: replies.put_nowait(reply))
    async with asyncio.timeout(20.0):
        reply = await replies.get()
    assert (reply.code, reply.refusal) == (code, refusal)
