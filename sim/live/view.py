"""The live view of a fleet: a table of the robots beside a small map seen from above."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from swarmd.core.messages import State, Status
from swarmd.sim.live.demo_run import Scene

ARROWS = "→↗↑↖←↙↓↘"
COLOURS = {
    State.IDLE: "cyan",
    State.RUNNING: "green",
    State.STOPPED: "yellow",
    State.ESTOPPED: "bold red",
    State.FAULTED: "bold magenta",
}
TABLE_WIDTH = 78
MARGIN = 4  # the map's frame and the gap beside the table
MAX_MAP = (48, 22)  # columns and rows
MIN_MAP = (16, 4)
FRAME = 2  # lines above and below the map
CURSOR = 1  # the line of the cursor, below the view


def render(scene: Scene, width: int, height: int) -> RenderableType:
    """The view for a terminal of `width` by `height` characters.

    With more robots than lines, robots that do not run are shown first, and the rest is counted.
    """
    heading = Text(scene.title, style="bold", no_wrap=True, overflow="ellipsis")
    footer = Text(scene.footer, style="dim", no_wrap=True, overflow="ellipsis")
    lines = height - CURSOR - len((heading, footer))
    table = table_of(scene, lines)
    below = lines - len(scene.poses) - 1
    if width >= TABLE_WIDTH + MARGIN + MIN_MAP[0] and lines >= MIN_MAP[1] + FRAME:
        size = map_size(scene.arena, width - TABLE_WIDTH - MARGIN, lines - FRAME)
        both = Table.grid(padding=(0, 2))
        both.add_row(table, map_of(scene, *size))
        return Group(heading, both, footer)
    if below >= MIN_MAP[1] + FRAME:
        size = map_size(scene.arena, width - MARGIN, below - FRAME)
        return Group(heading, table, map_of(scene, *size), footer)
    return Group(heading, table, footer)


def table_of(scene: Scene, lines: int) -> RenderableType:
    """A row for each robot: name, state, reason, pattern, scan rate, loop p99, nearest obstacle.

    At most `lines` with the header; if robots are left out, the last line counts them.
    """
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, width=TABLE_WIDTH)
    for title, width in (("name", 11), ("state", 9), ("reason", 18), ("pattern", 13)):
        table.add_column(title, width=width, no_wrap=True)
    for title, width in (("scan", 7), ("loop99", 7), ("near", 6)):
        table.add_column(title, width=width, no_wrap=True, justify="right")
    shown = chosen(scene, max(lines - 1, 1))
    for number, robot in enumerate(scene.poses):
        if robot in shown:
            label = Text(f"{_mark(number)} {robot}", no_wrap=True, overflow="ellipsis")
            table.add_row(label, *_cells(scene.statuses.get(robot)))
    more = len(scene.poses) - len(shown)
    return Group(table, Text(f"... and {more} more", style="dim")) if more else table


def chosen(scene: Scene, rows: int) -> tuple[str, ...]:
    """The robots to show in `rows`, one of which is kept for the count if not all fit.

    Robots that do not run are kept, since they need attention; others are left out from the end.
    """
    robots = list(scene.poses)
    if len(robots) <= rows:
        return tuple(robots)
    running = {name for name, one in scene.statuses.items() if one.state is State.RUNNING}
    first = sorted(robots, key=running.__contains__)
    kept = set(first[: rows - 1])
    return tuple(robot for robot in robots if robot in kept)


def _cells(status: Status | None) -> tuple[Text | str, ...]:
    if status is None:
        return (Text("no answer", style="red"),)
    near = status.decision.min_gap
    return (
        Text(status.state.value, style=COLOURS[status.state]),
        status.reason.value if status.reason else "",
        status.pattern or "",
        f"{status.health.scan_rate:.1f} Hz",
        f"{1000 * status.health.loop_p99:.1f} ms",
        "-" if near is None else f"{near:.2f} m",
    )


def map_size(arena: tuple[float, float], width: int, height: int) -> tuple[int, int]:
    """Columns and rows inside the frame with the arena's aspect ratio; a character is 1 by 2.

    At most `width` by `height`, and at most `MAX_MAP`.
    """
    columns = min(width, MAX_MAP[0], 2 * min(height, MAX_MAP[1]) * arena[0] / arena[1])
    return max(8, int(columns)), max(4, round(columns * arena[1] / arena[0] / 2))


def map_of(scene: Scene, columns: int, rows: int) -> Text:
    """The arena with a mark for each robot, and an arrow for its heading."""
    grid: list[list[tuple[str, str]]] = [[(" ", "")] * columns for _ in range(rows)]
    cells = {
        robot: cell_of(pose, scene.arena, columns, rows) for robot, pose in scene.poses.items()
    }
    for robot, (column, row) in cells.items():
        octant = _octant(scene.poses[robot][2])
        arrow = (column + _DX[octant], row - _DY[octant])
        if 0 <= arrow[0] < columns and 0 <= arrow[1] < rows:
            grid[arrow[1]][arrow[0]] = (ARROWS[octant], _colour(scene, robot))
    for number, (robot, (column, row)) in enumerate(cells.items()):
        grid[row][column] = (_mark(number), f"bold {_colour(scene, robot)}")
    text = Text(no_wrap=True)
    text.append("┌" + "─" * columns + "┐\n", style="dim")
    for line in grid:
        text.append("│", style="dim")
        for character, style in line:
            text.append(character, style=style)
        text.append("│\n", style="dim")
    text.append("└" + "─" * columns + "┘", style="dim")
    return text


def cell_of(
    pose: Sequence[float], arena: tuple[float, float], columns: int, rows: int
) -> tuple[int, int]:
    """Column and row of a pose; row 0 is the arena's largest y."""
    column = int((pose[0] / arena[0] + 0.5) * columns)
    row = int((0.5 - pose[1] / arena[1]) * rows)
    return min(max(column, 0), columns - 1), min(max(row, 0), rows - 1)


_DX = (1, 1, 0, -1, -1, -1, 0, 1)
_DY = (0, 1, 1, 1, 0, -1, -1, -1)


def _octant(yaw: float) -> int:
    return round(yaw / (math.pi / 4)) % 8


def _mark(number: int) -> str:
    marks = "123456789abcdefghijklmnopqrstuvwxyz"
    return marks[number] if number < len(marks) else "*"


def _colour(scene: Scene, robot: str) -> str:
    status = scene.statuses.get(robot)
    if status is None:
        return "white"
    return COLOURS[status.state].removeprefix("bold ")
