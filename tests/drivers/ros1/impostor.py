"""What stands in for the adapter in tests without ROS: says what it is told to, then waits.

Its behaviour is in IMPOSTOR: `garbage` sends packets that are none, and after them a state; `dies`
ends with a line on standard error; `mute` says nothing; `deaf` does not end when asked.
"""

from __future__ import annotations

import json
import os
import random
import socket
import struct
import sys
import time

STATE = {"event": "state", "master": False, "text": "an impostor"}


def main() -> None:
    kind = os.environ["IMPOSTOR"]
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
            b'J{"event": "link", "link": 3}',
            b"J" + b"[" * 5000,
            struct.pack("<cBd", b"D", 9, time.monotonic()) + b"of no link",
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
