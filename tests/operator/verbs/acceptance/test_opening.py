"""How a test opens a robot: what another test has left, and two robots that both answer."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.finding import Finding, warning
from swarmd.core.messages import Reason, Status
from swarmd.core.verbs import RecordingFile, RecordingsReply
from swarmd.operator.acceptance.result_file import RECORD
from swarmd.operator.verbs.acceptance.tested_robot import TestedRobot
from tests.support.statuses import status

TWICE = status("r", reason=Reason.DUPLICATE_ID, detail="this id is also held by abc")


@pytest.fixture
def robot(tmp_path: Path) -> TestedRobot:
    return TestedRobot(mock.Mock(), "r", tmp_path)


@pytest.mark.parametrize(
    ("now", "words"),
    [
        (TWICE, "two daemons have its name: this id is also held by abc"),
        (status("r"), "the copy was damaged"),
        (None, "the copy was damaged"),
    ],
)
def test_recordings_of_two_daemons_are_told_by_their_cause(
    robot: TestedRobot, now: Status | None, words: str
) -> None:
    damaged = SwarmError("the copy was damaged")
    with (
        mock.patch.object(robot, "_learn", side_effect=damaged),
        mock.patch.object(robot, "status", return_value=now),
        pytest.raises(SwarmError, match=words),
    ):
        robot.open()


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_test_that_goes_on_ends_the_recording_of_the_step_that_was_cut(
    robot: TestedRobot, tmp_path: Path, goes_on: bool
) -> None:
    """A recording that is no test's own goes on: the robot then refuses the test's."""
    if goes_on:
        (tmp_path / RECORD).touch()
    done: list[str] = []
    with (
        mock.patch.object(robot, "_record", side_effect=done.append),
        mock.patch.object(robot, "_start_recording", side_effect=lambda: done.append("start")),
        mock.patch.object(robot, "_fetched", return_value=[]),
        mock.patch("time.sleep"),
        pytest.raises(SwarmError, match="records already"),
    ):
        robot._learn()
    assert done == (["stop", "start"] if goes_on else ["start"])


def test_a_check_is_judged_by_what_no_other_step_judges(tmp_path: Path) -> None:
    """A2 judges the clock; the robot's own daemon is the other node that A6 looks for."""
    found = [
        Finding("scan", True, "5 Hz"),
        warning("clock", "not synchronised by NTP", "chrony"),
        Finding("last_word", False, "the daemon"),
    ]
    robot = TestedRobot(mock.Mock(), "r", tmp_path, lambda: found)
    assert robot._check() == found[:1]


def test_a_recording_is_copied_once_its_last_chunk_is_on_the_disk(robot: TestedRobot) -> None:
    """A file that is closed and has no checksum still gets its last chunk."""
    being_written = RecordingFile(name="a", size=10, is_open=False)
    finished = RecordingFile(name="a", size=20, is_open=False, crc=1)
    listed = [
        RecordingsReply(robot="r", now=0.0, clock="", files=(one,))
        for one in (being_written, finished)
    ]
    with (
        mock.patch(
            "swarmd.operator.verbs.acceptance.tested_robot.recordings_of", side_effect=listed
        ),
        mock.patch("time.sleep"),
    ):
        assert robot._finished_files(mock.Mock()) == [finished]
