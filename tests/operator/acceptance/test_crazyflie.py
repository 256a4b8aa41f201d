"""Parts A to D of the test with a daemon and an emulated Crazyflie, over the maker's cflib."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

import pytest

from swarmd.operator.acceptance.result_file import read_record
from swarmd.operator.acceptance.verdict import Result, Verdict
from tests.operator.acceptance.crazyflie_base import CrazyflieBase
from tests.operator.acceptance.daemon_rig import DaemonRig
from tests.support.processes import wait_until
from tests.support.swarmctl import swarmctl

pytest.importorskip("cflib", reason="extra crazyflie")
pytestmark = [pytest.mark.evidence, pytest.mark.integration, pytest.mark.timeout(900)]

ROBOT = "cf-01"
LONG = 150.0  # s
DOWN = 4.0  # s for which a daemon or a radio is away
LOOK = 4.0  # s of a step with a hand, before the hand
UNASKED = ("A1", "A2", "A3", "A4", "A5", "A7", "A8", "A9", "A10", "A11", "C3", "C4", "D4")
SIDES = {"A12": 0, "A13": 1, "A14": 2, "A15": 3}
TRIES = 3
"""On a busy machine a run may begin too late, or the drone may land: not shown, then."""


class Rig(DaemonRig):
    """A daemon of a Crazyflie, and its drone."""

    def __init__(self, folder: Path, left: ExitStack, **fields: object) -> None:
        self.base = CrazyflieBase(**fields)  # type: ignore[arg-type]
        left.callback(self.base.close)
        super().__init__(folder, left, ROBOT, "crazyflie", "crazyflie", self.base.options)

    @property
    def found(self) -> Mapping[str, Verdict]:
        return read_record(self.results).verdicts

    def step(self, name: str) -> Verdict:
        """Carry one step out, as its person would; again if it is not shown."""
        for _ in range(TRIES):
            self._carry_out(name)
            if self.found[name].result is not Result.NOT_SHOWN:
                break
        return self.found[name]

    def _carry_out(self, name: str) -> None:
        base = self.base
        one = self.asked(name)
        if name in UNASKED:
            one.end()
            return
        base.set_down(1.2 if name[0] == "D" else 1.8 if name == "C2" else 2.6)
        if name == "B3":
            one.read_on("[y/N]", LONG)
            self.restart()
            time.sleep(DOWN)
            one.press(b"y\n")
            one.end()
            return
        one.answer("y")
        if name in SIDES:
            time.sleep(LOOK)
            base.hand = SIDES[name]
        if name in ("B7", "B8"):
            wait_until(lambda: base.is_flying_ahead, "it flies", 40.0)
            time.sleep(1.5)
            if name == "B7":
                self.kill()
                time.sleep(DOWN)
                self.start()
            else:
                base.unplug()
                time.sleep(DOWN)
                base.plug_in()
            one.restore(LONG)
        one.read_on(f"{name} ", LONG)
        one.end()
        base.hand = -1


def rig_of(folder: Path, left: ExitStack, **fields: object) -> Rig:
    """A rig whose daemon is heard."""
    rig = Rig(folder, left, **fields)
    wait_until(lambda: rig.base.is_connected, "the daemon has connected to its drone", 60.0)
    time.sleep(DOWN)
    rig.base.plug_in()
    return rig


def results(rig: Rig, *names: str) -> Mapping[str, str]:
    """The results of these steps, carried out in this order."""
    return {name: f"{rig.step(name).result}" for name in names}


def test_nothing_moves_and_all_is_as_a_sound_drone_says(tmp_path: Path, left: ExitStack) -> None:
    rig = rig_of(tmp_path, left)
    names = ("A1", "A6", "A7", "A8", "A9", "A10", "A11", *SIDES)
    assert results(rig, *names) == dict.fromkeys(names, "pass"), rig.found
    assert rig.base.height == 0.0
    assert rig.step("A5").reason == "not asked of a drone"


def test_a_sound_drone_stops_and_lands_in_every_case(tmp_path: Path, left: ExitStack) -> None:
    rig = rig_of(tmp_path, left)  # B6: there is no link to cut here
    names = ("B1", "B2", "B3", "B4", "B5", "B7", "B8")
    assert results(rig, *names) == dict.fromkeys(names, "pass"), rig.found


def test_a_sound_drone_hovers_and_flies_to_a_wall(tmp_path: Path, left: ExitStack) -> None:
    rig = rig_of(tmp_path, left)
    names = ("B1", "C1", "C2", "C3", "D1", "D2", "D3")
    assert results(rig, *names) == dict.fromkeys(names, "pass"), rig.found
    assert {rig.step(name).reason for name in ("C4", "D4")} == {"not asked of a drone"}


@pytest.mark.parametrize(
    ("fields", "before", "step", "words"),
    [
        ({"is_mirrored": True}, ("A12",), "A13", "mirrored"),
        ({"loss": 0.1}, ("A6",), "A7", "scans are lost"),
        ({"ignores_zero": True}, (), "B1", "ignores zero"),
        ({"keeps_last": True}, ("B1",), "B8", "drove on"),
        ({"scale": 1.1}, ("B1", "C2"), "C3", "scale of the state estimate"),
    ],
    ids=["mirrored", "loss", "ignores zero", "keeps last", "scale"],
)
def test_a_fault_is_found_by_its_step(
    fields: Mapping[str, object],
    before: tuple[str, ...],
    step: str,
    words: str,
    tmp_path: Path,
    left: ExitStack,
) -> None:
    rig = rig_of(tmp_path, left, **fields)
    assert results(rig, *before) == dict.fromkeys(before, "pass"), rig.found
    found = rig.step(step)
    assert (found.result, words in found.reason) == (Result.FAIL, True), found
    if step == "B1":
        rig.asked("C1").end()
        assert rig.found["C1"].result is Result.NOT_SHOWN


def test_calibrate_refuses_a_drone(tmp_path: Path, left: ExitStack) -> None:
    """Why C4 is not asked: the first drive is over before the drone has taken off."""
    rig = rig_of(tmp_path, left)
    words = ("calibrate", ROBOT, "--floor", "3", "--yes")
    done = swarmctl(*words, environ={"SWARM": rig.swarm})
    assert (done.code == 0, "is a drone" in done.err) == (False, True), done
