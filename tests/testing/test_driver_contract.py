"""The contract finds faults: each broken driver fails the named test."""

from __future__ import annotations

import pytest

from swarmd.testing import driver_contract
from swarmd.testing.driver_contract import DriverContract
from tests.support import broken_drivers as broken
from tests.support.wire import Good, Wire

SHORT_TIMEOUT = 2.5

BROKEN: dict[str, tuple[type[Good], ...]] = {
    "reports_the_base_up": (broken.DeliversTooEarly, broken.NeverReportsUp),
    "commands_without_a_base": (
        broken.ReportsUpAtOnce,
        broken.QueuesCommands,
    ),
    "the_first_command_is_zero_and": (
        broken.StartsWithoutZero,
        broken.SendsOnlyZero,
        broken.ReversesTurns,
    ),
    "a_silent_base_is_lost": (
        broken.NeverReportsLost,
        broken.ReportsLostWithoutReason,
        broken.ResumesWithoutZero,
        broken.IsLostWithoutZero,
    ),
    "a_base_that_vanishes_and": (broken.ResumesWithoutZero, broken.EndsWhenLost),
    "slow_and_fast": (broken.LosesSlowSensors, broken.DropsTwoScansOfThree),
    "the_last_command_is_zero_and": (
        broken.SendsAfterItsEnd,
        broken.RepeatsAfterItsEnd,
    ),
    "the_last_command_is_zero_if": (broken.SendsZeroOnlyIfCancelled,),
    "a_command_just_before": (broken.RepeatsAfterItsEnd,),
    "sending_to_a_lost_base": (broken.BlocksInSend,),
    "leaves_no_task": (
        broken.RunsOnce,
        broken.LeavesATask,
        broken.LeavesASocket,
        broken.LeavesAProcess,
    ),
    "garbage": (
        broken.EndsOnGarbage,
        broken.CountsNoGarbage,
        broken.DeliversGarbage,
    ),
    "nan_and_infinity": (
        broken.NAN_AS_INFINITY,
        broken.DropsScansWithoutReturns,
    ),
    "the_number_of_rays": (broken.FIXED_COUNT, broken.FIXED_BEARINGS),
    "scans_are_whole": (
        *broken.WRONG_SCANS,
        broken.DeliversFromAThread,
    ),
    "odometry_is_finite": (*broken.WRONG_ODOMETRY,),
    "check_finds": (broken.SendsDuringCheck, broken.NEVER_WELL),
    "check_of_a_silent": (broken.ALWAYS_WELL, broken.NO_REASON),
    "a_hazard_is_told": (
        broken.TakesSilenceForNoHazard,
        broken.NeverTellsTheEndOfAHazard,
        broken.TellsHazardsAfterTheFirstScan,
    ),
    "a_ring_of_range_sensors": (
        broken.DeliversTheRingAsScan,
        broken.RepeatsTheStampOfTheRing,
    ),
    "a_stopped_robot": (broken.DropsCommandsOfStoppedRobots,),
    "an_unknown_option": (broken.AcceptsAnyOption,),
}


@pytest.mark.long
class TestGood(DriverContract):
    def rig(self) -> Wire:
        return Wire(Good)


@pytest.fixture(autouse=True)
def _short_timeout(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait less than elsewhere for what never happens."""
    if request.cls is None:
        monkeypatch.setattr(driver_contract, "TIMEOUT", SHORT_TIMEOUT)


CASES = [(name, kind) for name, kinds in BROKEN.items() for kind in kinds]


def run_test(contract: DriverContract, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the test of the contract whose name begins so."""
    (full,) = [one for one in dir(contract) if one.startswith(f"test_{name}")]
    test = getattr(contract, full)
    if name == "slow_and_fast":
        test(1.0, 3.2)
        test(50.0, 1.0)
    elif name == "leaves_no_task":
        test(monkeypatch)
    else:
        test()


@pytest.mark.short_rows(4)
@pytest.mark.integration
@pytest.mark.parametrize(("name", "kind"), CASES, ids=lambda v: getattr(v, "__name__", v))
def test_a_broken_driver_is_found(
    name: str, kind: type[Good], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Contract(DriverContract):
        def rig(self) -> Wire:
            return Wire(kind)

    with pytest.raises((AssertionError, TimeoutError, pytest.fail.Exception)):
        run_test(Contract(), name, monkeypatch)


def test_each_test_of_the_contract_finds_something() -> None:
    tests = [name for name in dir(DriverContract) if name.startswith("test_")]
    idle = [full for full in tests if not any(full.startswith(f"test_{name}") for name in BROKEN)]
    assert not idle
