"""What is mistyped: one clear line, a documented exit code, and the robot drives on undisturbed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import State, Status
from swarmd.operator.cli.daemon import exit_code_of, swarmd
from swarmd.operator.cli.swarmctl import run_cli
from tests.support.processes import wait_until

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
        self.body.wait_stepped()
        self._before: Status = swarm.status("r1")

    def check(self) -> None:
        """It still drives, by the same run and with the same parameters."""
        now, before = self.swarm.status("r1"), self._before
        assert (now.state, now.pattern, now.params) == (State.RUNNING, "drive", before.params)
        assert abs((now.uptime - now.since) - (before.uptime - before.since)) < 0.01
        self.body.wait_moving(boottime())


@pytest.fixture(scope="module")
def driving(shared_swarm: Swarm) -> Driving:
    """One robot for all mistakes, since none may change it."""
    return Driving(shared_swarm)


PATTERNS, PARAMETERS = "(see swarmctl patterns", "(see swarmctl patterns show"


@pytest.mark.parametrize(
    ("words", "code", "subjects"),
    [
        ("run drvie --all", 2, ["'drive'", PATTERNS, "swarmctl plugin push"]),
        ("run drive --all -p sped=0.1", 2, ["'speed'", PARAMETERS]),
        ("run drive --all -p speed=99", 2, ["speed is 99", PARAMETERS]),
        ("run drive --all -p speed=nan", 2, ["speed"]),
        ("run drive --all -p speed=fast", 2, ["speed"]),
        ("run drive r11", 4, ["'r1'"]),
        ("run drive --all --exclude r9", 4, ["r9"]),
        ("run drive --all --exclude r*", 4, ["targeted"]),
        ("param set r1 sped=1", 2, ["sped"]),
        ("param set r1 speed=-99", 2, ["speed is -99", PARAMETERS]),
        ("param get r9", 4, ["r9"]),
        ("stop r11", 4, ["'r1'"]),
        ("estop r11", 4, ["'r1'"]),
        ("reset r11", 4, ["'r1'"]),
        ("describe r11", 4, ["'r1'"]),
        ("members forget r1", 7, ["r1 is alive"]),
    ],
)
def test_swarmctl_reports_a_mistake_in_one_line(
    driving: Driving, words: str, code: int, subjects: list[str]
) -> None:
    """Mistakes that show once robots are known; tests/operator/cli/test_swarmctl.py has the
    others."""
    done = driving.swarm.ctl(*words.split())
    assert (done.code, done.err.count("\n")) == (code, 1), done
    assert (done.out == "") == (code != 2)  # what robots refuse is their answers, too
    assert done.err.startswith("error: ")
    assert all(subject in done.err for subject in subjects), done.err
    driving.check()


def test_an_unknown_swarm_is_reported_with_those_in_reach(driving: Driving) -> None:
    for verb in ("members", "estop"):
        wait_until(lambda: is_named_among_others(driving.swarm, verb), "the swarm is named")  # noqa: B023
    driving.check()


def is_named_among_others(swarm: Swarm, verb: str) -> bool:
    """Whether the swarm answers in time to a request to another one, which is an error."""
    done = swarm.ctl_once(verb, "--swarm", "nowhere", "--timeout", "200ms")
    assert (done.code, done.out, done.err.count("\n")) == (6, "", 1)
    assert done.err.startswith("error: no daemon of swarm 'nowhere' "), done.err
    there = re.search(r" swarms: (.*) \(see .*\n", done.err)
    return there is not None and swarm.name in there[1].split(", ")


@pytest.mark.parametrize(
    ("text", "subject"),
    [
        ("platform: wafle_pi", "'waffle_pi'"),
        ("plattform: waffle_pi", "'platform'"),
        ("platform: burger\nplatform: jackal", "'platform'"),
        ("lease: 0.01", "lease is 0.01"),
        ("lease: .nan", "lease is nan"),
        ("profile: feld", "'feld'"),
        ("driver: simulted", "'simulated'"),
        ("id: R1", "'R1'"),
        ("roster: r1", "roster is 'r1'"),
        ("parameters: {robots: {r1: {drive: {speed: [1]}}}}", "parameters.robots.r1.drive.speed"),
        ("id: r1\nlabels: {r1: [red]}", "red: [r1]"),
        ("parameters: {labels: {red: {}}}", "'red'"),
        ("labels: {red: [r9]}\nroster: [r1]", "'r9'"),
        ("a: b: c", "swarmd.yaml"),
        ("[r1]", "expected"),
    ],
)
def test_swarmd_reports_a_mistake_in_one_line(
    driving: Driving, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, subject: str
) -> None:
    """In a file that is right otherwise, and names the body of the robot that drives."""
    config = tmp_path / "swarmd.yaml"
    common = f"swarm: {driving.swarm.name}\ndriver_options: {{endpoint: {driving.body.endpoint}}}\n"
    config.write_text(text if text.startswith("[") else common + text + "\n")
    assert run_cli(swarmd, ["--config", str(config)], "swarmd", exit_code_of) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1), said
    assert said.err.startswith("error: ")
    assert subject in said.err
    driving.check()
