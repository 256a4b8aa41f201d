"""A daemon in another root file system, such as one of an emulated arm64, driven by swarmctl here.

`python -m studies.processors.daemon chroot ROOT ... python3` gets the command of the Python there,
which may set $LD_PRELOAD to a library of socket_options.c. The world runs here, and both sides see
one temporary folder and one network. A line for each verb tells its exit code and the state of the
robot then. The exit code is 1 unless all is as STORY wants, and the robot drives in each run.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence

from benchmarks.swarm import Swarm
from studies.processors.socket_options import SocketOptions
from swarmd.core.messages import State, Status

ROBOT = "tb3-01"
STORY: Sequence[tuple[str, State]] = (
    ("run random_walk --all", State.RUNNING),
    (f"stop {ROBOT}", State.STOPPED),
    ("run random_walk --all", State.RUNNING),
    ("estop --all", State.ESTOPPED),
    ("reset --all --yes", State.IDLE),
    ("run random_walk --all", State.RUNNING),
    ("stop --all", State.STOPPED),
)
"""Verbs, and the state of the robot that each brings about."""
START_TIMEOUT = 300.0  # s: an emulated interpreter on a busy machine
STATE_TIMEOUT = 30.0  # s until a state is seen
DRIVES = 5.0  # s of each run
_SWARMCTL = (sys.executable, "-c", "from swarmd.operator.cli.entry import swarmctl; swarmctl()")


class ForeignSwarm(Swarm):
    """A world of this machine with daemons that another Python runs."""

    settings: Mapping[str, object] = {}

    def __init__(self, python: Sequence[str]) -> None:
        self._python = python
        super().__init__(1)

    def _start(self) -> None:
        self.options = self.folder / "options"
        self.served = self._exit.enter_context(SocketOptions(self.options)).served
        super()._start()

    def wait(self, condition: Callable[[Mapping[str, Status]], bool], what: str) -> None:
        """As that of `Swarm`, for a slow processor."""
        deadline = time.monotonic() + START_TIMEOUT
        while not condition(self.statuses()):
            has_ended = any(daemon.poll() is not None for daemon in self.daemons.values())
            if has_ended or time.monotonic() > deadline:
                seen = {robot: status.health for robot, status in self.statuses().items()}
                sys.exit(f"no {what} within {START_TIMEOUT:.0f} s: {seen}, {self._last_words()}")
            time.sleep(0.2)

    def ctl(self, *words: str) -> subprocess.CompletedProcess[str]:
        """A swarmctl of this machine, to its end."""
        return subprocess.run(
            [*_SWARMCTL, "--swarm", self.name, *words], capture_output=True, text=True, check=False
        )

    @property
    def status(self) -> Status:
        """What the robot says of itself, once it is heard."""
        self.wait(lambda seen: ROBOT in seen, "status")
        return self.statuses().get(ROBOT) or self.status

    def state_within(self, seconds: float, wanted: State) -> State:
        """The state of the robot once it is as wanted, or after some seconds."""
        deadline = time.monotonic() + seconds
        while (state := self.status.state) is not wanted and time.monotonic() < deadline:
            time.sleep(0.1)
        return state

    def _is_ready(self, status: Status | None) -> bool:
        return status is not None and status.health.driver_up and status.health.scan_rate > 0.0

    def _python_of(self, name: str) -> Sequence[str]:
        return self._python if name in self.robots else super()._python_of(name)

    def _environment_of(self, name: str) -> Mapping[str, str]:
        return {"SOCKET_OPTIONS": str(self.options)} if name in self.robots else {}


def main(python: Sequence[str]) -> int:
    """Tell the story with a Python; returns the exit code."""
    about = "import platform as p; print(p.machine(), p.python_version(), *p.libc_ver())"
    print(subprocess.run([*python, "-c", about], capture_output=True, text=True).stdout.strip())
    began = time.monotonic()
    is_good = True
    with ForeignSwarm(python) as swarm:
        print(f"the daemon was ready after {time.monotonic() - began:.0f} s")
        members = swarm.ctl("members", "-o", "json", "--timeout", "20s")
        is_good &= members.returncode == 0 and ROBOT in members.stdout
        print(f"members: exit code {members.returncode}")
        for words, wanted in STORY:
            done = swarm.ctl(*words.split(), "--timeout", "20s")
            state = swarm.state_within(STATE_TIMEOUT, wanted)
            speeds = []
            deadline = time.monotonic() + (DRIVES if wanted is State.RUNNING else 0.0)
            while time.monotonic() < deadline:
                decision = swarm.status.decision
                speeds.append(abs(decision.safe_linear) + abs(decision.safe_angular))
                time.sleep(0.2)
            has_driven = max(speeds, default=1.0) > 0.0
            is_good &= done.returncode == 0 and state is wanted and has_driven
            text = (done.stdout + done.stderr).strip().splitlines()[-1:]
            print(f"{words}: exit code {done.returncode}, {state}, {' '.join(text)}")
        health = swarm.status.health
        print(f"kernels: {swarm.status.kernels}; {health.scan_rate:.1f} scans a second; {health}")
        print(f"options that the emulator lacks: {sorted(swarm.served)}")
        if not is_good:
            print(swarm.ctl("describe", ROBOT).stdout)
            print(swarm._last_words())
    return int(not is_good)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
