"""`swarmctl calibrate` with a daemon: what it refuses, Ctrl-C, and a whole calibration."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core.messages import ScanDelaySummary, State, Status
from swarmd.core.values import Platform
from swarmd.link.settings import NetworkSettings
from swarmd.operator.acceptance.dialogue import Dialogue
from swarmd.operator.acceptance.step import Step
from swarmd.operator.acceptance.verdict import passed
from swarmd.operator.calibration.figures import Figure
from swarmd.operator.cli.calibrate import _ask_and_drive, _end_findings
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.verbs.acceptance import talk
from swarmd.settings.settings import load_platform
from swarmd.sim.live.fleet import Fleet, FleetSpec
from swarmd.sim.live.starting import statuses_of
from tests.operator.acceptance.person import person
from tests.support.fake_daemon import FakeDaemon, FakeSwarm, light_status
from tests.support.processes import CAP, unique_swarm, wait_until
from tests.support.statuses import status as make_status
from tests.support.swarmctl import SWARMCTL, Finished, swarmctl

pytestmark = pytest.mark.integration
ROBOT = "r01"
TRIES = 5
FAILED, DISTURBED = 1, 7
"""Exit codes of a calibration whose robot was held, as for scans that a busy machine delays: the
first if the hold ended its run."""


@contextmanager
def one_robot(folder: Path, platform: str) -> Iterator[str]:
    """The swarm of a robot in the middle of a room of 3 x 2.6 m."""
    name = unique_swarm()
    spec = FleetSpec(
        swarm=name, robots={ROBOT: platform}, folder=folder, arena="3x2.6", layout="grid:0.6"
    )
    with Fleet(spec) as fleet:
        assert fleet
        wait_until(lambda: scans(name), "the robot scans", 60.0)
        yield name


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with one_robot(tmp_path_factory.mktemp("fleet"), "burger") as name:
        yield name


def status(swarm: str) -> Status | None:
    with Operator(NetworkSettings(swarm=swarm)) as operator:
        return statuses_of(operator.members()).get(ROBOT)


def answered_status(swarm: str) -> Status:
    found: list[Status] = []

    def answers() -> bool:
        if (one := status(swarm)) is not None:
            found.append(one)
        return bool(found)

    wait_until(answers, "the robot answers")
    return found[0]


def is_ready(swarm: str) -> bool:
    """A busy machine may fault the robot, which then refuses each further try until a reset."""
    found = status(swarm)
    if found is not None and found.state is State.FAULTED:
        swarmctl("reset", ROBOT, "--yes", environ={"SWARM": swarm})
        return False
    return found is not None and found.state in (State.IDLE, State.STOPPED)


def scans(swarm: str) -> bool:
    found = status(swarm)
    return found is not None and found.health.scan_rate > 0.0


def calibrate(swarm: str, *options: str) -> Finished:
    return swarmctl("calibrate", ROBOT, *options, environ={"SWARM": swarm})


def test_nothing_is_sent_without_confirmation(swarm: str) -> None:
    done = calibrate(swarm, "--floor", "2")
    assert (done.code, "--yes" in done.err) == (2, True)
    assert answered_status(swarm).generation == 0


def test_only_a_yes_to_its_question_lets_the_robot_drive(swarm: str) -> None:
    with person(swarm, ROBOT, "--floor", "2", verb="calibrate") as one:
        one.press(b"y\n")  # before the question
        one.answer("sure")
        one.read_on("y, n, q")
        one.press(b"n\n")
        code = one.end()
    assert (code, "2 x 2 m" in one.words) == (DISTURBED, True), one.text
    assert answered_status(swarm).generation == 0


def test_a_file_is_not_overwritten_without_a_terminal(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("mine")
    done = calibrate(unique_swarm(), "--floor", "2", "--yes", "--write", str(file))
    assert (done.code, "mine.yaml exists" in done.err) == (2, True)
    assert file.read_text() == "mine"


def test_a_floor_that_is_not_free_is_refused(swarm: str) -> None:
    for _ in range(TRIES):  # on a busy machine the robot may be held
        done = calibrate(swarm, "--floor", "3", "--yes")
        if is_found := "is not free" in done.err:
            break
    assert (done.code, is_found) == (7, True), done


@pytest.mark.timeout(600)
def test_an_interrupt_stops_the_robot(swarm: str) -> None:
    for _ in range(TRIES):
        wait_until(lambda: is_ready(swarm), "the robot stands ready", 60.0)
        process = subprocess.Popen(
            [*SWARMCTL, "calibrate", ROBOT, "--floor", "2", "--yes"],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "SWARM": swarm},
        )
        assert process.stderr is not None
        lines = list[str]()
        while not (lines and "drive 1" in lines[-1]) and (line := process.stderr.readline()):
            lines.append(line)
        process.send_signal(signal.SIGINT)
        lines.append(process.communicate(timeout=CAP)[1])
        if process.returncode not in (FAILED, DISTURBED):  # such as: held before the first drive
            break
    assert process.returncode == 130, lines
    assert "commanded zero" in " ".join("".join(lines).split())
    assert answered_status(swarm).state is State.STOPPED


@pytest.mark.evidence
@pytest.mark.timeout(600)
def test_a_calibration_finds_weak_brakes_and_writes_them(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Measures the braking of a body in real time, over 40 s without a stall of the machine.

    In simulated time: tests/operator/calibration/test_lockstep.py; what is written: test_report.py
    there.
    """
    told: list[Any] = []  # of the findings: a single calibration is too short for one
    monkeypatch.setattr(
        "swarmd.operator.cli.calibrate._end_findings", lambda *given: told.append(given)
    )
    file = tmp_path / "mine.yaml"
    weak = tmp_path / "weak.yaml"  # which swarmctl learns from a recording
    body = "{linear_acceleration: 0.6, angular_acceleration: 2.4}"
    weak.write_text(f"extends: burger\nbody: {body}\n")
    options = ("--floor", "2", "--yes", "--repeats", "1", "-o", "json", "--write", str(file))
    wanted = {
        "braking_linear": pytest.approx(0.6, rel=0.15),
        "braking_angular": pytest.approx(2.4, rel=0.15),
        "scan_delay": pytest.approx(0.1, abs=0.02),
    }
    for _ in range(TRIES):  # the drives are in real time, so that other work may disturb some
        file.unlink(missing_ok=True)
        with one_robot(
            tmp_path_factory.mktemp("fleet"), str(weak)
        ) as swarm:  # where the floor is free
            done = calibrate(swarm, *options)
        if done.code in (FAILED, DISTURBED):  # such as: held in a drive, or stopped by protection
            continue
        assert done.code == 0, done
        figures = {name: one["value"] for name, one in done.json["figures"].items()}
        found = {name: figures[name] for name in wanted}
        if found == wanted:
            break
    assert done.code == 0, done
    assert found == wanted
    file.write_text(file.read_text().replace("extends: ./weak.yaml", "extends: burger"))
    barrier = load_platform(str(file)).protection["barrier"]
    assert barrier["braking_linear"] < 0.7
    assert barrier["braking_angular"] < 2.8
    assert told[-1][1] == ROBOT
    assert wanted.keys() <= told[-1][4].values.keys()


FOUND = "braked at 0.60 +- 0.02 m/s2 in 3 stops, declared 1.00"
CAME = "2 things came at 0.60 +- 0.02 m/s or faster, declared at most 0.30"


class Resetting:
    """An operator that only takes requests."""

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []

    def request(self, kind: type, epochs: object, **fields: Any) -> Outcome:
        self.asked.append({"kind": kind, "epochs": epochs, **fields})
        return Outcome({}, missing=(ROBOT,))


@pytest.mark.parametrize(
    ("finding", "axis"),
    [(FOUND, "linear"), (FOUND.replace("m/s2", "m/s2 sideways"), "lateral")],
)
@pytest.mark.parametrize(("braking", "ends"), [(0.97, True), (0.86, False), (0.6, False)])
def test_a_calibration_ends_findings_that_it_does_not_confirm(
    capsys: pytest.CaptureFixture[str], braking: float, ends: bool, finding: str, axis: str
) -> None:
    """It ends nothing that it cannot tell, such as the speed of others."""
    found = make_status(ROBOT, findings=(finding, CAME))
    operator = Resetting()
    figure = Figure(braking, 0.02, 8, 1.0)
    calibrated = passed("", **{f"braking_{axis}": figure.text})
    _end_findings(operator, ROBOT, found, load_platform("burger"), calibrated)  # type: ignore[arg-type]  # all that it uses
    assert [one["findings"] for one in operator.asked] == ([(finding,)] if ends else [])
    assert all(one["epochs"] == {ROBOT: found.epoch} for one in operator.asked)
    assert ("keeps the finding: braked at" in capsys.readouterr().err) is not ends


def test_a_reset_ends_findings_only_if_it_is_asked_to(monkeypatch: pytest.MonkeyPatch) -> None:
    def with_finding(daemon: FakeDaemon) -> Status:
        return replace(light_status(daemon.robot, daemon.instance), findings=(FOUND,))

    monkeypatch.setattr(FakeDaemon, "status", with_finding)
    settings = NetworkSettings(swarm=unique_swarm())
    with closing(FakeSwarm(settings, (ROBOT,))) as fleet:
        for words in (), ("--findings", "--reason", "a test"):
            done = swarmctl("reset", ROBOT, *words, environ={"SWARM": settings.swarm})
            assert (done.code, FOUND in done.err) == (0, True), done
        asked = [(one.findings, one.reason) for one in fleet[ROBOT].different_requests]  # type: ignore[union-attr]  # resets
    assert asked == [((), ""), ((FOUND,), "a test")]


class Opened:
    """A robot of a dialogue that is not carried out."""

    robot = ROBOT

    def open(self, platform: Platform) -> None:
        self.platform = platform


def test_late_scans_need_a_larger_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a robot measures them, since each drive ends with the scans of its stop."""
    asked: list[Step] = []

    class Silent:
        def __init__(self, dialogue: Dialogue, *_: object) -> None:
            asked.append(dialogue.steps[0])

        def run(self) -> None: ...

    monkeypatch.setattr(talk, "Talk", Silent)
    delays = [
        None,
        *(ScanDelaySummary(declared=0.05, added=added, bound=0.1) for added in (0.0, 0.23)),
    ]
    for delay in delays:
        found = make_status(ROBOT, platform="jackal", scan_delay=delay)
        _ask_and_drive(Opened(), found, None, 3, 0.0)  # type: ignore[arg-type]  # all that it uses
    motions = [step.motion for step in asked if step.motion is not None]
    none, known, late = (motion.params["floor"] for motion in motions)
    assert none == known < late
    assert [motion.reach for motion in motions] == [0.5 * none, 0.5 * known, 0.5 * late]
    assert {motion.params["repeats"] for motion in motions} == {3}
    assert not any(step.needs for step in asked)


def test_a_drone_is_refused_before_anything_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    def of_drone(daemon: FakeDaemon) -> Status:
        return replace(light_status(daemon.robot, daemon.instance), platform="crazyflie")

    monkeypatch.setattr(FakeDaemon, "status", of_drone)
    settings = NetworkSettings(swarm=unique_swarm())
    with closing(FakeSwarm(settings, (ROBOT,))) as fleet:
        words = ("calibrate", ROBOT, "--floor", "3", "--yes")
        done = swarmctl(*words, environ={"SWARM": settings.swarm})
        asked = fleet[ROBOT].different_requests
    assert (done.code, f"{ROBOT} is a drone" in done.err, list(asked)) == (DISTURBED, True, []), (
        done
    )
