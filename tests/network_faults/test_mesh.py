"""A line of hosts that a routing daemon (babeld) joins: the ends reach each other by the middle."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.field import Field
from tests.support.field_swarm import FieldSwarm
from tests.support.processes import wait_until

ROBOTS = ("a", "b", "c")
pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(shutil.which("babeld") is None, reason="babeld is not installed"),
]


def address(host: str) -> str:
    """The host's address in the mesh."""
    return f"10.81.0.{ROBOTS.index(host) + 1}"


@contextlib.contextmanager
def routed(field: Field, host: str, folder: Path) -> Iterator[None]:
    """Run babeld on a host, which has its address in the mesh alone."""
    field.ip(host, "addr flush dev eth0 scope global", f"addr add {address(host)}/32 dev eth0")
    settings = ("ip_forward=1", "conf.all.send_redirects=0", "conf.all.rp_filter=0")
    for one in (*settings, "conf.eth0.send_redirects=0", "conf.eth0.rp_filter=0"):
        command = [*field.prefix(host), "sysctl", "-qw", f"net.ipv4.{one}"]
        subprocess.run(command, check=True)
    command = [
        *field.prefix(host), "babeld", "-H", "1", "-I", str(folder / f"{host}.pid"),
        "-S", str(folder / f"{host}.state"), "-c", "/dev/null",
        "-C", "redistribute local ip 10.81.0.0/24 allow", "-C", "redistribute local deny",
        "-C", "interface eth0 type wireless", "eth0",
    ]  # fmt: skip
    with (folder / f"{host}.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
    with process:
        try:
            yield
        finally:
            process.terminate()


def test_robots_out_of_each_others_radio_are_one_swarm_over_a_mesh(
    namespaces_permitted: None, is_secured: bool, tmp_path: Path
) -> None:
    with contextlib.ExitStack() as left:
        field = left.enter_context(contextlib.closing(Field(ROBOTS)))
        field.set_between(("a",), ("c",), is_cut=True)
        for host in ROBOTS:
            left.enter_context(routed(field, host, tmp_path))

        def has_route() -> bool:
            command = [*field.prefix("a"), "ip", "route", "show", address("c")]
            text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            return f"via {address('b')}" in text

        wait_until(has_route, "a route from a to c by b")
        seeds = [f"tcp/{address(host)}:7440" for host in ROBOTS]
        options: dict[str, object] = {"seeds": seeds}
        swarm = left.enter_context(
            FieldSwarm(tmp_path, field, ROBOTS, options, is_secured=is_secured)
        )
        swarm.start()
        words = [word for seed in seeds for word in ("--seed", seed)]

        def is_whole() -> bool:
            answer = swarm.ctl("a", *words, "members", "-o", "json").json
            members = [] if answer is None else answer["members"]
            # Alive by another's word is not enough: it may not be reachable from here yet.
            answered = [one for one in members if one["status"] is not None]
            return {one["robot"] for one in answered if one["presence"] == "alive"} == set(ROBOTS)

        wait_until(is_whole, "answers of all robots of the line, from one end")
        answer = swarm.ctl("a", *words, "run", "drive", "--all", "-o", "json")
        assert (answer.code, answer.json["missing"]) == (0, []), answer
        swarm.await_moving(*ROBOTS)
        answer = swarm.ctl("a", *words, "stop", "c")
        assert answer.code == 0, answer
        swarm.await_standing("c")
