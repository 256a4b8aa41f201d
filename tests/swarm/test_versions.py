"""Robots of other versions beside one of this version: of another wire, and of an earlier commit.

A change of a message adds its row: it works between the versions, or is refused in a line.
"""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from swarmd.core import codec
from swarmd.core.clock import boottime
from swarmd.core.messages import Reason, State, Status
from swarmd.core.values import Value
from swarmd.operator.session.exit_codes import UNREACHABLE
from swarmd.operator.session.members_view import Dials
from swarmd.operator.session.operator import Operator
from tests.support import earlier_version
from tests.support.keys import SwarmKeys
from tests.support.processes import CAP, DAEMON, DaemonProcess, attempts, free_endpoint, wait_until
from tests.support.swarmctl import STALLED, Finished, ask_in_time, heard_statuses
from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

OFFSETS = {"r2": 1, "r3": -1}


def test_robots_of_other_versions_are_stopped_and_shown_and_refuse_the_rest_by_name(
    swarm: Swarm, tmp_path: Path
) -> None:
    """r2 is newer, r3 older."""
    swarm.spawn("r1", swarm.resting("r1"))
    endpoints = {robot: free_endpoint() for robot in OFFSETS}
    with contextlib.ExitStack() as left:
        others = {
            robot: left.enter_context(
                DaemonProcess(
                    tmp_path / robot,
                    swarm=swarm.name,
                    robot=robot,
                    endpoint=endpoints[robot],
                    module=(
                        "tests.support.other_version",
                        str(offset),
                        swarm.name,
                        robot,
                        endpoints[robot],
                    ),
                )
            )
            for robot, offset in OFFSETS.items()
        }
        for other in others.values():
            other.wait_ready()
        swarm.status("r1")
        speaks = {
            robot: f"speaks {codec.VERSION + offset}, this swarmctl {codec.VERSION}"
            for robot, offset in OFFSETS.items()
        }
        shown = swarm.ctl("members")
        assert shown.code == 0
        rows = [line.split() for line in shown.out.splitlines()]
        for robot, text in speaks.items():
            assert f"{robot} {text}" in shown.out
            (row,) = (row for row in rows if row[:1] == [robot])
            assert row[:3] == [robot, "idle", "never_asked"]
        assert "# other version: " in shown.out

        ran = swarm.ctl("run", "drive", "--all")
        assert ran.outcome == (3, "3 targeted, 1 applied, 2 refused (r2, r3)")
        assert all(f"{robot} {text}" in ran.out for robot, text in speaks.items())
        for robot, other in others.items():
            done = swarm.ctl("run", "drive", robot)
            assert done.outcome == (7, f"1 targeted, 0 applied, 1 refused ({robot})")
            wait_until(  # the answer comes before the line
                lambda other=other: other.text().count("refused (other_version)") == 2,  # type: ignore[misc]
                "two refusals",
            )

        assert swarm.ctl("stop").outcome == (0, "3 targeted, 3 applied")
        assert swarm.ctl("estop", "r2").outcome == (0, "1 targeted, 1 applied")
        assert swarm.ctl("estop").outcome == (0, "3 targeted, 3 applied")
        listed = swarm.ctl("members", "-o", "json").json["members"]
        assert {one["robot"]: one["state"] for one in listed} == {
            "r1": "estopped",
            "r2": "estopped",
            "r3": "estopped",
        }
        assert all(text in swarm.ctl("describe", robot).out for robot, text in speaks.items())


THIS, EARLIER = "this", "earlier"
ROBOTS = {"r1": THIS, "r2": EARLIER}
LEASE = 4.0  # s: longer than stalls of the machine
AFTER = 10.0  # s of an incident that a robot keeps after it, before it writes the file
ATTEMPTS = 8  # runs that a stall of a robot may end before one goes on
# Whether the swarm is secured, and the version of swarmctl.
WAYS = [(False, EARLIER), (True, THIS), (True, EARLIER)]


class Meeting:
    """A robot of this version and one of an earlier version, and swarmctl of both."""

    def __init__(self, swarm: Swarm, *, is_secured: bool) -> None:
        self.swarm, self.is_secured = swarm, is_secured
        self._options: tuple[str, ...] = ()
        identities: dict[str, dict[str, Value]] = {robot: {} for robot in ROBOTS}
        identity = None
        if is_secured:
            keys = SwarmKeys(swarm.folder / "keys", swarm.name, ROBOTS, operators=("anna",))
            identities = {robot: {"identity": str(keys.folder_of(robot))} for robot in ROBOTS}
            self._options = ("--identity", str(keys.folder_of("anna")))
            identity = keys["anna"]
        daemons = [
            swarm.spawn(
                robot,
                swarm.body(robot),
                identities[robot],
                earlier_version.PREFIX if version == EARLIER else (),
                earlier_version.DAEMON if version == EARLIER else DAEMON,
            )
            for robot, version in ROBOTS.items()
        ]
        for daemon in daemons:
            daemon.wait_ready()
        self.left = contextlib.ExitStack()
        self.operator = self.left.enter_context(Operator(swarm.settings, identity=identity))
        self.statuses()

    def statuses(self) -> Mapping[str, Status]:
        """The status of each robot, as an operator of this version reads it."""
        return heard_statuses(self.operator, ROBOTS)

    def are(self, state: State) -> bool:
        """True if both robots are in the state; looked at ten times a second at most."""
        time.sleep(0.1)
        return {status.state for status in self.statuses().values()} == {state}

    def await_states(self, state: State) -> Mapping[str, Status]:
        """Wait until both robots are in the state; their statuses then."""
        wait_until(lambda: self.are(state), f"both are {state}")
        return self.statuses()

    def run(self, version: str) -> None:
        """A swarmctl of a version runs both robots; again if a stall has ended a run."""
        for _ in range(ATTEMPTS):
            self.obey(version, None, "run", "drive", "--all")
            wait_until(lambda: self.are(State.RUNNING) or has_stalled(self.statuses()), "both run")
            if self.are(State.RUNNING):
                return

    def obey(self, version: str, state: State | None, *words: str) -> None:
        """Both robots do what a swarmctl of a version says, and are in the state then."""
        done = self.ctl(version, *words)
        assert done.outcome == (0, "2 targeted, 2 applied"), done
        if state is not None:
            self.await_states(state)

    def ctl(self, version: str, *words: str) -> Finished:
        """A swarmctl of a version; asked again if the machine stalled."""
        if version == THIS:
            return self.swarm.ctl(*words, *self._options)
        environ = self.swarm.environ()
        whole = (*words, *self._options)
        return ask_in_time(
            lambda: earlier_version.earlier_swarmctl(*whole, environ=environ), late=(UNREACHABLE,)
        )

    @contextlib.contextmanager
    def held(self, version: str) -> Iterator[None]:
        """A swarmctl of a version runs both robots with a lease, and is killed at the end."""
        words = ("run", "drive", "--all", "--lease", f"{LEASE:g}s", *self._options)

        before = {robot: one.epoch.revision for robot, one in self.statuses().items()}

        def is_begun() -> bool:
            time.sleep(0.1)
            return all(
                one.epoch.revision > before[robot]
                and (one.state is State.RUNNING or one.reason is Reason.LOOP_STALLED)
                for robot, one in self.statuses().items()
            )

        if version == THIS:
            with self.swarm.begin_until(is_begun, "both run", *words):
                yield
            return
        log, environ = self.swarm.folder / "earlier.log", self.swarm.environ()
        for _ in attempts("both run"):
            process = earlier_version.begin_swarmctl(*words, environ=environ, log=log)
            try:
                if _goes_on_until(process, is_begun):
                    yield
                    return
            finally:
                process.kill()
                process.wait(CAP)
            assert STALLED.search(log.read_text()), log.read_text()


def has_stalled(statuses: Mapping[str, Status]) -> bool:
    """True if a stall of the machine has ended the run of a robot."""
    return any(one.reason is Reason.LOOP_STALLED for one in statuses.values())


def _await_time(at: float) -> None:
    """Wait until a time on the clock of this machine, in s."""
    wait_until(lambda: boottime() > at, "the time has come")


def _goes_on_until(process: subprocess.Popen[bytes], holds: Callable[[], bool]) -> bool:
    """Wait until it holds or the process has ended; True if the process goes on."""
    wait_until(lambda: holds() or process.poll() is not None, "both run")
    return process.poll() is None


@pytest.fixture(scope="module")
def meeting(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Meeting]:
    """A meeting in a secured swarm, or in one without keys; pytest begins each of them once."""
    earlier_version.need_earlier_version()
    with (
        contextlib.closing(Swarm(tmp_path_factory.mktemp("meeting"))) as swarm,
        contextlib.ExitStack() as left,
    ):
        made = Meeting(swarm, is_secured=request.param)
        left.enter_context(made.left)
        yield made


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("meeting", "version"), WAYS, indirect=["meeting"], scope="module")
def test_robots_of_two_versions_obey_operators_of_both(meeting: Meeting, version: str) -> None:
    """Members, run, stop, emergency stop and reset: each works."""
    listed = meeting.ctl(version, "members", "-o", "json")
    assert listed.code == 0, listed
    assert {one["robot"] for one in listed.json["members"]} == ROBOTS.keys()
    meeting.run(version)
    meeting.obey(version, State.STOPPED, "stop")
    meeting.obey(version, State.ESTOPPED, "estop")
    meeting.obey(version, State.IDLE, "reset", "--all", "--yes")


@pytest.mark.timeout(600)
@pytest.mark.parametrize("meeting", [False], indirect=True, scope="module")
def test_a_look_by_datagrams_dials_the_earlier_robot_alone(meeting: Meeting) -> None:
    """Or this one, too, if a stall has lost its parts: the answer is whole in each case."""
    with Operator(meeting.swarm.settings) as operator:
        view = operator.members(dials=Dials.UNTOLD)
        dialled = {robot for robot, _ in operator._sessions._dialled}
    assert view.answered == ROBOTS.keys()
    assert all(view.members[robot].status is not None for robot in ROBOTS)
    assert "r2" in dialled


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("meeting", "version", "others"),
    [(*way, {"r2"} if way == (True, EARLIER) else {"r1", "r2"}) for way in WAYS],
    indirect=["meeting"],
    scope="module",
)
def test_a_run_lease_holds_between_two_versions_or_ends_in_a_line(
    meeting: Meeting, version: str, others: set[str]
) -> None:
    """In a secured swarm the lease of an earlier operator has no time: this version says so.

    `others`: the robots that go on beyond the first lease.
    """
    for _ in range(ATTEMPTS):
        with meeting.held(version):
            _await_time(boottime() + 1.5 * LEASE)  # the first lease is long over
            statuses = meeting.statuses()
        ended = meeting.await_states(State.STOPPED)
        if not has_stalled(ended):
            break
    assert {robot for robot, one in statuses.items() if one.state is State.RUNNING} == others
    assert {one.reason for one in ended.values()} == {Reason.LEASE_ENDED}
    assert all("older swarmctl" in ended[robot].detail for robot in ROBOTS.keys() - others)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("meeting", [True], indirect=True, ids=["secured"], scope="module")
def test_marks_at_a_robot_of_one_version_are_kept_by_one_of_the_other(meeting: Meeting) -> None:
    """And swarmctl of both versions lists them of both robots."""
    marks = {THIS: "r2", EARLIER: "r1"}
    for version, robot in marks.items():

        def is_marked(version: str = version, robot: str = robot) -> bool:
            """A robot takes one mark in 10 s."""
            return meeting.ctl(version, "incident", "mark", f"seen by {version}", robot).code == 0

        wait_until(is_marked, "the mark is taken")

    def are_kept_by_both() -> bool:
        """A robot may not have answered, and a mark whose answer was late was made again."""
        for version in marks:
            found = (meeting.ctl(version, "incidents", "-o", "json").json or {}).get(
                "incidents", ()
            )
            for words in (f"seen by {one}" for one in marks):
                rows = [one["kept"] for one in found if words in one["text"]]
                kept = [{one["robot"] for one in row if one["size"]} for row in rows]
                if ROBOTS.keys() not in kept:
                    return False
        return True

    _await_time(boottime() + AFTER)  # each look of the earlier version is a process
    wait_until(are_kept_by_both, "both keep both", cap=2.0 * CAP)
