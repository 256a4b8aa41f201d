"""The settings of a swarm's network: interface, profile, lease, seeds; and their checks.

No Zenoh: the schema of files needs them.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator
from typing import Annotated, Literal, NamedTuple

from msgspec import Meta, Struct

from swarmd.core.errors import ConfigError
from swarmd.core.keys import check_id

FIELD_PORT = 7440  # Zenoh's own 7447 belongs to the bridges and routers of ROS robots
MIN_LEASE = 0.2
MAX_LEASE = 60.0

Profile = Literal["dev", "field", "routed"]
DEFAULT_SWARM = "default"
ONLY_HERE = (
    "no other computer reaches this robot; for other robots and laptops give profile field and the"
    " interface"
)
"""What profile `dev` means for a robot that is not simulated."""
# The path of a setting, such as ("seeds", 0), and the text of its fault.
Fault = tuple[tuple[str | int, ...], str]

_ENDPOINT = (  # compiled by `re` at the first endpoint
    r"(tcp|tls|quic|udp)/(\[[0-9a-fA-F:.]+(?:%[\w.-]+)?\]|[^/:#?\s]+):(\d{1,5})([?#]\S*)?"
)


class Endpoint(NamedTuple):
    """A Zenoh endpoint such as `tcp/10.0.0.5:7440#iface=wlan0`; `host` without brackets."""

    protocol: str
    host: str
    port: int
    suffix: str

    @property
    def is_loopback(self) -> bool:
        """True if the host is this machine."""
        return is_loopback(self.host)


def is_loopback(host: str) -> bool:
    """True for `localhost` and for loopback addresses."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def parse_endpoint(
    text: str, prefix: str = "", example: str = f"tcp/10.0.0.5:{FIELD_PORT}"
) -> Endpoint:
    """The parts of an endpoint such as `tcp/10.0.0.5:7440`.

    Raises ConfigError for any other text; the message is `prefix`, the text, and `example`.
    """
    match = re.fullmatch(_ENDPOINT, text)
    if match is None or int(match[3]) > 65535:
        raise ConfigError(f"{prefix}{text!r}; expected an endpoint such as {example}")
    return Endpoint(match[1], match[2].strip("[]"), int(match[3]), match[4] or "")


class NetworkSettings(Struct, frozen=True, kw_only=True):
    """The settings by which a robot or operator reaches its swarm."""

    # The name of the swarm. Swarms with different names neither see nor command each other.
    swarm: str = DEFAULT_SWARM
    # dev: robots on this machine. field: robots on one interface, without routers. routed: all
    # traffic by Zenoh routers at the endpoints `routers`.
    profile: Profile = "dev"
    # Required in profile `field`, which uses only this interface; `dev` uses `lo`.
    interface: str | None = None
    # Endpoints such as `tcp/10.0.0.5:7440`. Empty means an ephemeral port on loopback (dev) or port
    # 7440 on the interface (field).
    listen: tuple[str, ...] = ()
    # Endpoints of robots to which datagrams also go one by one: the way through networks that drop
    # multicast and broadcast, and the only way with `multicast` off.
    seeds: tuple[str, ...] = ()
    # For routed: endpoints of Zenoh routers, such as `tcp/10.0.0.1:7447`.
    routers: tuple[str, ...] = ()
    # Robots find each other by multicast. False: by `seeds` alone.
    multicast: bool = True
    # Answer the scouts by which Zenoh programs find robots. None: yes in dev, and in field unless
    # the swarm is secured or `multicast` is off. A scout of 3 bytes draws an answer of 40 bytes or
    # more from each robot. Robots never scout themselves.
    discoverable: bool | None = None
    # Seconds without a sign of life after which a peer counts as gone. A shorter lease notices
    # sooner and tolerates less loss. None: 2 s in dev, 3 s in field.
    lease: Annotated[float, Meta(ge=MIN_LEASE, le=MAX_LEASE)] | None = None

    @property
    def lease_seconds(self) -> float:
        """The lease in force, in s."""
        if self.lease is not None:
            return self.lease
        return 2.0 if self.profile == "dev" else 3.0

    def answers_scouts(self, *, is_secured: bool) -> bool:
        """True if the robots of the swarm answer the scouts of Zenoh programs."""
        if self.profile == "routed":
            return False
        if self.discoverable is not None:
            return self.discoverable
        return self.profile == "dev" or (self.multicast and not is_secured)

    @property
    def settle(self) -> float:
        """Seconds for which a robot that claims its id waits for beacons of other claimers."""
        return 0.25 if self.profile == "dev" else 1.0

    @property
    def interface_name(self) -> str:
        """The network interface that carries all traffic."""
        return self.interface or "lo"

    def faults(self) -> Iterator[Fault]:
        """Each fault of the settings: the path of the wrong key, and the text of the fault.

        Empty if the settings are valid. A fault that concerns two keys stands at the key that the
        user should change.
        """
        # 1. Each key alone.
        try:
            check_id(self.swarm, "swarm")
        except ConfigError as error:
            yield ("swarm",), str(error)
        if self.profile not in ("dev", "field", "routed"):
            yield ("profile",), f"profile is {self.profile!r}; expected dev, field or routed"
        if not MIN_LEASE <= self.lease_seconds <= MAX_LEASE:
            yield ("lease",), f"lease is {self.lease_seconds:g} s; expected 0.2 to 60 s"
        lists = {"listen": self.listen, "seeds": self.seeds, "routers": self.routers}
        for key, endpoints in lists.items():
            for index, text in enumerate(endpoints):
                if fault := self._endpoint_fault(key, text):
                    yield (key, index), f"{key}[{index}] is {fault}"

        # 2. Keys that a profile needs or excludes.
        if self.profile == "field" and self.interface is None:
            yield (
                ("profile",),
                "profile field needs `interface`: the network interface to use, such as wlan0",
            )
        if self.profile == "routed" and self.discoverable:
            yield (
                ("discoverable",),
                "discoverable is true, but programs find the robots of profile routed by its"
                " routers; leave it out",
            )
        if self.profile == "routed" and not self.routers:
            yield (
                ("profile",),
                "profile routed needs `routers`: endpoints of Zenoh routers,"
                " such as tcp/10.0.0.1:7447",
            )
        if self.profile == "field" and not self.multicast and not self.seeds:
            yield (
                ("multicast",),
                "profile field with multicast off needs `seeds`: endpoints of robots to dial,"
                " such as tcp/10.0.0.5:7440",
            )
        if self.profile != "dev" and self.swarm == DEFAULT_SWARM:
            yield (
                ("swarm",),
                f"profile {self.profile} needs a name of its own for the swarm;"
                f" {DEFAULT_SWARM!r} would meet every other unnamed swarm of the network",
            )

    def check(self) -> None:
        """Raise ConfigError for the first fault."""
        for _, text in self.faults():
            raise ConfigError(text)

    def _endpoint_fault(self, key: str, text: str) -> str:
        """The fault of an endpoint in the list `key`; empty if the endpoint is valid."""
        try:
            endpoint = parse_endpoint(text)
        except ConfigError as error:
            return str(error)
        if key != "listen" and endpoint.port == 0:
            return f"{text!r}; an endpoint to dial needs its port"
        if self.profile == "dev" and not endpoint.is_loopback:
            return f"{text!r}, but profile dev stays on this machine; use profile field"
        return ""
