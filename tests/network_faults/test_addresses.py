"""Addresses and interfaces that come late, change, go and come back, under real daemons."""

from __future__ import annotations

import contextlib
import itertools
import re
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support import dhcp
from tests.support.dhcp import Dhcp
from tests.support.field import Field
from tests.support.field_swarm import FieldSwarm
from tests.support.processes import wait_until
from tests.support.swarmctl import STALLED

pytestmark = pytest.mark.integration

ROBOTS = ("r01", "r02", "r03")
LAPTOP = "laptop"
Made = Callable[..., FieldSwarm]


@pytest.fixture
def made(namespaces_permitted: None, tmp_path: Path, is_secured: bool) -> Iterator[Made]:
    """`made()`: robots on a bridge, which know no seeds, without daemons yet, and a laptop."""
    with contextlib.ExitStack() as left:

        def make(**options: Any) -> FieldSwarm:
            field = Field((*ROBOTS, LAPTOP), is_switched=False)
            left.callback(field.close)
            return left.enter_context(
                FieldSwarm(tmp_path, field, ROBOTS, options, is_secured=is_secured)
            )

        yield make


def logged(swarm: FieldSwarm, robot: str, words: str, times: int = 1) -> bool:
    """True if the log of a robot's daemon says this so often."""
    return len(re.findall(words, swarm.daemons[robot].text())) >= times


def await_log(swarm: FieldSwarm, robot: str, words: str, times: int = 1) -> None:
    wait_until(lambda: logged(swarm, robot, words, times), f"{robot} logs {words!r}")


def await_all(
    swarm: FieldSwarm, what: str, state: str, *robots: str, began: float | None = None
) -> None:
    """Wait until the laptop has the states of all robots, these in `state`.

    Prints the seconds since `began`, or since the call.
    """
    began = time.monotonic() if began is None else began
    wanted = dict.fromkeys(robots, state)
    seen: dict[str, str] = {}

    def look() -> bool:
        seen.clear()
        seen.update(swarm.states(LAPTOP))
        return seen.keys() == set(swarm.robots) and wanted.items() <= seen.items()

    try:
        wait_until(look, f"{what}: all found, {robots} {state}")
    finally:
        print(f"{what}: {seen} after {time.monotonic() - began:.1f} s")


def run_all(swarm: FieldSwarm) -> None:
    """All robots drive after one request, which is repeated while a stall makes any refuse it."""

    def run() -> bool:
        answer = swarm.ctl(LAPTOP, "run", "drive", "--all", "-o", "json")
        assert answer.json is not None, answer
        replies, applied = answer.json["replies"], set(answer.json["applied"])
        assert replies.keys() == set(swarm.robots), answer
        texts = [replies[robot]["text"] for robot in replies.keys() - applied]
        assert all(map(STALLED.search, texts)), answer
        assert answer.code == 0 or texts, answer
        return not texts

    wait_until(run, "all robots run drive")
    swarm.await_moving()


def no_ipv6(swarm: FieldSwarm, *hosts: str) -> None:
    for host in hosts:
        write = "echo 1 > /proc/sys/net/ipv6/conf/eth0/disable_ipv6"
        subprocess.run([*swarm.field.prefix(host), "sh", "-c", write], check=True)


def only_ipv6(swarm: FieldSwarm, *hosts: str) -> None:
    """Take the IPv4 addresses away; the kernel makes a link-local one as the link comes up."""
    for host in hosts:
        swarm.field.ip(host, "addr flush dev eth0", "link set eth0 down", "link set eth0 up")

    def is_done() -> bool:
        return all(read_addresses(swarm, host)[0].startswith("fe80") for host in hosts)

    wait_until(is_done, f"{hosts} have link-local addresses alone")


def read_addresses(swarm: FieldSwarm, host: str) -> list[str]:
    """The addresses of the host's eth0 that are in use; one empty text if there are none."""
    words = ["-o", "addr", "show", "dev", "eth0", "-tentative"]
    shown = subprocess.run(
        ["ip", "-n", swarm.field.namespace(host), *words],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return re.findall(r"inet6? ([0-9a-f.:]+)/", shown.stdout) or [""]


# DHCP


@pytest.fixture
def leases(made: Made, tmp_path: Path) -> Iterator[tuple[FieldSwarm, Dhcp]]:
    """A swarm of which r01 gets its address by DHCP; the laptop is the server."""
    if why := dhcp.lacks():
        pytest.skip(why)
    swarm = made()
    no_ipv6(swarm, "r01")
    swarm.field.ip("r01", "addr flush dev eth0")
    with Dhcp(tmp_path, swarm.field, LAPTOP) as server:
        yield swarm, server


def test_a_robot_with_a_new_address_stands_and_is_found_again(
    leases: tuple[FieldSwarm, Dhcp],
) -> None:
    swarm, server = leases
    server.offer("r01", "10.80.0.101")
    server.ask("r01")
    wait_until(lambda: read_addresses(swarm, "r01") == ["10.80.0.101"], "r01 has an address")
    swarm.start()
    await_all(swarm, "at first", "idle", *ROBOTS)

    server.offer("r01", "10.80.0.102")
    wait_until(lambda: read_addresses(swarm, "r01") == ["10.80.0.102"], "r01 has another address")
    began = time.monotonic()
    await_log(swarm, "r01", r"eth0: address changed: 10\.80\.0\.101 -> 10\.80\.0\.102")
    await_all(swarm, "new address while idle", "idle", "r01", began=began)
    run_all(swarm)

    server.offer("r01", "10.80.0.103")
    wait_until(lambda: read_addresses(swarm, "r01") == ["10.80.0.103"], "r01 has another address")
    began = time.monotonic()
    await_log(swarm, "r01", r"eth0: address changed: 10\.80\.0\.102 -> 10\.80\.0\.103")
    swarm.await_standing("r01")
    await_all(swarm, "new address while running", "stopped", "r01", began=began)
    shown = swarm.ctl(LAPTOP, "describe", "r01", "-o", "json")
    assert "network_changed" in shown.out, shown
    assert {"r02", "r03"} <= swarm.moved()  # the others drive on
    swarm.moved()
    assert "r01" not in swarm.moved()
    run_all(swarm)


def test_a_robot_that_starts_before_dhcp_is_found_with_its_first_address(
    leases: tuple[FieldSwarm, Dhcp], tmp_path: Path
) -> None:
    swarm, server = leases
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        swarm.spawn("r01", environ={"NOTIFY_SOCKET": str(tmp_path / "notify")}).wait_ready()
        swarm.start(("r02", "r03"))
        await_log(swarm, "r01", "eth0: no address yet")
        server.offer("r01", "10.80.0.101")
        server.ask("r01")
        wait_until(lambda: read_addresses(swarm, "r01") == ["10.80.0.101"], "it has an address")
        began = time.monotonic()
        await_all(swarm, "first address", "idle", "r01", began=began)
        await_log(swarm, "r01", r"eth0: up, 10\.80\.0\.101")
        told = [systemd.recv(200) for _ in range(3)]
    assert told == [b"READY=1", b"STATUS=eth0: no address yet", b"STATUS=eth0: up, 10.80.0.101"]
    assert "10.80.0.101" in swarm.ctl(LAPTOP, "describe", "r01").out
    run_all(swarm)
    assert swarm.ctl(LAPTOP, "estop").code == 0


# Links and interfaces


def test_a_robot_drives_on_while_its_link_is_down_and_is_found_when_it_is_up(made: Made) -> None:
    swarm = made()
    swarm.start()
    await_all(swarm, "at first", "idle", *ROBOTS)
    run_all(swarm)
    swarm.field.ip("r01", "link set eth0 down")
    await_log(swarm, "r01", "eth0: down")
    wait_until(
        lambda: swarm.members(LAPTOP).get("r01", {}).get("presence") == "failed", "r01 failed"
    )
    swarm.field.ip("r01", "link set eth0 up")
    await_log(swarm, "r01", r"eth0: up, 10\.80\.0\.1")
    await_all(swarm, "link up", "running", *ROBOTS)
    assert not logged(swarm, "r01", "address changed")
    swarm.moved()
    swarm.await_moving()
    assert swarm.ctl(LAPTOP, "stop").code == 0


def test_a_robot_whose_interface_comes_back_is_found_again(made: Made) -> None:
    swarm = made()
    swarm.start()
    await_all(swarm, "at first", "idle", *ROBOTS)
    run_all(swarm)
    swarm.field.ip("r01", "link del eth0")
    await_log(swarm, "r01", "eth0: absent")
    plug_in(swarm, "r01", "radio")
    await_log(swarm, "r01", "the network is open again")
    swarm.await_standing("r01")
    await_all(swarm, "interface back", "stopped", "r01")
    run_all(swarm)
    assert swarm.ctl(LAPTOP, "estop").code == 0


def plug_in(swarm: FieldSwarm, host: str, bridge: str, address: str = "") -> None:
    field = swarm.field
    field.ip(
        "hub",
        f"link add name {host} type veth peer name eth0 netns {field.namespace(host)}",
        f"link set dev {host} up master {bridge}",
    )
    field.ip(
        host,
        f"link set eth0 address {field.mac(host)}",
        f"addr add {address or field.address(host)}/24 dev eth0",
        "link set eth0 up",
    )


def test_a_swarm_without_ipv4_runs_stops_and_is_seen(made: Made) -> None:
    swarm = made()
    only_ipv6(swarm, *ROBOTS, LAPTOP)
    swarm.start()
    await_all(swarm, "by link-local addresses", "idle", *ROBOTS)
    run_all(swarm)
    assert swarm.ctl(LAPTOP, "stop").code == 0
    swarm.await_standing()
    assert swarm.ctl(LAPTOP, "estop").code == 0
    await_all(swarm, "after the estop", "estopped", *ROBOTS)


def test_robots_with_and_without_ipv4_are_one_swarm(made: Made) -> None:
    swarm = made()
    only_ipv6(swarm, "r01")
    swarm.start()
    await_all(swarm, "one without IPv4", "idle", *ROBOTS)
    run_all(swarm)
    assert swarm.ctl(LAPTOP, "estop").code == 0
    await_all(swarm, "after the estop", "estopped", *ROBOTS)


def test_a_swarm_stays_on_its_interface(made: Made) -> None:
    """All have a second network, on which a robot of the same swarm is alone."""
    swarm = made()
    field = swarm.field
    field.ip("hub", "link add second type bridge mcast_snooping 0", "link set second up")
    for number, host in enumerate((*ROBOTS, LAPTOP), 1):
        field.ip(
            "hub",
            f"link add name s-{host} type veth peer name eth1 netns {field.namespace(host)}",
            f"link set dev s-{host} up master second",
        )
        field.ip(host, f"addr add 10.81.0.{number}/24 dev eth1", "link set eth1 up")
    field.ip("r03", "link set eth0 down", "link set eth0 name eth2", "link set eth1 down",
             "link set eth1 name eth0", "link set eth0 up")  # fmt: skip
    swarm.start()
    found: dict[str, str] = {}

    def look() -> bool:
        found.update(swarm.states(LAPTOP))
        return found.keys() >= {"r01", "r02"}

    wait_until(look, "r01 and r02 are found")
    # A roster names all robots: with keys r03 is missing, without them it is not known.
    absent = [] if swarm.keys is None else ["r03"]
    run = swarm.ctl(LAPTOP, "run", "drive", "--all", "-o", "json")
    assert (run.json["applied"], run.json["missing"]) == (["r01", "r02"], absent), run
    swarm.await_moving("r01", "r02")
    assert "r03" not in swarm.states(LAPTOP)
    assert "r03" not in swarm.moved()
    estop = swarm.ctl(LAPTOP, "estop", "-o", "json")
    assert (estop.json["applied"], estop.json["missing"]) == (["r01", "r02"], absent), estop
    assert estop.code == (3 if absent else 0), estop
    assert swarm.members(LAPTOP).keys() == {"r01", "r02"}


def test_a_robot_that_roams_to_another_access_point_drives_on(made: Made) -> None:
    swarm = made()
    swarm.field.ip(
        "hub",
        "link add radio2 type bridge",
        "link set radio2 up",
        "link add name ab type veth peer name ba",
        "link set dev ab up master radio",
        "link set dev ba up master radio2",
    )
    swarm.start()
    await_all(swarm, "at first", "idle", *ROBOTS)
    run_all(swarm)
    for bridge in ("radio2", "radio", "radio2"):
        swarm.field.ip("hub", "link set dev r01 nomaster", f"link set dev r01 master {bridge}")
        await_all(swarm, f"roamed to {bridge}", "running", *ROBOTS)
    swarm.moved()
    swarm.await_moving()
    stop = swarm.ctl(LAPTOP, "stop")
    assert stop.code == 0, stop


# Clocks and suspends


def test_no_wall_clock_is_needed(made: Made, tmp_path: Path) -> None:
    """Each robot's wall clock is wrong by years, and leaps by years with each look."""
    (tmp_path / "clock").mkdir()
    (tmp_path / "clock" / "sitecustomize.py").write_text(
        "import itertools, os, time\n"
        "leaps = itertools.cycle((-20, 0, 30, -5))\n"
        "base = time.time\n"
        "time.time = lambda: base() + (next(leaps) + int(os.environ['YEARS'])) * 3.15e7\n"
        "time.time_ns = lambda: int(time.time() * 1e9)\n"
    )
    swarm = made()
    years = itertools.cycle((-30, 0, 40))
    for robot in ROBOTS:
        environ = {"PYTHONPATH": str(tmp_path / "clock"), "YEARS": str(next(years))}
        swarm.spawn(robot, environ=environ)
    for daemon in swarm.daemons.values():
        daemon.wait_ready()
    await_all(swarm, "clocks wrong by years", "idle", *ROBOTS)
    run_all(swarm)
    assert swarm.ctl(LAPTOP, "estop").code == 0
    await_all(swarm, "after the estop", "estopped", *ROBOTS)
    wait_until(lambda: swarm.ctl(LAPTOP, "reset", "--all", "--yes").code == 0, "all are reset")
    run_all(swarm)
    for daemon in swarm.daemons.values():
        years_of_lines = {line[:4] for line in daemon.text().splitlines()}
        assert len(years_of_lines) > 1, daemon.text()


def test_a_robot_that_was_suspended_stands_and_is_found_again(made: Made) -> None:
    swarm = made()
    swarm.start()
    await_all(swarm, "at first", "idle", *ROBOTS)
    run_all(swarm)
    swarm.daemons["r01"].freeze()
    wait_until(
        lambda: swarm.members(LAPTOP).get("r01", {}).get("presence") == "failed", "r01 failed"
    )
    swarm.daemons["r01"].thaw()
    swarm.await_standing("r01")
    await_all(swarm, "thawed", "stopped", "r01")
    assert {"r02", "r03"} <= swarm.moved()
    run_all(swarm)
