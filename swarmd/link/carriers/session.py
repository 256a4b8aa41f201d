"""Opens Zenoh sessions: for a swarm by its profile, and others from Zenoh's own options.

Each session of a swarm tunes the sockets of its links, so that a peer that vanished does not stall
the links to the other peers. Zenoh sets SO_LINGER to 10 s on its TCP sockets. When the lease of a
vanished peer expires with unacknowledged data, close() blocks one of Zenoh's two receiving threads.
The remaining peers then receive nothing for up to 10 s. Measured: 10.1 s with six of eight robots
gone. Linux only, since the sockets are found in /proc/self/fd; elsewhere nothing is tuned.

swarmctl imports this module and must start fast, so asyncio is imported where it is used.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import re
import socket
import struct
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import zenoh
from msgspec.structs import replace
from zenoh.handlers import Callback

from swarmd.core.closing import is_program_ended
from swarmd.core.errors import ConfigError, NetworkError, SwarmError
from swarmd.link.access import asker_access, robot_access
from swarmd.link.carriers.forked import check_not_forked
from swarmd.link.carriers.interface_watch import flags_of, index_of
from swarmd.link.settings import FIELD_PORT, NetworkSettings, parse_endpoint

MAX_WIRE = 1024 * 1024
MAX_PORT_TRIES = 5
PULL_LINK_TIMEOUT = 3.0  # s
# us for which a full link may block the sender: Zenoh's default of 5 s would stall the daemon.
_MAX_BLOCK_US = 250_000
# ms for dialling: TCP's handshake and two round trips of Zenoh, on a network that loses packets.
# The timeout of the accepting side is _ACCEPT_MARGIN_MS longer: if it ended an opening between the
# last two steps, the dialling side would keep a link that the accepting side never reads, and would
# lack the declarations of the accepting side for good.
_OPEN_TIMEOUT_MS = 9000
_ACCEPT_MARGIN_MS = 1000
_MAX_PENDING_LINKS = 512  # connections without a handshake; Zenoh's default of 100 is soon used up
_MAX_BATCHES = 16  # the most that Zenoh allows
_FRAGMENT_TIMEOUT_US = 5_000
_IFF_UP = 1  # linux/if.h
_SYN_SENT = 2  # netinet/tcp.h
FDS = "/proc/self/fd"
# SO_LINGER off: close() returns at once, and the kernel still delivers unsent data. SO_LINGER on
# with 0 s would discard the last messages of a daemon that leaves.
_NO_LINGER = struct.pack("ii", 0, 0)

if TYPE_CHECKING:
    from concurrent.futures import Future

    from swarmd.link.keys.identity import Identity


Address = tuple[str, int]
S = TypeVar("S", bound=zenoh.Session | None)
T = TypeVar("T")


def open_session(
    settings: NetworkSettings, identity: Identity | None = None, *, late: Sequence[str] = ()
) -> zenoh.Session:
    """Open the session of a daemon, which listens and opens no connection itself.

    `late`: IPv4 addresses that the interface got after the first session of this process. Zenoh
    reads the addresses of interfaces once per process, and uses a late address only if the options
    name the address. Zenoh programs find the session by scouting on late addresses. Without an
    `identity` the session also listens there. Raises NetworkError in one line if the session cannot
    be opened.
    """
    options = session_options(settings, identity)
    if late:
        options["scouting/multicast/interface"] = ",".join(late)
        if identity is None:  # `LinkGate` guards only the port of `listen` of a secured robot
            more = tuple(f"tcp/{address}:0" for address in late)
            options["listen/endpoints"] = _listen(replace(settings, listen=settings.listen + more))
    return _open(settings, options)


def open_operator_session(
    settings: NetworkSettings, endpoints: Sequence[str], identity: Identity | None = None
) -> zenoh.Session:
    """Open a session that dials `endpoints` in the background; takes about 1 ms.

    Zenoh dials all endpoints at the same time, and again while the session is open. No endpoint can
    be added: robots that are found later need a further session. Raises NetworkError in one line if
    the session cannot be opened.
    """
    return _open(settings, operator_options(settings, endpoints, identity))


def open_pull_session(
    settings: NetworkSettings, address: Address, identity: Identity | None = None
) -> zenoh.Session:
    """Open a session to one peer, or to the routers; returns once it is linked.

    Raises NetworkError in one line, at the latest after PULL_LINK_TIMEOUT.
    """
    host, port = address
    endpoint = f"tcp/[{host}]:{port}" if ":" in host else f"tcp/{host}:{port}"
    options = {
        **operator_options(settings, [endpoint], identity),
        "mode": "client",
        "connect/timeout_ms": round(1000 * PULL_LINK_TIMEOUT),
        "connect/exit_on_failure": True,
    }
    return _open(settings, options)


def _open(settings: NetworkSettings, options: dict[str, object]) -> zenoh.Session:
    if settings.profile != "routed":
        check_interface(settings.interface_name)
    connect = options["connect/endpoints"]
    assert isinstance(connect, list)
    options = {**options, "connect/endpoints": [_dialled(endpoint) for endpoint in connect]}
    session = open_with(options, what=f"swarm {settings.swarm!r}")
    tune_sockets(session, settings.lease_seconds)
    return session


_SCOUTING: Mapping[str, object] = {
    "scouting/multicast/enabled": True,
    "scouting/multicast/listen": True,
}
PROMPT_OPTIONS: Mapping[str, object] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    # Sending never waits. Without room for a burst Zenoh would drop the newest message, which may
    # be a zero command.
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    "transport/link/tx/queue/size/real_time": 16,
    "transport/shared_memory/enabled": False,
}
"""Options of a session to one endpoint, which drops messages that cannot be sent at once."""


def open_with(options: Mapping[str, object], what: str) -> zenoh.Session:
    """Open a session with Zenoh's options, path to value.

    Raises NetworkError, whose text names `what` the session is for. Raises ForkedError in a process
    that was forked after its parent opened a session. Raises SwarmError once the main thread has
    ended: nothing would close the session before Python ends.
    """
    check_not_forked(f"no session for {what}")
    if is_program_ended():
        raise SwarmError(f"no session for {what}: the main thread of this program has ended")
    config = zenoh.Config()
    try:
        for path, value in options.items():
            config.insert_json5(path, msgspec.json.encode(value).decode())
        return zenoh.open(config)
    except (zenoh.ZError, UnicodeEncodeError) as error:  # a path may be no UTF-8
        raise NetworkError(f"no session for {what}: {_explain(str(error), options)}") from error


def open_listening(
    endpoint: str, options: Mapping[str, object], what: str
) -> tuple[zenoh.Session, str]:
    """Open a session that listens at a TCP endpoint; returns the session and its endpoint.

    Port 0 takes a free port. `what` names the session in errors. Raises NetworkError if the
    endpoint cannot be bound, ConfigError if its text is malformed.
    """
    try:
        protocol, host, port, suffix = parse_endpoint(endpoint)
    except ConfigError as error:
        raise ConfigError(f"endpoint is {error}") from error
    if protocol != "tcp" or suffix:
        raise ConfigError(f"endpoint is {endpoint!r}; expected a value such as tcp/127.0.0.1:0")
    if port:
        return open_with({**options, "listen/endpoints": [endpoint]}, what), endpoint
    for _ in range(MAX_PORT_TRIES):
        chosen = f"{endpoint.removesuffix('0')}{_free_port(host, what)}"
        try:
            return open_with({**options, "listen/endpoints": [chosen]}, what), chosen
        except NetworkError:  # another process took the port in between
            continue
    raise NetworkError(f"no free port for {what} at {endpoint}")


async def open_in_thread(open_it: Callable[[], S]) -> S:
    """Call `open_it` in a thread; returns the session that it opens.

    If the caller is cancelled meanwhile, the session is closed as soon as it is open, even if the
    loop has ended by then: an open session would keep the process alive.
    """
    import asyncio  # 22 ms of a start of swarmctl, which has no loop
    from concurrent.futures import Future

    opened: Future[S] = Future()

    def run() -> S:
        session = open_it()
        opened.set_result(session)
        return session

    try:
        return await asyncio.to_thread(run)
    except asyncio.CancelledError:
        opened.add_done_callback(_close)
        raise


def on_thread(handler: Callable[[T], object]) -> Callback[T]:
    """A callback that hands each item to `handler` on a daemon thread; see `batches_on_thread`.

    An error of the handler is logged; the next item follows.
    """

    def work(items: list[T]) -> None:
        for item in items:
            try:
                handler(item)
            except Exception:  # an item of the network may make a handler raise anything
                import logging  # 3 ms of the start of a command

                logging.getLogger(__name__).exception("an item from Zenoh was dropped")

    return batches_on_thread(work)


def batches_on_thread(work: Callable[[list[T]], object]) -> Callback[T]:
    """A callback that hands all that came to `work`, on a daemon thread, until it is undeclared.

    Python waits for the thread that Zenoh makes for a plain callback: a script that leaves a
    session open would never end. `work` must not call Zenoh: Python aborts if it ends while a
    daemon thread is inside such a call (`FATAL: exception not rethrown`).
    """
    queue: SimpleQueue[T | None] = SimpleQueue()  # None, once undeclared, is the last

    def run() -> None:
        is_declared = True
        while is_declared:
            items = [queue.get()]
            items += [queue.get() for _ in range(queue.qsize())]
            is_declared = items[-1] is not None
            work([item for item in items if item is not None])

    threading.Thread(target=run, name="swarmd-zenoh", daemon=True).start()
    return Callback(queue.put, lambda: queue.put(None), indirect=False)


def realtime_publisher(session: zenoh.Session, key: str, **options: Any) -> zenoh.Publisher:
    """A publisher that never waits and has the highest priority."""
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
        **options,
    )


def has_subscriber(publisher: zenoh.Publisher) -> bool:
    """True if another session subscribes to its key."""
    # The stubs call it a bool; it is an object with that attribute.
    return bool(getattr(publisher.matching_status, "matching", False))


def has_queryable(querier: zenoh.Querier) -> bool:
    """True if another session answers queries on its key."""
    return bool(getattr(querier.matching_status, "matching", False))


def undeclare(*entities: Any) -> None:
    """Undeclare tokens, subscribers, queryables, publishers; harmless once the session closed."""
    for entity in entities:
        with contextlib.suppress(zenoh.ZError):
            entity.undeclare()


def session_options(
    settings: NetworkSettings, identity: Identity | None = None
) -> dict[str, object]:
    """Zenoh's configuration of a daemon, path to value. Raises ConfigError for wrong settings."""
    if settings.profile == "routed":
        return _options(settings, "client", (), settings.routers, identity)
    options = _options(settings, "peer", _listen(settings), (), identity)
    if settings.answers_scouts(is_secured=identity is not None):
        # The daemon answers scouts and opens no connection: without a scout it sends no packet.
        options |= {
            **_SCOUTING,
            "scouting/multicast/autoconnect": [],
            "scouting/multicast/interface": settings.interface_name,
        }
    if identity is not None:
        options["access_control"] = robot_access(identity.roster, identity.name)
    return options


def operator_options(
    settings: NetworkSettings, endpoints: Sequence[str], identity: Identity | None = None
) -> dict[str, object]:
    """Zenoh's configuration of an operator; dials `endpoints`, or the routers in profile `routed`.

    Raises ConfigError for wrong settings.
    """
    if settings.profile == "routed":
        return _options(settings, "client", (), settings.routers, identity)
    options = _options(settings, "peer", (), endpoints, identity)
    if identity is not None:
        options["access_control"] = asker_access(identity.roster, identity.name)
    return options


def foreign_options(
    settings: NetworkSettings,
    endpoints: Sequence[str],
    identity: Identity | None = None,
    *,
    scouts: bool = False,
) -> dict[str, Any]:
    """The options of an operator's session, as a nested configuration for another Zenoh program.

    `endpoints`: robots or routers that the program dials. `scouts`: the program also finds the
    robots by multicast. Sizes and timeouts of links are left out, so that Zenoh's defaults hold.
    Raises ConfigError for wrong settings.
    """
    options = operator_options(settings, endpoints, identity)
    if scouts:
        options |= {
            **_SCOUTING,
            "scouting/multicast/autoconnect": ["router", "peer"],
            "scouting/multicast/interface": settings.interface_name,
            "open/return_conditions/connect_scouted": True,
        }
    sizes_and_timeouts = ("transport/unicast", "transport/link/tx", "transport/link/rx")
    return nested_options(
        {path: x for path, x in options.items() if not path.startswith(sizes_and_timeouts)}
    )


def nested_options(options: Mapping[str, object]) -> dict[str, Any]:
    """Options by path as Zenoh's files have them: `a/b/c` becomes {"a": {"b": {"c": value}}}."""
    nested: dict[str, Any] = {}
    for path, value in options.items():
        *section_names, name = path.split("/")
        section = nested
        for section_name in section_names:
            section = section.setdefault(section_name, {})
        section[name] = value
    return nested


def tls_options(identity: Identity) -> dict[str, object]:
    """The options of TLS links on which both ends show a certificate of the swarm's authority.

    The names in the certificates are not compared with addresses, since robots change addresses.
    Access rules compare the names with keys. A link ends when a certificate expires.
    """
    certificate = str(identity.certificate)
    key = str(identity.key)
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls": {
            "root_ca_certificate": str(identity.authority),
            "listen_certificate": certificate,
            "listen_private_key": key,
            "connect_certificate": certificate,
            "connect_private_key": key,
            "enable_mtls": True,
            "verify_name_on_connect": False,
            "close_link_on_expiration": True,
        },
    }


def _secured(endpoints: Sequence[str]) -> list[str]:
    """The endpoints with TLS in place of TCP. Raises ConfigError for another protocol."""
    made = []
    for text in endpoints:
        if not text.startswith(("tcp/", "tls/")):
            raise ConfigError(f"{text!r}; a secured swarm expects an endpoint tls/HOST:PORT")
        made.append(f"tls/{text[4:]}")
    return made


def _dialled(endpoint: str) -> str:
    """The endpoint to dial; for TLS to an IPv6 address a forwarder on loopback."""
    if not endpoint.startswith("tls/["):
        return endpoint
    _, host, port, _ = parse_endpoint(endpoint)
    from swarmd.link.carriers.ipv6_forward import forward_to  # loads asyncio

    return f"tls/127.0.0.1:{forward_to(host, port)}"


def _options(
    settings: NetworkSettings,
    mode: str,
    listen: Sequence[str],
    connect: Sequence[str],
    identity: Identity | None,
) -> dict[str, object]:
    """Zenoh's options of a session, each with its path as key; ConfigError for wrong settings.

    `mode`: Zenoh's "peer" or "client". `listen`, `connect`: endpoints; with an `identity` TCP
    endpoints become TLS endpoints, and other protocols are refused. The session finds nothing
    itself: scouting and gossip are off.
    """
    settings.check()
    if identity is not None:
        listen = _secured(listen)
        connect = _secured(connect)
    return {
        **({} if identity is None else tls_options(identity)),
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": list(listen),
        **_dial_options(mode, connect),
        "transport/unicast/open_timeout": _OPEN_TIMEOUT_MS,
        "transport/unicast/accept_timeout": _OPEN_TIMEOUT_MS + _ACCEPT_MARGIN_MS,
        "transport/unicast/accept_pending": _MAX_PENDING_LINKS,
        "transport/link/tx/lease": round(settings.lease_seconds * 1000),
        "transport/link/tx/queue/congestion_control/block/wait_before_close": _MAX_BLOCK_US,
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": (
            _FRAGMENT_TIMEOUT_US
        ),
        # Requests and their replies never wait: without room for a burst Zenoh would drop some.
        "transport/link/tx/queue/size/interactive_high": _MAX_BATCHES,
        "transport/link/tx/queue/size/real_time": _MAX_BATCHES,
        "transport/link/rx/max_message_size": MAX_WIRE,
        "transport/shared_memory/enabled": False,
    }


def _dial_options(mode: str, connect: Sequence[str]) -> dict[str, object]:
    """The options by which a session dials the endpoints `connect`, again and again.

    A peer dials all endpoints at the same time, without end (timeout -1). With the timeout 0 a peer
    would dial one endpoint after the other. A client has the timeout 0: with any other timeout it
    would dial its first router until this router answers, and never try the further routers.
    """
    return {
        "connect/endpoints": list(connect),
        "connect/timeout_ms": 0 if mode == "client" else -1,
        "connect/exit_on_failure": False,
        "connect/retry": {
            "period_init_ms": 200,
            "period_max_ms": 1000,
            "period_increase_factor": 1.5,
        },
        "open/return_conditions/connect_scouted": False,
    }


def default_listen(settings: NetworkSettings) -> str:
    """The endpoint of a daemon without `listen`: loopback, or all IPv4 and IPv6 addresses."""
    if settings.profile == "dev":
        return "tcp/127.0.0.1:0"
    try:
        socket.socket(socket.AF_INET6, socket.SOCK_STREAM).close()
    except OSError:  # a kernel without IPv6
        return f"tcp/0.0.0.0:{FIELD_PORT}"
    return f"tcp/[::]:{FIELD_PORT}"


def _listen(settings: NetworkSettings) -> list[str]:
    wanted = settings.listen or (default_listen(settings),)
    if settings.profile == "dev":
        return list(wanted)
    suffix = f"#iface={settings.interface_name}"
    return [endpoint if "#" in endpoint else endpoint + suffix for endpoint in wanted]


def check_interface(interface: str) -> None:
    """Raise NetworkError in one line if the interface is absent, or loopback is down."""
    index_of(interface)
    if interface == "lo" and not flags_of(interface) & _IFF_UP:
        raise NetworkError(
            "the network interface lo is down, so that nothing on this machine can meet;"
            " run: sudo ip link set lo up"
        )


def _explain(text: str, options: Mapping[str, object]) -> str:
    listen = options.get("listen/endpoints")
    endpoints = ", ".join(listen) if isinstance(listen, list) and listen else "no endpoint"
    if "in use" in text:
        return f"{endpoints} is in use on this machine; give this robot a `listen` of its own"
    if "assign requested address" in text:
        return f"{endpoints} is not an address of this machine; correct `listen`"
    if "No such device" in text:
        return f"{endpoints} names an interface that is not there; correct `interface`"
    if "ermission" in text or "not permitted" in text:
        return f"{endpoints} may not be bound by this user; get that right, or change `listen`"
    brief = " ".join(re.sub(r" at /\S+", "", text).split())
    return f"{brief[:300]} (listening on {endpoints})"


def _free_port(host: str, what: str) -> int:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        try:
            probe.bind((host, 0))
        except OSError as error:
            raise SwarmError(f"no port at {host} for {what}: {error}") from error
        return int(probe.getsockname()[1])


def _close(opened: Future[S]) -> None:
    session: zenoh.Session | None = opened.result()
    if session is not None:
        session.close()


# Tuning of sockets


def tune_sockets(session: zenoh.Session, lease: float) -> None:
    """Set the options of the sockets of all links, until the session closes. `lease` in s."""
    if not sys.platform.startswith("linux"):
        return

    tuned: set[str] = set()  # locators of the far ends

    def on_links(events: list[zenoh.LinkEvent]) -> None:
        # All links at once: in a flood of 200 links a second one look takes up to 40 ms.
        new: dict[str, str] = {}
        for event in events:
            near = str(event.link.src)
            far = str(event.link.dst)
            if event.kind != zenoh.SampleKind.PUT:
                tuned.discard(far)
                new.pop(far, None)
            elif far not in tuned:
                new[far] = near
        if new:
            tune_links([(near, far) for far, near in new.items()], lease)
            tuned.update(new)

    session.info.declare_link_events_listener(batches_on_thread(on_links), history=True)


def tune_links(links: Iterable[tuple[str, str]], lease: float) -> int:
    """Set the options of the sockets between pairs of locators such as `tcp/127.0.0.1:7447`.

    Returns the number of sockets.
    """
    tuned = 0
    for sock in _sockets_of(links):
        with contextlib.suppress(OSError):  # closed meanwhile
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGER)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(lease * 1000))
            tuned += 1
    return tuned


def end_links(links: Iterable[tuple[str, str]]) -> None:
    """End the links between pairs of locators. Linux only.

    Zenoh has no call for this. Zenoh closes a link whose socket was shut down, since it reads the
    end of the connection. Measured: the place of the link is free after 1 to 6 ms.
    """
    for sock in _sockets_of(links):
        with contextlib.suppress(OSError):  # closed meanwhile
            sock.shutdown(socket.SHUT_RDWR)


def end_dials(endpoints: Iterable[str]) -> None:
    """End the links to endpoints, and all TCP connections that are being made. Linux only.

    For the end of the program. Zenoh waits up to 9 s for a robot that accepts a connection and
    sends nothing, such as a frozen one, before it closes a session. Measured: 0.05 s after this.
    """
    ends = {address_of(endpoint) for endpoint in endpoints}
    for sock in own_sockets():
        with contextlib.suppress(OSError):  # closed meanwhile
            is_connecting = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 1)[0] == _SYN_SENT
            if is_connecting or _canonical(sock.getpeername()) in ends:
                sock.shutdown(socket.SHUT_RDWR)


def _sockets_of(links: Iterable[tuple[str, str]]) -> Iterator[socket.socket]:
    """The own sockets between pairs of locators, each closed before the next."""
    ends = {frozenset({address_of(src), address_of(dst)}) for src, dst in links}
    ports = {end[1] for pair in ends for end in pair if end is not None}
    for sock in connected_sockets():
        with contextlib.suppress(OSError):  # closed meanwhile
            names = sock.getsockname(), sock.getpeername()
            # Ports are compared first: to read the addresses of 1000 sockets takes 60 ms.
            is_near = ports.issuperset(name[1] for name in names)
            if is_near and frozenset(map(_canonical, names)) in ends:
                yield sock


def connected_sockets() -> Iterator[socket.socket]:
    """This process's connected TCP sockets; see `own_sockets`."""
    for sock in own_sockets():
        with contextlib.suppress(OSError):
            if sock.getpeername():
                yield sock


def own_sockets() -> Iterator[socket.socket]:
    """Duplicates of this process's TCP sockets, each closed before the next. Linux only.

    Zenoh opens these sockets and does not hand them out. Its threads may close and reuse the
    descriptors at any moment. A duplicate keeps referring to the same socket.
    """
    try:
        descriptors = os.listdir(FDS)
    except OSError:  # not Linux, or no file can be opened
        return
    for descriptor in descriptors:
        try:
            if not os.readlink(f"{FDS}/{descriptor}").startswith("socket:"):
                continue
            duplicate = os.dup(int(descriptor))
        except OSError:  # the descriptor was closed meanwhile
            continue
        try:
            sock = socket.socket(fileno=duplicate)
        except OSError:  # the descriptor was reused meanwhile, for a file
            os.close(duplicate)
            continue
        with sock:
            if sock.type == socket.SOCK_STREAM and sock.family in (socket.AF_INET, socket.AF_INET6):
                yield sock


def address_of(locator: str) -> Address | None:
    """The address in a locator: `("10.0.0.1", 7440)` of "tls/[::ffff:10.0.0.1]:7440"; else None."""
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
