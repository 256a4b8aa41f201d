"""Zenoh sessions by profile: `dev` stays on loopback, `field` on one named interface.

`SessionSettings` says what is wanted, `session_options` is what Zenoh is told (pure), and
`open_session` opens it and keeps vanished peers from stalling the others (`sockets.py`).
"""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import json
import re
import socket
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import zenoh

from swarmd.errors import ConfigError, NetworkError
from swarmd.keys import check_id
from swarmd.network.sockets import tune_sockets

MULTICAST_ADDRESS = "224.0.0.224"
FIRST_PORT = 7450
PORTS = 64
FIELD_PORT = 7440  # 7447, Zenoh's own, is that of the bridges and routers of ROS robots
MAX_WIRE = 1024 * 1024
_SIOCGIFFLAGS, _IFF_UP = 0x8913, 1  # linux/sockios.h, linux/if.h
# How long a full link may hold up the caller, in us: Zenoh's own 5 s would stall the guardian.
_BLOCKED_US = 250_000
# When dialling is given up. Zenoh 1.10 is not safe to interrupt there: an opening that its deadline
# meets between the last two steps leaves a link that one side never reads, and that side lacks the
# other's declarations for good (with 2000 in 1 to 2 % of heals, since address resolution repeats
# its questions every second, and none of 240 with this: a connection is made soon after 0, 1, 2
# or 3 s if at all).
_OPEN_MS = 4500
_BURST = 16  # batches, as many as Zenoh allows
_DROP_FRAGMENTS_US = 5_000
_ENDPOINT = re.compile(r"(tcp|tls|quic|udp)/(\[[0-9a-fA-F:.]+\]|[^/:#?\s]+):(\d{1,5})([?#]\S*)?")

Profile = Literal["dev", "field"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionSettings:
    """How to meet the swarm.

    `interface`: required in profile field, where nothing else is bound; dev uses `lo`.
    `listen`: Zenoh endpoints such as `tcp/10.0.0.5:7440`; empty means an ephemeral port on
    loopback (dev) or port 7440 on the interface (field).
    `seeds`: endpoints that are dialled, and again at least every second while they are away:
    the fast way back after a cut, and the only one with `multicast` off.
    `lease`: seconds without a sign of life after which a peer counts as gone; shorter notices
    sooner and tolerates less loss. None: 2 s in dev, 3 s in field.
    `wait_for_peers`: whether opening waits up to 0.5 s for a first peer to be found.
    """

    swarm: str
    profile: Profile = "dev"
    interface: str | None = None
    listen: tuple[str, ...] = ()
    seeds: tuple[str, ...] = ()
    multicast: bool = True
    lease: float | None = None
    wait_for_peers: bool = True

    @property
    def lease_seconds(self) -> float:
        """The lease in force, in s."""
        if self.lease is not None:
            return self.lease
        return 2.0 if self.profile == "dev" else 3.0

    @property
    def settle(self) -> float:
        """Seconds a claim of a robot id waits for rivals: what discovery takes, with margin."""
        return 0.1 if self.profile == "dev" else 1.0

    def as_operator(self) -> SessionSettings:
        """The same network for a visitor: any free port, and no waiting while opening."""
        anywhere = () if self.profile == "dev" else ("tcp/0.0.0.0:0",)
        return SessionSettings(
            swarm=self.swarm,
            profile=self.profile,
            interface=self.interface,
            listen=anywhere,
            seeds=self.seeds,
            multicast=self.multicast,
            lease=self.lease,
            wait_for_peers=False,
        )


def scouting_port(swarm: str) -> int:
    """The multicast port on which this swarm meets: one of 64, so that two seldom share it."""
    return FIRST_PORT + zlib.crc32(swarm.encode()) % PORTS


def session_options(settings: SessionSettings) -> dict[str, object]:
    """Zenoh's configuration, path to value; ConfigError names the setting that cannot be."""
    _check(settings)
    is_dev = settings.profile == "dev"
    interface = settings.interface or "lo"
    options: dict[str, object] = {
        "mode": "peer",
        "scouting/multicast/enabled": settings.multicast,
        "scouting/multicast/interface": interface,
        "scouting/multicast/address": f"{MULTICAST_ADDRESS}:{scouting_port(settings.swarm)}",
        "scouting/gossip/enabled": not is_dev or not settings.multicast,
        "listen/endpoints": _listen(settings, interface),
        "connect/endpoints": list(settings.seeds),
        "connect/retry": {
            "period_init_ms": 200,
            "period_max_ms": 1000,
            "period_increase_factor": 1.5,
        },
        "open/return_conditions/connect_scouted": settings.wait_for_peers,
        "transport/unicast/open_timeout": _OPEN_MS,
        "transport/unicast/accept_timeout": _OPEN_MS + 1000,
        "transport/link/tx/lease": round(settings.lease_seconds * 1000),
        "transport/link/tx/queue/congestion_control/block/wait_before_close": _BLOCKED_US,
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": (
            _DROP_FRAGMENTS_US
        ),
        # Requests and their acks never wait: without room for a burst some would be dropped.
        "transport/link/tx/queue/size/interactive_high": _BURST,
        "transport/link/tx/queue/size/real_time": _BURST,
        "transport/link/rx/max_message_size": MAX_WIRE,
        "transport/shared_memory/enabled": False,
    }
    return options


def open_session(settings: SessionSettings) -> zenoh.Session:
    """An open session; takes 2 to 500 ms. NetworkError says in one line why there is none."""
    options = session_options(settings)
    _check_interface(settings)
    session = open_with(options, what=f"swarm {settings.swarm!r}")
    tune_sockets(session, settings.lease_seconds)
    return session


def open_with(options: Mapping[str, object], what: str) -> zenoh.Session:
    """A session from Zenoh's own option paths; NetworkError names `what` it was for."""
    config = zenoh.Config()
    try:
        for path, value in options.items():
            config.insert_json5(path, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise NetworkError(f"no session for {what}: {_explain(str(error), options)}") from error


def undeclare(*entities: Any) -> None:
    """Undeclare tokens, subscribers, queryables, publishers; harmless once the session closed.

    `Any`, since Zenoh's own stubs leave `undeclare` without a return type.
    """
    for entity in entities:
        with contextlib.suppress(zenoh.ZError):
            entity.undeclare()


def _check(settings: SessionSettings) -> None:
    check_id(settings.swarm, "swarm")
    if settings.profile not in ("dev", "field"):
        raise ConfigError(f"profile is {settings.profile!r}; wanted is dev or field")
    if not 0.2 <= settings.lease_seconds <= 60.0:
        raise ConfigError(f"lease is {settings.lease_seconds:g} s; wanted are 0.2 to 60 s")
    for what, endpoints in (("listen", settings.listen), ("seeds", settings.seeds)):
        for endpoint in endpoints:
            _check_endpoint(what, endpoint)
    if settings.profile == "dev":
        _check_loopback(settings)
        return
    if settings.interface is None:
        raise ConfigError(
            "profile field needs `interface`: the name of the one network interface to use,"
            " such as wlan0"
        )
    if not settings.multicast and not settings.seeds:
        raise ConfigError(
            "profile field with multicast off needs `seeds`: endpoints of robots to dial,"
            " such as tcp/10.0.0.5:7440"
        )


def _check_endpoint(what: str, endpoint: str) -> None:
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or int(match[3]) > 65535:
        raise ConfigError(
            f"{what} has {endpoint!r}; wanted is an endpoint such as tcp/10.0.0.5:{FIELD_PORT}"
        )
    if what == "seeds" and int(match[3]) == 0:
        raise ConfigError(f"seeds has {endpoint!r}; a robot to dial needs its port")


def _check_loopback(settings: SessionSettings) -> None:
    for endpoint in (*settings.listen, *settings.seeds):
        match = _ENDPOINT.fullmatch(endpoint)
        if match is None or not _is_loopback(match[2].strip("[]")):
            raise ConfigError(
                f"profile dev stays on this machine, but {endpoint!r} is elsewhere;"
                " use profile field for a network"
            )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _listen(settings: SessionSettings, interface: str) -> list[str]:
    if settings.profile == "dev":
        return list(settings.listen) or ["tcp/127.0.0.1:0"]
    wanted = settings.listen or (f"tcp/0.0.0.0:{FIELD_PORT}",)
    return [one if "#" in one else f"{one}#iface={interface}" for one in wanted]


def _check_interface(settings: SessionSettings) -> None:
    interface = settings.interface or "lo"
    try:
        socket.if_nametoindex(interface)
    except OSError:
        known = ", ".join(sorted(name for _, name in socket.if_nameindex()))
        raise NetworkError(
            f"no network interface {interface!r} on this machine; there are: {known}"
        ) from None
    if interface == "lo" and not _is_up(interface):
        raise NetworkError(
            "the network interface lo is down, so that nothing on this machine can meet;"
            " run: sudo ip link set lo up"
        )


def _is_up(interface: str) -> bool:
    """The flag IFF_UP, asked of the kernel: /sys shows another network namespace's interfaces."""
    wanted = struct.pack("16sh14x", interface.encode(), 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        answer = fcntl.ioctl(asking, _SIOCGIFFLAGS, wanted)
    return bool(struct.unpack("16xh14x", answer)[0] & _IFF_UP)


def _explain(text: str, options: Mapping[str, object]) -> str:
    listen = options.get("listen/endpoints")
    where = ", ".join(listen) if isinstance(listen, list) and listen else "no endpoint"
    if "in use" in text:
        return f"{where} is in use on this machine; give this robot a `listen` of its own"
    if "assign requested address" in text:
        return f"{where} is not an address of this machine; correct `listen`"
    if "No such device" in text:
        return f"{where} names an interface that is not there; correct `interface`"
    if "ermission" in text or "not permitted" in text:
        return f"{where} may not be bound by this user; run with the right to, or change `listen`"
    brief = " ".join(re.sub(r" at /\S+", "", text).split())
    return f"{brief[:300]} (listening on {where})"
