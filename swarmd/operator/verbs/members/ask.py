"""The robots of a swarm as a look has shown them, for Python; and members are forgotten."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any

from swarmd.core.errors import RequestError
from swarmd.core.messages import Presence
from swarmd.core.verbs import ForgetRequest
from swarmd.operator.session.exit_codes import REFUSED, code_of_answers
from swarmd.operator.session.members_view import MembersView, SeenMember
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.states import Pose
from swarmd.operator.session.targets import check_known
from swarmd.operator.texts.status import NOT_DESCRIBED, sections_with_events
from swarmd.operator.texts.values import printable
from swarmd.operator.texts.why import why
from swarmd.operator.verbs.members.words import HEADER, health, row
from swarmd.plugins import installed_patterns

_COLOURS = {"running": "#2e7d32", "estopped": "#c62828", "faulted": "#c62828", "failed": "#c62828"}
_SIDE = 320  # px of the map

if TYPE_CHECKING:
    from swarmd.link.keys.identity import Identity
    from swarmd.operator.session.session import Session


@dataclass(frozen=True, eq=False)
class Members(Mapping[str, SeenMember]):
    """The robots of a swarm by name, as a look has shown them."""

    view: MembersView
    poses: Mapping[str, Pose] = field(default_factory=dict)  # empty if not asked for
    frame: str = "each by its own odometry"  # the frame of the poses, in words
    asker: Identity | None = None
    """With which the swarm was asked; None in a swarm without keys."""

    def __getitem__(self, name: str) -> SeenMember:
        return self.view.members[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.view.members)

    def __len__(self) -> int:
        return len(self.view.members)

    @property
    def alive(self) -> tuple[str, ...]:
        """The names of the robots that are alive."""
        return self.view.alive

    @property
    def missing(self) -> tuple[str, ...]:
        """The robots that are expected and did not answer."""
        return self.view.missing

    @property
    def exit_code(self) -> int:
        """0 if all expected robots answered, 3 if some did, 5 if none did."""
        return code_of_answers(self.view.expected, self.view.answered)

    @property
    def notes(self) -> tuple[str, ...]:
        """The count of the living robots, then a line for each problem."""
        return tuple(health(self.view))

    @property
    def role(self) -> str:
        """The role of this account's key: `operator`, `viewer` or `permit`; empty without keys."""
        return "" if self.asker is None else str(self.asker.role)

    def describe(self, robot: str) -> Description:
        """One robot in detail. RequestError, with the nearest name, if it is not known."""
        check_known(robot, self)
        member = self[robot]
        status = member.status
        parts = []
        if status is not None:
            parts = sections_with_events(member, status, _described(status.pattern))
        return Description(robot, why(member), tuple((title, tuple(rows)) for title, rows in parts))

    def rows(self) -> list[dict[str, Any]]:
        """A row for each robot, as `swarmctl members` prints it, for tables."""
        heads = [head.lower() for head in HEADER]
        rows: list[dict[str, Any]]
        rows = [dict(zip(heads, row(robot), strict=True)) for robot in self.values()]
        for fields in rows:
            x, y, yaw = self.poses.get(fields["name"], (math.nan,) * 3)
            fields |= {"x": x, "y": y, "yaw": yaw} if self.poses else {}
        return rows

    def __repr__(self) -> str:
        return f"Members({self.notes[0]!r})"

    def __str__(self) -> str:
        cells = [HEADER, *(row(robot) for robot in self.values())]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in cells]
        return printable_lines([*lines, *(f"# {note}" for note in self.notes)])

    def _repr_html_(self) -> str:
        heads = "".join(f"<th>{head.lower()}</th>" for head in HEADER)
        notes = "".join(f"<div>{escape(printable(note))}</div>" for note in self.notes)
        body = "".join(map(_html_row, map(row, self.values())))
        table = f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>"
        return f"<div>{map_of(self)}{table}{notes}</div>"


@dataclass(frozen=True)
class Description:
    """A robot in detail: `why` it stands or moves, and its status in titled groups of lines."""

    robot: str
    why: str
    sections: tuple[tuple[str, tuple[tuple[str, str], ...]], ...]

    def __repr__(self) -> str:
        return f"Description({f'{self.robot}: {self.why}'!r})"

    def __str__(self) -> str:
        lines = [f"{self.robot}: {self.why}"]
        for title, rows in self.sections:
            width = max((len(name) for name, _ in rows), default=0)
            lines += [title] if rows else []
            lines += [f"  {name.ljust(width)}  {value}" for name, value in rows]
        return printable_lines(lines)

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


def _described(pattern: str | None) -> Mapping[str, Any]:
    """The units of the reports of a pattern that is installed here as a package; else empty."""
    origin = installed_patterns().get(pattern or "")
    if origin is None or origin.is_file:
        return NOT_DESCRIBED
    module, _, name = origin.value.partition(":")
    with suppress(ImportError, AttributeError):  # the robot has another version of the package
        return {"report_units": getattr(import_module(module), name).report_units}
    return NOT_DESCRIBED


def map_of(members: Members) -> str:
    """The robots on a map, as SVG: arrows with names; empty without poses."""
    poses = members.poses
    if not poses:
        return ""
    xs = [pose[0] for pose in poses.values()]
    ys = [pose[1] for pose in poses.values()]
    side = 1.2 * max(max(xs) - min(xs), max(ys) - min(ys), 1.0)
    left = (min(xs) + max(xs) - side) / 2
    top = (min(ys) + max(ys) + side) / 2
    scale = _SIDE / side
    shapes = [_arrow(members, name, poses[name], left, top, scale) for name in sorted(poses)]
    frame = f'<rect width="{_SIDE}" height="{_SIDE}" fill="none" stroke="#999"/>'
    label = f'<text x="4" y="{_SIDE - 4}" font-size="10">{side:.1f} m, {members.frame}</text>'
    size = f'width="{_SIDE}" height="{_SIDE}" viewBox="0 0 {_SIDE} {_SIDE}"'
    return f"<svg {size}>{frame}{''.join(shapes)}{label}</svg>"


def _arrow(members: Members, name: str, pose: Pose, left: float, top: float, scale: float) -> str:
    x, y, yaw = pose
    member = members.get(name)
    state = "" if member is None or member.status is None else member.status.state.value
    colour = _COLOURS.get(state, "#546e7a")
    at = f"{(x - left) * scale:.1f} {(top - y) * scale:.1f}"
    turned = f'transform="translate({at}) rotate({-math.degrees(yaw):.1f})"'
    arrow = f'<path d="M9 0L-6 6L-3 0L-6 -6Z" fill="{colour}" {turned}/>'
    text = f'<text transform="translate({at})" dx="8" dy="-6" font-size="10">{escape(name)}</text>'
    return arrow + text


def _html_row(cells: Sequence[str]) -> str:
    colour = _COLOURS.get(cells[1])
    style = f' style="color: {colour}"' if colour else ""
    texts = [escape(printable(cell)) for cell in cells]
    return f"<tr{style}>{''.join(f'<td>{text}</td>' for text in texts)}</tr>"


def printable_lines(lines: Sequence[str]) -> str:
    """Lines whose control characters are `?`: robots send them."""
    return "\n".join(map(printable, lines))


def forget(session: Session, view: MembersView, name: str) -> Outcome:
    """Remove a robot that failed or left from the member lists of all robots.

    RequestError if the robot is alive.
    """
    if view.members[name].presence is Presence.ALIVE:
        text = f"{name} is alive; only robots that failed or left can be forgotten"
        raise RequestError(text, REFUSED)
    epochs = view.epochs(view.alive)
    wait = session.time_left(view)
    return session.operator.request(ForgetRequest, epochs, timeout=wait, name=name)
