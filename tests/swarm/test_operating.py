"""What an operator wants of a swarm, against real daemons that drive: starts at one moment,
canaries, leases, waits, and swarm files."""

from __future__ import annotations

import signal
from functools import partial
from pathlib import Path

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import STATUS_SILENCE, Reason, State
from swarmd.core.values import Value
from swarmd.operator.session.exit_codes import NO_TARGET, REFUSED, TIMEOUT
from tests.support.fake_body import Body
from tests.support.processes import stop_process, wait_until
from tests.support.swarmctl import STALLED, Finished, ask_in_time
from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

NAMES = ("r1", "r2")
FAILS = '''
"""A pattern that fails once it has run for a while."""
from swarmd.api import Inputs, MovementPattern, Params, Twist

class Fails(MovementPattern[Params]):
    """Drives, then raises."""

    def drive(self, inputs: Inputs) -> Twist:
        raise RuntimeError("on purpose")
'''


@pytest.fixture(scope="module")
def bodies(shared_swarm: Swarm) -> dict[str, Body]:
    """Two robots that drive; r1 has the label red."""
    plugins = shared_swarm.folder / "own"
    plugins.mkdir()
    (plugins / "fails.py").write_text(FAILS)
    found = {name: shared_swarm.body(name) for name in NAMES}
    options: dict[str, Value] = {"labels": {"red": ["r1"]}, "plugin_dir": str(plugins)}
    daemons = [shared_swarm.spawn(name, body, options) for name, body in found.items()]
    for daemon in daemons:
        daemon.wait_ready()
    done = shared_swarm.ctl("wait", "--for", "presence=alive", "--for", "count=2")
    assert done.code == 0, done
    return found


@pytest.fixture
def swarm(shared_swarm: Swarm, bodies: dict[str, Body]) -> Swarm:
    """The swarm, all stopped."""
    shared_swarm.ctl("stop")
    return shared_swarm


def generation(swarm: Swarm, robot: str) -> int:
    goal = swarm.status(robot).goal
    return goal.held.goal.generation if goal is not None and goal.held is not None else 0


def test_runs_start_at_one_moment_by_measured_clocks(swarm: Swarm, bodies: dict[str, Body]) -> None:
    began = boottime()
    done = swarm.ctl("run", "drive", "--all", "--at", "+1s", "-o", "json")
    assert done.code == 0, done
    start = done.json["start"]
    assert set(start["clocks"]) == set(NAMES)
    assert start["skew"] == pytest.approx(sum(start["clocks"].values()), abs=0.01)
    assert min(body.wait_moving(began).at for body in bodies.values()) >= began + 1.0
    assert swarm.ctl("goal").code == 0


def test_ctrl_c_before_the_moment_stops_the_start(swarm: Swarm) -> None:
    before = swarm.status("r1").epoch.revision
    words = ("run", "drive", "r1", "--at", "+30s")

    def is_asked() -> bool:
        return swarm.status("r1").epoch.revision > before

    with swarm.begin_until(is_asked, "r1 is asked", *words) as process:
        asked = swarm.status("r1")
        process.send_signal(signal.SIGINT)
        assert process.finish().code == 130
    assert swarm.status("r1").epoch.revision > asked.epoch.revision
    assert swarm.ctl("run", "drive", "r1").code == 0  # and not: still loading


def test_each_run_sets_a_greater_goal_and_undo_sets_the_one_before(swarm: Swarm) -> None:
    assert swarm.ctl("run", "drive", "--all", "-p", "speed=0.1").code == 0
    before = generation(swarm, "r1")
    assert swarm.ctl("run", "drive", "-l", "red", "-p", "speed=0.05", user="bob").code == 0
    assert generation(swarm, "r1") == before + 1
    found = swarm.ctl("goal", "-o", "json")
    assert found.code == 0, found
    assert {one["desired"] for one in found.json["robots"].values()} == {"drive"}
    issuers = {one["issuer"].partition("@")[0] for one in found.json["goals"].values()}
    assert {"anna", "bob"} <= issuers
    assert swarm.ctl("undo").code == 0
    assert swarm.status("r1").params["speed"].value == 0.1
    assert generation(swarm, "r1") == before + 2


def test_a_canary_that_fails_is_stopped_and_the_others_are_left_alone(swarm: Swarm) -> None:
    assert swarm.ctl("run", "drive", "r2").code == 0
    epoch = swarm.status("r2").epoch
    done = swarm.ctl("run", "fails", "--all", "--canary", "r1", "--canary-time", "20s")
    assert done.code == 1, done
    assert "r1" in done.err
    left = swarm.status("r2")
    assert (left.state, left.pattern, left.epoch) == (State.RUNNING, "drive", epoch)
    assert swarm.status("r1").state is not State.RUNNING


def test_after_a_canary_that_runs_well_all_run(swarm: Swarm) -> None:
    done = swarm.ctl("run", "drive", "--all", "--canary", "1", "--canary-time", "1s")
    assert done.outcome == (0, "2 targeted, 2 applied")
    assert [swarm.status(name).state for name in NAMES] == [State.RUNNING] * 2


def test_a_robot_that_is_stopped_while_the_canary_runs_is_not_started_after_it(
    swarm: Swarm,
) -> None:
    def stopped() -> Finished:
        swarm.ctl("stop")
        words = ("run", "drive", "--all", "--canary", "r1", "--canary-time", "6s")
        runs = partial(swarm.are, State.RUNNING, "r1")
        with swarm.begin_until(runs, "r1 is running", *words) as process:
            assert swarm.ctl("stop", "r2", user="bob").code == 0
            return process.finish()

    done = ask_in_time(stopped)  # a stall of that process ends it before all are asked
    assert done.outcome == (3, "2 targeted, 1 applied, 1 refused (r2)")
    assert [swarm.status(name).state for name in NAMES] == [State.RUNNING, State.STOPPED]


def test_a_program_that_stood_still_calls_no_canary_silent_and_tells_what_it_started(
    swarm: Swarm,
) -> None:
    words = ("run", "drive", "--all", "--canary", "r1", "--canary-time", "4s")
    runs = partial(swarm.are, State.RUNNING, "r1")
    with swarm.begin_until(runs, "r1 is running", *words) as process:
        assert process.err.readline().startswith("canary: r1")
        stop_process(process.pid)
        stood = boottime()
        wait_until(lambda: boottime() > stood + STATUS_SILENCE + 0.1, "a silence, were it one")
        process.send_signal(signal.SIGCONT)
        done = process.finish()
    assert done.code == 1, done
    assert STALLED.search(done.err)
    assert "r1 started before" in done.err
    assert swarm.are(State.RUNNING, "r1")
    assert not swarm.are(State.RUNNING, "r2")


def test_a_run_with_a_lease_ends_with_its_operator(swarm: Swarm) -> None:
    run = partial(swarm.are, State.RUNNING, *NAMES)
    with swarm.begin_until(run, "both are running", "run", "drive", "--all", "--lease", "1s"):
        since = swarm.status("r1").uptime
        # It goes on beyond its lease while the operator is there.
        swarm.await_status("r1", "longer there", lambda status: status.uptime > since + 2.0)
        assert swarm.status("r1").state is State.RUNNING
    for name in NAMES:
        assert swarm.await_state(name, State.STOPPED).reason is Reason.LEASE_ENDED
    resumed = swarm.ctl("resume", "r1")
    assert resumed.code == REFUSED, resumed
    assert swarm.status("r1").reason is Reason.LEASE_ENDED
    assert swarm.ctl("run", "drive", "r1").code == 0
    held = generation(swarm, "r1")
    undone = swarm.ctl("undo")
    assert undone.code == NO_TARGET, undone
    assert generation(swarm, "r1") == held


def test_ctrl_c_stops_a_run_with_a_lease(swarm: Swarm) -> None:
    runs, words = partial(swarm.are, State.RUNNING, "r1"), ("run", "drive", "r1", "--lease", "10s")
    with swarm.begin_until(runs, "r1 is running", *words) as keeper:
        keeper.send_signal(signal.SIGINT)
        assert keeper.finish().outcome == (0, "1 targeted, 1 applied")
    assert swarm.status("r1").reason is Reason.OPERATOR


def test_wait_ends_when_robots_are_as_wanted_or_names_those_that_are_not(swarm: Swarm) -> None:
    waiting = swarm.begin("wait", "--for", "state=running", "--for", "pattern=drive", "r1")
    assert swarm.ctl("run", "drive", "r1").code == 0
    assert waiting.finish().code == 0

    def names_r2_alone() -> bool:
        """r1 has to answer in this time."""
        done = swarm.ctl("wait", "--for", "state=running", "--timeout", "500ms")
        assert done.code == TIMEOUT
        return "r2" in done.err and "r1" not in done.err

    wait_until(names_r2_alone, "r2 is named")


def test_a_second_apply_of_a_swarm_file_changes_nothing(swarm: Swarm, tmp_path: Path) -> None:
    file = tmp_path / "swarm.yaml"
    file.write_text(
        f"swarm: {swarm.name}\n"
        "labels: {blue: [r1, r2]}\n"
        "goal: {pattern: drive, params: {speed: 0.1}, targets: ['label:blue']}\n"
        "parameters: {robots: {r2: {drive: {turn: 0.2}}}}\n"
    )
    assert swarm.ctl("diff", str(file)).code == 3
    refused = swarm.ctl("apply", str(file))
    assert refused.code == 2
    assert "--yes" in refused.err
    assert swarm.status("r1").labels == ("red",)
    assert swarm.ctl("apply", str(file), "--yes").code == 0
    for name in NAMES:
        status = swarm.status(name)
        assert (status.state, status.labels) == (State.RUNNING, ("blue",))
    assert swarm.status("r2").params["turn"].value == 0.2
    held = generation(swarm, "r1")
    again = swarm.ctl("apply", str(file))
    assert (again.code, again.out) == (0, "nothing to change\n"), again
    assert swarm.ctl("diff", str(file)).code == 0
    assert generation(swarm, "r1") == held
    assert swarm.ctl("label", "--all", "--reset").code == 0
    wait_until(lambda: swarm.status("r1").labels == ("red",), "the labels of the file")
