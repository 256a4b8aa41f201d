"""Stop and estop while a pattern is being loaded: the pattern then moves nothing."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Literal

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import Code, Reason, State

if TYPE_CHECKING:
    from tests.faults.conftest import Bench

pytestmark = pytest.mark.integration


@pytest.mark.parametrize(
    ("verb", "state", "reason"),
    [
        ("stop", State.STOPPED, Reason.OPERATOR),
        ("estop", State.ESTOPPED, Reason.ESTOP),
    ],
)
@pytest.mark.parametrize("is_driving", [True, False])
def test_a_stop_while_a_pattern_is_loaded_cancels_the_load(
    robot: Bench, verb: Literal["stop", "estop"], state: State, reason: Reason, is_driving: bool
) -> None:
    if is_driving:
        robot.drive()
    epoch = robot.status().epoch
    with ThreadPoolExecutor() as pool:
        asked = boottime()
        run = pool.submit(robot.ask, "run", epoch=epoch, pattern="slow_import", params={})
        robot.witness.wait("loading", lambda status: status.detail == "loading slow_import", asked)
        halted = boottime()
        ack = robot.halt(verb)
        print(f"{verb} acked after {boottime() - halted:.3f} s: {ack.text}")
        reply = run.result()
    print(f"run answered after {boottime() - asked:.3f} s: {reply.text}")
    assert reply.code is Code.REFUSED
    assert reply.text == f"{reason} while it was being loaded"

    robot.await_state(state, reason, halted)
    zero = robot.body.wait_zero(halted)
    robot.moves_not(zero.at, scans=8)  # longer than the import would have taken
    status = robot.status()
    assert (status.state, status.reason) == (state, reason)


def test_a_pattern_that_imports_for_a_second_is_loaded_and_drives(robot: Bench) -> None:
    moving = robot.drive()
    asked = boottime()
    assert robot.run("slow_import").code is Code.APPLIED
    zero = robot.body.wait_zero(asked)
    again = robot.body.wait_moving(zero.at)
    print(f"stood {again.at - zero.at:.3f} s between the two patterns")
    assert moving.at < zero.at
    assert robot.status().pattern == "slow_import"
