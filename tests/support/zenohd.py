"""The router of `make zenohd`, with REST and a storage of statuses, on loopback alone."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from tests.support.processes import CAP, wait_until
from tests.support.ros2_bridge import ROUTER

ZENOHD = ROUTER.with_name("zenohd")
RUST_EXAMPLE = ROUTER.with_name("zenoh-swarm")
_ZENOH, _REST = "127.0.0.1", "127.0.0.2"  # any free port of each
_LISTENS = "0A"  # the state in /proc/net/tcp


def why_no_zenohd() -> str:
    """What a test with zenohd or the example in Rust lacks here; empty if nothing."""
    if ZENOHD.exists() and RUST_EXAMPLE.exists():
        return ""
    return "no router with the plugins of zenohd: run make zenohd, which needs cargo"


class Zenohd:
    """A router that dials the robots of one swarm, and stores their statuses in memory.

    Without scouting, by which it would join the swarms of other tests on loopback.
    """

    def __init__(self, folder: Path, swarm: str, robots: Sequence[str]) -> None:
        config, self.log = folder / "zenohd.json5", folder / "zenohd.log"
        config.write_text(json.dumps(_config(swarm, robots)))
        command = ["setpriv", "--pdeathsig", "KILL", str(ZENOHD), "-c", str(config)]
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        self._ports: dict[str, int] = {}
        wait_until(self._listens, "zenohd listens for sessions and HTTP")
        self.endpoint = f"tcp/{_ZENOH}:{self._ports[_ZENOH]}"
        self.url = f"http://{_REST}:{self._ports[_REST]}"

    def get(self, selector: str) -> bytes:
        """The body that REST gives for a selector."""
        with urlopen(f"{self.url}/{selector}", timeout=CAP) as answer:
            content: bytes = answer.read()
            return content

    def values(self, selector: str) -> dict[str, Any]:
        """Each key and its value in the JSON that REST gives for a selector."""
        return {sample["key"]: sample["value"] for sample in json.loads(self.get(selector))}

    def close(self) -> None:
        self._process.kill()
        self._process.wait(CAP)

    def _listens(self) -> bool:
        assert self._process.poll() is None, self.log.read_text()
        folder, inodes = Path(f"/proc/{self._process.pid}/fd"), set()
        for file in folder.iterdir():
            with suppress(OSError):  # closed meanwhile
                inodes.add(os.readlink(file))
        for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == _LISTENS and f"socket:[{words[9]}]" in inodes:
                host, port = (bytes.fromhex(word) for word in words[1].split(":"))
                self._ports[".".join(map(str, reversed(host)))] = int.from_bytes(port)
        return self._ports.keys() == {_ZENOH, _REST}


def _config(swarm: str, robots: Sequence[str]) -> dict[str, Any]:
    storage = {"key_expr": f"swarm/{swarm}/*/state/status", "volume": "memory"}
    return {
        "mode": "router",
        "listen": {"endpoints": [f"tcp/{_ZENOH}:0"]},
        "connect": {"endpoints": [*robots]},
        "scouting": {"gossip": {"enabled": False}, "multicast": {"enabled": False}},
        "adminspace": {"enabled": True},
        "plugins_loading": {"enabled": True},
        "plugins": {
            "rest": {"http_port": f"{_REST}:0"},
            "storage_manager": {"storages": {"status": storage}},
        },
    }
