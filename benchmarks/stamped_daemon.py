"""The daemon, which records the time of each stage that a scan passes through.

`python -m benchmarks.stamped_daemon CONFIG.yaml STAMPS.json PARENT`. The daemon is the usual one,
and records times (stamps, ns of CLOCK_MONOTONIC) at the borders between its parts.
`plugins/timed.py` records the times within the pattern host. Only the first time of a scan at a
border counts.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from time import monotonic_ns
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = "1"

from swarmd.core.events import ScanInput, SensorInput
from swarmd.core.host_messages import HostCommand, HostEvent, Step, Stepped
from swarmd.core.processes import SHORT_SLICE, ask_for_slices, die_with_parent
from swarmd.core.values import Twist
from swarmd.daemon import daemon as daemon_module
from swarmd.daemon.daemon import Daemon
from swarmd.daemon.driver import DriverSink
from swarmd.driver_api.driver import Sink
from swarmd.drivers import simulated
from swarmd.network.carriers.robot_link import Frame
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.settings.settings import load_daemon_settings


class Stamps:
    """The first time of each scan at each border."""

    def __init__(self) -> None:
        self.by_border: dict[str, dict[int, int]] = defaultdict(dict)
        self.loop = self.frame = 0

    def put(self, border: str, seq: int, at: int | None = None) -> None:
        self.by_border[border].setdefault(seq, monotonic_ns() if at is None else at)


STAMPS = Stamps()  # of this process, which is one measurement


class StampedDriver(simulated.SimulatedDriver):
    def _take(self, sink: Sink, frame: Frame, batch: Any) -> None:
        STAMPS.loop = monotonic_ns()
        super()._take(sink, frame, batch)

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        STAMPS.put("safe_sent", scan_seq)
        STAMPS.put("requested_sent", requested_scan_seq)
        super().send(twist, scan_seq, requested_scan_seq, is_stopped=is_stopped)


class StampedRunner(ProcessRunner):
    def send(self, command: HostCommand) -> None:
        super().send(command)
        if isinstance(command, Step) and command.inputs.scan is not None:
            STAMPS.put("to_host", command.inputs.scan.seq)

    def on_frame(self, host: Any, frame: bytes) -> None:
        STAMPS.frame = monotonic_ns()
        super().on_frame(host, frame)

    def events(self) -> Iterable[HostEvent]:
        for event in super().events():
            if isinstance(event, Stepped):
                STAMPS.put("from_host", event.scan_seq, STAMPS.frame)
                self._note_host(event)
            yield event

    def _note_host(self, event: Stepped) -> None:
        report = event.outputs.report
        if "seq" in report:
            STAMPS.put("host_in", int(report["seq"]), int(report["came"]))
            STAMPS.put("host_out", int(report["seq"]), int(report["went"]))


class StampedSink(DriverSink):
    def take(self, input: SensorInput) -> None:
        if isinstance(input, ScanInput):
            STAMPS.put("loop", input.scan.seq, STAMPS.loop)
            STAMPS.put("decoded", input.scan.seq)
        super().take(input)


async def serve(config: Path) -> None:
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    ask_for_slices(SHORT_SLICE)
    loop.add_signal_handler(signal.SIGTERM, stop.set)
    settings = load_daemon_settings(config, {})
    driver = StampedDriver(
        swarm=settings.network.swarm,
        robot=settings.id,
        platform=settings.platform,
        options=settings.driver_options,
    )
    daemon = Daemon(settings, driver)
    daemon.sink = StampedSink(daemon.step, daemon._neighborhood)
    await daemon.run(stop)


def main() -> None:
    config, stamps, parent = sys.argv[1:]
    die_with_parent(int(parent))
    logging.basicConfig(stream=sys.stderr, level=logging.INFO)
    setattr(daemon_module, "ProcessRunner", StampedRunner)  # noqa: B010
    asyncio.run(serve(Path(config)))
    Path(stamps).write_text(json.dumps(STAMPS.by_border))


if __name__ == "__main__":
    main()
