"""Watches a network interface: whether it is there and up, and its addresses, by netlink.

Formats: netlink(7), rtnetlink(7), linux/rtnetlink.h and linux/if_addr.h. The parsers and
`InterfaceHistory` are pure.
"""

from __future__ import annotations

import ipaddress
import socket
import struct
from collections.abc import Callable, Iterator
from enum import StrEnum
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.errors import NetworkError

if TYPE_CHECKING:
    from asyncio import AbstractEventLoop, TimerHandle

QUIET_TIME = 0.2  # s without news after which a burst of them is over
MAX_BURST = 1.0  # s after which it counts as over anyway

_HEAD = struct.Struct("=IHHII")  # length, type, flags, sequence, port
_LINK = struct.Struct("=BxHiII")  # family, type, index, flags, change
_ADDRESS = struct.Struct("=BBBBI")  # family, prefix length, flags, scope, index
_ATTRIBUTE = struct.Struct("=HH")
_ERROR, _DONE = 2, 3
_NEW_LINK, _DELETE_LINK, _GET_LINK = 16, 17, 18
_NEW_ADDRESS, _DELETE_ADDRESS, _GET_ADDRESS = 20, 21, 22
_REQUEST, _DUMP = 0x1, 0x300
_UP_AND_RUNNING = 0x41
_IFLA_IFNAME, _IFA_ADDRESS, _IFA_LOCAL, _IFA_FLAGS = 3, 1, 2, 8
_UNUSABLE = 0x48  # tentative, or found to be a duplicate
_GROUPS = 0x1 | 0x10 | 0x100  # RTMGRP_LINK, RTMGRP_IPV4_IFADDR, RTMGRP_IPV6_IFADDR
_TIMEOUT = 1.0
_MAX_MESSAGE = 65536
_READS = 64  # messages of the kernel in a turn of the loop


class InterfaceState(Struct, frozen=True):
    """An interface; `is_up`: it is on and has a carrier; `addresses`: the usable ones, IPv4 first.

    `index`: its number, which changes if it goes and comes back; 0 if it is absent.
    """

    exists: bool = False
    is_up: bool = False
    addresses: tuple[str, ...] = ()
    index: int = 0

    @property
    def ipv4(self) -> tuple[str, ...]:
        """The IPv4 addresses."""
        return tuple(one for one in self.addresses if ":" not in one)

    @property
    def link_local(self) -> tuple[str, ...]:
        """The link-local IPv6 addresses."""
        return tuple(one for one in self.addresses if one.startswith("fe80:"))

    @property
    def is_usable(self) -> bool:
        """True if it is up and has an address."""
        return self.is_up and bool(self.addresses)

    @property
    def text(self) -> str:
        """The state in a few words."""
        if not self.exists:
            return "absent"
        if not self.is_up:
            return "down"
        if not self.addresses:
            return "no address yet"
        if not self.ipv4:
            return f"no IPv4 address yet, {', '.join(self.link_local or self.addresses)}"
        return f"up, {', '.join(self.ipv4)}"


class InterfaceEvent(StrEnum):
    """What happened to an interface."""

    ABSENT = "absent"
    DOWN = "down"
    NO_ADDRESS = "no_address"
    UP = "up"
    ADDRESS_CHANGED = "address_changed"


class InterfaceChange(Struct, frozen=True):
    """A change, with a line for the log such as `wlan0: no address yet`.

    `must_reopen`: peers know the robot by an address that is gone, or the sockets are bound to an
    interface that went and came back. `must_rejoin`: the interface is up again, and its groups may
    be lost.
    """

    event: InterfaceEvent
    state: InterfaceState
    line: str
    must_reopen: bool = False
    must_rejoin: bool = False


class InterfaceHistory:
    """Tells what a new state changes. Global IPv6 addresses come and go without a word. Pure."""

    def __init__(self, interface: str, state: InterfaceState) -> None:
        self._interface = interface
        self.state = state
        self._last = state  # the addresses and index by which peers may know the robot

    def on_state(self, state: InterfaceState) -> InterfaceChange | None:
        """The change to this state; None if nothing that matters has changed."""
        before, self.state = self.state, state
        if _essence(before) == _essence(state):
            return None
        event = _event(state)
        line = f"{self._interface}: {state.text}"
        if event is not InterfaceEvent.UP:
            return InterfaceChange(event, state, line)
        last = self._last
        lost = _lost(last, state)
        is_new = bool(last.index) and last.index != state.index
        # An IPv4 address that is away, as while DHCP asks, stays in mind beside the IPv6 ones.
        kept = () if state.ipv4 else last.ipv4
        self._last = replace(state, addresses=kept + state.addresses)
        if lost:
            event = InterfaceEvent.ADDRESS_CHANGED
            now = state.ipv4 or state.link_local
            line = f"{self._interface}: address changed: {', '.join(lost)} -> {', '.join(now)}"
        must_rejoin = _event(before) is not InterfaceEvent.UP
        return InterfaceChange(event, state, line, bool(lost) or is_new, must_rejoin)


class InterfaceWatch:
    """Calls `on_change(change)` on the loop, once for a burst of changes, until `close`.

    Raises NetworkError if the kernel offers no netlink.
    """

    def __init__(
        self,
        loop: AbstractEventLoop,
        interface: str,
        on_change: Callable[[InterfaceChange], object],
    ) -> None:
        self._loop, self._interface, self._on_change = loop, interface, on_change
        self._timer: TimerHandle | None = None
        self._burst_at: float | None = None
        try:
            self._socket = socket.socket(
                socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.NETLINK_ROUTE
            )
            self._socket.bind((0, _GROUPS))
        except OSError as error:
            raise NetworkError(f"the interface cannot be watched by netlink: {error}") from error
        self._history = InterfaceHistory(interface, read_state(interface))
        loop.add_reader(self._socket, self._on_readable)

    @property
    def state(self) -> InterfaceState:
        """The state after the last change."""
        return self._history.state

    def close(self) -> None:
        """End the watch; more than once is harmless."""
        if self._timer is not None:
            self._timer.cancel()
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket)
            self._socket.close()

    def _on_readable(self) -> None:
        is_news = False
        for _ in range(_READS):
            try:
                payload = self._socket.recv(_MAX_MESSAGE)
            except BlockingIOError:
                break
            except OSError:  # some were lost (ENOBUFS)
                is_news = True
                continue
            is_news |= concerns(payload, self._interface, self.state.index)
        if is_news:
            now = self._loop.time()
            if self._burst_at is None:
                self._burst_at = now
            if self._timer is not None:
                self._timer.cancel()
            end = min(now + QUIET_TIME, self._burst_at + MAX_BURST)
            self._timer = self._loop.call_at(end, self._look)

    def _look(self) -> None:
        self._timer = self._burst_at = None
        try:
            state = read_state(self._interface)
        except NetworkError:  # the kernel has no memory for an answer: ask it again
            self._timer = self._loop.call_later(MAX_BURST, self._look)
            return
        change = self._history.on_state(state)
        if change is not None:
            self._on_change(change)


def _event(state: InterfaceState) -> InterfaceEvent:
    if not state.exists:
        return InterfaceEvent.ABSENT
    if not state.is_up:
        return InterfaceEvent.DOWN
    return InterfaceEvent.UP if state.is_usable else InterfaceEvent.NO_ADDRESS


def _essence(state: InterfaceState) -> tuple[object, ...]:
    is_up = _event(state) is InterfaceEvent.UP
    addresses = (set(state.ipv4), set(state.link_local)) if is_up else ()
    return _event(state), state.index, addresses


def _lost(last: InterfaceState, state: InterfaceState) -> tuple[str, ...]:
    """The addresses in `last` of the family in use that are gone: none while that is away."""
    if last.ipv4:
        kept = state.ipv4
        return tuple(one for one in last.ipv4 if one not in kept) if kept else ()
    kept = state.link_local
    return tuple(one for one in last.link_local if one not in kept) if kept else ()


# Netlink: values in, values out


class LinkMessage(Struct, frozen=True):
    """The interface `index` is there, up or not, or has gone (not `exists`)."""

    index: int
    name: str
    exists: bool
    is_up: bool


class AddressMessage(Struct, frozen=True):
    """An address of the interface `index` is usable, or not any more."""

    index: int
    address: str
    is_usable: bool


def messages_in(payload: bytes) -> Iterator[LinkMessage | AddressMessage]:
    """What the kernel says of links and addresses; what is malformed or of no interest is left out.

    `payload`: messages of netlink, one after the other.
    """
    for kind, body in _messages(payload):
        if kind in (_NEW_LINK, _DELETE_LINK) and len(body) >= _LINK.size:
            _, _, index, flags, _ = _LINK.unpack_from(body)
            name = dict(_attributes(body[_LINK.size :])).get(_IFLA_IFNAME, b"")
            is_up = flags & _UP_AND_RUNNING == _UP_AND_RUNNING
            exists = kind == _NEW_LINK
            text = name.rstrip(b"\0").decode(errors="replace")
            yield LinkMessage(index, text, exists, is_up and exists)
        elif kind in (_NEW_ADDRESS, _DELETE_ADDRESS) and len(body) >= _ADDRESS.size:
            _, _, flags, _, index = _ADDRESS.unpack_from(body)
            parts = dict(_attributes(body[_ADDRESS.size :]))
            if len(parts.get(_IFA_FLAGS, b"")) == 4:
                (flags,) = struct.unpack("=I", parts[_IFA_FLAGS])
            raw = parts.get(_IFA_LOCAL) or parts.get(_IFA_ADDRESS) or b""
            if len(raw) in (4, 16):
                is_usable = kind == _NEW_ADDRESS and not flags & _UNUSABLE
                yield AddressMessage(index, str(ipaddress.ip_address(raw)), is_usable)


def concerns(payload: bytes, interface: str, index: int) -> bool:
    """True if a message is about this interface, by its name or the number that it had."""
    return any(
        message.index == index or (isinstance(message, LinkMessage) and message.name == interface)
        for message in messages_in(payload)
    )


def _messages(payload: bytes) -> Iterator[tuple[int, bytes]]:
    return _pieces(payload, _HEAD)


def _attributes(payload: bytes) -> Iterator[tuple[int, bytes]]:
    for kind, body in _pieces(payload, _ATTRIBUTE):
        yield kind & 0x3FFF, body  # without the flags of nested and big-endian attributes


def _pieces(payload: bytes, head: struct.Struct) -> Iterator[tuple[int, bytes]]:
    """Type and content of each piece; both kinds of heads begin with length and type."""
    at = 0
    while at + head.size <= len(payload):
        length, kind = head.unpack_from(payload, at)[:2]
        if not head.size <= length <= len(payload) - at:
            return
        yield kind, payload[at + head.size : at + length]
        at += (length + 3) & ~3


# Questions to the kernel


def index_of(interface: str) -> int:
    """The number of an interface. Raises NetworkError in one line if it is not there."""
    try:
        return socket.if_nametoindex(interface)
    except OSError:
        known = ", ".join(sorted(name for _, name in socket.if_nameindex()))
        raise NetworkError(
            f"no network interface {interface!r} on this machine; there are: {known}"
        ) from None


def read_state(interface: str) -> InterfaceState:
    """The state of an interface now, in some 0.5 ms. Raises NetworkError without an answer."""
    try:
        index = socket.if_nametoindex(interface)
    except OSError:
        return InterfaceState()
    question = _LINK.pack(socket.AF_UNSPEC, 0, index, 0, 0)
    for message in _ask(_GET_LINK, _REQUEST, question):
        if isinstance(message, LinkMessage) and message.index == index:
            return InterfaceState(True, message.is_up, addresses_of(index), index)
    return InterfaceState()  # it has gone meanwhile


def addresses_of(index: int) -> tuple[str, ...]:
    """The usable addresses of an interface, IPv4 first. Raises NetworkError without an answer."""
    question = _ADDRESS.pack(socket.AF_UNSPEC, 0, 0, 0, 0)
    found = [
        message.address
        for message in _ask(_GET_ADDRESS, _REQUEST | _DUMP, question)
        if isinstance(message, AddressMessage) and message.index == index and message.is_usable
    ]
    return tuple(sorted(found, key=lambda text: ":" in text))


def _ask(kind: int, flags: int, question: bytes) -> list[LinkMessage | AddressMessage]:
    found: list[LinkMessage | AddressMessage] = []
    head = _HEAD.pack(_HEAD.size + len(question), kind, flags, 1, 0)
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as asking:
            asking.settimeout(_TIMEOUT)
            asking.send(head + question)
            while True:
                payload = asking.recv(_MAX_MESSAGE)
                found += messages_in(payload)
                kinds = {kind for kind, _ in _messages(payload)}
                if not flags & _DUMP or not kinds or kinds & {_DONE, _ERROR}:
                    return found
    except OSError as error:
        raise NetworkError(f"the kernel does not answer by netlink: {error}") from error
