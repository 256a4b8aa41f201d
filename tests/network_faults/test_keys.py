"""A secured swarm on a radio that fails; with `make network` every test here has keys, too."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR, TRUE, VERBS, judge, prepare
from tests.support.processes import wait_until

pytestmark = pytest.mark.integration

ROBOTS = ("r01", "r02", "r03")
FAKETIME = next(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"), None)


@pytest.fixture(scope="module")
def is_secured() -> bool:
    return True


def test_every_verb_is_answered_truly_over_a_slow_and_lossy_radio(swarm: FieldSwarm) -> None:
    radio = (*ROBOTS, FAR)
    for verb in ("members", "run", "estop", "reset"):
        swarm.field.set_between(radio, radio, delay=0.05, loss=0.1)
        swarm.moved()
        judged = judge(swarm, verb, swarm.ctl(FAR, *VERBS[verb], "-o", "json"))
        assert judged.verdict == TRUE, judged
        swarm.field.clear()
    assert "by anna" in swarm.daemons["r01"].text()


def test_a_laptop_without_keys_finds_nothing(swarm: FieldSwarm) -> None:
    prepare(swarm, "running")
    answer = swarm.begin(NEAR, "estop", "--timeout", "1s", is_insecure=True).finish()
    assert answer.code == 6, answer
    assert swarm.states(NEAR) == dict.fromkeys(ROBOTS, "running")


@pytest.mark.evidence
@pytest.mark.skipif(FAKETIME is None, reason="libfaketime is not installed")
def test_a_clock_of_1970_has_links_and_one_beyond_the_certificates_stops_alone(
    swarm: FieldSwarm,
) -> None:
    for robot, clock in {"r01": "@1970-01-02 00:00:00", "r02": "+14600d"}.items():
        environ = {"FAKETIME": clock, "FAKETIME_DONT_FAKE_MONOTONIC": "1"}
        swarm.daemons[robot].kill()
        daemon = swarm.spawn(robot, environ={"LD_PRELOAD": str(FAKETIME), **environ}).wait_ready()
        has_line = "has ended by the clock" in daemon.text()
        assert has_line is (robot == "r02"), daemon.text()

    def is_run_by_two() -> bool:
        ran = swarm.ctl(NEAR, "run", "drive", "--all", "-o", "json").json or {}
        return (ran.get("applied"), ran.get("missing")) == (["r01", "r03"], ["r02"])

    wait_until(is_run_by_two, "r01 and r03 run, and r02 is named")
    swarm.await_moving("r01", "r03")
    assert swarm.members(NEAR)["r02"]["presence"] == "alive"
    assert swarm.states(NEAR).keys() == {"r01", "r03"}
    estop = swarm.ctl(NEAR, "estop", "-o", "json").json
    assert estop["applied"] == list(ROBOTS), estop
    for robot in ("r01", "r02"):
        swarm.daemons[robot].kill()


def test_each_robot_keeps_an_incident_that_another_one_has_signed(swarm: FieldSwarm) -> None:
    prepare(swarm, "idle")
    assert swarm.ctl(NEAR, "incident", "mark", "it shook", "r01").code == 0
    wait_until(lambda: swarm.keepers(NEAR, "it shook") == set(ROBOTS), "all keep it")
