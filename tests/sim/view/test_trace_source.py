"""Recorded runs on the page: positions, contacts, readings and scans of a trace at a time."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.operator.view.source import hello_of
from swarmd.settings.platforms import load_platform
from swarmd.sim.trace import Trace, TraceBuilder
from swarmd.sim.view import shown
from swarmd.sim.view.trace_source import RecordedRun, TraceSource
from swarmd.sim.world.floor import FloorField, Patch
from swarmd.sim.world.scalar_fields import LinearField

BURGER = load_platform("burger")
IDS = ("a", "b")
META = {
    "arena": "6x4,box/crate:0:1:0.4:0.4:0:2,pole:-2:1:0.2",
    "radio": {"range": 1.5},
    "events": [{"at": 0.3, "action": "run", "robots": ["a"], "pattern": "flocking"}],
}


def recorded(**parts: Any) -> Trace:
    """Two robots for 4 s: `a` drives along x from the middle, `b` stands 1 m to its left."""
    shape = np.array([[[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]])
    builder = TraceBuilder(IDS, [BURGER, BURGER], META, movable_boxes=("crate",), box_shapes=shape)
    for k in range(41):
        poses = np.array([[0.05 * k, 0.0, 0.0], [0.0, 1.0, 0.0]])
        box = np.array([[0.0, 1.5, 0.0]]) if k < 30 else np.full((1, 3), np.nan)
        builder.add(5.0 + 0.1 * k, poses, np.full((2, 3), 0.1), box)
    builder.add_contact(6.0, "a", "b", 0.1, 0.0)
    builder.add_contact(6.1, "a", "b", 0.1, 0.0)
    builder.add_contact(8.5, "b", "box/crate", 0.1, 0.0)
    return replace(builder.trace(), **parts)


def source_of(runs: Mapping[str, RecordedRun], first: str = "one") -> TraceSource:
    def load(name: str) -> RecordedRun:
        if name not in runs:
            raise ConfigError(f"{name}.npz: damaged")
        return runs[name]

    return TraceSource("title", [*runs, "broken"], load, first, clock=lambda: 0.0)


@pytest.fixture
def source() -> TraceSource:
    state = np.full((41, 2), "running")
    opinion = np.full((41, 2), np.nan)
    opinion[:, 0] = 2.0
    present = np.ones((41, 2), dtype=bool)
    present[:20, 1] = False
    trace = recorded(
        state=state,
        present=present,
        report={"opinion": opinion},
        readings={"light": np.linspace(1.0, 5.0, 41)[:, None] * [1.0, np.nan]},
        words={"mood": np.full((41, 2), "calm")},
    )
    light = LinearField(name="light", slope=2.0, base=1.0)
    return source_of({"one": RecordedRun(trace, [light])})


def test_poses_are_interpolated_from_the_start_of_the_run(source: TraceSource) -> None:
    source.playback.seek(1.05)
    time, places = source.frame()
    assert time == pytest.approx(1.05)
    assert places[0] == pytest.approx([0.0, 0.525, 0.0, 0.0])
    assert source.playback.duration == pytest.approx(4.0)


def test_rows_have_reports_readings_and_presence(source: TraceSource) -> None:
    source.playback.seek(1.0)
    a, b = source.rows()["a"], source.rows()["b"]
    assert a["report"] == {"opinion": 2.0, "mood": "calm"}
    assert (a["readings"], b["readings"]) == ({"light": pytest.approx(2.0)}, {})
    assert (a["presence"], a["state"], a["pattern"]) == ("alive", "running", "flocking")
    assert (b["presence"], b["state"]) == ("absent", "")
    json.dumps(source.rows(), allow_nan=False)


def test_reports_have_the_units_that_their_experiment_declares() -> None:
    trace = recorded(
        report={"left": np.full((41, 2), 0.25)}, words={"mood": np.full((41, 2), "calm")}
    )
    source = source_of({"one": RecordedRun(trace, report_units={"left": "m", "mood": "m"})})
    detail = source.detail("a")
    assert detail is not None
    assert ["Report left", "0.25 m"] in detail["values"]
    assert ["Report mood", "calm"] in detail["values"]
    assert hello_of(source, "viewer")["report_units"]["flocking"]["left"] == "m"


def test_contacts_are_shown_while_they_last_and_listed_after(source: TraceSource) -> None:
    touches = []
    for time in (0.9, 1.05, 3.0, 3.6):
        source.playback.seek(time)
        touches.append([row["touches"] for row in source.rows().values()])
    assert touches == [["", ""], ["b", "a"], ["", ""], ["", "box crate"]]
    detail = source.detail("b")
    assert detail is not None
    assert detail["events"] == [["3.5 s", "touches box crate"], ["1.0 s", "touches a"]]


def test_marks_are_contacts_states_and_events_of_the_scenario() -> None:
    state = np.full((41, 2), "estopped")
    state[:20] = "running"
    source = source_of({"one": RecordedRun(recorded(state=state))})
    assert source.marks() == [
        (0.3, "run flocking", ("a",)),
        (1.0, "touches b", ("a",)),
        (2.0, "estopped", ("a", "b")),
        (3.5, "touches box crate", ("b",)),
    ]


def test_a_fault_and_what_its_robot_said_are_shown() -> None:
    events = [
        {"at": 1.0, "action": "fault scan frozen", "robots": ["a"], "pattern": ""},
        {"at": 3.0, "action": "mend scan frozen", "robots": ["a"], "pattern": ""},
    ]
    # The trace begins at 5 s of its own clock.
    meta = {**META, "events": events, "said": [[7.0, "a", "stopped (frozen_scan)"]]}
    source = source_of({"one": RecordedRun(recorded(meta=meta))})
    assert [mark[:2] for mark in source.marks() if "touches" not in mark[1]] == [
        (1.0, "fault scan frozen"),
        (2.0, "stopped (frozen_scan)"),
        (3.0, "mend scan frozen"),
    ]

    def shown(robot: str, time: float) -> Mapping[str, Any]:
        source.playback.seek(time)
        detail = source.detail(robot)
        assert detail is not None
        return detail

    assert ["Fault", "scan frozen"] in shown("a", 2.5)["values"]
    assert shown("a", 2.5)["events"][0] == ["2.0 s", "stopped (frozen_scan)"]
    for robot, time in (("b", 2.5), ("a", 0.5), ("a", 3.5)):
        assert "Fault" not in [name for name, _ in shown(robot, time)["values"]]


def test_boxes_leave_and_links_end_beyond_the_radio(source: TraceSource) -> None:
    source.playback.seek(1.0)
    ((_, pose),) = source.boxes()
    assert pose == pytest.approx([0.0, 1.5, 0.0])
    assert list(source.links()) == []  # b has no daemon yet
    source.playback.seek(2.0)
    assert list(source.links()) == [(0, 1)]
    source.playback.seek(3.0)
    assert list(source.links()) == []
    assert source.boxes() == []


def test_scans_are_computed_from_the_positions(source: TraceSource) -> None:
    source.playback.seek(0.0)
    points = source.scan("a")
    assert points is not None
    ahead = points[np.argmin(np.abs(np.arctan2(points[:, 1], points[:, 0])))]
    assert ahead[0] == pytest.approx(3.0, abs=0.01)  # the wall
    left = points[np.abs(points[:, 0] + 0.03) < 0.02]
    assert left[:, 1].max() == pytest.approx(1.0, abs=0.15)  # b, in front of the crate


def test_another_run_is_chosen_and_a_broken_one_is_not() -> None:
    other = replace(recorded(), ids=("c", "d"))
    source = source_of({"one": RecordedRun(recorded()), "two": RecordedRun(other)})
    revision = source.revision
    source.playback.seek(2.0)
    source.playback.choose("two")
    assert [robot.name for robot in source.robots] == ["c", "d"]
    assert source.revision > revision
    assert (source.playback.run, source.playback.time) == ("two", 0.0)
    with pytest.raises(ConfigError):
        source.playback.choose("broken")
    assert source.playback.run == "two"
    assert list(source.rows()) == ["c", "d"]
    assert source.detail("a") is None
    assert source.scan("a") is None


def test_a_run_without_instants_shows_nothing() -> None:
    trace = TraceBuilder(IDS, [BURGER, BURGER], META).trace()
    source = source_of({"one": RecordedRun(trace)})
    assert len(source.frame()[1]) == 0
    assert source.rows() == {}
    assert source.links() == ()
    assert source.detail("a") is None


def test_the_floor_is_a_picture_of_its_own_and_no_field() -> None:
    floor = FloorField(name="ground", patches=(Patch(disc=(0.0, 0.0, 0.5)),))
    arena = source_of({"one": RecordedRun(recorded(), [floor])}).arena
    assert arena is not None
    assert dict(arena.fields) == {}
    head, _, data = arena.floor.partition(",")
    picture = base64.b64decode(data)
    assert head == "data:image/png;base64"
    assert picture.startswith(b"\x89PNG")
    pixels = shown.png_of(np.zeros((2, 3, 3), np.uint8))
    assert struct.unpack(">II", pixels[16:24]) == (3, 2)
    assert zlib.decompress(pixels[41:-16]) == bytes(2 * 10)
