"""Hosts in network namespaces on one Ethernet: a radio that can be delayed, lossy and cut.

Each host has `eth0` on the radio, and `wire0` on a clean second network to the namespace `hub`,
where the fake bodies are: what happens to the radio does not happen between a robot and its body.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from tests.support.forked import enter_network
from tests.support.switch import Traffic

ROOT = Path(__file__).parents[2]
BODIES = "10.99.0.1"  # the hub's address on the wire
_PLAIN = (
    "import sys; from tests.support.switch import switch_offloads_off\n"
    "for name in sys.argv[1:]: switch_offloads_off(name)"
)


def lacks() -> str:
    """Why there can be no field on this machine; empty if there can."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        return "network namespaces need the `ip` command and root"
    try:
        Field(("a",)).close()
    except subprocess.CalledProcessError as error:
        return f"network namespaces are not permitted here: {str(error.stderr).strip()}"
    return ""


class Field:
    """Namespaces of `hosts`, which see each other from the start; a context manager by `close`.

    The radio is a `Switch`, or with `is_switched` false a bridge of the kernel, which is faster
    and knows no rules. `neighbours` writes each host's address into the others' tables: those of
    all namespaces together have 1024 places for entries that are learned.
    """

    def __init__(
        self,
        hosts: Sequence[str],
        *,
        seed: int = 1,
        is_switched: bool = True,
        neighbours: bool = False,
    ) -> None:
        self.hosts = tuple(hosts)
        self._tag = secrets.token_hex(3)
        self._switch: subprocess.Popen[str] | None = None
        try:
            self._make(is_switched, seed, neighbours)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Take the namespaces away; processes in them have to be gone."""
        if self._switch is not None:
            with self._switch as process:
                process.communicate(timeout=60.0)
            self._switch = None
        there = os.listdir("/run/netns") if os.path.isdir("/run/netns") else ()
        mine = [name for name in there if name.startswith(self.namespace(""))]
        _ip(f"netns del {name}" for name in mine)

    def namespace(self, host: str) -> str:
        return f"swarmd-{self._tag}-{host}"

    def prefix(self, host: str) -> tuple[str, ...]:
        """What a command begins with that runs on a host, or on `hub`."""
        return ("ip", "netns", "exec", self.namespace(host))

    def address(self, host: str) -> str:
        """The host's address on the radio."""
        return f"10.80.0.{self.hosts.index(host) + 1}"

    def mac(self, host: str) -> str:
        """The link address of the host on the radio."""
        return f"02:00:00:00:00:{self.hosts.index(host) + 1:02x}"

    def ip(self, host: str, *lines: str) -> None:
        """Run lines of `ip` on a host, or on `hub`."""
        _ip(lines, self.namespace(host))

    def socket(self, host: str, port: int = 0) -> socket.socket:
        """A UDP socket of this process on a host, bound to `port` of every address."""
        with ThreadPoolExecutor(1) as pool:  # a thread may be in a namespace of its own
            return pool.submit(_socket_in, self.namespace(host), port).result()

    # The radio

    def set(self, *, source: str = "*", target: str = "*", **rule: Any) -> None:
        """Set fields of the `Rule` of one direction; of all directions without names."""
        self._change([{"from": source, "to": target, **rule}])

    def set_between(self, some: Iterable[str], others: Iterable[str], **rule: float | bool) -> None:
        """Set fields of the rules between two groups of hosts, both ways and at once."""
        pairs = [(a, b) for a in some for b in others if a != b]
        both = [*pairs, *((b, a) for a, b in pairs)]
        self._change([{"from": a, "to": b, **rule} for a, b in both])

    def split(self, *some: str) -> None:
        """Let nothing pass between these hosts and all others, and tell neither side."""
        self.set_between(some, set(self.hosts) - set(some), is_cut=True)

    def clear(self) -> None:
        """Every frame arrives at once, once and in order."""
        clean: dict[str, Any] = {
            "delay": 0.0,
            "jitter": 0.0,
            "loss": 0.0,
            "duplicate": 0.0,
            "reorder": 0.0,
        }
        self.set(**clean, is_cut=False)

    def heal(self) -> None:
        """End all cuts."""
        self.set(is_cut=False)

    def traffic(self) -> dict[str, Traffic]:
        """What each host has sent since the last call."""
        return {host: Traffic(**counted) for host, counted in self._ask({"count": True}).items()}

    def _change(self, changes: list[dict[str, Any]]) -> None:
        self._ask({"set": changes})

    def _ask(self, command: dict[str, Any]) -> Any:
        assert self._switch is not None, "a bridge of the kernel knows no rules"
        assert self._switch.stdin is not None
        self._switch.stdin.write(json.dumps(command) + "\n")
        self._switch.stdin.flush()
        return self._answer()

    def _answer(self) -> Any:
        assert self._switch is not None
        assert self._switch.stdout is not None
        line = self._switch.stdout.readline()
        assert line, f"the switch ended with {self._switch.wait(10.0)}"
        return json.loads(line)

    # The set-up

    def _make(self, is_switched: bool, seed: int, neighbours: bool) -> None:
        _ip(f"netns add {self.namespace(name)}" for name in ("hub", *self.hosts))
        hub = self.namespace("hub")
        wire = ["link set lo up", "link add wire type bridge", "link set wire up"]
        wire += [f"addr add {BODIES}/24 dev wire"]
        if not is_switched:
            wire += ["link add radio type bridge", "link set radio up"]
        for name in self.hosts:
            wire += [
                f"link add name {name} type veth peer name e-{name}",
                f"link add name w-{name} master wire type veth peer name wire0"
                f" netns {self.namespace(name)}",
                f"link set dev w-{name} up",
                f"link set dev {name} up promisc on" + (" " if is_switched else " master radio"),
            ]
        _ip(wire, hub)
        plain = [end for name in self.hosts for end in (name, f"e-{name}")]
        subprocess.run(
            [*self.prefix("hub"), sys.executable, "-c", _PLAIN, *plain], check=True, cwd=ROOT
        )
        moves = (
            f"link set dev e-{name} netns {self.namespace(name)} name eth0" for name in self.hosts
        )
        _ip(moves, hub)
        if is_switched:
            self._switch = subprocess.Popen(
                [*self.prefix("hub"), sys.executable, "-m", "tests.support.switch",
                 "--seed", str(seed), *self.hosts],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
            )  # fmt: skip
            self._answer()
        for number, name in enumerate(self.hosts, 1):
            lines = [
                "link set lo up",
                f"link set eth0 address {self.mac(name)}",
                f"addr add {self.address(name)}/24 dev eth0",
                "link set eth0 up",
                f"addr add 10.99.0.{number + 1}/24 dev wire0",
                "link set wire0 up",
            ]
            if neighbours:
                lines += [
                    f"neigh add {self.address(other)} lladdr 02:00:00:00:00:{at:02x} dev eth0"
                    " nud permanent"
                    for at, other in enumerate(self.hosts, 1)
                    if other != name
                ]
            _ip(lines, self.namespace(name))


def _socket_in(namespace: str, port: int) -> socket.socket:
    enter_network(namespace)
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("", port))
    return made


def _ip(lines: Iterable[str], namespace: str = "") -> None:
    """Run lines of `ip` in one process; CalledProcessError if any fails."""
    within = ("-n", namespace) if namespace else ()
    text = "\n".join(lines)
    subprocess.run(
        ["ip", *within, "-batch", "-"], input=text, check=True, capture_output=True, text=True
    )
