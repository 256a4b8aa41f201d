"""Keeps a peer that vanished from stalling the links to those that are still there.

Zenoh sets SO_LINGER to 10 s on its TCP sockets. When a lease expires with unacknowledged data,
close() then blocks one of the two receiving threads in the kernel, and the survivors hear nothing
from each other for up to 10 s (measured: 10.1 s with six of eight robots gone). Linux only, since
the sockets are found in /proc/self/fd; elsewhere nothing is tuned.

Zenoh sessions by profile: `dev` stays on loopback, `field` on one named interface.

`SessionSettings` says what is wanted, `session_options` is what Zenoh is told (pure), and
`open_session` opens it and keeps vanished peers from stalling the others (`sockets.py`).

Sessions that listen where their makers say: one endpoint, port 0 for a free one.

Opens a session without holding up the loop; apart from `session`, which swarmctl imports.

Opening a session without holding up the loop, and leaving none behind.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import ipaddress
import json
import os
import re
import socket
import struct
import sys
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

import zenoh

from swarmd.core.errors import ConfigError, NetworkError, SwarmError
from swarmd.core.keys import check_id

_FDS = "/proc/self/fd"
# Off: close() returns at once, and what is unsent is still delivered in the background. On with
# 0 s would cut off the last words of a daemon that leaves.
_NO_LINGER = struct.pack("ii", 0, 0)

Address = tuple[str, int]


def tune_sockets(session: zenoh.Session, lease: float) -> None:
    """Tune every link of the session, now and later, until it closes. `lease` in s."""
    if not sys.platform.startswith("linux"):
        return

    def on_link(event: zenoh.LinkEvent) -> None:
        # On a thread of its own, which Zenoh starts for this callback.
        if event.kind == zenoh.SampleKind.PUT:
            tune_link(event.link.src, event.link.dst, lease)

    session.info.declare_link_events_listener(on_link, history=True)


def tune_link(src: str, dst: str, lease: float) -> int:
    """Tune the sockets between two locators such as `tcp/127.0.0.1:7447`; says how many."""
    ends = {_address(src), _address(dst)}
    tuned = 0
    for sock in connected_sockets():
        with contextlib.suppress(OSError):  # closed meanwhile
            if _canonical(sock.getsockname()) in ends and _canonical(sock.getpeername()) in ends:
                _tune(sock, lease)
                tuned += 1
    return tuned


def connected_sockets() -> Iterator[socket.socket]:
    """This process's connected TCP sockets, each as a duplicate that is closed after its turn.

    The descriptors belong to other threads, which may close and reuse them at any moment: a
    duplicate stays what it is while it is looked at.
    """
    for name in os.listdir(_FDS):
        try:
            duplicate = _duplicate(int(name))
        except OSError:
            continue
        if duplicate is None:
            continue
        with duplicate:
            if _is_tcp(duplicate):
                yield duplicate


def _duplicate(fd: int) -> socket.socket | None:
    if not os.readlink(f"{_FDS}/{fd}").startswith("socket:"):
        return None
    copy = os.dup(fd)
    try:
        return socket.socket(fileno=copy)
    except OSError:
        os.close(copy)
        return None


def _is_tcp(sock: socket.socket) -> bool:
    if sock.family not in (socket.AF_INET, socket.AF_INET6) or sock.type != socket.SOCK_STREAM:
        return False
    try:
        sock.getpeername()
    except OSError:
        return False
    return True


def _tune(sock: socket.socket, lease: float) -> None:
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGER)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(lease * 1000))


def _address(locator: str) -> Address | None:
    host, _, port = locator.partition("/")[2].partition("#")[0].partition("?")[0].rpartition(":")
    return _canonical((host.strip("[]"), int(port))) if port.isdecimal() else None


def _canonical(name: object) -> Address | None:
    if not isinstance(name, tuple) or len(name) < 2:
        return None
    try:
        address = ipaddress.ip_address(str(name[0]).partition("%")[0])
    except ValueError:
        return None
    mapped = getattr(address, "ipv4_mapped", None)
    return str(mapped or address), int(name[1])


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


_TRIES = 5
_LISTEN_ENDPOINT = re.compile(r"tcp/([^:]+|\[[^]]+\]):(\d+)")


def open_listening(
    endpoint: str, options: Mapping[str, object], what: str
) -> tuple[zenoh.Session, str]:
    """A session with Zenoh's own option paths that listens at `endpoint`, and where that is.

    NetworkError names `what` it was for if the endpoint cannot be had, ConfigError if it is none.
    """
    match = _LISTEN_ENDPOINT.fullmatch(endpoint)
    if match is None or int(match[2]) > 65535:
        raise ConfigError(f"endpoint is {endpoint!r}; wanted is such as tcp/127.0.0.1:0")
    if int(match[2]):
        return open_with({**options, "listen/endpoints": [endpoint]}, what), endpoint
    for _ in range(_TRIES):
        chosen = f"tcp/{match[1]}:{_free_port(match[1].strip('[]'), what)}"
        try:
            return open_with({**options, "listen/endpoints": [chosen]}, what), chosen
        except NetworkError:  # another took it in between
            continue
    raise NetworkError(f"no free port for {what} at {endpoint}")


def _free_port(host: str, what: str) -> int:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        try:
            probe.bind((host, 0))
        except OSError as error:
            raise SwarmError(f"no port at {host} for {what}: {error}") from error
        return int(probe.getsockname()[1])


async def opened_session(settings: SessionSettings) -> zenoh.Session:
    """`open_session` in a thread; closed again if nobody waits for it any more."""
    opening = asyncio.ensure_future(asyncio.to_thread(open_session, settings))
    try:
        return await asyncio.shield(opening)
    except asyncio.CancelledError:
        (await opening).close()
        raise


S = TypeVar("S", bound=zenoh.Session | None)


async def opened(open_it: Callable[[], S]) -> S:
    """What `open_it` gives, called in a thread; closed at once if nobody waits for it any more.

    Even if the loop ends meanwhile: a session that is left open would keep the process alive.
    """
    opening = _Opening(open_it)
    try:
        return await asyncio.to_thread(opening.run)
    except asyncio.CancelledError:
        opening.abandon()
        raise


class _Opening(Generic[S]):
    def __init__(self, open_it: Callable[[], S]) -> None:
        self._open, self._lock = open_it, threading.Lock()
        self._found: S | None = None
        self._is_abandoned = False

    def run(self) -> S:
        found = self._open()
        with self._lock:
            self._found = found
            if self._is_abandoned:
                _close(found)
        return found

    def abandon(self) -> None:
        with self._lock:
            self._is_abandoned = True
            _close(self._found)


def _close(session: zenoh.Session | None) -> None:
    if session is not None:
        session.close()
