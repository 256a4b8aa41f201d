"""Recordings on the page: poses, scans, states and events of robots at a time."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest

from swarmd.core.avoided import Avoided, WayState
from swarmd.core.errors import ConfigError
from swarmd.core.events import OdometryInput, ScanInput
from swarmd.core.messages import LimitingObstacle
from swarmd.core.values import Odometry, Pose, Scan, Twist
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.head import RecordingHead
from swarmd.daemon.recording.merge import place, survey, write_merged
from swarmd.daemon.recording.process import Converter
from swarmd.operator.view.recording_source import RecordingSource
from swarmd.operator.view.source import hello_of
from swarmd.robot.protection.decision import Decision
from swarmd.robot.setup import RobotIdentity, RobotSetup
from swarmd.settings.file_limits import FileLimits
from swarmd.settings.platforms import load_platform
from tests.support.statuses import status

BURGER = load_platform("burger")
SPEED = 0.1


def head(robot: str, clock: str) -> RecordingHead:
    return RecordingHead(
        swarm="s",
        clock=clock,
        machine="",
        identity=RobotIdentity(
            robot=robot,
            platform=BURGER,
            setup=RobotSetup(driver="story"),
            seed=1,
            instance="boot1",
        ),
    )


def recorded(
    folder: Path,
    robot: str,
    begin: float,
    seconds: float,
    clock: str = "boot",
    avoided: Avoided | None = None,
    more: Sequence[frames.TextEntry] = (),
) -> Path:
    """A robot that drives along x with SPEED, and records until it is stopped at half time."""
    texts = head(robot, clock).texts()
    converter = Converter(
        frames.Begin(begin, str(folder), robot, texts, 1.7e9 + begin, FileLimits())
    )
    entries: list[frames.Entry] = [*more]
    entries.append(frames.EventEntry(begin + seconds / 2, "stopped by anna"))
    for k in range(int(10 * seconds) + 1):
        at, is_running = begin + 0.1 * k, 0.1 * k < seconds / 2
        pose = Pose(SPEED * 0.1 * k, 0.0, math.pi - 0.01 + 0.1 * k)
        reading = Odometry(at, pose, Twist(SPEED))
        entries.append(frames.input_entry(OdometryInput(reading), at))
        state, reason = ("running", "") if is_running else ("stopped", "operator")
        if is_running and avoided is not None:
            reason = "protection"
        twist = Twist(SPEED * is_running)
        decision = Decision(
            mode="barrier",
            requested=twist,
            safe=twist,
            reason=None,
            is_active=is_running,
            rows=(LimitingObstacle(0.1, 0.3, 0.2),),
            min_gap=None,
            scan_age=0.1,
            scan_seq=k,
            avoided=avoided,
        )
        entries.append(frames.DecisionEntry(at, "tick", state, reason, decision))
        ranges = np.full(len(BURGER.scan.bearings), 1.0 + k)
        scan = Scan(k, at, ranges, BURGER.scan.bearings, 0.1, 3.5)
        entries.append(frames.input_entry(ScanInput(scan), at))
    for entry in sorted(entries, key=lambda entry: entry.at):
        converter.add(entry)
    converter.writer.close()
    assert converter.writer.path is not None
    return converter.writer.path


def test_the_reason_of_a_robot_that_gives_way_names_the_opening(tmp_path: Path) -> None:
    path = recorded(tmp_path, "tb3-01", 50.0, 4.0, avoided=Avoided(0.2, 0.83, WayState.WAIT))
    source = RecordingSource([path], clock=lambda: 0.0)
    source.playback.seek(1.05)
    row = source.rows()["tb3-01"]
    text = "gives way at an opening, 0.8 m"
    assert (row["protection"], row["why"], row["stands"]) == (text, f"protection: {text}", "held")


def test_shows_each_robot_at_its_time(tmp_path: Path) -> None:
    paths = [recorded(tmp_path, "tb3-01", 50.0, 4.0), recorded(tmp_path, "tb3-02", 52.0, 10.0)]
    source = RecordingSource(paths, clock=lambda: 0.0)
    assert [one.name for one in source.robots] == ["tb3-01", "tb3-02"]
    assert source.playback.duration == pytest.approx(12.0, abs=0.01)
    assert source.timeline.notes == []

    source.playback.seek(1.05)
    time, places = source.frame()
    assert time == pytest.approx(1.05)
    assert places[:, 0].tolist() == [0]  # the other one is not recorded yet
    assert places[0, 1] == pytest.approx(SPEED * 1.05, abs=1e-6)
    rows = source.rows()
    assert rows["tb3-01"]["state"] == "running"
    assert rows["tb3-01"]["protection"] == "active"
    assert rows["tb3-01"]["safe"] == pytest.approx([SPEED, 0.0, 0.0])
    assert rows["tb3-01"]["rows"] == [[0.1, 0.3, 0.2]]
    assert rows["tb3-02"]["presence"] == "absent"
    points = source.scan("tb3-01")
    assert points is not None
    assert np.hypot(*(points - BURGER.scan.offset).T) == pytest.approx(1.0 + 10, abs=1e-5)

    source.playback.seek(3.0)
    assert source.frame()[1][:, 0].tolist() == [0, 1]
    row = source.rows()["tb3-01"]
    assert (row["state"], row["why"]) == ("stopped", "operator")
    detail = source.detail("tb3-01")
    assert detail is not None
    assert detail["events"] == [["2.0 s", "stopped by anna"]]
    assert [mark[1:] for mark in source.marks()] == [
        ("stopped by anna", ("tb3-01",)),
        ("stopped by anna", ("tb3-02",)),
    ]
    assert [mark[0] for mark in source.marks()] == pytest.approx([2.0, 7.0])

    source.playback.seek(12.0)
    assert source.rows()["tb3-01"]["presence"] == "absent"
    assert source.frame()[1][:, 0].tolist() == [1]
    json.dumps(source.rows(), allow_nan=False)


def test_a_merged_file_shows_the_same_as_its_parts(tmp_path: Path) -> None:
    paths = [recorded(tmp_path, "tb3-01", 50.0, 4.0), recorded(tmp_path, "tb3-02", 52.0, 10.0)]
    merged = tmp_path / "all.mcap"
    write_merged(place(survey(paths)), merged)
    one, other = RecordingSource([merged], lambda: 0.0), RecordingSource(paths, lambda: 0.0)
    assert [robot.name for robot in one.robots] == ["tb3-01", "tb3-02"]
    for source in (one, other):
        source.playback.seek(3.0)
    np.testing.assert_allclose(one.frame()[1], other.frame()[1], atol=1e-6)
    assert one.rows() == other.rows()
    with pytest.raises(ConfigError, match="merged already"):
        RecordingSource([merged, *paths])


def test_time_zero_is_the_first_odometry_and_robots_stand_side_by_side(tmp_path: Path) -> None:
    paths = [recorded(tmp_path, "tb3-01", 50.0, 4.0), recorded(tmp_path, "tb3-02", 50.0, 4.0)]
    text = frames.EventEntry(20.0, "before")
    begin = frames.Begin(20.0, str(tmp_path / "log"), "tb3-01", head("tb3-01", "boot").texts(),
                         1.7e9 + 20.0, FileLimits())  # fmt: skip
    converter = Converter(begin)
    converter.add(text)
    converter.writer.close()
    assert converter.writer.path is not None
    source = RecordingSource([converter.writer.path, *paths], clock=lambda: 0.0)
    assert source.playback.duration == pytest.approx(4.0, abs=0.01)
    assert source.frame()[1][:, 2].tolist() == [-0.5, 0.5]
    detail = source.detail("tb3-01")
    assert detail is not None
    assert detail["events"] == [["-30.0 s", "before"]]


def test_a_robot_on_another_clock_is_named(tmp_path: Path) -> None:
    paths = [recorded(tmp_path, "tb3-01", 50.0, 4.0)]
    paths.append(recorded(tmp_path, "tb3-02", 50.0, 4.0, clock="other"))
    (note,) = RecordingSource(paths).timeline.notes
    assert note.startswith("tb3-02: ")


def test_a_turn_through_pi_is_interpolated_the_short_way(tmp_path: Path) -> None:
    source = RecordingSource([recorded(tmp_path, "tb3-01", 50.0, 4.0)], clock=lambda: 0.0)
    source.playback.seek(0.05)
    _, places = source.frame()
    assert math.remainder(places[0, 3] - (math.pi - 0.01 + 0.05), 2 * math.pi) == pytest.approx(
        0.0, abs=1e-6
    )


def test_what_is_damaged_is_noted_and_the_rest_shown(tmp_path: Path) -> None:
    path = recorded(tmp_path, "tb3-01", 50.0, 60.0)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    source = RecordingSource([cut])
    assert str(cut) in source.timeline.notes[0]
    assert 0.0 < source.playback.duration < 60.0


def test_another_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "notes.mcap"
    path.write_text("no recording")
    with pytest.raises(ConfigError, match=r"notes\.mcap"):
        RecordingSource([path])


def test_reports_have_the_units_of_their_patterns_once_these_are_described(tmp_path: Path) -> None:
    told = status("tb3-01", pattern="levy_walk", report={"left": 0.25})
    entry = frames.TextEntry(51.0, "/status", msgspec.json.encode(told))
    source = RecordingSource([recorded(tmp_path, "tb3-01", 50.0, 4.0, more=(entry,))])
    source.playback.seek(1.5)

    def report() -> dict[str, str]:
        detail = source.detail("tb3-01")
        assert detail is not None
        return dict(dict(detail["sections"])["Report"])

    assert report() == {"left": "0.25"}
    before = source.revision
    row = {"name": "levy_walk", "report_units": {"left": "m"}, "params": []}
    source.take_patterns([row, {"name": "drive", "error": "cannot be loaded"}])
    assert report() == {"left": "0.25 m"}
    assert source.revision > before
    assert hello_of(source, "viewer")["report_units"] == {"levy_walk": {"left": "m"}}
