"""Sends datagrams as fast as asked: `python -m tests.support.flood HEX PORT SOURCES RATE SECONDS`.

To the unicast port on loopback and to the group, in turns, from SOURCES sockets in turn; prints how
many it sent.
"""

from __future__ import annotations

import socket
import struct
import sys
import time

from swarmd.link.carriers.udp import GROUP4, GROUP_PORT

BURST = 50


def main(payload: bytes, port: int, sources: int, rate: float, seconds: float) -> None:
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(sources)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
        index = struct.pack("4s4si", bytes(4), bytes(4), socket.if_nametoindex("lo"))
        one.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, index)
    targets = [("127.0.0.1", port), (GROUP4, GROUP_PORT)]
    began = due = time.monotonic()
    sent = 0
    print("begun", flush=True)
    while (now := time.monotonic()) - began < seconds:
        if now < due:
            time.sleep(due - now)
            continue
        due = max(due, now - 0.1) + BURST / rate  # what it could not send in time it never sends
        for _ in range(BURST):
            sockets[sent % sources].sendto(payload, targets[sent // sources % 2])
            sent += 1
    print(sent)


if __name__ == "__main__":
    main(bytes.fromhex(sys.argv[1]), *map(int, sys.argv[2:]))
