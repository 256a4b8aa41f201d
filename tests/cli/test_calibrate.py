"""`swarmctl calibrate` with a daemon: what it refuses, Ctrl-C, and a whole calibration."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from swarmd.calibration.figures import Figure
from swarmd.cli.calibrate import _end_findings, _floor
from swarmd.core.messages import ScanDelaySummary, State, Status
from swarmd.network.operator.operator import Operator
from swarmd.network.operator.outcome import Outcome
from swarmd.network.settings import NetworkSettings
from swarmd.settings.settings import load_platform
from swarmd.sim.live.fleet import Fleet, FleetSpec
from swarmd.sim.live.starting import statuses_of
from tests.support.processes import unique_swarm, wait_until
from tests.support.statuses import status as make_status

pytestmark = pytest.mark.integration
ROBOT = "r01"
DISTURBED = 7
"""Exit code of a calibration whose robot was held, as for scans that a busy machine delays."""


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A Burger with weak brakes in the middle of a room of 3 x 2.6 m."""
    folder = tmp_path_factory.mktemp("fleet")
    weak = folder / "weak.yaml"
    body = "{linear_acceleration: 0.6, angular_acceleration: 2.4}"
    weak.write_text(f"extends: burger\nbody: {body}\n")
    name = unique_swarm()
    spec = FleetSpec(
        swarm=name, robots={ROBOT: str(weak)}, folder=folder, arena="3x2.6", layout="grid:0.6"
    )
    with Fleet(spec) as fleet:
        assert fleet
        wait_until(lambda: scans(name), "the robot scans", 60.0)
        yield name


def status(swarm: str) -> Status | None:
    with Operator(NetworkSettings(swarm=swarm)) as operator:
        return statuses_of(operator.members()).get(ROBOT)


def scans(swarm: str) -> bool:
    found = status(swarm)
    return found is not None and found.health.scan_rate > 0.0


def calibrate(swarm: str, *options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [str(Path(sys.executable).with_name("swarmctl")), "calibrate", ROBOT, *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "SWARM": swarm},
    )


def test_nothing_is_sent_without_confirmation(swarm: str) -> None:
    process = calibrate(swarm, "--floor", "2")
    assert "--yes" in process.communicate(timeout=30.0)[1]
    assert process.returncode == 2
    found = status(swarm)
    assert found is not None
    assert found.generation == 0


def test_a_file_is_not_overwritten_without_a_terminal(swarm: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("mine")
    process = calibrate(swarm, "--floor", "2", "--yes", "--write", str(file))
    assert "mine.yaml exists" in process.communicate(timeout=30.0)[1]
    assert process.returncode == 2
    assert file.read_text() == "mine"


def test_a_floor_that_is_not_free_is_refused(swarm: str) -> None:
    process = calibrate(swarm, "--floor", "3", "--yes")
    assert "is not free" in process.communicate(timeout=60.0)[1]
    assert process.returncode == 7


def test_an_interrupt_stops_the_robot(swarm: str) -> None:
    process = calibrate(swarm, "--floor", "2", "--yes")
    assert process.stderr is not None
    for line in process.stderr:
        if "drive 1" in line:
            break
    process.send_signal(signal.SIGINT)
    assert "commanded zero" in process.communicate(timeout=30.0)[1]
    assert process.returncode == 130
    found = status(swarm)
    assert found is not None
    assert found.state is State.STOPPED


@pytest.mark.timeout(600)
def test_a_calibration_finds_weak_brakes_and_writes_them(swarm: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    options = ("--floor", "2", "--yes", "--repeats", "2", "-o", "json", "--write", str(file))
    wanted = {
        "braking_linear": pytest.approx(0.6, rel=0.15),
        "braking_angular": pytest.approx(2.4, rel=0.15),
        "scan_delay": pytest.approx(0.1, abs=0.02),
    }
    for _ in range(5):  # the drives are in real time, so that other work may disturb some
        file.unlink(missing_ok=True)
        process = calibrate(swarm, *options)
        out, error = process.communicate(timeout=180.0)
        if process.returncode == DISTURBED and "held: " in error:
            continue
        assert process.returncode == 0, error
        figures = {name: one["value"] for name, one in json.loads(out)["figures"].items()}
        found = {name: figures[name] for name in wanted}
        if found == wanted:
            break
    assert process.returncode == 0, error
    assert found == wanted
    file.write_text(file.read_text().replace("extends: ./weak.yaml", "extends: burger"))
    barrier = load_platform(str(file)).protection["barrier"]
    assert barrier["braking_linear"] < 0.7
    assert barrier["braking_angular"] < 2.8
    assert "keeps the finding: braked at" in error  # the calibration confirms it
    ctl = [str(Path(sys.executable).with_name("swarmctl")), "reset", ROBOT]
    for words, kept in ([], True), (["--findings", "--reason", "a test"], False):
        done = subprocess.run(
            [*ctl, *words], capture_output=True, text=True, env={**os.environ, "SWARM": swarm}
        )
        assert done.returncode == 0
        assert "braked at" in done.stderr
        now = status(swarm)
        assert now is not None
        assert bool(now.findings) == kept
    now = status(swarm)
    assert now is not None
    assert any("(a test): braked at" in event.text for event in now.events)


FOUND = "braked at 0.60 +- 0.02 m/s2 in 3 stops, declared 1.00"
CAME = "2 things came at 0.60 +- 0.02 m/s or faster, declared at most 0.30"


class Resetting:
    """An operator that only takes requests."""

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []

    def request(self, kind: type, epochs: object, **fields: Any) -> Outcome:
        self.asked.append({"kind": kind, "epochs": epochs, **fields})
        return Outcome({}, missing=(ROBOT,))


@pytest.mark.parametrize(("braking", "ends"), [(0.97, True), (0.86, False), (0.6, False)])
def test_a_calibration_ends_findings_that_it_does_not_confirm(braking: float, ends: bool) -> None:
    """It ends nothing that it cannot tell, such as the speed of others."""
    found = make_status(ROBOT, findings=(FOUND, CAME))
    operator = Resetting()
    figure = Figure(braking, 0.02, 8, 1.0)
    _end_findings(operator, ROBOT, found, {"braking_linear": figure.text})  # type: ignore[arg-type]  # all that it uses
    assert [one["findings"] for one in operator.asked] == ([(FOUND,)] if ends else [])
    assert all(one["epochs"] == {ROBOT: found.epoch} for one in operator.asked)


def test_late_scans_need_a_larger_floor() -> None:
    """As a robot measures them, since each drive ends with the scans of its stop."""
    delays = [
        None,
        *(ScanDelaySummary(declared=0.05, added=added, bound=0.1) for added in (0.0, 0.23)),
    ]
    none, known, late = (
        _floor(make_status(ROBOT, platform="jackal", scan_delay=delay)) for delay in delays
    )
    assert none == known < late
