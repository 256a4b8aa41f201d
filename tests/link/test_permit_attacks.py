"""Permits that stops on their way between robots must not widen, in virtual time."""

from __future__ import annotations

from typing import Literal

import pytest
from msgspec.structs import replace

from swarmd.daemon.key_permits import KeyPermits
from swarmd.link.datagram import Drive, RunLease, Stop, pack
from swarmd.link.keys.roster import KeyPermit
from swarmd.link.signature import Flaw
from tests.link.keyring import Keyring
from tests.link.virtual_network import OPERATOR, TAG, Robot, VirtualNetwork

NOW = 1_800_000_000.0
ROBOTS = ("r1", "r2", "r3")
PERMITS = {
    "agent": KeyPermit(role="agents", key=bytes(64), may=("stop",), until=int(NOW) + 60),
    "pupil": KeyPermit(
        role="pupils", key=bytes(64), may=("stop r1", "estop r1"), until=int(NOW) + 60
    ),
}


class Clock:
    """The wall clock of all robots, in s since 1970."""

    wall = NOW


class Judge:
    """The permits of one robot, with the roster that this robot has."""

    def __init__(self, robot: str, keyring: Keyring, clock: Clock) -> None:
        self._robot = robot
        self._keyring = keyring
        self.identity = keyring.identity(robot)
        self.permits = KeyPermits(
            robot, lambda: self.identity, lambda: None, wall=lambda: clock.wall
        )

    def take_roster(self) -> None:
        """Take the present generation of the roster."""
        self.identity = self._keyring.identity(self._robot)
        self.permits.take_roster()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def judges() -> dict[str, Judge]:
    """By name of a robot; `network` fills it."""
    return {}


@pytest.fixture
def network(clock: Clock, judges: dict[str, Judge]) -> VirtualNetwork:
    """Three robots that know permits, and `old`, which was made before there were permits."""
    names = (*ROBOTS, "old")
    keyring = Keyring(names, operators=("anna", "bob"), permits=PERMITS)
    made = VirtualNetwork(0, keyring=keyring, joined=False)
    for name in ROBOTS:
        judges[name] = Judge(name, keyring, clock)
        made.add(name, judge_stop=judges[name].permits.judge_stop)
    made.add("old")
    made.run(3.0)
    made.until(lambda: all(len(members(robot)) == 3 for robot in made.robots.values()))
    made.is_tapped = True
    # No robot knows the key of a name that its version does not know.
    made.reaches = lambda sender, receiver: (sender, receiver) != ("operator", "old")
    return made


def members(robot: Robot) -> list[str]:
    return [name for name, _ in robot.peer.membership.alive_addresses()]


def stop_by(
    network: VirtualNetwork,
    name: str,
    verb: Literal["stop", "estop"] = "stop",
    *,
    to: tuple[str, ...] = ROBOTS,
    operator: str = "",
    hops: int = 0,
) -> None:
    """A stop of all robots, which the key of `name` signs and which `to` hear; then 8 s pass."""
    stop = Stop(id=f"{verb}-{name}", verb=verb, operator=operator or name, hops=hops)
    assert network.keyring is not None
    signed = network.keyring.trust(name).signer.sign(pack(TAG, stop))
    for robot in to:
        network.inject(signed, OPERATOR, robot)
    network.run(8.0)


def stopped(network: VirtualNetwork) -> set[str]:
    return {name for name, robot in network.robots.items() if robot.stops}


def test_a_stop_that_nothing_narrows_reaches_each_robot_by_relay(network: VirtualNetwork) -> None:
    stop_by(network, "agent", to=("r2",))
    assert stopped(network) == {"r1", "r2", "r3", "old"}
    assert not any(robot.denied for robot in network.robots.values())


@pytest.mark.parametrize("verb", ["stop", "estop"])
@pytest.mark.parametrize("to", [("r1",), ("r2",), ROBOTS])
def test_relays_carry_a_stop_of_named_robots_to_no_other(
    network: VirtualNetwork, verb: Literal["stop", "estop"], to: tuple[str, ...]
) -> None:
    """Also not to a robot that believes each stop that a robot relays."""
    stop_by(network, "pupil", verb, to=to)
    assert stopped(network) == {"r1"}
    sent = [body for _, body, _, _ in network.tapped if isinstance(body, Stop)]
    assert {stop.targets for stop in sent} <= {("r1",)}
    assert {stop.scope for stop in sent} <= {"robots"}
    assert network.robots["r1"].denied == []
    for name in {*to} - {"r1"}:
        (text,) = network.robots[name].denied
        assert "may stop r1" in text


@pytest.mark.parametrize("wall", [NOW + 60, NOW + 1e6, 0.0])
@pytest.mark.parametrize("name", [*PERMITS])
def test_a_permit_that_has_ended_stops_no_robot_and_is_not_relayed(
    network: VirtualNetwork, clock: Clock, wall: float, name: str
) -> None:
    clock.wall = wall
    stop_by(network, name)
    assert stopped(network) == set()
    assert all(network.robots[robot].denied for robot in ROBOTS)
    assert not [body for _, body, _, _ in network.tapped if isinstance(body, Stop)]


def revoke(
    network: VirtualNetwork, judges: dict[str, Judge], *names: str, but: tuple[str, ...] = ()
) -> None:
    """The robots take a roster without these names, `but` these robots do not hear of it."""
    network.change_roster(remove=names, but=but)
    for name in judges.keys() - {*but}:
        judges[name].take_roster()


@pytest.mark.parametrize("verb", ["stop", "estop"])
@pytest.mark.parametrize("name", [*PERMITS])
def test_no_robot_with_the_new_roster_obeys_a_revoked_permit_by_relay(
    network: VirtualNetwork, judges: dict[str, Judge], name: str, verb: Literal["stop", "estop"]
) -> None:
    """r3 did not hear of the roster: it obeys the key as before, and relays its stop."""
    keyring = network.keyring
    assert keyring is not None
    stop = Stop(id="late", verb=verb, operator=name, targets=("r1", "r3"), scope="robots")
    late = keyring.trust(name).signer.sign(pack(TAG, stop))
    of_relay = keyring.trust("r3").signer.sign(pack(TAG, replace(stop, hops=1)))
    revoke(network, judges, name, but=("r3",))
    network.inject(late, OPERATOR, "r3")
    network.inject(of_relay, network.robots["r3"].address)  # also where r3 would not relay it
    network.run(8.0)
    assert stopped(network) & {"r1", "r2"} == set()
    assert network.robots["r1"].denied
    assert not any(
        isinstance(body, Stop) for name, body, _, _ in network.tapped if name in ("r1", "r2")
    )


def test_a_relayed_stop_of_a_revoked_operator_counts_as_before(
    network: VirtualNetwork, judges: dict[str, Judge]
) -> None:
    keyring = network.keyring
    assert keyring is not None
    stop = Stop(id="bob", verb="stop", operator="bob", hops=1)
    of_relay = keyring.trust("r3").signer.sign(pack(TAG, stop))
    revoke(network, judges, "bob", but=("r3",))
    network.inject(of_relay, network.robots["r3"].address, "r1")
    network.run(8.0)
    assert stopped(network) >= {"r1", "r2"}


def test_a_stop_of_a_permit_of_the_roster_before_is_refused_that_of_an_operator_is_not(
    network: VirtualNetwork, judges: dict[str, Judge]
) -> None:
    keyring = network.keyring
    assert keyring is not None
    stop = Stop(id="before", verb="stop", operator="agent")
    of_agent = keyring.trust("agent").signer.sign(pack(TAG, stop))
    of_bob = keyring.trust("bob").signer.sign(
        pack(TAG, Stop(id="bob", verb="stop", operator="bob"))
    )
    revoke(network, judges, "agent", "bob")
    network.run(5.0)
    for robot in ROBOTS:  # an older version knows the key of no name with a permit
        network.inject(of_agent, OPERATOR, robot)
    network.run(8.0)
    assert stopped(network) == set()
    assert all(network.robots[robot].denied for robot in ROBOTS)
    network.inject(of_bob, OPERATOR)
    network.run(8.0)
    assert stopped(network) == {*ROBOTS, "old"}


def test_no_other_name_widens_a_permit(network: VirtualNetwork) -> None:
    """The names that a stop states: of an operator, of an agent of the pupil, of a relay."""
    stop_by(network, "pupil", operator="anna")
    stop_by(network, "pupil", operator="agent")
    stop_by(network, "pupil", hops=1)
    assert stopped(network) == set()
    assert all(network.robots[name].flaws[Flaw.FORGED] == 3 for name in ROBOTS)
    stop_by(network, "pupil", "estop", operator="pupil by anna")
    assert stopped(network) == {"r1"}


def test_a_permit_renews_no_run(network: VirtualNetwork) -> None:
    keyring = network.keyring
    assert keyring is not None
    lease = RunLease(id="goal", operator="agent", count=1)
    network.inject(keyring.trust("agent").signer.sign(pack(TAG, lease)), OPERATOR)
    network.run(1.0)
    for name in ROBOTS:
        assert network.robots[name].leases == []
        assert network.robots[name].flaws[Flaw.ROLE] == 1


def test_a_command_of_a_hand_counts_for_its_robot_alone_and_in_the_name_of_its_signer(
    network: VirtualNetwork,
) -> None:
    """Robots relay none, so that no other robot hands one on."""
    keyring = network.keyring
    assert keyring is not None
    drive = Drive(robot="r1", hand="h1", operator="anna", order=1, sent=1, linear=0.1, angular=0.0)
    network.inject(keyring.trust("anna").signer.sign(pack(TAG, drive)), OPERATOR)
    for other in ("bob", "agent"):
        network.inject(keyring.trust(other).signer.sign(pack(TAG, drive)), OPERATOR)
    by_robot = keyring.trust("r2").signer.sign(pack(TAG, drive))
    network.inject(by_robot, ("10.0.0.2", 7000))
    network.inject(pack(TAG, drive), OPERATOR)  # not signed
    network.run(3.0)
    assert {name: robot.drives for name, robot in network.robots.items() if robot.drives} == {
        "r1": [drive]
    }
    flaws = network.robots["r1"].flaws
    assert (flaws[Flaw.FORGED], flaws[Flaw.ROLE], flaws[Flaw.UNSIGNED]) == (2, 1, 1)
    assert not [body for _, body, _, _ in network.tapped if isinstance(body, Drive)]
