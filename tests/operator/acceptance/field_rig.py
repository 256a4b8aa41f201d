"""A simulated robot, its daemon and a person's laptop on hosts of their own, in one radio network.

`ROBOT` and `LAPTOP` are on the radio, and so is `OTHER`, from which a test looks on.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import msgspec
from msgspec.structs import replace

from swarmd.core.values import Array
from swarmd.operator.acceptance.result_file import (
    StepResult,
    read_record,
    write_record,
)
from swarmd.operator.acceptance.verdict import Verdict, passed
from swarmd.sim.live.state import WorldOptions
from swarmd.sim.trace import load_trace
from tests.operator.acceptance.person import Person, person
from tests.support.field import BODIES, Field
from tests.support.field_swarm import FieldSwarm
from tests.support.processes import CAP, DAEMON, DaemonProcess

ROBOT, LAPTOP, OTHER = "r01", "laptop", "other"
WORLD = f"tcp/{BODIES}:9100"


class FieldRig:
    """A swarm in profile `field` without daemons yet; bodies and world are on the host `hub`."""

    def __init__(self, folder: Path, left: ExitStack) -> None:
        self.folder, self.results, self._left = folder, folder / "results", left
        self.field = left.enter_context(closing(Field((ROBOT, LAPTOP, OTHER))))
        self.swarm = left.enter_context(FieldSwarm(folder, self.field, (ROBOT,)))
        self._world: subprocess.Popen[bytes] | None = None
        self._trace = folder / "trace.npz"

    def start_world(self, arena: str) -> None:
        """A Burger in the middle of an arena, which is recorded."""
        options = WorldOptions(
            swarm=self.swarm.name,
            robots={ROBOT: "burger"},
            arena=arena,
            layout="grid:1.0",
            realism="realistic",
            endpoint=WORLD,
            trace=str(self._trace),
        )
        words = (msgspec.json.encode(options).decode(), "--die-with-parent", str(os.getpid()))
        self._world = subprocess.Popen(
            [*self.field.prefix("hub"), sys.executable, "-m", "swarmd.sim.live.server", *words],
            stdout=subprocess.PIPE,
        )
        self._left.callback(self.end_world)
        assert self._world.stdout is not None
        assert self._world.stdout.readline()

    def end_world(self) -> None:
        if self._world is not None:
            with self._world as process:
                process.send_signal(signal.SIGTERM)
                process.wait(CAP)
            self._world = None

    def poses(self) -> Array:
        """(n, 3) true poses of the robot since the start of the world, which ends."""
        self.end_world()
        return load_trace(self._trace).pose[:, 0]

    def start_daemon(
        self, host: str = ROBOT, endpoint: str = WORLD, module: Sequence[str] = DAEMON
    ) -> DaemonProcess:
        """A daemon with the name of the robot on a host, once it is ready."""
        daemon = DaemonProcess(
            self.folder / f"daemon-{host}",
            swarm=self.swarm.name,
            robot=ROBOT,
            endpoint=endpoint,
            platform="burger",
            options={"profile": "field", "interface": "eth0", "insecure": True},
            namespace=self.field.namespace(host),
            module=module,
        )
        return self._left.enter_context(daemon).wait_ready()

    @property
    def body(self) -> str:
        """The endpoint of a body that rests, for a daemon without the world."""
        return self.swarm._endpoints[ROBOT]

    @contextmanager
    def person(self, only: str) -> Iterator[Person]:
        """A person at the laptop who asks for this part or step."""
        words = ("--only", only, "--folder", str(self.results), "--insecure")
        environ = {"SWARM_CONFIG": str(self.swarm.config), "HOME": str(self.folder)}
        prefix = self.field.prefix(LAPTOP)
        with person(self.swarm.name, ROBOT, *words, prefix=prefix, environ=environ) as one:
            yield one

    def note_passed(self, step: str) -> None:
        """Note that the step has passed with this robot, just now."""
        with self.person("A1") as one:  # its record tells what is tested
            one.end()
        record = read_record(self.results)
        result = StepResult(
            id=step,
            name="",
            why="",
            verdict=passed(""),
            at=time.time(),
            subject=record.subject,
        )
        write_record(self.results, replace(record, steps=(*record.steps, result)))

    def verdict(self, step: str) -> Verdict:
        return read_record(self.results).verdicts[step]

    def filter_multicast(self, host: str) -> None:
        """Drop what comes to a host by multicast."""
        rules = (
            "add table inet test\n"
            "add chain inet test in { type filter hook input priority 0; }\n"
            "add rule inet test in ip daddr 224.0.0.0/4 drop\n"
            "add rule inet test in ip6 daddr ff00::/8 drop\n"
        )
        command = [*self.field.prefix(host), "nft", "-f", "-"]
        subprocess.run(command, input=rules, text=True, check=True)

    def cut(self) -> None:
        """Take the link of the laptop down, as a cable that is pulled."""
        self.field.ip(LAPTOP, "link set eth0 down")

    def join(self) -> None:
        self.field.ip(LAPTOP, "link set eth0 up")

    def state(self) -> str:
        """The state of the robot that the other host hears; empty if it does not hear it."""
        return self.swarm.states(OTHER).get(ROBOT, "")
