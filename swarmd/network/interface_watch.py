"""The state of a network interface, as the kernel tells it by netlink.

Formats: rtnetlink(7), linux/netlink.h, linux/rtnetlink.h and linux/if_addr.h.
"""

from __future__ import annotations

import ipaddress
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from swarmd.core.errors import NetworkError

_HEAD = struct.Struct("=IHHII")  # length, type, flags, sequence, port
_LINK = struct.Struct("=BxHiII")  # family, type, index, flags, change
_ADDRESS = struct.Struct("=BBBBI")  # family, prefix length, flags, scope, index
_ATTRIBUTE = struct.Struct("=HH")
_ERROR, _DONE = 2, 3
_NEW_LINK, _DELETE_LINK, _NEW_ADDRESS, _DELETE_ADDRESS, _GET_ADDRESS = 16, 17, 20, 21, 22
_REQUEST_DUMP = 0x301
_UP_AND_RUNNING = 0x41
_IFA_ADDRESS, _IFA_LOCAL, _IFA_FLAGS = 1, 2, 8
_UNUSABLE = 0x48  # tentative, or found to be a duplicate
_TIMEOUT = 1.0


@dataclass(frozen=True, slots=True)
class AddressMessage:
    """An address of the interface `index` came (`is_new`) or went."""

    index: int
    address: str
    is_new: bool


def addresses_in(payload: bytes) -> Iterator[AddressMessage]:
    """The usable addresses in what the kernel sent; what is malformed is left out."""
    for kind, body in _messages(payload):
        if kind in (_NEW_ADDRESS, _DELETE_ADDRESS) and len(body) >= _ADDRESS.size:
            _, _, flags, _, index = _ADDRESS.unpack_from(body)
            parts = dict(_attributes(body[_ADDRESS.size :]))
            if len(parts.get(_IFA_FLAGS, b"")) == 4:
                (flags,) = struct.unpack("=I", parts[_IFA_FLAGS])
            raw = parts.get(_IFA_LOCAL) or parts.get(_IFA_ADDRESS) or b""
            if len(raw) in (4, 16):
                is_new = kind == _NEW_ADDRESS and not flags & _UNUSABLE
                yield AddressMessage(index, str(ipaddress.ip_address(raw)), is_new)


def addresses_of(index: int) -> tuple[str, ...]:
    """The usable addresses of an interface, IPv4 first; asks the kernel, some 50 us.

    Raises NetworkError if it does not answer.
    """
    found: list[str] = []
    request = _ADDRESS.pack(socket.AF_UNSPEC, 0, 0, 0, 0)
    head = _HEAD.pack(_HEAD.size + len(request), _GET_ADDRESS, _REQUEST_DUMP, 1, 0)
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as asking:
            asking.settimeout(_TIMEOUT)
            asking.send(head + request)
            is_done = False
            while not is_done:
                payload = asking.recv(65536)
                found += [m.address for m in addresses_in(payload) if m.index == index and m.is_new]
                kinds = [kind for kind, _ in _messages(payload)]
                is_done = not kinds or _DONE in kinds or _ERROR in kinds
    except OSError as error:
        raise NetworkError(f"the kernel tells no addresses by netlink: {error}") from error
    return tuple(sorted(found, key=lambda text: ":" in text))


def index_of(interface: str) -> int:
    """The number of an interface. Raises NetworkError in one line if it is not there."""
    try:
        return socket.if_nametoindex(interface)
    except OSError:
        known = ", ".join(sorted(name for _, name in socket.if_nameindex()))
        raise NetworkError(
            f"no network interface {interface!r} on this machine; there are: {known}"
        ) from None


def _messages(payload: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + _HEAD.size <= len(payload):
        length, kind, *_ = _HEAD.unpack_from(payload, at)
        if not _HEAD.size <= length <= len(payload) - at:
            return
        yield kind, payload[at + _HEAD.size : at + length]
        at += (length + 3) & ~3


def _attributes(payload: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + _ATTRIBUTE.size <= len(payload):
        length, kind = _ATTRIBUTE.unpack_from(payload, at)
        if not _ATTRIBUTE.size <= length <= len(payload) - at:
            return
        yield kind & 0x3FFF, payload[at + _ATTRIBUTE.size : at + length]
        at += (length + 3) & ~3
