"""Replaces the adapter in tests without ROS: behaves as FAKE_ADAPTER names, then waits.

`garbage`: malformed packets, then a state. `dies`: ends with a line on standard error. `mute`:
sends nothing. `deaf`: does not end on a leave_beacon.
"""

from __future__ import annotations

import json
import os
import random
import socket
import struct
import sys
import time

STATE = {"event": "state", "master": False, "text": "a fake adapter"}


def main() -> None:
    kind = os.environ["FAKE_ADAPTER"]
    sock = socket.socket(fileno=os.dup(0))
    if kind == "dies":
        sys.exit("it cannot go on")
    if kind == "garbage":
        for size in range(1, 60):
            sock.send(random.Random(size).randbytes(size))
        for packet in (
            b"D",
            b"J",
            b"J[]",
            b'J{"event": "state"}',
            b'J{"event": "state", "master": 7}',
            b'J{"event": "foreign", "node": 3}',
            b"J" + b"[" * 5000,
            struct.pack("<cBd", b"D", 9, time.monotonic()) + b"of no topic",
            struct.pack("<cBd", b"D", 0, float("nan")),
            b"H and more",
        ):
            sock.send(packet)
    if kind != "mute":
        sock.send(b"J" + json.dumps(STATE).encode())
    while sock.recv(65536) or kind == "deaf":
        pass


if __name__ == "__main__":
    main()
