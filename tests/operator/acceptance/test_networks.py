"""Faults between the robot and the person's computer: names, multicast and links, for real."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from swarmd.operator.acceptance.result_file import read_record
from swarmd.operator.acceptance.verdict import Result
from tests.operator.acceptance.field_rig import LAPTOP, OTHER, ROBOT, FieldRig
from tests.support.field import lacks
from tests.support.processes import DAEMON, wait_until

pytestmark = [
    pytest.mark.evidence,
    pytest.mark.integration,
    pytest.mark.skipif(bool(lacks()), reason=lacks() or "it has all"),
]
LONG = 120.0  # s
CUT = 10.0  # s
CALIBRATION = 400.0  # s
CIRCLE = 1.0  # m: half of the floor of a Burger
DRIVES = 8.0  # s of calibration until the cable is pulled
ROOM = "3.6x3.2,box/crate:1.6:1.3:0.3:0.3"


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[FieldRig]:
    with ExitStack() as left:
        yield FieldRig(tmp_path, left)


def test_two_daemons_of_one_name_are_found(rig: FieldRig) -> None:
    rig.start_daemon(endpoint=rig.body)
    rig.field.split(OTHER)  # a second daemon that finds the name in use does not start
    twin = rig.start_daemon(OTHER, endpoint=rig.body)
    rig.field.heal()
    wait_until(lambda: "is also held by" in twin.text(), "it hears the other one")
    for step in ("A1", "A4"):
        with rig.person(step) as one:
            assert one.end() != 0
        # Both answer: what one of them begins to send the other one may end.
        assert f"{step} FAIL two daemons have its name" in one.words or (
            f"error: {ROBOT}: two daemons have its name" in one.words
        )


@pytest.mark.skipif(shutil.which("nft") is None, reason="no nft here")
@pytest.mark.parametrize(
    ("host", "words"), [(LAPTOP, "multicast is filtered"), (ROBOT, "firewall: may drop")]
)
def test_filtered_multicast_is_found(rig: FieldRig, host: str, words: str) -> None:
    rig.start_daemon(endpoint=rig.body)
    rig.filter_multicast(host)
    with rig.person("A4") as one:
        one.read_on("A4 ", LONG)
        one.end()
    found = rig.verdict("A4")
    assert found.result is Result.FAIL, found
    assert words in found.reason


@pytest.mark.parametrize(
    ("module", "result", "word"),
    [
        (DAEMON, Result.PASS, "at rest"),
        (
            ("tests.operator.acceptance.leaseless_daemon",),
            Result.FAIL,
            "run lease did not end the run",
        ),
    ],
    ids=["sound", "no lease"],
)
def test_a_link_that_is_cut_while_the_robot_drives(
    rig: FieldRig, module: Sequence[str], result: Result, word: str
) -> None:
    rig.start_world("9x3")
    rig.start_daemon(module=module)
    rig.note_passed("B1")
    with rig.person("B6") as one:
        one.answer("y")
        wait_until(lambda: rig.state() == "running", "it drives")
        time.sleep(2.0)
        rig.cut()
        time.sleep(CUT)
        rig.join()
        one.read_on("press Enter", LONG)
        one.press(b"\n")
        one.read_on("B6 ", LONG)
        one.end()
    found = rig.verdict("B6")
    assert found.result is result, found
    assert word in found.reason


def test_a_cable_that_is_pulled_during_the_calibration(rig: FieldRig) -> None:
    """The robot rests within the announced circle, and what it measured does not count."""
    calibrate_and_cut(rig, 4.0, "n")  # C9
    assert rig.verdict("C3").reason.startswith("it needs C2 to pass")
    with rig.person("C") as one:
        one.read_on("C2 calibration", LONG)
        one.answer("q")
        one.end()
    poses = rig.poses()
    ways = np.hypot(*(poses[:, :2] - poses[0, :2]).T)
    print(f"{ways.max():.2f} m")
    assert 0.1 < ways.max() < CIRCLE


def test_the_calibration_goes_on_after_the_cable_was_off_for_long(rig: FieldRig) -> None:
    """The test has ended meanwhile, and its recording runs on."""
    calibrate_and_cut(rig, 25.0)
    assert "C3" not in read_record(rig.results).verdicts
    with rig.person("C") as one:
        one.answer("y")
        one.read_on("C2 PASS", CALIBRATION)
        one.read_on("C8 platform", LONG)
        one.answer("n")
        one.answer("n")  # C9
        one.end()


def calibrate_and_cut(rig: FieldRig, seconds: float, *answers: str) -> None:
    """Begin the calibration, and pull the cable for `seconds` while the robot drives.

    `answers`: to the questions after it.
    """
    rig.start_world(ROOM)
    rig.start_daemon()
    rig.note_passed("B1")
    with rig.person("C") as one:
        one.answer("n")
        one.read_on(f"it moves by {CIRCLE:.2f}")
        one.answer("y")
        wait_until(lambda: rig.state() == "running", "it drives")
        time.sleep(DRIVES)
        rig.cut()
        wait_until(lambda: rig.state() == "stopped", "it stops by itself")
        time.sleep(seconds)
        rig.join()
        for answer in answers:
            one.answer(answer)
        one.end()
    found = rig.verdict("C2")
    assert (found.result, found.reason) == (Result.NOT_SHOWN, "the robot was not heard any more")
