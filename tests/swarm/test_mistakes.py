"""What is mistyped: one clear line, a documented exit code, and the robot drives on undisturbed."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import State, Status
from tests.support.processes import CAP

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


class Driving:
    """A robot that drives, and has to go on doing so."""

    def __init__(self, swarm: Swarm) -> None:
        self.swarm = swarm
        self.body = swarm.body("r1")
        self.daemon = swarm.start("r1", self.body)
        swarm.run_drive("r1")
        self._moving = self.body.wait_stepped()
        self._before: Status = swarm.status("r1")

    def check(self) -> None:
        """It still drives, and did all the time."""
        now, before = self.swarm.status("r1"), self._before
        assert (now.state, now.pattern, now.params) == (State.RUNNING, "drive", before.params)
        self.body.wait_moving(boottime())
        assert self.body.ran_since(self._moving)


@pytest.fixture(scope="module")
def driving(shared_swarm: Swarm) -> Driving:
    """One robot for all mistakes, since none may change it."""
    return Driving(shared_swarm)


NO_ROBOT = "error: no robot 'r9'; there are: r1; see `swarmctl members`"
SPEED = "m/s (from runtime); wanted is a float from -2 to 2 m/s"


@pytest.mark.parametrize(
    ("words", "code", "line"),
    [
        ("run drvie --all", 2, "error: no pattern 'drvie'; did you mean 'drive'?"),
        ("run ../drive --all", 2, "error: '../drive' is no pattern name"),
        ("run drive", 2, "error: run needs targets"),
        ("run drive --all r1", 2, "error: run takes names or --all, not both"),
        ("run drive R1", 2, "error: 'R1' is no robot name"),
        ("run drive --all -p sped=0.1", 2, "error: no parameter 'sped'; did you mean 'speed'?"),
        ("run drive --all -p speed=99", 2, f"error: parameter speed is 99 {SPEED}"),
        ("run drive --all -p speed=nan", 2, f"error: parameter speed is 'nan' {SPEED}"),
        ("run drive --all -p speed=fast", 2, f"error: parameter speed is 'fast' {SPEED}"),
        ("run drive --all -p speed", 2, "error: -p 'speed' is no key=value"),
        ("run drive --all -p speed=0 -p speed=1", 2, "error: -p speed is given twice"),
        ("run drive --all --for soon", 2, "error: Invalid value for '--for': 'soon'"),
        ("run drive --all --for 0s", 2, "error: Invalid value for '--for': '0s'"),
        ("run drive --all --fro 60s", 2, "error: No such option '--fro'"),
        ("run drive r9", 4, NO_ROBOT),
        ("run drive --all --exclude r9", 4, NO_ROBOT),
        ("run drive --all --exclude r*", 4, "error: no robot is targeted"),
        ("param set r1 sped=1", 2, "error: no parameter 'sped'; did you mean 'speed'?"),
        ("param set r1 speed=-99", 2, f"error: parameter speed is -99 {SPEED}"),
        ("param set r1", 2, "error: param set needs values"),
        ("param set speed=1", 2, "error: param set needs targets"),
        ("param get r9", 4, NO_ROBOT),
        ("stopp", 2, "error: no verb 'stopp'; did you mean 'stop'?"),
        ("stop r9", 4, NO_ROBOT),
        ("estop r9", 4, NO_ROBOT),
        ("reset", 2, "error: reset needs targets"),
        ("reset r9", 4, NO_ROBOT),
        ("describe r9", 4, NO_ROBOT),
        ("patterns show drvie", 2, "error: no pattern 'drvie'; did you mean 'drive'?"),
        ("members forget r1", 7, "error: r1 is alive;"),
        ("members -o yaml", 2, "error: Invalid value for '-o'"),
        ("members --swarm NOPE", 2, "error: swarm is 'NOPE'; wanted are 1 to 63 of a-z"),
        ("members --profile field", 2, "error: profile field needs `interface`"),
        ("members --config none.yaml", 2, "error: none.yaml: cannot be read: No such file"),
    ],
)
def test_swarmctl_reports_a_mistake_in_one_line(
    driving: Driving, words: str, code: int, line: str
) -> None:
    done = driving.swarm.ctl(*words.split())
    assert (done.code, done.err.count("\n")) == (code, 1), done
    assert done.err.startswith(line)
    driving.check()


def test_an_unknown_swarm_is_reported_with_those_in_reach(driving: Driving) -> None:
    for verb in ("members", "estop"):
        done = driving.swarm.ctl(verb, "--swarm", "nowhere")
        assert (done.code, done.out, done.err.count("\n")) == (6, "", 1)
        there = re.fullmatch(
            r"error: no daemon of swarm 'nowhere' .* swarms: (.*) \(see .*\n", done.err
        )
        assert there, done.err
        assert driving.swarm.name in there[1].split(", ")
    driving.check()


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("platform: wafle_pi", "no platform 'wafle_pi'; did you mean 'waffle_pi'?"),
        ("plattform: waffle_pi", "no key 'plattform'; did you mean 'platform'?"),
        ("platform: burger\nplatform: jackal", "key 'platform' stands twice, first in line"),
        ("lease: 0.01", "lease is 0.01; wanted a number of at least 0.2"),
        ("lease: .nan", "lease is nan; wanted"),
        ("profile: feld", "profile is 'feld'; wanted"),
        ("driver: simulted", "no driver 'simulted'; did you mean 'simulated'?"),
        ("id: R1", "id is 'R1'; wanted are 1 to 63"),
        ("roster: r1", "roster is 'r1'; wanted"),
        ("parameters: {robots: {r1: {drive: {speed: [1]}}}}", "parameters.robots.r1.drive.speed"),
        ("parameters: {labels: {red: {}}}", "no label 'red'"),
        ("labels: {red: [r9]}\nroster: [r1]", "no robot in the roster 'r9'; there are: r1"),
        ("a: b: c", "mapping values are not allowed here"),
        ("[r1]", "wanted"),
    ],
)
def test_swarmd_reports_a_mistake_in_one_line(
    driving: Driving, tmp_path: Path, text: str, line: str
) -> None:
    """In a file that is right otherwise, and names the body of the robot that drives."""
    config = tmp_path / "swarmd.yaml"
    common = f"swarm: {driving.swarm.name}\ndriver_options: {{endpoint: {driving.body.endpoint}}}\n"
    config.write_text(text if text.startswith("[") else common + text + "\n")
    command = [sys.executable, "-m", "swarmd.cli.daemon", "--config", str(config)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=CAP, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done
    assert done.stderr.startswith("error: ")
    assert line in done.stderr
    driving.check()
