"""What facts of machines and robots mean."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core.finding import Finding, Level, unknown
from swarmd.core.machine import throttled
from swarmd.core.messages import Sandbox
from swarmd.core.verbs import DiskFacts, DoctorReply, MachineFacts, NetworkFacts, PortFacts
from swarmd.operator.cli.findings import HERE, Line, rows_of
from swarmd.operator.texts.doctor import (
    STEPS,
    identity,
    name,
    of_machine,
    of_network,
    of_robot,
    round_trip,
    worst,
)

NOW = 1.8e9
DAY = 86400.0
MACHINE = MachineFacts(
    host="pi",
    python="3.11.2",
    cores=4,
    load=0.5,
    memory=4_000_000_000,
    free_memory=2_000_000_000,
    wall=NOW,
    is_synced=True,
    disks=(DiskFacts(purpose="state", path="/s", free=9_000_000_000, size=10_000_000_000),),
)
NETWORK = NetworkFacts(
    interface="wlan0",
    exists=True,
    is_up=True,
    addresses=("10.0.0.5",),
    mtu=1500,
    has_multicast=True,
    is_wireless=True,
    ports=(PortFacts(protocol="tcp", port=7440, users=("this process",)),),
    firewall="open",
)
REPLY = DoctorReply(
    robot="r1",
    version="1.0",
    kernels="compiled",
    profile="field",
    machine=MACHINE,
    network=NETWORK,
    identity_expires=NOW + 40 * DAY,
    heard={"any": 2, "multicast": 2},
    sandbox=Sandbox(denied=("files", "network", "processes")),
)


def levels(findings: Iterable[Finding]) -> Mapping[str, Level]:
    return {one.subject: one.level for one in findings if one.level is not Level.OK}


def robot(reply: DoctorReply = REPLY, **seen: object) -> Mapping[str, Level]:
    known: dict[str, object] = {
        "skew": 0.1,
        "error": 0.01,
        "version": "1.0",
        "ways": ("multicast",),
        "others": 2,
        "now": NOW,
    }
    return levels(of_robot(reply, **(known | seen)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("bits", "level"),
    [
        ("0\n", Level.OK),
        ("50005\n", Level.WARNING),
        ("50000\n", Level.WARNING),
        ("e0008\n", Level.OK),
    ],
)
def test_the_under_voltage_of_a_raspberry_pi_is_a_warning(
    tmp_path: Path, bits: str, level: Level
) -> None:
    """The bits are those of Raspberry Pi's documentation of get_throttled: 0 now, 16 before."""
    file = tmp_path / "soc/soc:firmware/get_throttled"
    file.parent.mkdir(parents=True)
    file.write_text(bits)
    facts = replace(MACHINE, throttled=throttled(tmp_path))
    (power,) = (one for one in of_machine(facts) if one.subject == "power")
    assert power.level is level


def test_a_machine_without_that_firmware_has_no_finding_of_its_voltage(tmp_path: Path) -> None:
    assert throttled(tmp_path) is None
    assert "power" not in {one.subject for one in of_machine(MACHINE)}


def test_a_robot_in_order_has_no_finding() -> None:
    assert robot() == {}


@pytest.mark.parametrize(
    ("change", "subject", "level"),
    [
        ({"is_synced": False}, "clock", Level.WARNING),
        ({"is_synced": None}, "clock", Level.UNKNOWN),
        ({"wall": 100.0}, "clock", Level.WARNING),
        ({"load": 7.0}, "load", Level.WARNING),
        ({"free_memory": 50_000_000}, "memory", Level.WARNING),
        (
            {"disks": (DiskFacts(purpose="state", path="/s", fault="Read-only"),)},
            "state",
            Level.FAULT,
        ),
        (
            {"disks": (DiskFacts(purpose="recordings", path="/s", fault="full"),)},
            "recordings",
            Level.WARNING,
        ),
        (
            {"disks": (DiskFacts(purpose="recordings", path="/s", free=10**8, size=10**9),)},
            "recordings",
            Level.WARNING,
        ),
    ],
)
def test_each_fault_of_a_machine_is_found(
    change: dict[str, object], subject: str, level: Level
) -> None:
    assert levels(of_machine(replace(MACHINE, **change))) == {subject: level}


@pytest.mark.parametrize(
    ("change", "subject", "level"),
    [
        ({"exists": False}, "interface", Level.FAULT),
        ({"is_up": False}, "interface", Level.FAULT),
        ({"addresses": ()}, "interface", Level.FAULT),
        ({"mtu": 1280}, "mtu", Level.WARNING),
        ({"has_multicast": False}, "multicast", Level.WARNING),
        ({"firewall": "drops", "firewall_text": "udp drop"}, "firewall", Level.WARNING),
        ({"firewall": "unknown", "firewall_text": "not root"}, "firewall", Level.UNKNOWN),
        (
            {"ports": (PortFacts(protocol="tcp", port=7440, users=("nc (4)",)),)},
            "ports",
            Level.WARNING,
        ),
    ],
)
def test_each_fault_of_a_network_is_found(
    change: dict[str, object], subject: str, level: Level
) -> None:
    assert levels(of_network(replace(NETWORK, **change), is_robot=True)) == {subject: level}


@pytest.mark.parametrize(
    ("change", "subject", "level"),
    [
        ({"skew": -60.0}, "skew", Level.WARNING),
        ({"version": "2.0"}, "version", Level.WARNING),
        ({"ways": ()}, "heard here", Level.WARNING),
        ({"ways": ("unicast",)}, "heard here", Level.WARNING),
        ({"others": 3}, "hears", Level.WARNING),
    ],
)
def test_what_this_machine_sees_of_a_robot_is_judged(
    change: dict[str, object], subject: str, level: Level
) -> None:
    assert robot(REPLY, **change) == {subject: level}


def test_what_a_robot_tells_is_judged() -> None:
    assert robot(replace(REPLY, identity_expires=None)) == {"identity": Level.WARNING}
    assert robot(replace(REPLY, identity_expires=None, profile="dev")) == {}
    assert robot(replace(REPLY, heard={"any": 2, "unicast": 2})) == {"hears": Level.WARNING}
    assert robot(replace(REPLY, roster=3), roster=4) == {"roster": Level.WARNING}
    assert robot(replace(REPLY, storage="/s cannot be written")) == {"latches": Level.FAULT}
    open_host = Sandbox(denied=("network",), missing="files: no Landlock")
    assert robot(replace(REPLY, sandbox=open_host)) == {"pattern host": Level.WARNING}
    assert robot(replace(REPLY, sandbox=None)) == {"pattern host": Level.UNKNOWN}


def test_the_end_of_a_certificate_is_a_warning_and_then_a_fault() -> None:
    found = [identity(NOW + days * DAY, NOW) for days in (15.0, 13.0, -1.0)]
    assert [one.level for one in found] == [Level.OK, Level.WARNING, Level.FAULT]
    assert all(one.remedy for one in found[1:])
    assert worst(found) is Level.FAULT
    assert worst(found[:2]) is Level.WARNING
    assert worst([unknown("x", "")]) is Level.OK


def test_each_check_of_a_robot_belongs_to_a_step_of_the_acceptance_test() -> None:
    """docs/acceptance.md: A1 to A4 judge the name, keys, clock and computer, and its link."""
    disks = [replace(MACHINE.disks[0], purpose=purpose) for purpose in ("state", "recordings")]
    machine = replace(MACHINE, disks=tuple(disks), throttled=0)
    network = replace(NETWORK, has_multicast=False, mtu=1500)
    reply = replace(REPLY, machine=machine, network=network, storage="lost", roster=3)
    seen: dict[str, Any] = {"skew": 0.0, "error": 0.0, "version": "1.0", "ways": ()}
    found = [*of_robot(reply, **seen, others=2, now=NOW, roster=4), name(1), round_trip(0.1, 0.0)]
    assert {one.subject for one in found} == STEPS.keys() - {"answer"}
    rows = {"name": "A1", "clock": "A2", "power": "A3", "round trip": "A4", "answer": "A1"}
    assert {subject: STEPS[subject] for subject in rows} == rows


@pytest.mark.parametrize(
    ("found", "level"),
    [
        (name(1), Level.OK),
        (name(2), Level.FAULT),
        (round_trip(0.19, 0.19), Level.OK),
        (round_trip(0.21, 0.0), Level.WARNING),
        (round_trip(0.1, 0.21), Level.WARNING),
    ],
)
def test_a_second_daemon_is_a_fault_and_a_slow_link_a_warning(found: Finding, level: Level) -> None:
    assert found.level is level
    assert bool(found.remedy) is (level is not Level.OK)


def test_every_problem_says_what_to_do() -> None:
    bad = replace(MACHINE, is_synced=False, load=99.0, free_memory=0)
    down = replace(NETWORK, is_up=False, mtu=500, has_multicast=False, firewall="drops")
    found = [*of_machine(bad), *of_network(down, is_robot=True)]
    assert all(one.remedy for one in found if one.level in (Level.WARNING, Level.FAULT))


def test_the_worst_come_first_and_equal_ones_of_several_robots_are_one_row() -> None:
    full, busy = (
        Finding(what, False, "no room", is_minor=what == "load") for what in ("state", "load")
    )
    well = Finding("mtu", True, "1500")
    rows = {HERE: (well,), "r1": (well, busy, full), "r2": (well, busy), "r3": (busy,)}
    lines = [Line(where, one) for where, found in rows.items() for one in found]
    assert rows_of(lines, only_problems=False) == [
        ("fault", "r1", "state", "no room"),
        ("warning", "all 3 robots", "load", "no room"),
        ("ok", "this machine, r1, r2", "mtu", "1500"),
    ]
    assert [row[2] for row in rows_of(lines, only_problems=True)] == ["state", "load"]
