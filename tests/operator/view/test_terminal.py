"""A fleet on a terminal: the rows of the table, the robots on the map, the lines below."""

from __future__ import annotations

import io
import math
from dataclasses import replace

import pytest
from rich.console import Console

from swarmd.core.messages import Health, Reason, State, Status
from swarmd.operator.view.scene import Area, Scene, area_around
from swarmd.operator.view.terminal import cell_of, lines_of, map_of, map_size, render
from tests.support.statuses import status

ARENA = Area((6.0, 3.0))


def shown(scene: Scene, width: int = 140, height: int = 30) -> str:
    console = Console(width=width, height=height, file=io.StringIO(), color_system=None)
    with console.capture() as capture:
        console.print(render(scene, width, height))
    return capture.get()


def scene(**poses: tuple[float, float, float]) -> Scene:
    return Scene("attraction", ARENA, poses, {name: status(name) for name in poses})


def test_a_row_has_the_status_of_the_robot() -> None:
    row = next(line for line in shown(scene(a=(0.0, 0.0, 0.0))).splitlines() if "1 a" in line)
    assert row.split("│")[0].split() == (
        ["1", "a", "running", "drive", "5.0", "Hz", "4.1", "ms", "0.61", "m"]
    )


def test_a_lost_base_is_shown_whatever_the_state() -> None:
    health = Health(driver="no such device", driver_up=False)
    lost = {"a": status("a", state=State.ESTOPPED, health=health)}
    shown_row = shown(Scene("estop", ARENA, {"a": (0.0, 0.0, 0.0)}, lost))
    assert "base lost" in shown_row


@pytest.mark.parametrize(
    ("pose", "cell"),
    [
        ((-2.99, 1.49), (0, 0)),
        ((2.99, -1.49), (39, 9)),
        ((0.01, -0.01), (20, 5)),
        ((99.0, 99.0), (39, 0)),
    ],
)
def test_map_has_x_to_the_right_and_y_upwards(
    pose: tuple[float, float], cell: tuple[int, int]
) -> None:
    assert cell_of(pose, ARENA, 40, 10) == cell


@pytest.mark.parametrize(
    ("yaw", "arrow", "offset"),
    [
        (0.0, "→", (1, 0)),
        (math.pi / 2, "↑", (0, -1)),
        (-math.pi, "←", (-1, 0)),
        (-3 * math.pi / 4, "↙", (-1, 1)),
    ],
)
def test_an_arrow_points_where_the_robot_heads(
    yaw: float, arrow: str, offset: tuple[int, int]
) -> None:
    lines = [line.plain for line in map_of(scene(a=(0.01, -0.01, yaw)), 40, 10)]
    assert lines[1 + 5][1 + 20] == "1"
    assert lines[1 + 5 + offset[1]][1 + 20 + offset[0]] == arrow


def test_map_keeps_the_shape_of_the_arena() -> None:
    assert map_size(Area((6.0, 3.0)), 40, 100) == (40, 10)
    assert map_size(Area((6.0, 6.0)), 100, 20) == (40, 20)
    assert map_size(Area((6.0, 3.0)), 160, 60) == (160, 40)  # all that the terminal has


@pytest.mark.parametrize(("width", "height"), [(140, 40), (100, 24), (80, 24), (80, 12), (40, 10)])
def test_view_fits_the_terminal(width: int, height: int) -> None:
    robots = {f"tb3-{i:02d}": (i - 4.0, 0.0, 0.0) for i in range(1, 8)}
    lines = shown(scene(**robots), width, height).splitlines()
    assert max(len(line) for line in lines) <= width
    assert len(lines) < height
    assert ("┌" in "".join(lines)) == (height >= 24)


def test_the_frame_of_the_map_is_whole_at_each_width() -> None:
    robots = scene(**{f"tb3-{i:02d}": (i - 4.0, 0.0, 0.0) for i in range(1, 8)})
    for width in range(40, 201):
        for note in ("", "each by its own odometry", "x" * 300):
            lines = [line.plain for line in lines_of(replace(robots, map_note=note), width, 40)]
            (top,) = (line[line.index("┌") :] for line in lines if "┌" in line)
            (bottom,) = (line[line.index("└") :] for line in lines if "└" in line)
            room = len(top) - 2
            shown_note = f" {note} " if 0 < len(note) <= room - 2 else ""
            assert top == f"┌{'─' * room}┐"
            assert bottom == f"└{shown_note}{'─' * (room - len(shown_note))}┘"


def crowd(*standing: int) -> Scene:
    """Thirty robots, of which some stand and the last does not answer."""
    names = [f"tb3-{i:02d}" for i in range(1, 31)]
    statuses = {name: status(name) for name in names[:-1]}
    for i in standing:
        name = f"tb3-{i:02d}"
        statuses[name] = status(name, state=State.STOPPED, reason=Reason.NO_SCAN)
    poses = {name: (0.1 * i - 1.5, 0.0, 0.0) for i, name in enumerate(names)}
    return Scene("attraction", ARENA, poses, statuses, footer="the end")


@pytest.mark.parametrize(("width", "height"), [(80, 24), (140, 24), (80, 10), (140, 6), (80, 40)])
def test_robots_that_stand_are_shown_first_and_the_rest_is_counted(width: int, height: int) -> None:
    lines = shown(crowd(25), width, height).splitlines()
    text = "\n".join(lines)
    assert len(lines) < height
    assert lines[0].startswith("attraction")
    assert lines[-1].startswith("the end")
    if height < 34:
        rows = sum(" tb3-" in line for line in lines)
        assert f"... and {30 - rows} more" in text
        assert "silent" in text  # the alarm is shown before the stopped robot
        assert "no_scan" in text or rows < 2
    else:
        assert "more" not in text


def test_robots_keep_their_order_and_marks_if_some_are_left_out() -> None:
    names = [line.split()[:2] for line in shown(crowd(25), 80, 10).splitlines()[2:-2]]
    assert names == [
        ["1", "tb3-01"],
        ["2", "tb3-02"],
        ["3", "tb3-03"],
        ["p", "tb3-25"],
        ["u", "tb3-30"],
    ]


def test_a_robot_with_a_note_is_silent_in_place_of_its_status() -> None:
    noted = replace(scene(a=(0.0, 0.0, 0.0)), robots=("a", "c"), notes={"c": "failed 3 s ago"})
    rows = [line.split("│")[0].split() for line in shown(noted).splitlines()[2:4]]
    assert [row[:3] for row in rows] == [["1", "a", "running"], ["c", "silent", "failed"]]


@pytest.mark.parametrize(
    "alarm",
    [
        status("tb3-29", state=State.ESTOPPED, reason=Reason.ESTOP),
        status("tb3-29", state=State.FAULTED),
        status("tb3-29", health=Health(driver="no such device", driver_up=False)),
    ],
    ids=["estopped", "faulted", "base lost"],
)
def test_an_alarm_is_shown_before_robots_that_are_idle(alarm: Status) -> None:
    many = crowd()
    idle = {name: status(name, state=State.IDLE) for name in many.statuses}
    lines = shown(replace(many, statuses={**idle, "tb3-29": alarm}), 80, 10).splitlines()
    assert [line.split()[1] for line in lines[2:-2]] == [
        *("tb3-01", "tb3-02", "tb3-03", "tb3-29", "tb3-30")  # tb3-30 is silent
    ]
    assert "25 more" in lines[-2]


@pytest.mark.parametrize(("width", "height"), [(1, 1), (20, 2), (80, 3)])
def test_a_terminal_without_room_for_a_robot_is_drawn(width: int, height: int) -> None:
    lines = lines_of(crowd(25), width, height)
    assert max(line.cell_len for line in lines) <= width


def test_the_last_lines_stay_on_a_small_terminal() -> None:
    below = [("estop: 1 not acknowledged", "bold red"), ("why", "")]
    lines = shown(replace(crowd(), below=below), 80, 5).splitlines()
    assert [line.split()[0] for line in lines] == ["attraction", "estop:", "why", "the"]


def test_control_characters_of_a_robot_do_not_reach_the_terminal() -> None:
    evil = Scene("t", ARENA, {"a": (0.0, 0.0, 0.0)}, {"a": status("a", pattern="x\x1b[2Jy")})
    text = shown(replace(evil, below=[("\x1b]0;title\x07", "")]))
    assert "\x1b" not in text
    assert "x?[2Jy" in text


def test_an_area_around_places_contains_them_in_whole_metres() -> None:
    poses = {"a": (0.2, 0.0, 0.0), "b": (3.7, -1.2, 0.0)}
    assert area_around(poses) == Area((6.0, 3.0), (2.0, -0.5))
    assert area_around({"a": (0.0, 0.0, 0.0)}).size == (2.0, 2.0)
