"""The verbs of swarmctl against real daemons.

r1 and r2 have bodies, so that their runs last; that of a robot without its body ends after 2 s.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest

from swarmd.network.operator.operator import Operator
from swarmd.network.settings import NetworkSettings
from swarmd.settings.settings import load_platform
from swarmd.sim.live.starting import statuses_of
from tests.support.fake_body import Body
from tests.support.processes import CAP, DaemonProcess, run_command, unique_swarm, wait_until

pytestmark = pytest.mark.integration

ROBOTS = ("r1", "r2", "r3")
NOWHERE = "tcp/127.0.0.1:9"
HANGS = """
from swarmd.api import Outputs, Params, Pattern
while True:
    pass
"""


class Swarm:
    """Three daemons and a terminal; the robots of `endpoints` have bodies there."""

    def __init__(
        self, folder: Path, name: str | None = None, endpoints: Mapping[str, str] | None = None
    ) -> None:
        self.name = name or unique_swarm()
        self.endpoints = endpoints or {}
        self.plugins = folder / "own"
        self.plugins.mkdir()
        (self.plugins / "hangs.py").write_text(HANGS)
        self.home = folder / "home"
        self.home.mkdir()
        self.operator = Operator(NetworkSettings(swarm=self.name))
        self.daemons = {robot: self.start(robot, folder) for robot in ROBOTS}

    def close(self) -> None:
        self.operator.close()
        for daemon in self.daemons.values():
            daemon.kill()

    def start(self, robot: str, folder: Path) -> DaemonProcess:
        """One more daemon."""
        return DaemonProcess(
            folder / robot,
            swarm=self.name,
            robot=robot,
            endpoint=self.endpoints.get(robot, NOWHERE),
            plugin_dir=self.plugins,
            options={"labels": {"red": ["r1"]}},
        )

    @property
    def environment(self) -> dict[str, str]:
        return {**os.environ, "HOME": str(self.home), "SWARM": self.name}

    def ctl(self, *args: str) -> subprocess.CompletedProcess[str]:
        """A swarmctl command; its standard input is no terminal."""
        return run_command("swarmctl", *args, cwd=self.home, SWARM=self.name)

    def json(self, *args: str) -> Any:
        answer = json.loads(self.ctl(*args, "-o", "json", "--timeout", "10s").stdout)
        assert answer["apiVersion"] == "swarm/v1"
        return answer

    def status(self, robot: str) -> Any:
        """The status in plain values, as an operator in this process sees it."""
        return msgspec.to_builtins(statuses_of(self.operator.members())[robot])

    def has_body(self, robot: str) -> bool:
        """True once the driver of the robot is connected."""
        return bool(self.status(robot)["health"]["driver_up"])

    def is_alive(self, *robots: str) -> bool:
        return set(robots) <= set(statuses_of(self.operator.members()))


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Swarm]:
    name = unique_swarm()
    platform = load_platform("waffle_pi")
    with ExitStack() as left:
        bodies = {
            robot: left.enter_context(Body(platform, swarm=name, robot=robot))
            for robot in ("r1", "r2")
        }
        endpoints = {robot: body.endpoint for robot, body in bodies.items()}
        swarm = Swarm(tmp_path_factory.mktemp("swarm"), name, endpoints)
        left.callback(swarm.close)
        for daemon in swarm.daemons.values():
            daemon.wait_ready()
        wait_until(lambda: swarm.is_alive(*ROBOTS), "all alive")
        wait_until(lambda: all(map(swarm.has_body, endpoints)), "the bodies are found")
        yield swarm


@pytest.fixture
def swarm(running: Swarm) -> Iterator[Swarm]:
    """The swarm, all stopped, without emergency stops; thawed and reset at the end."""
    running.operator.send_stop("stop", select=lambda names: (), names=ROBOTS)
    yield running
    for daemon in running.daemons.values():
        daemon.thaw()
    wait_until(lambda: running.is_alive(*ROBOTS), "all alive again")
    if any(running.status(robot)["latches"] for robot in ROBOTS):
        assert running.ctl("reset", "--all", "--yes").returncode == 0
    names = running.home / ".cache" / "swarmd" / f"members-dev-{running.name}.json"
    written = [path for path in running.home.rglob("*") if path.is_file()]
    assert written in ([], [names])  # no verb has written anything but names for completion


def last_line(done: subprocess.CompletedProcess[str]) -> str:
    return done.stdout.splitlines()[-1]


def test_members_lists_all_robots_and_problems(swarm: Swarm) -> None:
    done = swarm.ctl("members", "--timeout", "10s")
    lines = done.stdout.splitlines()
    assert (done.returncode, done.stderr) == (0, "")
    assert lines[0].split()[:4] == ["NAME", "STATE", "REASON", "PATTERN"]
    assert [line.split()[0] for line in lines[1:4]] == list(ROBOTS)
    assert lines[4] == "# 3/3 alive"
    assert lines[5].startswith("# driver lost: r3 (")


def test_run_ends_with_a_count(swarm: Swarm) -> None:
    done = swarm.ctl("run", "drive", "r1", "r[23]", "-p", "speed=0.1", "--for", "60s")
    assert (done.returncode, done.stderr) == (0, "")
    assert last_line(done) == "3 targeted, 3 applied"
    assert swarm.status("r2")["params"]["speed"] == {"value": 0.1, "source": "request"}


def test_a_run_ends_when_its_condition_holds(swarm: Swarm) -> None:
    done = swarm.ctl("run", "majority_rule", "r1", "--until", "nearer:1", "--until", "timeout:0.5")
    assert (done.returncode, done.stderr) == (0, "")
    wait_until(lambda: swarm.status("r1")["state"] != "running", "the run is over")
    status = swarm.status("r1")
    assert (status["state"], status["reason"]) == ("idle", "finished")
    assert status["detail"] == "until 0.5 s have passed"


def test_run_in_json_keeps_stdout_parseable(swarm: Swarm) -> None:
    answer = swarm.json("run", "drive", "--all", "--exclude", "r3")
    assert (answer["kind"], answer["exit_code"]) == ("Outcome", 0)
    assert answer["applied"] == ["r1", "r2"]
    assert answer["line"] == "2 targeted, 2 applied"


def test_estop_is_held_until_reset_names_it(swarm: Swarm) -> None:
    stopped = swarm.ctl("estop", "--reason", "smoke")
    assert (stopped.returncode, last_line(stopped)) == (0, "3 targeted, 3 applied")
    refused = swarm.ctl("run", "drive", "--all")
    assert (refused.returncode, last_line(refused)) == (
        7,
        "3 targeted, 0 applied, 3 refused (r1, r2, r3)",
    )
    ((latch_id, latch),) = swarm.status("r2")["latches"].items()
    assert (latch["scope"], latch["reason"]) == ("swarm", "smoke")
    reset = swarm.ctl("reset", "--all", "--yes", "--reason", "out")
    assert reset.returncode == 0
    assert (
        f"clears emergency stop {latch_id} of {latch['issuer']} for all robots (smoke)"
        in reset.stderr
    )
    assert [swarm.status(robot)["state"] for robot in ROBOTS] == ["idle"] * 3


def test_an_estop_of_named_robots_is_not_swarm_wide(swarm: Swarm) -> None:
    assert last_line(swarm.ctl("estop", "r1")) == "1 targeted, 1 applied"
    assert [latch["scope"] for latch in swarm.status("r1")["latches"].values()] == ["robots"]
    assert swarm.status("r2")["latches"] == {}


def test_estop_names_a_frozen_daemon_and_is_partial(swarm: Swarm) -> None:
    swarm.daemons["r2"].freeze()
    done = swarm.ctl("estop")
    assert done.returncode == 3
    assert last_line(done) == "3 targeted, 2 applied, 1 no answer (r2)"


def test_stop_counts_a_name_that_no_robot_has(swarm: Swarm) -> None:
    done = swarm.ctl("stop", "r1", "r11")
    assert done.returncode == 3
    assert last_line(done) == "2 targeted, 1 applied, 1 no answer (r11)"
    assert "'r1'" in done.stderr


def test_no_answer_in_time_ends_with_5(swarm: Swarm) -> None:
    swarm.daemons["r3"].freeze()
    done = swarm.ctl("run", "drive", "r3", "--timeout", "500ms")
    assert (done.returncode, last_line(done)) == (5, "1 targeted, 0 applied, 1 no answer (r3)")


def test_a_pattern_that_cannot_be_loaded_ends_with_1(swarm: Swarm) -> None:
    done = swarm.ctl("run", "hangs", "r1", "--timeout", "10s")
    assert (done.returncode, last_line(done)) == (1, "1 targeted, 0 applied, 1 failed (r1)")


def test_an_unreachable_swarm_names_the_swarms_found(swarm: Swarm) -> None:
    done = swarm.ctl("members", "--swarm", unique_swarm())
    assert done.returncode == 6
    assert swarm.name in done.stderr


def test_param_set_changes_and_param_get_shows_the_source(
    swarm: Swarm,
) -> None:
    swarm.ctl("run", "drive", "--all")
    done = swarm.ctl("param", "set", "r1", "speed=0.05", "-p", "turn=0.5")
    assert (done.returncode, last_line(done)) == (0, "1 targeted, 1 applied")
    look = ("param", "get", "--timeout", "10s")
    wait_until(lambda: "0.05" in swarm.ctl(*look, "r1").stdout, "speed 0.05 in force")
    rows = [line.split() for line in swarm.ctl(*look, "-k", "turn").stdout.splitlines()]
    assert rows[1] == ["r1", "drive", "turn", "0.5", "request"]
    assert rows[2][:4] == ["r2", "drive", "turn", "0"]
    assert swarm.ctl(*look, "-k", "trun").returncode == 2
    swarm.ctl("stop")
    assert last_line(swarm.ctl("param", "get", "r1")) == "# no pattern is running on r1"


def test_describe_explains_and_shows_everything(swarm: Swarm) -> None:
    lines = swarm.ctl("describe", "r1").stdout.splitlines()
    assert lines[0].startswith("r1: stopped: ")
    assert {"Robot", "State", "Protection", "Health", "Events"} <= set(lines)
    assert "  labels    red" in lines
    member = swarm.json("describe", "r1")["member"]
    assert (member["robot"], member["status"]["labels"]) == ("r1", ["red"])


# A process that makes its standard input its terminal, where Ctrl-C reaches it.
IN_TERMINAL = (
    "import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0);"
    " from swarmd.cli.swarmctl import main; main()"
)


def in_terminal(swarm: Swarm, act: Callable[[int, int], None], *args: str) -> tuple[int, str]:
    """Exit code and screen of a command in a terminal; `act(pid, terminal)` on its question."""
    terminal, own = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", IN_TERMINAL, *args],
        stdin=own, stdout=own, stderr=own,
        cwd=swarm.home, env=swarm.environment, start_new_session=True,
    )  # fmt: skip
    os.close(own)
    screen = b""
    try:
        while b"[y/N]" not in screen:
            screen += os.read(terminal, 1024)
        # A signal between the question and the read is noted only once a line has come.
        wait_until(lambda: reads_stdin(process.pid), "the command reads the answer")
        act(process.pid, terminal)
        while piece := os.read(terminal, 1024):
            screen += piece
    except OSError:  # how Linux says that the other end of a terminal is closed
        pass
    finally:
        os.close(terminal)
    return process.wait(CAP), screen.decode()


def reads_stdin(pid: int) -> bool:
    """Whether a process's main thread waits in a system call on descriptor 0."""
    words = Path(f"/proc/{pid}/syscall").read_text().split()
    return len(words) > 1 and words[1] == "0x0"


@pytest.mark.parametrize(
    ("act", "code", "state"),
    [
        (lambda pid, terminal: os.write(terminal, b"y\n"), 0, "idle"),
        (lambda pid, terminal: os.write(terminal, b"n\n"), 1, "estopped"),
        (lambda pid, terminal: os.write(terminal, b"\x03"), 130, "estopped"),
        (lambda pid, terminal: os.kill(pid, signal.SIGINT), 130, "estopped"),
    ],
    ids=["yes", "no", "ctrl-c", "sigint"],
)
def test_reset_asks_for_confirmation_on_a_terminal(
    swarm: Swarm, act: Callable[[int, int], None], code: int, state: str
) -> None:
    swarm.ctl("estop", "r1")
    found, screen = in_terminal(swarm, act, "reset", "r1", "r2")
    assert found == code, screen
    assert "Reset r1, r2?" in screen
    assert swarm.status("r1")["state"] == state


def test_reset_of_several_robots_without_a_terminal_needs_yes(swarm: Swarm) -> None:
    swarm.ctl("estop")
    refused = swarm.ctl("reset", "--all")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "--yes" in refused.stderr
    assert [swarm.status(robot)["state"] for robot in ROBOTS] == ["estopped"] * 3
    assert swarm.ctl("reset", "r1").returncode == 0
    assert [swarm.status(robot)["state"] for robot in ROBOTS] == ["idle", "estopped", "estopped"]


def test_a_killed_robot_is_listed_until_it_is_forgotten(
    tmp_path: Path,
) -> None:
    swarm = Swarm(tmp_path)
    try:
        for daemon in swarm.daemons.values():
            daemon.wait_ready()
        wait_until(lambda: swarm.is_alive(*ROBOTS), "all alive")
        swarm.daemons["r3"].kill()
        wait_until(lambda: "# failed: r3 (" in swarm.ctl("members").stdout, "r3 listed as failed")
        done = swarm.ctl("run", "drive", "--all")
        assert (done.returncode, last_line(done)) == (
            3,
            "3 targeted, 2 applied, 1 no answer (r3)",
        )
        swarm.daemons["r4"] = swarm.start("r4", tmp_path).wait_ready()  # has never met r3
        wait_until(lambda: swarm.is_alive("r1", "r2", "r4"), "r4 has joined")
        done = swarm.ctl("members", "forget", "r3")
        assert (done.returncode, last_line(done)) == (0, "3 targeted, 3 applied")
        assert "r3" not in swarm.ctl("members").stdout
        assert last_line(swarm.ctl("run", "drive", "--all")) == "3 targeted, 3 applied"
    finally:
        swarm.close()
