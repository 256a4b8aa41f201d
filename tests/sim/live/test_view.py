"""The live view: the rows of the table, and the robots on the map."""

from __future__ import annotations

import io
import math

import pytest
from rich.console import Console

from swarmd.core.messages import Reason, State
from swarmd.sim.live.demo_run import Scene
from swarmd.sim.live.view import cell_of, map_of, map_size, render
from tests.support.statuses import status

ARENA = (6.0, 3.0)


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
    lines = map_of(scene(a=(0.01, -0.01, yaw)), 40, 10).plain.splitlines()
    assert lines[1 + 5][1 + 20] == "1"
    assert lines[1 + 5 + offset[1]][1 + 20 + offset[0]] == arrow


def test_map_keeps_the_shape_of_the_arena() -> None:
    assert map_size((6.0, 3.0), 40, 100) == (40, 10)
    assert map_size((6.0, 6.0), 100, 20) == (40, 20)


@pytest.mark.parametrize(("width", "height"), [(140, 40), (100, 24), (80, 24), (80, 12), (40, 10)])
def test_view_fits_the_terminal(width: int, height: int) -> None:
    robots = {f"tb3-{i:02d}": (i - 4.0, 0.0, 0.0) for i in range(1, 8)}
    lines = shown(scene(**robots), width, height).splitlines()
    assert max(len(line) for line in lines) <= width
    assert len(lines) < height
    assert ("┌" in "".join(lines)) == (height >= 24)


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
def test_stopped_robots_are_shown_first_and_the_rest_is_counted(width: int, height: int) -> None:
    lines = shown(crowd(25), width, height).splitlines()
    text = "\n".join(lines)
    assert len(lines) < height
    assert lines[0].startswith("attraction")
    assert lines[-1].startswith("the end")
    if height < 34:
        rows = sum(" tb3-" in line for line in lines)
        assert f"... and {30 - rows} more" in text
        assert "no answer" in text or rows < 2
        assert "no_scan" in text
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
