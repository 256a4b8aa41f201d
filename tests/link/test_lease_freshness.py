"""Which leases show a robot that they are new; whole swarms: tests/histories/test_histories.py."""

from __future__ import annotations

import pytest
from msgspec.msgpack import encode
from msgspec.structs import replace

from swarmd.link.datagram import RunLease, pack, unpack
from swarmd.link.members.lease_freshness import lease_age
from swarmd.link.peer import HeardLease
from swarmd.link.signature import Flaw
from tests.link.keyring import Keyring
from tests.link.virtual_network import OPERATOR, TAG, VirtualNetwork

OWN, EARLIER = b"robot2", b"robot1"  # two lives of the daemon of one robot
LEASE = RunLease(id="goal", operator="anna", count=1, instance=OWN, clock=20_000)


@pytest.mark.parametrize(
    ("lease", "now", "age"),
    [
        (LEASE, 20.0, 0.0),
        (LEASE, 21.5, 1.5),
        (LEASE, 320.0, 300.0),  # replayed, or held back
        (LEASE, 19.96, 0.0),  # within the rounding
        (LEASE, 19.0, None),  # of a time to come
        (replace(LEASE, instance=EARLIER), 20.0, None),
        (replace(LEASE, instance=b""), 20.0, None),
        (RunLease(id="goal", operator="anna", count=1), 20.0, None),  # of an older version
    ],
    ids=[
        "new",
        "late",
        "replayed",
        "rounded",
        "future",
        "earlier_life",
        "no_instance",
        "older_version",
    ],
)
def test_a_lease_counts_from_the_time_on_the_clock_of_its_robot(
    lease: RunLease, now: float, age: float | None
) -> None:
    found = lease_age(lease, OWN, now)
    assert found == (None if age is None else pytest.approx(age))


def test_each_version_reads_the_leases_of_the_other() -> None:
    """An older version has three fields, and ignores what follows them."""
    head = pack(TAG, LEASE)[: 4 + 1 + 8]
    older = encode(["goal", "anna", 7])
    payload = head + len(older).to_bytes(2, "big") + older
    assert unpack(TAG, payload) == RunLease(id="goal", operator="anna", count=7)
    assert unpack(TAG, pack(TAG, LEASE)) == LEASE
    body = pack(TAG, LEASE)[4 + 1 + 8 + 2 :]
    assert body[1:].startswith(older[1:-1])  # id and operator stand where they stood


def secured() -> VirtualNetwork:
    keyring = Keyring(("r1", "r2"), operators=("anna", "bob"), viewers=("class",))
    made = VirtualNetwork(2, keyring=keyring)
    made.is_tapped = True
    return made


def sent_to(network: VirtualNetwork, robot: str) -> RunLease:
    """A lease that the operator anna sends this robot now."""
    clock = round(1000.0 * network.now)
    return replace(LEASE, instance=network.robots[robot].peer._instance, clock=clock)


def ages(network: VirtualNetwork, robot: str) -> list[float | None]:
    """The ages of the leases that the robot has taken, rounded to 10 ms; and forgets them."""
    heard = network.robots[robot].leases
    found = [None if one.age is None else round(one.age, 2) for one in heard]
    heard.clear()
    return found


def test_a_recorded_lease_is_as_old_as_it_is_and_of_its_robot_alone() -> None:
    network = secured()
    network.send(sent_to(network, "r1"), "r1")
    network.run(0.05)
    [recorded] = [raw for _, body, raw, _ in network.tapped if isinstance(body, RunLease)]
    assert ages(network, "r1") == [pytest.approx(0.05, abs=0.06)]
    network.run(60.0)
    network.inject(recorded, OPERATOR)
    network.run(0.05)
    assert ages(network, "r1") == [pytest.approx(60.1, abs=0.1)]
    assert ages(network, "r2") == [None]
    network.add("r1")  # restarts
    network.run(5.0)
    network.inject(recorded, OPERATOR)
    network.run(0.05)
    assert ages(network, "r1") == [None]


@pytest.mark.parametrize("name", ["bob", "class", "r2"])
def test_nobody_renews_the_lease_of_another_operator(name: str) -> None:
    network = secured()
    assert network.keyring is not None
    payload = network.keyring.trust(name).signer.sign(pack(TAG, sent_to(network, "r1")))
    network.inject(payload, OPERATOR, "r1")
    network.run(0.05)
    assert ages(network, "r1") == []
    flaws = network.robots["r1"].flaws
    assert flaws[Flaw.FORGED] + flaws[Flaw.ROLE] == 1


def test_without_keys_each_lease_counts_as_new() -> None:
    network = VirtualNetwork(1)
    for lease in (LEASE, RunLease(id="goal", operator="anna", count=2)):
        network.send(lease, "r1")
        network.run(0.05)
    assert network.robots["r1"].leases == [
        HeardLease(LEASE, 0.0),
        HeardLease(RunLease(id="goal", operator="anna", count=2), 0.0),
    ]
