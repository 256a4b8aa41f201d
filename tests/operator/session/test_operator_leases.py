"""Leases of an operator: to whom they go, and which time on the clock of a robot they state."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from swarmd.core.messages import Member, PeerView, Presence
from swarmd.link.datagram import (
    PRESENCES,
    Address,
    Beacon,
    MemberList,
    MemberReport,
    OnDatagram,
    RunLease,
    Solicit,
    pack,
    tag_of,
    unpack,
)
from swarmd.link.keys.identity import authority_of
from swarmd.link.keys.roster import Role
from swarmd.link.settings import NetworkSettings
from swarmd.link.signature import Author
from swarmd.operator.session import carriers as operator_datagrams
from swarmd.operator.session import operator as operator_module
from swarmd.operator.session.operator import CLOCK_PERIOD, Operator
from tests.link.keyring import Keyring
from tests.support.statuses import make_member

AHEAD = 500.0  # s, of the clock of the robot
ADDRESS: Address = ("127.0.0.1", 7440)
NAMES = ("r1", "r2")


class FakeRobot:
    """A carrier with one robot, `r1`, which answers each solicit at once."""

    def __init__(self, keyring: Keyring | None) -> None:
        self.now = 100.0
        self.life = b"robot1"
        self.leases: list[RunLease] = []
        self.solicits = self._sequence = 0
        self._trust = None if keyring is None else keyring.trust("r1")
        authority = b"" if keyring is None else authority_of(keyring.identity("anna"))
        self._tag = tag_of("dev", "lab", authority)
        self._on_datagram: OnDatagram = lambda *_: None

    def send(self, payload: bytes) -> None:
        """To all."""
        body = unpack(self._tag, payload)
        if isinstance(body, Solicit):
            self.solicits += 1
            self.answer(body.echo)

    def send_to(self, payload: bytes, address: Address) -> None:
        """To the robot."""
        body = unpack(self._tag, payload)
        if isinstance(body, RunLease) and address == ADDRESS:
            self.leases.append(body)

    def answer(self, echo: int) -> None:
        """Answer a solicit."""
        self._sequence += 1
        beacon = Beacon(
            robot="r1",
            instance=self.life,
            sequence=self._sequence,
            wire=1,
            state=0,
            revision=0,
            echo=echo,
            clock=round(1000.0 * (self.now + AHEAD)),
        )
        payload = pack(self._tag, beacon)
        if self._trust is not None:
            payload = self._trust.signer.sign(payload, Author(Role.OPERATOR, "anna"))
        self._on_datagram(payload, ADDRESS, 0.0)

    def confirm(self, source: Address) -> None:
        """Nothing."""

    def start_thread(self, on_datagram: OnDatagram) -> None:
        """Hand datagrams over in the thread of the caller."""
        self._on_datagram = on_datagram

    def close(self) -> None:
        """Nothing is open."""


class Leasing:
    """An operator that has looked, and its robot."""

    def __init__(self, *, is_secured: bool, monkeypatch: pytest.MonkeyPatch) -> None:
        keyring = Keyring(("r1", "r2"), operators=("anna",)) if is_secured else None
        self.robot = FakeRobot(keyring)
        for module in (operator_module, operator_datagrams):
            monkeypatch.setattr(module, "boottime", lambda: self.robot.now)
        identity = None if keyring is None else keyring.identity("anna")
        self.operator = Operator(
            NetworkSettings(swarm="lab"), identity=identity, carrier=self.robot
        )
        discovery = self.operator._new_discovery(self.robot.now)
        self.operator._datagrams.solicit(discovery, self.robot.now)
        self.robot.solicits = 0

    def renew(self, count: int, after: float) -> RunLease:
        """The lease that the robot gets `after` s."""
        self.robot.now += after
        self.operator.send_lease("goal", count, NAMES)
        return self.robot.leases[-1]


@pytest.fixture(params=[True, False], ids=["secured", "without keys"])
def leasing(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Leasing]:
    made = Leasing(is_secured=request.param, monkeypatch=monkeypatch)
    with made.operator:
        yield made


def test_each_lease_states_the_time_on_the_clock_of_its_robot(
    leasing: Leasing, request: pytest.FixtureRequest
) -> None:
    is_secured = leasing.operator.identity is not None
    for count, after in enumerate((0.0, 0.25, 0.25, 5.0), 1):
        lease = leasing.renew(count, after)
        assert (lease.id, lease.count) == ("goal", count)
        if is_secured:
            assert lease.instance == b"robot1"
            shown = leasing.robot.now + AHEAD
            assert shown - 0.01 < lease.clock / 1000.0 <= shown
        else:
            assert (lease.instance, lease.clock) == (b"", 0)


def test_the_clocks_are_asked_for_each_period_in_a_secured_swarm_alone(leasing: Leasing) -> None:
    for count in range(1, 42):
        leasing.renew(count, CLOCK_PERIOD / 4)
    is_secured = leasing.operator.identity is not None
    assert leasing.robot.solicits == (11 if is_secured else 0)


def test_a_robot_that_restarts_gets_a_lease_of_its_new_life(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = Leasing(is_secured=True, monkeypatch=monkeypatch)
    with made.operator:
        assert made.renew(1, 0.0).instance == b"robot1"
        made.robot.life = b"robot2"
        assert made.renew(2, CLOCK_PERIOD).instance == b"robot2"


def test_no_lease_goes_to_a_robot_that_is_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Leasing(is_secured=False, monkeypatch=monkeypatch)
    with made.operator:
        made.operator.send_lease("goal", 1, ("r2",))
        assert made.robot.leases == []


def test_an_instance_that_a_robot_reports_of_another_is_not_believed(leasing: Leasing) -> None:
    """A robot that is heard through others alone: its instance is the word of one of them."""
    discovery = leasing.operator._discovery
    assert discovery is not None
    status = make_member("wolf").status
    assert status is not None
    report = MemberReport(
        robot="r2",
        instance=b"robot2",
        presence=PRESENCES.index(Presence.ALIVE),
        age=0,
        host="127.0.0.1",
        port=7441,
    )
    now = leasing.robot.now
    discovery.on_member_list(MemberList(robot="r1", instance=b"robot1", members=(report,)), now)
    member = Member(robot="r2", instance="zz", presence=Presence.ALIVE, age=0.0)
    discovery.on_view(PeerView(robot="wolf", status=status, members=(member,)), now + 0.1)
    leasing.renew(1, 0.2)
    assert [lease.count for lease in leasing.robot.leases] == [1]
