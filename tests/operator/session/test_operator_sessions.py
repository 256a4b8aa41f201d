"""The sessions of an operator: endpoints that Zenoh refuses, closes that hang."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable

import pytest

from swarmd.link.datagram import Address
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session import carriers as operator_sessions
from swarmd.operator.session.operator import Operator
from tests.link.conftest import Robots
from tests.support.operator_threads import is_closing
from tests.support.processes import CAP, wait_until


class Stubborn:
    """A session whose end takes long, or fails."""

    def __init__(self, act: Callable[[], object]) -> None:
        self.close = act


def test_a_close_that_hangs_or_fails_holds_nobody_up(
    settings: NetworkSettings, robots: Robots
) -> None:
    robots("a")
    go_on = threading.Event()

    def fail() -> None:
        raise RuntimeError("close operation timed out!")

    with Operator(settings) as operator:
        assert operator.members().answered == {"a"}
        operator._sessions._opened += [Stubborn(go_on.wait), Stubborn(fail)]  # type: ignore[list-item]
    assert is_closing()
    go_on.set()
    wait_until(lambda: not is_closing(), "all sessions are closed")


FROZEN = """
import atexit, socket, threading
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.roster import CLOSING
from swarmd.link.settings import NetworkSettings
frozen = socket.create_server(("127.0.0.1", 0))
atexit.register(lambda: print([one.name for one in threading.enumerate() if one.name == CLOSING]))
operator = Operator(NetworkSettings(swarm="frozen"))
operator._sessions._open_sessions({("r1", "one life"): frozen.getsockname()}, 0.0)
link, _ = frozen.accept()
link.recv(1)  # the handshake has begun
"""


@pytest.mark.integration
@pytest.mark.parametrize("end", ["", "operator.close()"])
def test_the_end_of_a_program_waits_for_no_frozen_robot(end: str) -> None:
    """A frozen robot accepts a link and sends nothing; Zenoh would close the session 9 s later."""
    ended = subprocess.run(
        [sys.executable, "-c", FROZEN + end],
        capture_output=True,
        text=True,
        check=False,
        timeout=CAP,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "[]\n", "")


@pytest.mark.long
def test_an_endpoint_that_zenoh_refuses_ends_no_look(
    settings: NetworkSettings, robots: Robots, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One wrong endpoint among those dialled together costs no other robot its link."""
    robots("a", "b")
    first, endpoint = [True], operator_sessions.endpoint_of

    def spoil(address: Address, interface: str) -> str:
        return "tcp/[a b/c#?]:1" if first and first.pop() else endpoint(address, interface)

    monkeypatch.setattr(operator_sessions, "endpoint_of", spoil)
    with Operator(settings) as operator:
        assert operator.members(timeout=20.0).answered == {"a", "b"}
