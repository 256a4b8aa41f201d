"""When data arrived at a socket, by the kernel, on the wall clock."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterable

SO_TIMESTAMPNS = 35  # asm-generic/socket.h
_TIMESPEC = struct.Struct("@ll")
ROOM = socket.CMSG_SPACE(_TIMESPEC.size)
"""Bytes of ancillary data with the time of arrival."""


def waited(ancillary: Iterable[tuple[int, int, bytes]]) -> float:
    """Seconds since the data arrived, by the wall clock; 0 without the kernel's time."""
    for level, kind, content in ancillary:
        if (level, kind, len(content)) == (socket.SOL_SOCKET, SO_TIMESTAMPNS, _TIMESPEC.size):
            seconds, nanoseconds = _TIMESPEC.unpack(content)
            return time.time() - float(seconds) - 1e-9 * float(nanoseconds)
    return 0.0
