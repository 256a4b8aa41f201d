"""What changed for a robot in a recording: one line a change, over the whole minute."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from swarmd.core.events import (
    TICK_INPUT,
    DriverInput,
    HazardsInput,
    HostInput,
    NeighborsInput,
    NoteInput,
    RequestInput,
    ScanInput,
)
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.host_messages import HostDied
from swarmd.core.messages import State
from swarmd.core.values import Neighbor, Scan
from swarmd.core.verbs import StopRequest
from swarmd.operator.replay.changes import MAX_LINES, Changes, input_text
from swarmd.operator.replay.replay import prepare
from swarmd.operator.replay.swarm import repeat_together
from tests.support.recorded_stories import ORIGINS, Story


def decision(state: str = "running", reason: str = "", **more: Any) -> SimpleNamespace:
    fields = {"is_active": False, "is_recovering": False, "avoiding": "", "bearings": ()}
    return SimpleNamespace(**{"state": state, "reason": reason, **fields, **more})


def scan(seq: int, first: float) -> ScanInput:
    ranges = np.linspace(first, first + 1.0, 36)
    return ScanInput(Scan(seq, 0.0, ranges, np.linspace(-3.0, 3.0, 36), 0.1, 4.0))


def told(changes: Changes, until: float = 1e9) -> list[tuple[float, str]]:
    return [(one.at, one.text) for one in changes.lines(until)]


def test_a_lidar_that_freezes_is_told_with_the_scan_at_which_it_froze() -> None:
    """Scans at 10 Hz that differ until 4.0 s; then 20 equal ones; the hold comes at 5.0 s."""
    changes = Changes()
    for number in range(61):
        at = number / 10.0
        changes.take_input(scan(number, 1.0 + 0.01 * min(number, 40)), at)
        held = ("running", "frozen_scan") if at >= 5.0 else ("running", "")
        changes.take_decision(decision(*held), at)
    changes.take_decision(decision("stopped", "frozen_scan"), 6.1)
    lines = told(changes)
    assert [at for at, _ in lines] == [0.0, 4.1, 5.0, 6.1]
    assert "scan" in lines[1][1]
    assert lines[2][1] == "running -> held frozen_scan"
    assert lines[3][1] == "held frozen_scan -> stopped frozen_scan"


def test_ranges_without_returns_repeat_without_a_line() -> None:
    """As the monitor of protection: a hall without a return is no frozen lidar."""
    changes = Changes()
    for number in range(30):
        empty = Scan(number, 0.0, np.full(36, np.inf), np.linspace(-3.0, 3.0, 36), 0.1, 4.0)
        changes.take_input(ScanInput(empty), number / 10.0)
    assert told(changes) == []


def test_equal_decisions_are_one_line() -> None:
    changes = Changes()
    for number in range(1000):
        changes.take_decision(decision(), number / 20.0)
    assert told(changes) == [(0.0, "running")]


def test_protection_that_flickers_is_one_line_and_a_hold_after_it_its_own() -> None:
    changes = Changes()
    for number in range(20):
        changes.take_decision(decision(is_active=number % 2 == 1), 1.0 + 0.2 * number)
    changes.take_decision(decision("running", "stale_scan"), 4.9)
    lines = told(changes)
    assert [at for at, _ in lines] == pytest.approx([1.0, 1.2, 4.9])
    assert "19" in lines[1][1]
    assert "4.800" in lines[1][1], "until when"
    assert lines[2][1].endswith("held stale_scan")


def test_protection_that_changes_slowly_has_a_line_each() -> None:
    changes = Changes()
    for number in range(4):
        changes.take_decision(decision(is_active=number % 2 == 1), 3.0 * number)
    assert [at for at, _ in told(changes)] == [0.0, 3.0, 6.0, 9.0]


def test_figures_in_the_words_of_avoidance_are_no_change() -> None:
    changes = Changes()
    for number in range(30):
        words = f"avoiding tb3-0{4 + number // 29}"
        if number < 20:
            words = f"avoiding an object at {number - 9} deg, {number / 10.0} m"
        changes.take_decision(decision(avoiding=words), 3.0 * number)
    assert [at for at, _ in told(changes)] == [0.0, 60.0, 87.0], "peers are told apart"


def test_scans_that_end_are_told_at_the_last_one() -> None:
    changes = Changes()
    for number in range(100):
        if number <= 50 or number > 90:
            changes.take_input(scan(number, 1.0 + 0.01 * number), number / 10.0)
        changes.take_input(TICK_INPUT, number / 10.0)
    (line,) = told(changes)
    assert line[0] == 5.0
    assert "scan" in line[1]
    assert "4.1 s" in line[1]


def test_scans_that_never_come_again_are_told() -> None:
    changes = Changes()
    for number in range(100):
        if number <= 50:
            changes.take_input(scan(number, 1.0 + 0.01 * number), number / 10.0)
        changes.take_input(TICK_INPUT, number / 10.0)
    (line,) = told(changes)
    assert line[0] == 5.0
    assert "scan" in line[1]


def test_a_slow_sensor_is_not_silent() -> None:
    changes = Changes()
    for number in range(20):
        changes.take_input(scan(number, 1.0 + 0.01 * number), 1.5 * number)
    assert told(changes) == []


def test_a_stop_that_robots_repeat_is_told_once() -> None:
    changes = Changes()
    for at in (1.0, 1.25, 30.0):
        changes.take_input(RequestInput(StopRequest(id="r", operator="anna")), at)
    changes.take_input(RequestInput(StopRequest(id="s", operator="anna")), 31.0)
    assert [at for at, _ in told(changes)] == [1.0, 31.0]


def test_what_happens_once_has_a_line_each_in_the_order_of_time() -> None:
    changes = Changes()
    changes.take_input(DriverInput(is_up=True, text=""), 1.0)
    changes.take_input(DriverInput(is_up=True, text=""), 2.0)
    changes.take_input(NeighborsInput((Neighbor("b", 0.0), Neighbor("a", 0.0))), 2.5)
    changes.take_input(NeighborsInput((Neighbor("a", 0.4), Neighbor("b", 0.0))), 2.6)
    changes.take_input(HazardsInput((Hazard(HazardKind.CLIFF, "front left"),)), 3.0)
    changes.take_input(RequestInput(StopRequest(id="r", operator="anna")), 4.0)
    changes.take_input(HostInput(HostDied(1, "killed by signal 9")), 5.0)
    changes.take_input(NoteInput("black box: full"), 6.0)
    changes.take_event("black box: full", 6.0)
    changes.take_event("stopped by anna", 4.0)
    changes.take_input(NeighborsInput((Neighbor("a", 0.4),)), 7.0)
    changes.take_input(DriverInput(is_up=False, text="no cable"), 8.0)
    lines = told(changes)
    assert [at for at, _ in lines] == [1.0, 2.5, 3.0, 4.0, 4.0, 5.0, 6.0, 7.0, 8.0]
    for text, wanted in zip(
        [text for _, text in lines],
        ["base", "a, b", "cliff front left", "stop", "anna", "signal 9", "full", "a", "no cable"],
        strict=True,
    ):
        assert wanted in text
    assert len(told(changes, until=4.0)) == 5


def test_lines_are_bounded_and_the_last_ones_stay() -> None:
    changes = Changes()
    for number in range(3 * MAX_LINES):
        changes.take_input(NoteInput(f"line {number}"), float(number))
    lines = told(changes)
    assert len(lines) == MAX_LINES + 1
    assert str(2 * MAX_LINES) in lines[0][1]
    assert lines[-1][1].endswith(f"line {3 * MAX_LINES - 1}")


@pytest.mark.parametrize(
    ("input", "words"),
    [
        (TICK_INPUT, ("daemon",)),
        (HostInput(HostDied(1, "killed")), ("pattern host", "killed")),
        (NoteInput("a chair"), ("log", "a chair")),
        (scan(7, 1.0), ("scan", "36 rays")),
    ],
)
def test_a_raw_line_has_words(input: Any, words: tuple[str, ...]) -> None:
    assert all(word in input_text(input) for word in words)


def test_a_recorded_robot_whose_lidar_freezes_is_told_from_the_first_repeated_scan_on(
    tmp_path: Path,
) -> None:
    """Through the recording: the scans freeze in a run, the hold follows, and then the end."""
    story = Story(tmp_path)
    story.robot.advance(1.0)
    story.recorder.begin(story.robot)

    def room(seq: int, now: float) -> Scan:
        """Walls of many distances, which change a little with each scan."""
        scan = story._scan(seq, now)
        walls = np.linspace(1.0, 2.0, len(scan.ranges)) + 1e-4 * seq
        return structs.replace(scan, ranges=walls)

    story.robot.scans = room
    story.run("drive", 2.0, speed=0.1)
    frozen, froze = room(0, story.robot.now), story.robot.now
    story.robot.scans = lambda seq, now: structs.replace(frozen, seq=seq, stamp=now)
    story.robot.advance(15.0)
    assert story.robot.robot.state is State.STOPPED
    life = prepare([story.recorder.finish()], ORIGINS)
    changes = Changes()
    life.replay.changes = changes
    repeat_together([life])
    assert life.parity().safe.is_equal
    first = life.replay._begin or 0.0
    lines = told(changes)
    repeats, held, stopped = (
        next(one for one in lines if words in one[1])
        for words in ("repeat", "-> held frozen_scan", "-> stopped")
    )
    assert froze - first <= repeats[0] <= froze - first + 1.0
    assert repeats[0] < held[0] < stopped[0]
