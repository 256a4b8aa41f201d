"""A fake daemon that prints its events, one JSON line each; run in a network namespace.

Publishes 3 kB at 20 Hz, so that links to vanished peers hold unacknowledged data. Lines:
{"ready": name}, {"member": name, "presence": ..., "at": s}, and on each line of standard input
{"gaps": {name: longest silence in s since the last such line}}.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time

from swarmd.core.keys import Key
from swarmd.core.messages import Member
from swarmd.network.settings import NetworkSettings
from tests.support.fake_daemon import FakeDaemon

PERIOD = 0.05


class Survivor:
    def __init__(self, daemon: FakeDaemon) -> None:
        self._daemon = daemon
        self._heard: dict[str, float] = {}
        self._gaps: dict[str, float] = {}

    async def run(self) -> None:
        bus = self._daemon.bus
        bus.on_member(self._on_member)
        bus.listen("sense", "noise", self._on_noise)
        for member in bus.members.values():
            self._on_member(member)
        lines = await _stdin()
        _say({"ready": self._daemon.robot})
        noise = asyncio.create_task(self._noise())
        while await lines.readline():
            now = time.monotonic()
            gaps = {name: max(self._gaps[name], now - at) for name, at in self._heard.items()}
            self._gaps = dict.fromkeys(self._gaps, 0.0)
            _say({"gaps": gaps})
        noise.cancel()

    async def _noise(self) -> None:
        while True:
            self._daemon.bus.publish("sense", "noise", bytes(3000))
            await asyncio.sleep(PERIOD)

    def _on_member(self, member: Member) -> None:
        _say({"member": member.robot, "presence": member.presence, "at": time.monotonic()})

    def _on_noise(self, key: Key, payload: bytes) -> None:
        now = time.monotonic()
        before = self._heard.get(key.robot, now)
        self._heard[key.robot] = now
        self._gaps[key.robot] = max(self._gaps.get(key.robot, 0.0), now - before)


def _say(event: dict[str, object]) -> None:
    print(json.dumps(event), flush=True)


async def _stdin() -> asyncio.StreamReader:
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), sys.stdin
    )
    return reader


async def _main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("robot")
    parser.add_argument("--swarm", required=True)
    parser.add_argument("--interface", required=True)
    parser.add_argument("--listen", action="append", default=[])
    parser.add_argument("--seed", action="append", default=[])
    args = parser.parse_args()
    settings = NetworkSettings(
        swarm=args.swarm,
        profile="field",
        interface=args.interface,
        listen=tuple(args.listen),
        seeds=tuple(args.seed),
        multicast=False,
        lease=2.0,
    )
    async with FakeDaemon(settings, args.robot) as daemon:
        await Survivor(daemon).run()


if __name__ == "__main__":
    asyncio.run(_main())
