"""The members as an operator finds them, by light daemons: real sessions, real processes."""

from __future__ import annotations

import contextlib
import json
import socket
from pathlib import Path

import pytest

from swarmd.core import codec
from swarmd.core.messages import Epoch, Presence
from swarmd.link.carriers.udp import UdpCarrier
from swarmd.link.datagram import Beacon, Solicit, pack, tag_of, unpack
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.exit_codes import PARTIAL
from swarmd.operator.session.members_view import Dials
from swarmd.operator.session.operator import Operator
from swarmd.operator.verbs.members.words import health, heard_row
from tests.link.conftest import Robots
from tests.support.swarmctl import fork_command


def test_members_come_with_their_own_status(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "b", "c")
    with Operator(settings) as operator:
        view = operator.members()
    assert view.alive == ("a", "b", "c")
    assert view.answered == {"a", "b", "c"}
    assert view.epochs(["b"]) == {"b": Epoch(instance=swarm["b"].instance, revision=0)}


def test_a_look_by_datagrams_dials_nobody(settings: NetworkSettings, robots: Robots) -> None:
    robots("a", "b")
    with Operator(settings) as operator:
        view = operator.members(needs_status=False, dials=Dials.NONE)
        assert not operator._sessions.is_open
    assert view.answered == {"a", "b"}
    assert not view.missing
    a = view.members["a"]
    assert (a.status, heard_row(a)[1]) == (None, a.state)
    assert "no answer" not in " ".join(health(view))


def test_robots_that_join_are_dialled_by_an_operator_that_stays(
    settings: NetworkSettings, robots: Robots
) -> None:
    with Operator(settings) as operator:
        for number, name in enumerate("abc", 1):
            robots(name)
            assert len(operator.members().answered) == number


@pytest.mark.long
def test_those_that_left_or_failed_are_listed(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "polite", "rude")
    swarm.call(swarm["polite"].leave)
    swarm.call(swarm["rude"].vanish)
    swarm.until(lambda: swarm["a"].network.members["rude"].presence is Presence.FAILED)
    with Operator(settings) as operator:
        members = operator.members().members
    assert {name: member.presence for name, member in members.items()} == {
        "a": Presence.ALIVE,
        "polite": Presence.LEFT,
        "rude": Presence.FAILED,
    }


class Hole:
    """A robot that is heard, and whose TCP port takes no connection: SYNs are dropped."""

    def __init__(self, settings: NetworkSettings, robot: str) -> None:
        self._robot = robot
        self._tag = tag_of(settings.profile, settings.swarm)
        self._server = socket.create_server(("127.0.0.1", 0), backlog=0)
        name = self._server.getsockname()
        self._fillers = [socket.socket() for _ in range(4)]
        for one in self._fillers:
            one.setblocking(False)
            one.connect_ex(name)
        self._carrier = UdpCarrier(settings, self._tag, port=name[1])
        self._carrier.start_thread(self._on_datagram)
        self._sequence = 0

    def _on_datagram(self, payload: bytes, source: tuple[str, int], waited: float) -> None:
        body = unpack(self._tag, payload)
        if not isinstance(body, Solicit):
            return
        self._sequence += 1
        beacon = Beacon(
            robot=self._robot,
            instance=b"hollow",
            sequence=self._sequence,
            wire=codec.VERSION,
            state=0,
            revision=0,
            echo=body.echo,
        )
        self._carrier.send_to(pack(self._tag, beacon), source)

    def close(self) -> None:
        self._carrier.close()
        for one in (self._server, *self._fillers):
            one.close()


@pytest.mark.long
@pytest.mark.integration
def test_a_robot_that_takes_no_connection_changes_neither_the_answer_nor_the_exit_code(
    settings: NetworkSettings, robots: Robots, tmp_path: Path
) -> None:
    robots("a")
    with contextlib.closing(Hole(settings, "hole")):
        words = ("members", "--swarm", settings.swarm, "-o", "json")
        done = fork_command("swarmctl", *words, cwd=tmp_path)
    assert done.returncode == PARTIAL
    answer = json.loads(done.stdout)
    assert answer["missing"] == ["hole"]
    contacts = {one["robot"]: one["contact"] for one in answer["members"]}
    assert contacts == {"a": "answered", "hole": "no answer"}
    assert done.stderr.startswith("view not complete: hole heard ")
    assert done.stderr.count("\n") == 1
