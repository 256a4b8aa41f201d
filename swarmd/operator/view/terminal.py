"""Draws a fleet on a terminal: a table of the robots beside a small map seen from above."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import zip_longest

from rich.cells import cell_len, set_cell_size
from rich.console import Group
from rich.text import Text

from swarmd.core.messages import State, Status
from swarmd.operator.texts.values import printable
from swarmd.operator.texts.why import SILENT, lost_base, state_word
from swarmd.operator.view.scene import Area, Scene

ARROWS = "→↗↑↖←↙↓↘"
COLOURS = {
    State.IDLE: "cyan",
    State.RUNNING: "green",
    State.STOPPED: "yellow",
    State.ESTOPPED: "bold red",
    State.FAULTED: "bold magenta",
}
COLUMNS = (("state", 9), ("reason", 18), ("pattern", 13), ("scan", 7), ("loop99", 7), ("near", 6))
NUMBERS = frozenset({"scan", "loop99", "near"})
NAME_WIDTH = 11
MAX_NAME_WIDTH = 24
TABLE_WIDTH = NAME_WIDTH + sum(1 + width for _, width in COLUMNS)
LOST = "bold white on magenta"
"""The style of a base that is lost: the robot takes no command, whatever its state."""
GAP = 2  # between the table and the map
MARGIN = 5  # the map's frame and the gap beside the table
MIN_MAP = (16, 4)
FRAME = 2  # lines above and below the map
CURSOR = 1  # the line of the cursor, below the view


def render(scene: Scene, width: int, height: int) -> Group:
    """The view as text, for a terminal of `width` by `height`; one line is left for the cursor."""
    return Group(*lines_of(scene, width, height - CURSOR))


def lines_of(scene: Scene, width: int, height: int) -> list[Text]:
    """The screen as text: at most `height` lines of at most `width` characters.

    From top to bottom: title, table of robots with a map, answers and prompt. A map smaller than
    MIN_MAP (width, height) is left out. A table that is too long shows the robots that `chosen`
    returns, and the number of hidden robots.
    """
    title = _line(scene.title, "bold")
    bottom = [_line(text, style) for text, style in scene.below]
    bottom.append(_line(scene.footer, scene.footer_style))
    body = _table_and_map(scene, width, max(height - 1 - len(bottom), 2))
    # A low screen has less of the table, then less of the answers; the prompt, the last line,
    # always stays.
    top_height = max(height - len(bottom), 0)
    bottom_height = max(height, 1)
    lines = [title, *body][:top_height] + bottom[-bottom_height:]
    for line in lines:
        line.truncate(width, overflow="ellipsis")
    return lines


def _table_and_map(scene: Scene, width: int, height: int) -> list[Text]:
    """The table in at most `height` lines, with a map beside or below, if there is room for one."""
    min_map_width, min_map_height = MIN_MAP
    width_beside = width - TABLE_WIDTH - MARGIN
    if width_beside >= min_map_width and height >= min_map_height + FRAME:
        # Long names widen the table, from the columns that the map can spare.
        name_width = _name_width(scene, width_beside - min_map_width)
        table_width = TABLE_WIDTH - NAME_WIDTH + name_width
        map_width = width - table_width - MARGIN
        map_lines = map_of(scene, *map_size(scene.area, map_width, height - FRAME))
        return _side_by_side(table_of(scene, height, name_width), map_lines)
    table = table_of(scene, height, _name_width(scene, width - TABLE_WIDTH))
    header = 1
    height_below = height - header - len(scene.order)
    if height_below < min_map_height + FRAME:
        return table
    return table + map_of(scene, *map_size(scene.area, width - MARGIN, height_below - FRAME))


def table_of(scene: Scene, lines: int, name_width: int = NAME_WIDTH) -> list[Text]:
    """The table of robots: name, state, reason, pattern, scan rate, loop delay, nearest obstacle.

    At most `lines` lines with the header; the last line counts the robots that are left out.
    """
    header = " ".join([_cell("name", name_width), *(_cell(*column) for column in COLUMNS)])
    rows = [Text(header, style="bold")]
    robots_shown = chosen(scene, max(lines - 1, 1))
    marks = {robot: _mark(number) for number, robot in enumerate(scene.poses)}
    for robot in robots_shown:
        rows.append(_row(scene, robot, marks.get(robot, " "), name_width))
    if len(robots_shown) < len(scene.order):
        hidden = len(scene.order) - len(robots_shown)
        rows.append(Text(f"... and {hidden} more", style="dim"))
    return rows


def chosen(scene: Scene, rows: int) -> Sequence[str]:
    """The robots to show in `rows` lines; if not all fit, the last line counts the hidden robots.

    Alarms are kept first, running robots last. The shown robots stay in their order.
    """
    robots = scene.order
    if len(robots) <= rows:
        return robots
    kept = set(sorted(robots, key=partial(_rank, scene))[: rows - 1])
    return tuple(robot for robot in robots if robot in kept)


def _rank(scene: Scene, robot: str) -> int:
    """0 for an alarm (silent, estopped, faulted, base lost), 2 for a robot that runs, else 1."""
    status = scene.statuses.get(robot)
    if status is None or status.state in (State.ESTOPPED, State.FAULTED) or lost_base(status):
        return 0
    return 2 if status.state is State.RUNNING else 1


def map_size(area: Area, width: int, height: int) -> tuple[int, int]:
    """(columns, rows) of a map with the aspect ratio of `area`, at most `width` by `height`.

    A character is half as wide as high.
    """
    length, depth = area.size
    columns = min(width, 2 * height * length / depth)
    return max(8, int(columns)), max(4, round(columns * depth / length / 2))


def map_of(scene: Scene, columns: int, rows: int) -> list[Text]:
    """The area with a mark for each robot, and an arrow for its heading."""
    grid: list[dict[int, tuple[str, str]]] = [{} for _ in range(rows)]
    cells = {robot: cell_of(pose, scene.area, columns, rows) for robot, pose in scene.poses.items()}
    for robot, (column, row) in cells.items():
        octant = round(scene.poses[robot][2] / (math.pi / 4)) % 8
        arrow = (column + _DX[octant], row - _DY[octant])
        if 0 <= arrow[0] < columns and 0 <= arrow[1] < rows:
            grid[arrow[1]][arrow[0]] = (ARROWS[octant], _colour(scene, robot))
    for number, (robot, (column, row)) in enumerate(cells.items()):
        grid[row][column] = (_mark(number), f"bold {_colour(scene, robot)}")
    note = f" {scene.map_note} " if 0 < len(scene.map_note) <= columns - 2 else ""
    return [
        Text(f"┌{'─' * columns}┐", style="dim"),
        *(_map_line(line, columns) for line in grid),
        Text(f"└{note.ljust(columns, '─')}┘", style="dim"),
    ]


def cell_of(pose: Sequence[float], area: Area, columns: int, rows: int) -> tuple[int, int]:
    """Column and row of a pose; row 0 is the area's largest y."""
    column = int(((pose[0] - area.center[0]) / area.size[0] + 0.5) * columns)
    row = int((0.5 - (pose[1] - area.center[1]) / area.size[1]) * rows)
    return min(max(column, 0), columns - 1), min(max(row, 0), rows - 1)


def _row(scene: Scene, robot: str, mark: str, name_width: int) -> Text:
    status = scene.statuses.get(robot)
    note = scene.notes.get(robot)
    row = Text(_cell(f"{mark} {robot}", name_width), no_wrap=True)
    if status is None or note:
        row.append(f" {SILENT:9} {printable(note or '')}".rstrip(), "red")
        return row
    for (title, width), text in zip(COLUMNS, _values(status), strict=True):
        is_number = title in NUMBERS
        shown = text.rjust(width) if is_number else _cell(text, width)
        style = COLOURS[status.state] if title == "state" else ""
        row.append(f" {shown}", LOST if title == "reason" and lost_base(status) else style)
    return row


def _values(status: Status) -> tuple[str, ...]:
    near = status.decision.min_gap
    return (
        state_word(status),
        "base lost" if lost_base(status) else status.reason.value if status.reason else "",
        status.pattern or "",
        f"{status.health.scan_rate:.1f} Hz",
        f"{1000 * status.health.loop_p99:.1f} ms",
        "-" if near is None else f"{near:.2f} m",
    )


def _name_width(scene: Scene, spare: int) -> int:
    """The width of the first column: as the names need, at most `spare` more than usual."""
    needed = max((len(robot) for robot in scene.order), default=0) + 2
    return min(max(needed, NAME_WIDTH), NAME_WIDTH + max(spare, 0), MAX_NAME_WIDTH)


def _side_by_side(left: list[Text], right: list[Text]) -> list[Text]:
    width = max(line.cell_len for line in left)
    both = []
    for line, beside in zip_longest(left, right, fillvalue=Text()):
        padded = line.copy()
        padded.pad_right(width - padded.cell_len + GAP)
        both.append(padded.append_text(beside))
    return both


def _map_line(cells: dict[int, tuple[str, str]], columns: int) -> Text:
    text = Text(no_wrap=True)
    text.append("│", "dim")
    at = 0
    for column, (character, style) in sorted(cells.items()):
        text.append(" " * (column - at))
        text.append(character, style)
        at = column + 1
    text.append(" " * (columns - at))
    text.append("│", "dim")
    return text


def _line(text: str, style: str) -> Text:
    return Text(printable(text), style=style, no_wrap=True)


def _cell(text: str, width: int) -> str:
    text = printable(text)
    if cell_len(text) <= width:
        return set_cell_size(text, width)
    return f"{set_cell_size(text, width - 1)}…"


_DX = (1, 1, 0, -1, -1, -1, 0, 1)
_DY = (0, 1, 1, 1, 0, -1, -1, -1)


def _mark(number: int) -> str:
    marks = "123456789abcdefghijklmnopqrstuvwxyz"
    return marks[number] if number < len(marks) else "*"


def _colour(scene: Scene, robot: str) -> str:
    status = scene.statuses.get(robot)
    if status is None or robot in scene.notes:
        return "white"
    return COLOURS[status.state].removeprefix("bold ")
