"""Profile field on real interfaces: a cable that is cut, and healed.

Eight peers in three network namespaces on one bridge. The peers that vanish fail once their lease
is over. Those that stay receive each other's messages meanwhile (without the tuning of sockets
they receive nothing for about 10 s). Soon after the cable is back all members are alive again.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from swarmd.network.settings import NetworkSettings

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
ADDRESSES = {"a": "10.77.0.1", "b": "10.77.0.2", "far": "10.77.0.3"}
STAYING = {"a": ("a", 7447), "b": ("b", 7447)}
VANISHING = {f"v{number}": ("far", 7447 + number) for number in range(6)}
PEERS = STAYING | VANISHING
# A stalled receiver is held for 10 s by Zenoh's linger; the lease here is 2 s.
STALLED = 5.0


class Peer:
    """One survivor.py in its namespace; its events, and the presence it last saw of each."""

    def __init__(self, name: str, namespace: str, swarm: str) -> None:
        side, port = PEERS[name]
        seeds = [
            word
            for other, (where, number) in PEERS.items()
            if other != name
            for word in ("--seed", f"tcp/{ADDRESSES[where]}:{number}")
        ]
        self._changed = threading.Condition()
        self._process = subprocess.Popen(
            ["ip", "netns", "exec", namespace, sys.executable, "-m",
             "tests.network.survivor", name, "--swarm", swarm, "--interface", "eth0",
             "--listen", f"tcp/{ADDRESSES[side]}:{port}", *seeds],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
        )  # fmt: skip
        self.events: list[dict[str, Any]] = []
        self.presences: dict[str, str] = {}
        self.gaps: list[dict[str, float]] = []
        self.is_ready = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def until(self, condition: Any) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: condition(self), 30.0), str(self.events)

    def silences(self) -> dict[str, float]:
        """The longest gap between messages of each other peer since the last call, in s."""
        assert self._process.stdin is not None
        count = len(self.gaps)
        self._process.stdin.write("gaps\n")
        self._process.stdin.flush()
        self.until(lambda peer: len(peer.gaps) > count)
        return self.gaps[-1]

    def end(self) -> None:
        try:
            self._process.communicate(timeout=10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            event = json.loads(line)
            with self._changed:
                self.events.append(event)
                if "member" in event:
                    self.presences[event["member"]] = event["presence"]
                elif "gaps" in event:
                    self.gaps.append(event["gaps"])
                else:
                    self.is_ready = True
                self._changed.notify_all()


@pytest.fixture
def peers(namespaces: Any, settings: NetworkSettings) -> Iterator[dict[str, Peer]]:
    sides = {side: namespaces.join(side, address) for side, address in ADDRESSES.items()}
    made = {name: Peer(name, sides[side], settings.swarm) for name, (side, _) in PEERS.items()}
    try:
        for peer in made.values():
            peer.until(lambda peer: peer.is_ready)
        yield made
    finally:
        for peer in made.values():
            peer.end()


def alive(names: set[str]) -> Any:
    return lambda peer: {n for n, c in peer.presences.items() if c == "alive"} == names


def test_vanished_peers_fail_and_do_not_stall_the_others(
    namespaces: Any, peers: dict[str, Peer]
) -> None:
    everyone = set(PEERS)
    for name, peer in peers.items():
        peer.until(alive(everyone - {name}))
    peers["a"].silences()
    peers["b"].silences()

    cut_at = time.monotonic()
    namespaces.cut("far")
    peers["a"].until(alive({"b"}))
    peers["b"].until(alive({"a"}))
    noticed = time.monotonic() - cut_at
    for name in VANISHING:
        peers[name].until(alive(set(VANISHING) - {name}))
    gap = max(peers["a"].silences()["b"], peers["b"].silences()["a"])
    assert {peers["a"].presences[name] for name in VANISHING} == {"failed"}
    assert gap < STALLED

    heal_at = time.monotonic()
    namespaces.heal("far")
    for name, peer in peers.items():
        peer.until(alive(everyone - {name}))
    healed = time.monotonic() - heal_at
    gap = max(gap, peers["a"].silences()["b"], peers["b"].silences()["a"])
    assert gap < STALLED
    print(f"noticed {noticed:.2f} s, longest silence {gap:.2f} s, healed {healed:.2f} s")
