"""The short form of the robot-hours: fixed seeds, every family of scenes, no collision.

The long form is `python -m studies.safety hours`; docs/evidence/safety.md has its results.
"""

from __future__ import annotations

import re

import pytest
from _pytest.mark import ParameterSet

from studies.safety.__main__ import main
from studies.safety.judge import collisions
from studies.safety.judgement import judge
from studies.safety.runs import attackers
from studies.safety.scenes import Scene, scenario
from swarmd.core.errors import ConfigError
from swarmd.sim.lockstep.lockstep import simulate_run

pytestmark = pytest.mark.long

SEED = 7


def evidence(family: str, platform: str, visibility: str, duration: float) -> ParameterSet:
    scene = Scene(family, platform, visibility, duration=duration)
    return pytest.param(scene, marks=pytest.mark.evidence)


@pytest.mark.parametrize(
    "scene",
    [
        Scene("goals", "burger", "real", duration=10.0),
        Scene("swap", "waffle_pi", "body", duration=10.0),
        Scene("rush", "waffle_pi", "real", duration=10.0),
        Scene("rush", "jackal", "real", duration=10.0),
        Scene("doors", "burger", "body", duration=10.0),
        Scene("poles", "waffle_pi", "body", duration=10.0),
        Scene("misuse", "burger", "body", duration=10.0),
        # Without protection these have one to three contacts; the others have ten and more.
        evidence("twists", "burger", "body", 10.0),
        evidence("twists", "jackal", "body", 10.0),
        evidence("goals", "mixed", "body", 20.0),
    ],
    ids=lambda scene: scene.name,
)
def test_a_protected_swarm_has_no_contact(scene: Scene) -> None:
    assert collisions(simulate_run(scenario(scene), SEED)) == []


@pytest.mark.parametrize(
    "scene",
    [Scene("lead", "burger", duration=10.0), evidence("flank_twists", "waffle_pi", "body", 20.0)],
    ids=lambda scene: scene.name,
)
def test_an_attacked_robot_does_not_drive_into_another(scene: Scene) -> None:
    trace = simulate_run(scenario(scene), SEED)
    among = attackers(trace)
    assert any({one.a, one.b} & among for one in collisions(trace, among))
    assert judge(trace, among).faults == 0


@pytest.mark.parametrize(("family", "least"), [("goals", 10), ("misuse", 2)])
def test_without_protection_the_same_swarms_collide(family: str, least: int) -> None:
    # Otherwise the tests above would pass without any effect of protection.
    trace = simulate_run(scenario(Scene(family, "burger", mode="off", duration=10.0)), SEED)
    assert len(collisions(trace)) > least


def test_a_single_run_prints_each_touch_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    main(("one", "rush", "burger", "body", "off", str(SEED), "--duration", "5"))
    touches, sums = capsys.readouterr().out.split("At fault:\n")
    first = touches.splitlines()[1]
    assert re.fullmatch(
        r" +\d+\.\d\d s  burger-\d+ and \S+: burger-\d+ closes at \d+\.\d cm/s, \d+\.\d at the"
        r" first step, pushed at \d+\.\d",
        first,
    )
    assert "  min gap [m]: 0.000" in sums.splitlines()


@pytest.mark.parametrize(
    "words", [("--families", "poles", "--platforms", "jackal"), ("--robot-hours", "0")]
)
def test_robot_hours_without_a_run_are_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError, match="none of these families"):
        main(("hours", *words))


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("hours", "--jobs", "0"), "0 is below 1"),
        (("one", "ram", "burger", "body", "barrier", "-1"), "-1 is below 0"),
    ],
)
def test_a_number_out_of_range_is_named(
    words: tuple[str, ...], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(words)
    assert text in capsys.readouterr().err
