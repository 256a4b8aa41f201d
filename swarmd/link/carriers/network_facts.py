"""Facts of this machine's network for `doctor`: an interface, the ports of swarmd, packet filters.

Most facts are read from /proc and /sys. `nft` and `iptables-save` are started only as root, since
other users may not read their rules.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from swarmd.core.verbs import NetworkFacts, PortFacts
from swarmd.link.carriers.interface_watch import read_state
from swarmd.link.carriers.udp import GROUP_PORT

CONTROL_PORT = 7440
PORTS = (("tcp", CONTROL_PORT), ("udp", CONTROL_PORT), ("udp", GROUP_PORT))
_MULTICAST = 0x1000  # IFF_MULTICAST
_TOOL_TIMEOUT = 2.0  # s for nft or iptables-save
_LISTENING = {"tcp": "0A", "udp": "07"}
_MAX_USERS = 8
_DROPS = re.compile(r"\b(drop|reject)\b|policy drop|-j (DROP|REJECT)|^:(INPUT|OUTPUT) DROP")
_CONCERNS = re.compile(
    r"dport|udp|multicast|pkttype|policy|^:INPUT|-A INPUT|ct state invalid"
    r"|(?<![.\d])(22[4-9]|23\d)\.\d|\bff[0-9a-f]{2}:",  # groups of IPv4 and IPv6
    re.I,
)


def measure_network(interface: str) -> NetworkFacts:
    """The facts of an interface and of the ports; takes some ms, as root up to 4 s."""
    state = read_state(interface)
    folder = Path("/sys/class/net") / interface
    firewall, text = _firewall()
    flags = _number(folder / "flags")
    return NetworkFacts(
        interface=interface[:64],
        exists=state.exists,
        is_up=state.is_up,
        addresses=state.addresses[:32],
        mtu=_number(folder / "mtu"),
        has_multicast=None if flags is None else bool(flags & _MULTICAST),
        is_wireless=(folder / "wireless").exists() or (folder / "phy80211").exists(),
        ports=tuple(port_users(protocol, port) for protocol, port in PORTS),
        firewall=firewall,
        firewall_text=text[:1000],
    )


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text().strip(), 0)
    except (OSError, ValueError):
        return None


# Ports


def port_users(protocol: str, port: int) -> PortFacts:
    """The processes that listen on a port of this machine."""
    inodes = {
        inode
        for family in ("", "6")
        for inode in _sockets(Path(f"/proc/net/{protocol}{family}"), port, _LISTENING[protocol])
    }
    users = sorted(set(_owners(inodes))) if inodes else []
    return PortFacts(protocol=protocol, port=port, users=tuple(users[:_MAX_USERS]))


def _sockets(table: Path, port: int, state: str) -> Iterator[str]:
    """The inodes of sockets that listen on a port: columns as in proc(5)."""
    with suppress(OSError):
        for line in table.read_text().splitlines()[1:]:
            words = line.split()
            if int(words[1].rpartition(":")[2], 16) == port and words[3] == state:
                yield words[9]


def _owners(inodes: set[str]) -> Iterator[str]:
    """The processes that hold these sockets, such as `swarmd (412)`; `?`: not known."""
    left = {f"socket:[{inode}]" for inode in inodes}
    own = Path("/proc") / str(os.getpid())
    for process in (own, *Path("/proc").glob("[0-9]*")):
        if not left:
            return
        with suppress(OSError):  # it ended, or belongs to another user
            if held := left.intersection(_open_files(process / "fd")):
                left -= held
                name = (process / "comm").read_text().strip()
                yield "this process" if process == own else f"{name[:40]} ({process.name})"
    if left:
        yield "?"


def _open_files(folder: Path) -> Iterator[str]:
    for file in folder.iterdir():
        with suppress(OSError):  # it was closed
            yield os.readlink(file)


# Packet filters


def _firewall() -> tuple[str, str]:
    """`open`, `drops` or `unknown`, with the rules that drop, or why the rules are not known."""
    if os.geteuid() != 0:
        return "unknown", "only root may read the rules of nft and iptables"
    rules: list[str] = []
    asked = False
    for command in (("nft", "list", "ruleset"), ("iptables-save",)):
        if shutil.which(command[0]) is None:
            continue
        asked = True
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=_TOOL_TIMEOUT, check=False
            )
        except (OSError, subprocess.TimeoutExpired):
            return "unknown", f"{command[0]} gave no answer"
        if done.returncode:
            return "unknown", f"{command[0]}: {done.stderr.strip()[:200]}"
        rules += dropping_rules(done.stdout)
    if not asked:
        return "unknown", "neither nft nor iptables is installed"
    return ("drops", "; ".join(rules)) if rules else ("open", "")


def dropping_rules(text: str) -> list[str]:
    """The rules of `nft list ruleset` or `iptables-save` that may drop datagrams. Pure."""
    lines = (" ".join(line.split()) for line in text.splitlines())
    return [line for line in lines if _DROPS.search(line) and _CONCERNS.search(line)]
