"""Robots that know each other by seeds alone, and a cut of which no robot learns.

What was asked before a cut must not move a robot after it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from tests.support.field import Field
from tests.support.field_swarm import FieldSwarm, Lines
from tests.support.network_matrix import FAR, NEAR
from tests.support.processes import wait_until

pytestmark = pytest.mark.integration

ROBOTS = ("r1", "r2", "r3", "r4")
LEFT, RIGHT = ROBOTS[:2], ROBOTS[2:]
ALL_ALIVE = dict.fromkeys(ROBOTS, "alive")
Made = Callable[[float], FieldSwarm]


@pytest.fixture
def made(namespaces_permitted: None, tmp_path: Path) -> Iterator[Made]:
    """`made(lease)`: daemons that are ready; FAR is beside LEFT, and NEAR beside RIGHT."""
    with contextlib.ExitStack() as left:

        def make(lease: float) -> FieldSwarm:
            field = Field((*ROBOTS, FAR, NEAR))
            left.callback(field.close)
            seeds = [f"tcp/{field.address(robot)}:7440" for robot in ROBOTS]
            network = {"multicast": False, "insecure": True, "seeds": seeds, "lease": lease}
            swarm = left.enter_context(FieldSwarm(tmp_path, field, ROBOTS, network=network))
            swarm.start()
            for host in (FAR, NEAR):
                await_presences(swarm, host, ALL_ALIVE)
            return swarm

        yield make


def await_presences(swarm: FieldSwarm, host: str, wanted: Mapping[str, str]) -> None:
    """Wait until the members have these presences as seen from a host."""

    def look() -> bool:
        return {name: one["presence"] for name, one in swarm.members(host).items()} == wanted

    wait_until(look, f"{host} sees {wanted}")


def late_operator(swarm: FieldSwarm) -> Lines:
    """An operator beside LEFT that has seen all robots, and sends its `run SECONDS` later."""
    late = swarm.talk(FAR, "tests.support.late_operator", str(swarm.config))
    assert late.ask("look") == {"seen": [*ROBOTS]}
    return late


def test_no_late_run_moves_a_swarm_that_was_cut_in_two(made: Made) -> None:
    swarm = made(1.5)
    assert swarm.ctl(FAR, "run", "drive", "--all").outcome == (0, "4 targeted, 4 applied")
    swarm.await_moving()
    late = late_operator(swarm)

    swarm.field.split(FAR, *LEFT)
    stop_right = swarm.begin(NEAR, "stop", "--timeout", "3s")
    swarm.await_standing(*RIGHT)
    swarm.moved()
    swarm.await_moving(*LEFT)  # the other side is autonomous
    stop_left = swarm.begin(FAR, "stop", "--timeout", "3s")
    swarm.await_standing(*LEFT)
    swarm.moved()
    assert [stop.finish().outcome for stop in (stop_left, stop_right)] == [
        (3, "4 targeted, 2 applied, 2 no answer (r3, r4)"),
        (3, "4 targeted, 2 applied, 2 no answer (r1, r2)"),
    ]
    late.say("run 1")
    await_presences(swarm, FAR, ALL_ALIVE | dict.fromkeys(RIGHT, "failed"))
    await_presences(swarm, NEAR, ALL_ALIVE | dict.fromkeys(LEFT, "failed"))
    assert late.hear().keys() == set(ROBOTS)

    swarm.field.heal()
    for host in (FAR, NEAR):
        await_presences(swarm, host, ALL_ALIVE)
    answers = late.ask("run 20")
    assert {name: answer[0] for name, answer in answers.items()} == dict.fromkeys(ROBOTS, "refused")
    assert swarm.moved() == set()

    # The stops of both sides are still handed on, and one may come between look and request.
    wait_until(
        lambda: swarm.ctl(NEAR, "run", "drive", "--all").outcome == (0, "4 targeted, 4 applied"),
        "all robots run again",
    )
    swarm.await_moving()


def test_a_run_delayed_by_a_short_cut_is_refused(made: Made) -> None:
    """The links outlive the cut, and deliver afterwards what was asked during it."""
    swarm = made(10.0)
    late = late_operator(swarm)
    assert swarm.ctl(NEAR, "run", "drive", *RIGHT, user="bob").code == 0
    swarm.await_moving(*RIGHT)

    swarm.field.split(FAR, *LEFT)
    late.say("run 5")
    stopping = swarm.begin(NEAR, "stop", *RIGHT, user="bob")
    swarm.await_standing(*RIGHT)
    swarm.moved()
    swarm.field.heal()
    answers = late.hear()
    assert {name: answer and answer[0] for name, answer in answers.items()} == {
        **dict.fromkeys(LEFT, "applied"),
        **dict.fromkeys(RIGHT, "refused"),
    }
    assert answers["r3"][1].startswith("robot changed since you looked, by bob@")
    assert stopping.finish().code == 0
    assert not swarm.moved() & set(RIGHT)
