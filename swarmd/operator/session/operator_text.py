"""An operator's name and reasons, shortened so that requests and datagrams can carry them.

A stop must not fail because of its reason: a text that is too long is cut, and a character without
an encoding in UTF-8 is replaced.
"""

from __future__ import annotations

import getpass
import os
import socket

# Bounds of the texts in a request, in characters, and in a datagram, in bytes.
MAX_OPERATOR = 128
MAX_OPERATOR_BYTES = 256
MAX_REASON = 256
MAX_REASON_BYTES = 512


def operator_name() -> str:
    """The name of this operator, such as `anna@laptop`."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):
        user = f"uid{os.getuid()}"
    return sendable_name(f"{user}@{socket.gethostname()}")


def sendable_name(name: str) -> str:
    """An operator's name as any request carries it."""
    return _sendable(name, MAX_OPERATOR, MAX_OPERATOR_BYTES)


def request_reason(reason: str) -> str:
    """A reason as a request by Zenoh carries it."""
    return _sendable(reason, MAX_REASON, 4 * MAX_REASON)


def stop_reason(reason: str) -> str:
    """A reason as the datagram of a stop carries it."""
    return _sendable(reason, MAX_REASON, MAX_REASON_BYTES)


def _sendable(text: str, length: int, room: int) -> str:
    """The first `length` characters and `room` bytes; what UTF-8 cannot carry becomes `?`."""
    whole = text.encode("utf-8", "replace").decode()[:length]
    return whole.encode()[:room].decode(errors="ignore")
