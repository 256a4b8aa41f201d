"""Reports of recordings: the trace of a merged recording, and what the page holds."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from msgspec import structs

from swarmd.core.events import OdometryInput
from swarmd.core.messages import Reason
from swarmd.core.values import Odometry, Pose, Twist
from swarmd.daemon.recording.frames import (
    Begin,
    ClockEntry,
    DecisionEntry,
    TextEntry,
    as_json,
    input_entry,
)
from swarmd.daemon.recording.merge import place, survey, write_merged
from swarmd.daemon.recording.process import Converter
from swarmd.operator.view.timeline import read_timeline
from swarmd.robot.protection.decision import Decision
from swarmd.settings.file_limits import FileLimits
from swarmd.sim.cli.exp import exp
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.report.recording_report import _clocks, stops_of, trace_of
from tests.support.incidents import ID, incident_of
from tests.support.statuses import status

SPEED = 0.1  # m/s
HELD = (4.0, 7.0)
"""When robot b stands before an obstacle, in s."""


def record(folder: Path, robot: str) -> Path:
    """Ten seconds at 10 Hz in which a robot drives straight on, and b is held for three."""
    about = {"robot": robot, "clock": "one", "platform": "burger", "version": "1"}
    begin = Begin(50.0, str(folder / robot), robot, about, 1.7e9, FileLimits())
    converter = Converter(begin)
    if robot == "a":
        converter.add(ClockEntry(50.0, "b", "one", 50.0, 50.001, 50.002))
    x = 0.0
    for k in range(101):
        time = k / 10.0
        is_held = robot == "b" and HELD[0] <= time < HELD[1]
        wanted = Twist(SPEED, 0.0)
        safe = Twist() if is_held else wanted
        reason = Reason.PROTECTION if is_held else None
        decision = Decision("barrier", wanted, safe, reason, is_held, (), 0.3, 0.05, k)
        pose = Odometry(time, Pose(x, 0.0, 0.0), safe)
        converter.add(input_entry(OdometryInput(pose), 50.0 + time))
        words = "scan", "running", reason.value if reason else ""
        converter.add(DecisionEntry(50.0 + time, *words, decision))
        if robot == "a" and k % 10 == 0:
            charge = status("a", report={"opinion": k}, readings={"battery": 0.9 - 0.001 * k})
            converter.add(TextEntry(50.0 + time, "/status", as_json(charge)))
        x += safe.linear / 10.0
    converter.writer.close()
    assert converter.writer.path is not None
    return converter.writer.path


@pytest.fixture(scope="module")
def merged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    paths = [record(folder, "a"), record(folder, "b")]
    write_merged(place(survey(paths)), folder / "evening.mcap")
    return folder / "evening.mcap"


def test_the_trace_of_a_recording(merged: Path) -> None:
    timeline = read_timeline([merged])
    trace = trace_of(timeline, merged)
    assert trace.ids == ("a", "b")
    assert trace.duration == pytest.approx(10.0, abs=0.01)
    assert not timeline.is_shared
    assert trace.pose[-1, 0, 0] - trace.pose[0, 0, 0] == pytest.approx(10.0 * SPEED, abs=0.01)
    assert trace.pose[-1, 1, 0] - trace.pose[0, 1, 0] == pytest.approx(7.0 * SPEED, abs=0.02)
    assert trace.pose[0, 1, 1] - trace.pose[0, 0, 1] == pytest.approx(1.0)  # side by side
    assert trace.active is not None
    assert trace.reason is not None
    held = trace.t[trace.active[:, 1]]
    assert (held[0], held[-1]) == pytest.approx((HELD[0], HELD[1] - 0.1), abs=0.11)
    assert set(np.unique(trace.reason[:, 1])) == {"", "protection"}


def test_the_reason_of_a_stop_is_the_earliest_of_the_most_frequent(merged: Path) -> None:
    """Not any of them, which would differ between processes by the hashes of texts."""
    trace = trace_of(read_timeline([merged]), merged)
    assert trace.reason is not None
    reason = trace.reason.copy()
    stopped = np.flatnonzero(reason[:, 1] == "protection")
    words = ["stale_scan", "no_scan", "driver_lost", "frozen_scan", "invalid_scan"]
    reason[stopped, 1] = np.resize(np.array(words), len(stopped) // 5 * 5).tolist() + [""] * (
        len(stopped) % 5
    )
    ((_, robot, _, why),) = stops_of(replace(trace, reason=reason))
    assert (robot, why) == ("b", "stale scan")


def test_the_trace_of_a_recording_has_the_reports_and_readings_of_statuses(merged: Path) -> None:
    trace = trace_of(read_timeline([merged]), merged)
    names = ["reading:battery.start", "reading:battery.min_end", "report:opinion.max_end"]
    values = measure(trace, names)
    assert values == pytest.approx(dict(zip(names, (0.9, 0.8, 100.0), strict=True)), abs=1e-9)
    assert np.isnan(trace.readings["battery"][:, 1]).all()  # b has no battery


def test_the_report_of_a_recording(merged: Path) -> None:
    done = CliRunner().invoke(exp, ["report", str(merged)], catch_exceptions=False)
    assert done.exit_code == 0
    text = merged.with_suffix(".html").read_text()
    sections = re.findall(r'<section id="(\w+)"', text)
    assert sections == ["robots", "figures", "stops", "run", "clocks", "again", "manifest"]
    (stop,) = re.findall(
        r"<tr><td>(4\.\d) s</td><td>b</td><td>(\S+) s</td><td>protection</td>", text
    )
    assert 2.7 <= float(stop[1]) <= 3.1
    assert "start poses are not known" in text
    assert "Reading battery over time." in text
    data = re.search(r'id="run-data">(.*?)</script>', text, re.DOTALL)
    assert data is not None
    assert [robot["name"] for robot in json.loads(data[1])["hello"]["robots"]] == ["a", "b"]
    refused = CliRunner().invoke(exp, ["report", str(merged), "--seed", "3"])
    assert "for experiments" in str(refused.exception)


def test_the_player_of_an_incident_begins_ten_seconds_before(tmp_path: Path) -> None:
    later = structs.replace(incident_of("b"), id="ff0123456789", text="a lion")
    for robot, heard in (("a", 74.0), ("b", 71.0)):
        about = {"robot": robot, "clock": "one", "platform": "burger", "version": "1"}
        folder = str(tmp_path / robot)
        converter = Converter(Begin(50.0, folder, ID, about, 1.7e9, FileLimits()))
        for at in np.arange(50.0, 80.0, 0.5).tolist():
            pose = Odometry(at, Pose(0.1 * at, 0.0, 0.0), Twist(0.2))
            converter.add(input_entry(OdometryInput(pose), at))
            if at == heard:
                converter.add(TextEntry(at, "/incident", as_json(incident_of("b"))))
            if at == 78.0:
                converter.add(TextEntry(at, "/incident", as_json(later)))
                converter.add(TextEntry(at, "/incident", b"[1]"))
        converter.writer.close()
    done = CliRunner().invoke(exp, ["report", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0
    text = (tmp_path / "report.html").read_text()
    data = re.search(r'id="run-data">(.*?)</script>', text, re.DOTALL)
    assert data is not None
    assert json.loads(data[1])["start"] == pytest.approx(11.0)
    assert "<h1>b: a chair fell</h1>" in text, "the cause first"
    assert f"Incident {ID} (mark) of b at 21.0 s, told by b" in text
    assert "a lion" not in text
    sections = re.findall(r'<section id="(\w+)"', text)
    assert sections[:3] == ["run", "kept", "robots"]
    kept = re.search(r'<section id="kept">(.*?)</section>', text, re.DOTALL)
    assert kept is not None
    rows = re.findall(r"<tr><td>(.*?)</td><td>(.*?)</td><td>(.*?)</td>", kept[1])
    assert rows == [("b", "had it", "-21.0 to +8.5 s"), ("a", "kept it", "-21.0 to +8.5 s")]


@pytest.mark.parametrize("words", ["it died", "<img src=x onerror=alert(1)>"])
def test_the_robot_of_an_incident_without_a_recording_is_in_the_table(
    tmp_path: Path, words: str
) -> None:
    """A daemon that was killed writes its minute at its next start: at first it has none here."""
    about = {"robot": "a", "clock": "one", "platform": "burger", "version": "1"}
    converter = Converter(Begin(50.0, str(tmp_path), ID, about, 1.7e9, FileLimits()))
    for at in np.arange(50.0, 60.0, 0.5).tolist():
        pose = Odometry(at, Pose(0.1 * at, 0.0, 0.0), Twist(0.2))
        converter.add(input_entry(OdometryInput(pose), at))
        if at == 55.0:
            silent = structs.replace(incident_of("b", words), by="a")
            converter.add(TextEntry(at, "/incident", as_json(silent)))
    converter.writer.close()
    done = CliRunner().invoke(exp, ["report", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0
    text = (tmp_path / "report.html").read_text()
    kept = re.search(r'<section id="kept">(.*?)</section>', text, re.DOTALL)
    assert kept is not None
    rows = re.findall(r"<tr><td>(.*?)</td><td>(.*?)</td><td>(.*?)</td>", kept[1])
    assert rows[0][:2] == ("b", "had it")
    assert "no recording" in rows[0][2]
    assert rows[1] == ("a", "told it", "-5.0 to +4.5 s")
    assert "--why b" in text
    assert f"<h1>b: {escape(words)}</h1>" in text


def test_a_file_that_is_no_recording_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"nothing")
    done = CliRunner().invoke(exp, ["report", str(tmp_path / "a.mcap")])
    assert "not a recording" in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize("clocks", ["[" * 20_000, "{}x", "[1]", '[{"robot": "a"}]', "7"])
def test_damaged_clocks_of_a_stranger_are_a_sentence(clocks: str) -> None:
    assert "cannot be read" in _clocks({"clocks": clocks})
