"""A measured swarm: one world process and its daemons, as real processes on this machine."""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

from swarmd.core.messages import Status
from swarmd.core.verbs import ResetRequest, RunRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.settings.yamlfile import text_of
from swarmd.sim.live.fleet import end_processes

HERE = Path(__file__).parent
PLUGINS = HERE / "plugins"
READY_TIMEOUT = 60.0  # s
STOP_TIMEOUT = 5.0  # s between TERM and KILL
WRITE_TIMEOUT = 60.0  # s the same for a world, which decodes and writes its stamps at its end
POLL_PERIOD = 0.05

Process = subprocess.Popen[bytes]


class Swarm:
    """A context manager with a world and `count` daemons, ready for a run.

    The world steps MuJoCo at 100 Hz. It records the times of scans and commands at its network
    links; `close` leaves them in `folder`.

    - `others`: platforms, by name, of further robots without a daemon.
    - `world`: further fields of `WorldOptions`.
    """

    settings: Mapping[str, object] = MappingProxyType({"plugin_dir": str(PLUGINS)})
    """Further settings of each daemon."""

    def __init__(
        self,
        count: int,
        platform: str = "waffle_pi",
        *,
        others: Mapping[str, str] = MappingProxyType({}),
        world: Mapping[str, object] = MappingProxyType({}),
    ) -> None:
        self.name = f"bench-{secrets.token_hex(3)}"
        self.robots = tuple(f"tb3-{number:02d}" for number in range(1, count + 1))
        self.endpoint = ""
        self._platform, self._others, self._options = platform, others, world
        self.daemons: dict[str, Process] = {}
        self.world: Process | None = None
        self._exit = ExitStack()

    def __enter__(self) -> Self:
        self.folder = Path(self._exit.enter_context(tempfile.TemporaryDirectory()))
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        self._exit.close()

    def close(self) -> None:
        """End all processes; the stamps are written by then."""
        end_processes([*self.daemons.values()], STOP_TIMEOUT)
        if self.world is not None:
            end_processes([self.world], WRITE_TIMEOUT)

    def run(self, pattern: str, **params: Any) -> Outcome:
        """Run a pattern on all robots; SystemExit unless all of them have it."""
        view = self.operator.members()
        epochs = view.epochs(self.robots)
        outcome = self.operator.request(RunRequest, epochs, pattern=pattern, params=params)
        if len(outcome.applied) != len(self.robots):
            sys.exit(f"run {pattern}: {outcome.line} {outcome}")
        return outcome

    def reset(self) -> None:
        """Take all robots out of `faulted` or `stopped`."""
        view = self.operator.members()
        self.operator.request(ResetRequest, view.epochs(self.robots), reason="benchmark")

    def statuses(self) -> Mapping[str, Status]:
        """What each robot says of itself now."""
        members = self.operator.members().members
        return {r: m.status for r, m in members.items() if m.status is not None}

    def wait(self, condition: Callable[[Mapping[str, Status]], bool], what: str) -> None:
        """Until the statuses are as wanted; SystemExit with the logs' last lines if never."""
        deadline = time.monotonic() + READY_TIMEOUT
        while not condition(self.statuses()):
            if time.monotonic() > deadline:
                sys.exit(f"no {what} within {READY_TIMEOUT:.0f} s: {self._last_words()}")
            time.sleep(POLL_PERIOD)

    def wait_ready(self) -> None:
        """Until every daemon has its body and scans."""
        self.wait(lambda seen: all(self._is_ready(seen.get(r)) for r in self.robots), "ready swarm")

    def _is_ready(self, status: Status | None) -> bool:
        return status is not None and status.health.driver_up and status.health.scan_rate > 3.0

    def _start(self) -> None:
        self.world = self._spawn_world()
        assert self.world.stdout is not None
        line = self.world.stdout.readline()
        if not line:
            sys.exit(f"the world did not start: {self._last_words()}")
        ready = json.loads(line)
        self.endpoint = ready["endpoint"]
        self.driver_options: Mapping[str, object] = ready["driver_options"]
        for robot in self.robots:
            self.daemons[robot] = self._spawn(robot, self._daemon_command(robot))
        self.operator = self._exit.enter_context(Operator(NetworkSettings(swarm=self.name)))
        self.wait_ready()

    def _spawn_world(self) -> Process:
        there = {**dict.fromkeys(self.robots, self._platform), **self._others}
        side = 6 if len(self.robots) <= 9 else 9
        options = {"swarm": self.name, "robots": there, "arena": f"{side}x{side}", **self._options}
        command = [
            "-m",
            "benchmarks.stamped_world",
            str(self.folder / "world.npz"),
            json.dumps(options),
        ]
        command += ["--die-with-parent", str(os.getpid())]
        return self._spawn("world", command, stdout=subprocess.PIPE)

    def _daemon_command(self, robot: str) -> list[str]:
        config = self.folder / f"{robot}.yaml"
        settings: dict[str, object] = {
            "id": robot,
            "swarm": self.name,
            "platform": self._platform,
            "driver": "simulated",
            "driver_options": dict(self.driver_options),
            "state_dir": str(self.folder / "state"),
            **self.settings,
        }
        config.write_text(text_of(settings))
        tie = ["--die-with-parent", str(os.getpid())]
        start = "from swarmd.operator.cli.entry import swarmd; swarmd()"
        return ["-c", start, "--config", str(config), *tie]

    def _spawn(self, name: str, arguments: Sequence[str], stdout: int | None = None) -> Process:
        with (self.folder / f"{name}.log").open("ab") as log:
            return subprocess.Popen(
                [*self._python_of(name), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log if stdout is None else stdout,
                stderr=log,
                cwd=HERE.parent,
                start_new_session=True,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", **self._environment_of(name)},
            )

    def _python_of(self, name: str) -> Sequence[str]:
        return (sys.executable,)

    def _environment_of(self, name: str) -> Mapping[str, str]:
        return {}

    def _last_words(self) -> str:
        texts = {log.stem: log.read_text(errors="replace") for log in self.folder.glob("*.log")}
        return "; ".join(f"{name}: {text.strip()[-200:]}" for name, text in sorted(texts.items()))
