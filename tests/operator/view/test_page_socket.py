"""The page of a living swarm over HTTP and its socket, as a browser uses them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any
from urllib.request import urlopen

import pytest
from websockets.sync.client import ClientConnection, connect

from swarmd.core.messages import State
from tests.operator.view.test_page import served
from tests.operator.view.test_server import socket_of
from tests.support.processes import CAP

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = [pytest.mark.integration, pytest.mark.smoke]


def test_a_page_shows_a_robot_and_its_emergency_stop_latches_it(swarm: Swarm) -> None:
    swarm.start("tb3-01", swarm.resting("tb3-01"))
    with served(swarm) as (address,):
        with urlopen(address, timeout=CAP) as answer:
            assert b'src="main.js"' in answer.read()
        with connect(socket_of(address), max_size=None) as page:
            await_shown(page, state="idle")
            page.send('{"kind":"act","id":"a","verb":"estop"}')
            assert "1 targeted, 1 applied" in await_shown(page, state="estopped", is_final=True)
    assert swarm.status("tb3-01").state is State.ESTOPPED


def await_shown(page: ClientConnection, *, state: str, is_final: bool = False) -> str:
    """Wait until the robot is in a state and, if `is_final`, an answer is final; its line."""
    row: dict[str, Any] = {}
    answer: dict[str, Any] = {}
    while row.get("state") != state or answer.get("is_final", False) != is_final:
        one = page.recv(timeout=CAP)
        if isinstance(one, bytes):
            page.send('{"kind":"ack"}')
            continue
        found = json.loads(one)
        if found["kind"] == "rows":
            row = found["rows"].get("tb3-01", row)
        elif found["kind"] == "answer":
            answer = found
    return str(answer.get("line"))
