"""The verbs of swarmctl against real daemons.

r1 and r2 have bodies, so that their runs last; that of a robot without its body ends after 2 s.
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from swarmd.core.messages import Param, Presence, Reason, State
from swarmd.operator.session.exit_codes import UNREACHABLE
from tests.support.processes import CAP, DaemonProcess, unique_swarm, wait_until
from tests.support.swarmctl import swarmctl

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

ROBOTS = ("r1", "r2", "r3")
HANGS = "import threading\nthreading.Event().wait()\n"


@pytest.fixture(scope="module")
def daemons(shared_swarm: Swarm) -> dict[str, DaemonProcess]:
    plugins = shared_swarm.folder / "own"
    plugins.mkdir()
    (plugins / "hangs.py").write_text(HANGS)
    bodies = {robot: shared_swarm.body(robot) for robot in ("r1", "r2")}
    options: dict[str, Any] = {"plugin_dir": str(plugins), "labels": {"red": ["r1"]}}
    found = {robot: shared_swarm.spawn(robot, bodies.get(robot), options) for robot in ROBOTS}
    for daemon in found.values():
        daemon.wait_ready()
    for robot in bodies:
        shared_swarm.await_status(robot, "connected", lambda one: one.health.driver_up)
    return found


@pytest.fixture
def swarm(shared_swarm: Swarm, daemons: dict[str, DaemonProcess]) -> Iterator[Swarm]:
    """The swarm, all stopped, without emergency stops; thawed and reset at the end."""
    shared_swarm.operator.send_stop("stop", select=lambda names: (), names=ROBOTS)
    yield shared_swarm
    for daemon in daemons.values():
        daemon.thaw()
    if any(shared_swarm.status(robot).latches for robot in daemons):
        assert shared_swarm.ctl("reset", "--all", "--yes").code == 0
    names = shared_swarm.home / f".cache/swarmd/members-dev-{shared_swarm.name}.json"
    written = [path for path in shared_swarm.home.rglob("*") if path.is_file()]
    assert written in ([], [names])  # no verb has written anything but names for completion


def states(swarm: Swarm) -> list[State]:
    return [swarm.status(robot).state for robot in ROBOTS]


def test_members_lists_all_robots_and_problems(swarm: Swarm) -> None:
    done = swarm.ctl("members", "--timeout", "10s")
    lines = done.out.splitlines()
    assert (done.code, done.err) == (0, "")
    assert lines[0].split()[:4] == ["NAME", "STATE", "REASON", "PATTERN"]
    assert [line.split()[0] for line in lines[1:4]] == list(ROBOTS)
    assert lines[4] == "# 3/3 alive"
    assert lines[5].startswith("# driver lost: r3 (")


def test_the_audit_log_has_requests_stops_and_refusals_of_each_robot(swarm: Swarm) -> None:
    stopped = swarm.ctl("stop", "--all")
    assert stopped.outcome == (3, "3 targeted, 2 applied, 1 failed (r3)")  # r3 has no base
    assert swarm.ctl("run", "no-such-pattern", "r1").code != 0
    entries = swarm.audit()
    assert {one["robot"] for one in entries if one["verb"] == "stop"} == set(ROBOTS)
    (refused,) = (one for one in entries if one["verb"] == "run")
    assert (refused["robot"], refused["targets"]) == ("r1", 1)
    assert refused["result"].startswith("refused")
    assert "@" in refused["operator"]
    assert refused["time"] is not None
    words = ("audit", "-l", "red", "-n", "1", "--since", "1h", "-o", "json")
    assert [one["robot"] for one in swarm.ctl(*words).json["entries"]] == ["r1"]
    assert "no-such-pattern" in swarm.ctl("audit", "r1").out


def test_logs_are_filtered_and_followed(swarm: Swarm) -> None:
    records = swarm.ctl("logs", "--grep", "READY IN SWARM", "-o", "json").json["records"]
    assert {one["robot"] for one in records} == set(ROBOTS)
    assert all("ready" in one["text"] for one in records)
    assert swarm.ctl("logs", "--level", "error", "-o", "json").json["records"] == []
    with swarm.begin("logs", "r1", "-f", "-o", "json", "--grep", "estop to") as follower:
        try:
            swarm.ctl("estop", "--all")
            first = json.loads(follower.out.readline())
        finally:
            follower.kill()
    assert (first["kind"], first["robot"]) == ("LogRecord", "r1")
    assert "estop to all robots" in first["text"]


def test_links_tell_who_hears_whom(swarm: Swarm) -> None:
    links: list[dict[str, Any]] = []

    def are_measured() -> bool:
        links[:] = swarm.ctl("links", "-o", "json").json["links"]
        pairs = {(one["robot"], one["hears"]) for one in links if one["round_trip"] is not None}
        return pairs == set(itertools.permutations(ROBOTS, 2))

    wait_until(are_measured, "each robot has measured its link to each other one")
    assert len(links) == 6
    for one in links:
        assert one["received"] > 0
        assert "multicast" in one["ways"]
    assert swarm.ctl("links", "r9").code == 4


def test_doctor_looks_at_this_machine_and_each_robot(swarm: Swarm) -> None:
    found = swarm.ctl("doctor", "-o", "json").json["findings"]
    assert {one["where"] for one in found} == {"this machine", *ROBOTS}
    of_r1 = {one["what"]: one for one in found if one["where"] == "r1"}
    assert {"skew", "version", "identity", "heard here", "hears", "state", "ports"} <= set(of_r1)
    assert of_r1["hears"]["finding"].startswith("2 of 2")
    shown = swarm.ctl("doctor", "--problems", "r1").out.splitlines()
    assert not any(line.startswith("ok") for line in shown)


def test_doctor_works_without_a_robot() -> None:
    there = {"SWARM": unique_swarm()}
    alone = swarmctl("doctor", "--timeout", "0.3s", environ=there)
    assert alone.code == 0
    assert "no robot of swarm" in alone.out
    wrong = swarmctl("doctor", "--profile", "dev", "--seed", "x", environ=there)
    assert wrong.code == 1
    assert "python" in wrong.out  # the rows of this machine


def test_run_ends_with_a_count(swarm: Swarm) -> None:
    done = swarm.ctl("run", "drive", "r1", "r[2-3]", "-p", "speed=0.1", "--for", "60s")
    assert (*done.outcome, done.err) == (0, "3 targeted, 3 applied", "")
    assert swarm.status("r2").params["speed"] == Param(value=0.1, source="request")
    answer = swarm.ctl("run", "drive", "--all", "--exclude", "r3", "-o", "json").json
    assert (answer["apiVersion"], answer["kind"], answer["exit_code"]) == ("swarm/v1", "Outcome", 0)
    assert answer["applied"] == ["r1", "r2"]
    assert answer["line"] == "2 targeted, 2 applied"


def test_a_run_ends_when_its_condition_holds(swarm: Swarm) -> None:
    done = swarm.ctl("run", "majority_rule", "r1", "--until", "nearer:1", "--until", "timeout:0.5")
    assert (done.code, done.err) == (0, "")
    status = swarm.await_status("r1", "over", lambda one: one.state is not State.RUNNING)
    assert (status.state, status.reason) == (State.IDLE, Reason.FINISHED)
    assert status.detail == "until 0.5 s have passed"


@pytest.mark.smoke
def test_an_estop_is_held_until_a_reset_names_it(swarm: Swarm) -> None:
    assert swarm.ctl("estop", "r1").outcome == (0, "1 targeted, 1 applied")
    assert [latch.scope for latch in swarm.status("r1").latches.values()] == ["robots"]
    assert swarm.status("r2").latches == {}
    stopped = swarm.ctl("estop", "--reason", "smoke")
    assert stopped.outcome == (3, "3 targeted, 2 applied, 1 failed (r3)")  # r3 has no base
    refused = swarm.ctl("run", "drive", "--all")
    assert refused.outcome == (7, "3 targeted, 0 applied, 3 refused (r1, r2, r3)")
    ((latch_id, latch),) = swarm.status("r2").latches.items()
    assert (latch.scope, latch.reason) == ("swarm", "smoke")
    refused = swarm.ctl("reset", "--all")
    assert (refused.code, refused.out) == (2, "")
    assert "--yes" in refused.err
    assert states(swarm) == [State.ESTOPPED] * 3
    assert swarm.ctl("reset", "r1").code == 0
    assert states(swarm) == [State.IDLE, State.ESTOPPED, State.ESTOPPED]
    reset = swarm.ctl("reset", "--all", "--yes", "--reason", "out")
    assert reset.code == 0
    assert f"clears emergency stop {latch_id} by {latch.issuer}, " in reset.err
    assert states(swarm) == [State.IDLE] * 3


def test_stop_counts_a_name_that_no_robot_has(swarm: Swarm) -> None:
    done = swarm.ctl("stop", "r1", "r11")
    assert done.outcome == (3, "2 targeted, 1 applied, 1 no answer (r11)")
    assert "'r1'" in done.err


def test_no_answer_in_time_ends_with_5(swarm: Swarm, daemons: dict[str, DaemonProcess]) -> None:
    daemons["r3"].freeze()
    done = swarm.ctl("run", "drive", "r3", "--timeout", "500ms")
    assert done.outcome == (5, "1 targeted, 0 applied, 1 no answer (r3)")


def test_a_pattern_that_cannot_be_loaded_ends_with_1(swarm: Swarm) -> None:
    done = swarm.ctl_once("run", "hangs", "r1", "--timeout", "10s")
    assert done.outcome == (1, "1 targeted, 0 applied, 1 failed (r1)")


def test_an_unreachable_swarm_names_the_swarms_found(swarm: Swarm) -> None:
    unknown = unique_swarm()

    def names_those_that_answer() -> bool:
        done = swarm.ctl_once("members", "--swarm", unknown)
        assert done.code == UNREACHABLE
        return swarm.name in done.err

    wait_until(names_those_that_answer, "this swarm is named")


def test_param_set_changes_and_param_get_shows_the_source(swarm: Swarm) -> None:
    swarm.ctl("run", "drive", "--all")
    done = swarm.ctl("param", "set", "r1", "speed=0.05", "-p", "turn=0.5")
    assert done.outcome == (0, "1 targeted, 1 applied")
    look = ("param", "get", "--timeout", "10s")
    wait_until(lambda: "0.05" in swarm.ctl(*look, "r1").out, "speed 0.05 in force")
    rows = [line.split() for line in swarm.ctl(*look).out.splitlines()]
    turns = [row for row in rows if row[2:3] == ["turn"]]
    assert turns[0] == ["r1", "drive", "turn", "0.5", "request"]
    assert turns[1][:4] == ["r2", "drive", "turn", "0"]
    swarm.ctl("stop")
    assert swarm.ctl("param", "get", "r1").outcome[1] == "# no pattern is running on r1"


def test_describe_explains_and_shows_everything(swarm: Swarm) -> None:
    lines = swarm.ctl("describe", "r1").out.splitlines()
    assert lines[0].startswith("r1: stopped: ")
    assert {"Robot", "State", "Protection", "Health", "Events"} <= set(lines)
    assert "  labels    red" in lines
    member = swarm.ctl("describe", "r1", "-o", "json").json["member"]
    assert (member["robot"], member["status"]["labels"]) == ("r1", ["red"])


# A process that makes its standard input its terminal, where Ctrl-C reaches it.
IN_TERMINAL = (
    "import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0);"
    " from swarmd.operator.cli.swarmctl import main; main()"
)


def in_terminal(swarm: Swarm, answer: bytes, *args: str) -> tuple[int, str]:
    """Exit code and screen of a command in a terminal that gets this answer to its question."""
    terminal, own = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", IN_TERMINAL, *args],
        stdin=own, stdout=own, stderr=own,
        env={**os.environ, **swarm.environ()}, start_new_session=True,
    )  # fmt: skip
    os.close(own)
    screen = b""
    try:
        while b"[y/N]" not in screen:
            screen += os.read(terminal, 1024)
        # A signal between the question and the read is noted only once a line has come.
        wait_until(lambda: reads_stdin(process.pid), "the command reads the answer")
        os.write(terminal, answer)
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
    ("answer", "code", "state"),
    [(b"y\n", 0, State.IDLE), (b"n\n", 1, State.ESTOPPED), (b"\x03", 130, State.ESTOPPED)],
    ids=["yes", "no", "ctrl-c"],
)
def test_reset_asks_for_confirmation_on_a_terminal(
    swarm: Swarm, answer: bytes, code: int, state: State
) -> None:
    swarm.ctl("estop", "r1")
    found, screen = in_terminal(swarm, answer, "reset", "r1", "r2")
    assert found == code, screen
    assert "Reset r1, r2?" in screen
    assert swarm.status("r1").state is state


def test_a_killed_robot_is_listed_until_it_is_forgotten_everywhere(
    swarm: Swarm, daemons: dict[str, DaemonProcess]
) -> None:
    """The last of this module. A robot that never met it forgets it, too."""
    refused = swarm.ctl("members", "forget", "r3")
    assert refused.code == 7
    assert refused.err == "error: r3 is alive; only robots that failed or left can be forgotten\n"
    daemons.pop("r3").kill()
    for peer in ("r1", "r2"):
        swarm.await_presence(peer, "r3", Presence.FAILED)
    assert "# failed: r3 (" in swarm.ctl("members").out
    done = swarm.ctl("run", "drive", "--all")
    assert done.outcome == (3, "3 targeted, 2 applied, 1 no answer (r3)")
    daemons["r4"] = swarm.start("r4")
    for peer in ("r1", "r2"):
        swarm.await_presence(peer, "r4", Presence.ALIVE)
    done = swarm.ctl("members", "forget", "r3")
    assert done.outcome == (0, "3 targeted, 3 applied")
    wait_until(lambda: swarm.presences("r1").keys() == {"r2", "r4"}, "r1 has forgotten it")
    wait_until(lambda: swarm.presences("r2").keys() == {"r1", "r4"}, "r2 has forgotten it")
    assert "r3" not in swarm.ctl("members").out
    assert swarm.ctl("run", "drive", "--all").outcome == (0, "3 targeted, 3 applied")
