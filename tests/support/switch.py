"""A user-space Ethernet switch: delay, loss, duplicates, reordering, cuts, for each direction.

It runs in the network namespace that holds its ports, one end of a veth pair for each host, and
needs no kernel module:

    ip netns exec HUB python -m tests.support.switch --seed 1 a b c

Each line on standard input is a JSON command and gets one line of JSON as its answer:

- `{"set": [{"from": "a", "to": "*", "delay": 0.1}]}` changes what happens to frames from one port
  to another; `*` is every port. See `Rule`.
- `{"count": true}` answers the traffic of each port since the last `count`. See `Traffic`.

The switch ends with its standard input.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import dataclasses
import fcntl
import heapq
import json
import random
import selectors
import socket
import struct
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

ETH_P_ALL = 3
SO_RCVBUFFORCE = 33
RECEIVE_BUFFER = 16 << 20
MAX_QUEUED = 100_000
BURST = 64  # frames of one port before the next port's turn
REORDER_DELAY = 0.05  # s

_SIOCETHTOOL = 0x8946
# ETHTOOL_SRXCSUM, _STXCSUM, _SSG, _STSO, _SGSO, _SGRO
_OFFLOADS = (0x15, 0x17, 0x19, 0x1F, 0x24, 0x2C)


@dataclass(slots=True)
class Rule:
    """What happens to frames of one direction.

    `delay` and `jitter` in s: a frame takes `delay` plus or minus up to `jitter`. `loss`,
    `duplicate` and `reorder` are probabilities; a reordered frame takes `REORDER_DELAY` more.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    is_cut: bool = False


@dataclass(slots=True)
class Traffic:
    """Frames and bytes, with Ethernet headers, that a host has sent; `group`: broadcast too."""

    unicast_frames: int = 0
    unicast_bytes: int = 0
    group_frames: int = 0
    group_bytes: int = 0


def switch_offloads_off(interface: str) -> None:
    """Make an interface of this namespace send whole frames with checksums.

    A frame that passes a packet socket keeps neither a deferred checksum nor deferred segments.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for command in _OFFLOADS:
            value = ctypes.create_string_buffer(struct.pack("II", command, 0), 8)
            request = struct.pack("16sP", interface.encode(), ctypes.addressof(value))
            try:
                fcntl.ioctl(asking, _SIOCETHTOOL, request.ljust(40, b"\0"))
            except OSError:  # one that this kernel does not have
                continue


class Switch:
    """The ports, the rules of each direction, and the frames that are under way."""

    def __init__(self, ports: Iterable[str], seed: int) -> None:
        self._random = random.Random(seed)
        self._sockets = {port: _open(port) for port in ports}
        self._rules = {(a, b): Rule() for a in self._sockets for b in self._sockets if a != b}
        self._learned: dict[bytes, str] = {}
        self._queue: list[tuple[float, int, str, str, bytes]] = []
        self._number = 0
        self._traffic = {port: Traffic() for port in self._sockets}

    def serve(self) -> None:
        """Pass frames on and obey commands until standard input ends."""
        selector = selectors.DefaultSelector()
        for port, raw in self._sockets.items():
            selector.register(raw, selectors.EVENT_READ, port)
        selector.register(sys.stdin, selectors.EVENT_READ)
        print(json.dumps({"ports": list(self._sockets)}), flush=True)
        while True:
            wait = max(0.0, self._queue[0][0] - time.monotonic()) if self._queue else None
            for key, _ in selector.select(wait):
                if key.data is not None:
                    self._receive(key.data)
                elif line := sys.stdin.readline():
                    print(json.dumps(self._obey(json.loads(line))), flush=True)
                else:
                    return
            now = time.monotonic()
            while self._queue and self._queue[0][0] <= now:
                _, _, source, target, frame = heapq.heappop(self._queue)
                if not self._rules[source, target].is_cut:
                    self._send(target, frame)

    def _receive(self, port: str) -> None:
        for _ in range(BURST):
            try:
                frame, where = self._sockets[port].recvfrom(65535)
            except OSError:  # nothing more
                return
            if where[2] != socket.PACKET_OUTGOING:
                self._forward(port, frame, time.monotonic())

    def _forward(self, port: str, frame: bytes, now: float) -> None:
        is_group = bool(frame[0] & 1)
        traffic = self._traffic[port]
        if is_group:
            traffic.group_frames += 1
            traffic.group_bytes += len(frame)
        else:
            traffic.unicast_frames += 1
            traffic.unicast_bytes += len(frame)
        self._learned[frame[6:12]] = port
        known = None if is_group else self._learned.get(frame[:6])
        for target in self._sockets if known is None else (known,):
            if target != port:
                self._pass(port, target, frame, now)

    def _pass(self, port: str, target: str, frame: bytes, now: float) -> None:
        rule, chance = self._rules[port, target], self._random.random
        if rule.is_cut or (rule.loss and chance() < rule.loss):
            return
        for _ in range(2 if rule.duplicate and chance() < rule.duplicate else 1):
            due = now + rule.delay
            if rule.jitter:
                due += self._random.uniform(-rule.jitter, rule.jitter)
            if rule.reorder and chance() < rule.reorder:
                due += REORDER_DELAY
            if due <= now:
                self._send(target, frame)
            elif len(self._queue) < MAX_QUEUED:
                self._number += 1
                heapq.heappush(self._queue, (due, self._number, port, target, frame))

    def _send(self, port: str, frame: bytes) -> None:
        with contextlib.suppress(OSError):  # the host is gone, or its buffer is full
            self._sockets[port].send(frame)

    def _obey(self, command: Mapping[str, Any]) -> object:
        if "count" in command:
            counted = {port: dataclasses.asdict(one) for port, one in self._traffic.items()}
            self._traffic = {port: Traffic() for port in self._sockets}
            return counted
        for change in command["set"]:
            fields = {key: value for key, value in change.items() if key not in ("from", "to")}
            for (source, target), rule in self._rules.items():
                if change["from"] in ("*", source) and change["to"] in ("*", target):
                    self._rules[source, target] = dataclasses.replace(rule, **fields)
        return {"set": len(command["set"])}


def _open(port: str) -> socket.socket:
    switch_offloads_off(port)
    raw = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_ALL))
    raw.bind((port, ETH_P_ALL))
    raw.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, RECEIVE_BUFFER)
    raw.setblocking(False)
    return raw


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("ports", nargs="+")
    options = parser.parse_args()
    Switch(options.ports, options.seed).serve()


if __name__ == "__main__":
    main()
