"""Code that is replaced while robots run: tried first, then stopped, run again only if asked."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import Code, Reason, Status
from swarmd.core.messages import State as S
from swarmd.testing.driver_contract import is_running
from tests.support.processes import DaemonProcess, children, wait_until

if TYPE_CHECKING:
    from tests.support.fake_body import Body, Commanded
    from tests.support.swarmctl import Finished, Running
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

CODE = """
from swarmd.api import Annotated, Inputs, MovementPattern, Params, Twist, about

class OwnParams(Params, frozen=True):
    speed: Annotated[float, about("how fast", ge=0.0, le=1.0)] = 0.1

class Own(MovementPattern[OwnParams]):
    '''A test's.'''
    params_type = OwnParams
    needs = frozenset()

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(self.params.speed)

    def report(self):
        return {"version": VERSION}
"""
V1, V2 = (CODE.replace("VERSION", version) for version in "12")
HANGS = "import threading\nthreading.Event().wait()\n"
HOG = "hoard = []\nwhile True:\n    hoard.append(bytes(1 << 26))\n"


class Own:
    """A robot with a plugin folder that holds `own.py`."""

    def __init__(self, swarm: Swarm, folder: Path) -> None:
        self.swarm = swarm
        self.folder = folder
        folder.mkdir()
        self.write(V1)
        self.body: Body = swarm.body("r1")
        self.daemon: DaemonProcess = swarm.start(
            "r1", self.body, options={"plugin_dir": str(folder)}
        )

    def write(self, text: str) -> None:
        """Change the file."""
        (self.folder / "own.py").write_text(text)

    def run(self, *words: str) -> Status:
        """Run the pattern, and wait until it moves."""
        done = self.swarm.ctl("run", "own", "r1", *words)
        assert done.code == 0, done
        self.body.wait_moving(boottime())
        return self.at_version()

    def at_version(self, version: int | None = None) -> Status:
        """The first status that reports this version, or any."""

        def holds(status: Status) -> bool:
            told = status.report.get("version")
            return status.state is S.RUNNING and told is not None and version in (None, told)

        return self.swarm.await_status("r1", f"at version {version}", holds)

    def reload(self, *words: str, name: str = "own") -> Finished:
        """`swarmctl plugin reload NAME r1`."""
        return self.swarm.ctl("plugin", "reload", name, "r1", *words)

    def start_reload(self, *words: str, user: str = "anna") -> Running:
        """A reload of code that hangs, whose trial is under way."""
        self.run()
        self.write(HANGS)
        return self.swarm.begin_until(
            lambda: len(self.hosts()) == 2,
            "the trial is under way",
            *("plugin", "reload", "own", "r1", *words),
            user=user,
        )

    def hosts(self) -> list[int]:
        """The processes of its daemon."""
        return children(self.daemon.process.pid)

    def calm(self) -> None:
        """It stands and has version 1, whatever was before."""
        self.write(V1)
        assert self.swarm.ctl("stop").code == 0
        if self.swarm.status("r1").state is S.ESTOPPED:
            assert self.swarm.ctl("reset", "r1").code == 0
        assert self.reload().code == 0

    def check_undisturbed(self, moving: Commanded, before: Status) -> None:
        """Since `moving` it has run on all the time, the same object in the same process."""
        after = self.swarm.status("r1")
        assert (after.state, after.generation, after.report, after.params) == (
            S.RUNNING,
            before.generation,
            before.report,
            before.params,
        )
        assert after.health.host_restarts == before.health.host_restarts
        assert self.body.ran_since(moving)
        self.body.wait_moving(boottime())


@pytest.fixture(scope="module")
def robot(shared_swarm: Swarm, tmp_path_factory: pytest.TempPathFactory) -> Own:
    """One robot for all tests."""
    return Own(shared_swarm, tmp_path_factory.mktemp("shared") / "own")


@pytest.fixture
def own(robot: Own) -> Own:
    """The shared robot; it stands and has version 1."""
    robot.calm()
    return robot


def test_reloading_a_pattern_that_does_not_run_stops_nothing(robot: Own) -> None:
    """The first of this module: `robot` was never asked to run it."""
    done = robot.reload("--run")
    assert done.code == 0, done
    assert "idle, as before" in done.out
    assert robot.swarm.status("r1").state is S.IDLE
    robot.swarm.run_drive("r1")
    moving = robot.body.wait_stepped()
    before = robot.swarm.status("r1")
    done = robot.reload("--run")
    assert "drive goes on" in done.out
    robot.check_undisturbed(moving, before)
    robot.write(V2)
    robot.run()
    assert robot.at_version().report == {"version": 2}


def test_a_reload_stops_and_the_next_run_has_the_new_code(own: Own) -> None:
    own.run()
    assert own.at_version().report == {"version": 1}
    own.write(V2)
    done = own.reload()
    assert done.outcome == (0, "1 targeted, 1 applied"), done
    own.body.wait_zero(boottime())
    stopped = own.swarm.status("r1")
    assert (stopped.state, stopped.reason) == (S.STOPPED, Reason.RELOADED)
    assert stopped.detail.startswith("own, by anna@")
    own.run()
    assert own.at_version().report == {"version": 2}


def test_a_reload_with_run_keeps_the_parameters(own: Own) -> None:
    own.run("-p", "speed=0.05", "--for", "1h")
    own.write(V2)
    done = own.reload("--run")
    assert done.code == 0, done
    status = own.at_version(2)
    assert (status.params["speed"].value, status.params["speed"].source) == (0.05, "request")
    moving = own.body.wait_moving(boottime())
    assert moving.twist.linear == pytest.approx(0.05)
    texts = [event.text for event in status.events]
    assert any(text.startswith("own reloaded, by anna@") for text in texts), texts
    assert any(text.startswith("stopped (reloaded) own") for text in texts), texts


BROKEN = [
    ("import os\nimport nothing_of_that_name\n", "No module named 'nothing_of_that_name' (own"),
    ("x = 1\n\ndef broken(:\n", "SyntaxError: invalid syntax (own.py:3)"),
    ("x = 1\n", "must hold exactly one Pattern"),
    (V2.replace("speed:", "pace:"), "no parameter 'speed'; there are: avoidance, pace"),
    (V2.replace("needs =", "x = 1 / 0\n    needs ="), "ZeroDivisionError"),
    ("import os\nos._exit(3)\n", "ended with code 3"),
    ("import ctypes\nctypes.string_at(0)\n", "killed by SIGSEGV"),
    (HOG, "needed more memory than it may have"),
]


def test_code_that_does_not_load_is_refused_without_effect(own: Own) -> None:
    before = own.run("-p", "speed=0.05")
    for text, told in BROKEN:
        moving = own.body.wait_stepped(boottime())
        own.write(text)
        done = own.reload("--run", "-o", "json")
        reply = done.json["replies"]["r1"]
        assert (reply["code"], done.json["exit_code"]) == ("refused", done.code), done
        assert done.code in (2, 7)  # 2: a parameter that the new code does not know
        assert told in reply["text"]
        own.check_undisturbed(moving, before)
        wait_until(lambda: len(own.hosts()) == 1, "the trial's process is gone")
        assert is_running(own.hosts()[0])


@pytest.mark.evidence  # waits TRIAL_TIMEOUT; in the suite: tests/robot/test_requests_reload.py
def test_code_that_hangs_is_refused_and_its_process_ended(own: Own) -> None:
    before = own.run()
    moving = own.body.wait_stepped(boottime())
    own.write(HANGS)
    began = time.monotonic()
    done = own.reload()
    assert time.monotonic() - began < 20.0
    assert done.code == 7, done
    assert "own: loading took more than 10 s" in done.out
    own.check_undisturbed(moving, before)
    wait_until(lambda: len(own.hosts()) == 1, "the trial's process is gone")


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_ends_the_trial(own: Own, verb: str) -> None:
    begun = own.start_reload("--run", "-o", "json")
    stopped = own.swarm.ctl(verb, "r1")
    assert stopped.code == 0, stopped
    zero = own.body.wait_zero(boottime())
    done = begun.finish()
    assert done.code == 7, done
    assert "while the new code was being tried" in done.json["replies"]["r1"]["text"]
    wait_until(lambda: len(own.hosts()) == 1, "the trial's process is gone")
    own.body.wait(lambda command: command.scan_seq >= zero.scan_seq + 5, zero.at)
    assert not own.body.moved_since(zero.at)


def test_no_second_trial_and_no_run_during_a_trial(own: Own) -> None:
    begun = own.start_reload(user="ben")
    for words in (("plugin", "reload", "own", "r1"), ("run", "drive", "r1")):
        done = own.swarm.ctl(*words)
        assert done.code == 7, done
        assert "still trying own, by ben@" in done.out
    done = own.swarm.ctl("param", "set", "r1", "speed=0.2")
    assert done.code == 7, done
    assert own.swarm.ctl("stop", "r1").code == 0  # ends the trial, which would take 10 s
    assert begun.finish().code == 7


def test_only_patterns_that_exist_can_be_reloaded(own: Own) -> None:
    own.swarm.run_drive("r1")
    done = own.reload("--run", name="drive")
    assert done.code == 0, done
    assert "runs drive" in done.out
    done = own.reload(name="drvie")
    assert done.code == 2, done
    assert "no pattern 'drvie'" in done.err
    assert own.swarm.status("r1").state is S.RUNNING


def test_an_edit_without_reload_changes_nothing(own: Own) -> None:
    before = own.run()
    moving = own.body.wait_stepped(boottime())
    own.write("x = 1\n\ndef broken(:\n")
    done = own.swarm.ctl("run", "own", "r1", "-o", "json")
    assert done.json["replies"]["r1"]["code"] == Code.REFUSED.value
    after = own.swarm.status("r1")
    assert (after.state, after.pattern, after.report) == (S.RUNNING, "own", before.report)
    assert own.body.ran_since(moving)
    assert own.swarm.ctl("param", "set", "r1", "speed=0.07").code == 0


def test_a_daemon_that_ends_during_a_trial_leaves_no_process(own: Own) -> None:
    """The last of this module, since its daemon has ended."""
    begun = own.start_reload()
    hosts = own.hosts()
    assert own.daemon.terminate() == 0
    wait_until(lambda: not any(map(is_running, hosts)), "its processes are gone")
    assert begun.finish().code in (5, 7)
