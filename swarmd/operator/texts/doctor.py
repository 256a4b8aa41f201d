"""Makes findings, each with the next step, from facts of machines and robots. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from swarmd.core.clock import FIRST_WALL
from swarmd.core.finding import Finding, Level, unknown, warning
from swarmd.core.verbs import DiskFacts, DoctorReply, MachineFacts, NetworkFacts
from swarmd.operator.texts.keys import end_of_certificate, life
from swarmd.operator.texts.values import sandbox_text

GOOD_MTU = 1400 + 28
"""The largest datagram with the heads of IPv4 and UDP; a smaller MTU makes fragments."""
MIN_FREE = {"state": 50_000_000, "recordings": 1_000_000_000}  # bytes
MIN_FREE_MEMORY = 100_000_000
MAX_LOAD = 1.5  # of each core
MAX_SKEW = 2.0  # s
EXPIRES_SOON = 14 * 86400.0
# s and share of a link on which stops come late
SLOW_TRIP = 0.2
MUCH_LOSS = 0.2
_PORT = 7440
# bits of vcgencmd get_throttled
_UNDER_VOLTAGE = 1 << 0
_UNDER_VOLTAGE_BEFORE = 1 << 16
THIS = "this process"
STEPS: Mapping[str, str] = {
    **dict.fromkeys(("answer", "name", "version", "identity", "roster", "latches"), "A1"),
    **dict.fromkeys(("pattern host", "python"), "A1"),
    **dict.fromkeys(("clock", "skew"), "A2"),
    **dict.fromkeys(("load", "memory", "state", "recordings", "power"), "A3"),
    **dict.fromkeys(("heard here", "hears", "round trip", "interface", "mtu"), "A4"),
    **dict.fromkeys(("multicast", "ports", "firewall"), "A4"),
}
"""The checks of a robot by their subject, with the step of the acceptance test that judges each."""


def of_machine(facts: MachineFacts) -> Iterator[Finding]:
    """Findings of clock, load, memory and disks."""
    if facts.wall < FIRST_WALL:
        remedy = "set the clock or connect a time source: certificates need it"
        yield warning("clock", "the clock has not been set", remedy)
    elif facts.is_synced is False:
        remedy = "systemctl enable --now systemd-timesyncd, or chrony"
        yield warning("clock", "not synchronised by NTP", remedy)
    else:
        text = "synchronised by NTP" if facts.is_synced else "whether NTP sets it is not known"
        yield Finding("clock", True, text, is_measured=facts.is_synced is not None)
    is_busy = facts.load > MAX_LOAD * facts.cores
    text = f"load {facts.load:.1f} on {facts.cores} cores"
    remedy = "find what takes the time: top, swarmctl members --wide"
    yield warning("load", text, remedy, is_due=is_busy)
    is_full = facts.free_memory < MIN_FREE_MEMORY
    text = f"{_size(facts.free_memory)} of {_size(facts.memory)} free"
    remedy = "end other programs: a pattern may need 256 MB"
    yield warning("memory", text, remedy, is_due=is_full)
    yield from map(_disk, facts.disks)
    if facts.throttled is not None:
        yield _power(facts.throttled)
    yield Finding("python", True, f"{facts.python} on {facts.host}")


def _power(throttled: int) -> Finding:
    """The finding of the voltage of a Raspberry Pi, by the bits of its firmware."""
    text = "no under-voltage since the start of the machine"
    if throttled & _UNDER_VOLTAGE_BEFORE:
        text = "under-voltage since the start of the machine"
    if throttled & _UNDER_VOLTAGE:
        text = "under-voltage now: the processor is slowed, and the machine may stop"
    is_due = bool(throttled & (_UNDER_VOLTAGE | _UNDER_VOLTAGE_BEFORE))
    remedy = (
        "charge the battery, or use a stronger supply and a shorter cable (vcgencmd get_throttled)"
    )
    return warning("power", text, remedy, is_due=is_due)


def _disk(disk: DiskFacts) -> Finding:
    if disk.fault:
        text = f"{disk.path} cannot be written ({disk.fault})"
        lost = "emergency stops" if disk.purpose == "state" else "recordings"
        remedy = f"free or remount the disk, or name another folder; {lost} would be lost"
        is_minor = disk.purpose != "state"
        return Finding(disk.purpose, False, text, remedy, is_minor=is_minor)
    is_low = disk.free < MIN_FREE.get(disk.purpose, 0)
    text = f"{_size(disk.free)} of {_size(disk.size)} free in {disk.path}"
    return warning(disk.purpose, text, "remove old recordings or other files", is_due=is_low)


def of_network(facts: NetworkFacts, *, is_robot: bool) -> Iterator[Finding]:
    """Findings of the interface, ports and packet filters.

    `is_robot`: the facts are those of a robot, whose port must be free for its daemon. An interface
    that is absent has no further findings.
    """
    name = facts.interface
    addresses = ", ".join(facts.addresses)
    if not facts.exists:
        yield Finding("interface", False, f"{name} is absent", "give another --interface")
        return
    if not facts.is_up:
        yield Finding("interface", False, f"{name} is down", f"ip link set {name} up")
    elif not facts.addresses:
        remedy = "wait for DHCP, or give it an address"
        yield Finding("interface", False, f"{name} has no address", remedy)
    else:
        kind = " (WiFi)" if facts.is_wireless else ""
        yield Finding("interface", True, f"{name}{kind}: up, {addresses}")
    if facts.mtu is not None:
        is_small = facts.mtu < GOOD_MTU
        remedy = f"ip link set {name} mtu 1500, if the network allows it"
        text = f"{facts.mtu}; large datagrams travel in fragments" if is_small else f"{facts.mtu}"
        yield warning("mtu", text, remedy, is_due=is_small)
    if facts.has_multicast is False and name != "lo":
        remedy = f"ip link set {name} multicast on; without it seeds are needed"
        yield warning("multicast", f"switched off on {name}", remedy)
    yield _ports(facts, is_robot=is_robot)
    yield _firewall(facts)


def _ports(facts: NetworkFacts, *, is_robot: bool) -> Finding:
    parts = [
        f"{port.protocol} {port.port} {'by ' + ', '.join(port.users) if port.users else 'free'}"
        for port in facts.ports
    ]
    foreign = [
        port for port in facts.ports if port.port == _PORT and port.users and THIS not in port.users
    ]
    if is_robot and foreign and facts.interface != "lo":  # there daemons take any free port
        remedy = f"end what uses {_PORT}, or name the robot's real port in seeds"
        return warning("ports", "; ".join(parts), remedy)
    return Finding("ports", True, "; ".join(parts))


def _firewall(facts: NetworkFacts) -> Finding:
    if facts.firewall == "drops":
        remedy = "allow udp 7440 and 7446, tcp 7440, and multicast to 224.0.0.226"
        return warning("firewall", f"may drop: {facts.firewall_text}", remedy)
    if facts.firewall == "open":
        return Finding("firewall", True, "no rule of nft or iptables drops")
    return unknown("firewall", f"not known: {facts.firewall_text}")


def name(daemons: int) -> Finding:
    """The finding of a name that so many daemons have."""
    if daemons <= 1:
        return Finding("name", True, "one daemon has this name")
    text = f"{daemons} daemons have this name"
    return Finding("name", False, text, "stop one of them, or give it another id")


def round_trip(seconds: float, loss: float) -> Finding:
    """The finding of the way to the robots and back, and of the share of datagrams that is lost."""
    text = f"{1e3 * seconds:.0f} ms, {loss:.0%} lost"
    is_due = seconds > SLOW_TRIP or loss > MUCH_LOSS
    return warning("round trip", text, "see swarmctl links; move the access point", is_due=is_due)


def of_robot(
    reply: DoctorReply,
    *,
    skew: float,
    error: float,
    version: str,
    ways: Sequence[str],
    others: int,
    now: float,
    roster: int | None = None,
) -> Iterator[Finding]:
    """The findings of a robot: its clock, version, identity, network, pattern host and machine.

    Args:
        reply: what the robot's daemon answered.
        skew: s, the robot's wall clock less that of this machine.
        error: s, the bound of the error of `skew`.
        version: the version of this swarmctl.
        ways: by which ways the robot's beacons reach this machine, such as `multicast`; may be
            empty.
        others: the number of other robots that are alive.
        now: s since 1970.
        roster: the generation of the roster on this machine; None: this machine has no roster.
    """
    # 1. Clock, software and keys.
    yield _skew(skew, error)
    if reply.version != version:
        text = f"{reply.version}, this swarmctl {version}"
        yield warning("version", text, "install the same version everywhere")
    else:
        yield Finding("version", True, f"{reply.version}; kernels: {reply.kernels}")
    yield _identity(reply, now)
    if roster is not None and reply.roster is not None and reply.roster != roster:
        text = f"it has roster {reply.roster}, this machine {roster}"
        yield warning("roster", text, "swarmctl keys push")

    # 2. The network between robot and machine, and between robots.
    yield _heard_here(ways, reply.profile)
    if reply.profile != "routed":  # with routers no datagram comes directly from a robot
        yield _hears(reply, others)

    # 3. The robot itself. `storage`: why a restart would lose latches (the state folder's fault).
    if reply.storage:
        remedy = "make the state folder writable, then repeat the estop; see docs/trouble.md"
        yield Finding("latches", False, reply.storage, remedy)
    yield _sandbox(reply)
    yield from of_machine(reply.machine)
    yield from of_network(reply.network, is_robot=True)


def _sandbox(reply: DoctorReply) -> Finding:
    if reply.sandbox is None:
        return unknown("pattern host", "it has not started yet")
    text = sandbox_text(reply.sandbox)
    if not reply.sandbox.missing:
        return Finding("pattern host", True, text)
    remedy = "a kernel with Landlock and seccomp; see docs/evidence/security.md"
    return warning("pattern host", text, remedy)


def _skew(skew: float, error: float) -> Finding:
    text = f"{abs(skew):.3f} s {'ahead of' if skew > 0 else 'behind'} this machine (+- {error:.3f})"
    if abs(skew) - error > MAX_SKEW:
        remedy = "synchronise both clocks; commands do not depend on them, certificates do"
        return warning("skew", text, remedy)
    return Finding("skew", True, text)


def _identity(reply: DoctorReply, now: float) -> Finding:
    if reply.identity_expires is None:
        if reply.profile == "dev":
            return Finding("identity", True, "none; profile dev needs none")
        remedy = "swarmctl keys init, then swarmd install BUNDLE; see docs/security.md"
        return warning("identity", "insecure: anyone may drive it", remedy)
    return identity(reply.identity_expires, now)


def identity(expires: float, now: float) -> Finding:
    """The finding of a certificate that ends at `expires`, in s since 1970."""
    left = expires - now
    if now < FIRST_WALL:
        remedy = "set the clock of this machine"
        return warning("identity", end_of_certificate(expires, now), remedy)
    remedy = "swarmctl keys renew"
    if left <= 0.0:
        return Finding("identity", False, f"its certificate ended {life(-left)} ago", remedy)
    text = f"its certificate ends in {life(left)}"
    return warning("identity", text, remedy, is_due=left < EXPIRES_SOON)


def _heard_here(ways: Sequence[str], profile: str) -> Finding:
    if profile == "routed":
        return Finding("heard here", True, "through routers")
    if "multicast" in ways:
        return Finding("heard here", True, f"by {', '.join(ways)}")
    if not ways:
        remedy = "look at firewalls, and at client isolation of the access point"
        return warning("heard here", "no beacon came while listening", remedy)
    remedy = "multicast is filtered: name robots as seeds, or allow it on the access point"
    return warning("heard here", f"by {', '.join(ways)} only", remedy)


def _hears(reply: DoctorReply, others: int) -> Finding:
    heard = reply.heard.get("any", 0)
    ways = ", ".join(f"{n} by {way}" for way, n in sorted(reply.heard.items()) if way != "any")
    text = f"{heard} of {others} other robots" + (f": {ways}" if ways else "")
    if heard < others:
        return warning("hears", text, "see swarmctl links")
    if heard and not reply.heard.get("multicast", 0):
        return warning("hears", text, "multicast is filtered: see swarmctl links")
    return Finding("hears", True, text)


def worst(findings: Iterable[Finding]) -> Level:
    """The worst level; `unknown` counts as ok."""
    levels = {finding.level for finding in findings}
    return next((level for level in (Level.FAULT, Level.WARNING) if level in levels), Level.OK)


def _size(value: int) -> str:
    return f"{value / 1e9:.1f} GB" if value >= 1e9 else f"{value / 1e6:.0f} MB"
