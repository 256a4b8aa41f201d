"""Makes event lines from the statuses and looks of robots. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

from swarmd.core.messages import (
    MAX_EVENTS,
    STATUS_SILENCE,
    LoggedEvent,
    Presence,
    Reason,
    State,
    Status,
)
from swarmd.core.token_bucket import TokenBucket
from swarmd.operator.session.members_view import MembersView, SeenMember

RATE = 2.0
BURST = 20.0
"""Lines of one robot per second, and at once; further lines are only counted."""
TOGETHER = 1.0
"""s within which equal texts of several robots, numbers aside, become one line."""
_NUMBER = re.compile(r"(-?\d+(?:\.\d+)?)")
_NO_HOLD = (None, Reason.NO_REQUESTED_COMMAND, Reason.PROTECTION)


@dataclass(frozen=True, slots=True, order=True)
class EventLine:
    """An event of a robot, for display.

    The values of `kind`:

    - `event`: a line of the robot's own log.
    - `hold`: the reason for which protection holds the robot has changed.
    - `watch`: the robot appeared, fell silent or returned.
    - `gap`: some events of the robot are missing here.
    """

    at: float  # s on the clock of the caller
    robot: str
    kind: str  # event, hold, watch or gap
    text: str


class EventFeed:
    """Turns the statuses of robots, and lists of members, into event lines.

    Times are in s on one clock. The first status of a robot also has earlier events of the robot;
    events that are older than `since` s give no lines.
    """

    def __init__(self, since: float = float("inf")) -> None:
        self._since = since
        self._last: dict[str, tuple[Status, float]] = {}
        self._absent: dict[str, str] = {}
        self._budgets: dict[str, TokenBucket] = {}
        self._left_out: dict[str, int] = {}
        self._has_looked = False

    def on_status(self, status: Status, now: float) -> list[EventLine]:
        """The lines that follow from a status."""
        name = status.robot
        known = self._last.get(status.robot)
        if known is not None and _is_overtaken(status, known[0]):
            return []
        self._last[name] = status, now
        lines = []
        if self._absent.pop(name, ""):
            lines.append(EventLine(now, name, "watch", "answers again"))
        elif known is None and self._has_looked:
            lines.append(EventLine(now, name, "watch", "joined"))
        before = None if known is None else known[0]
        if before is not None and before.instance != status.instance:
            lines.append(EventLine(now, name, "watch", "its daemon was started anew"))
            before = None
        lines += self._limited(name, self._logged(before, status, now), now)
        return lines

    def on_view(self, view: MembersView, now: float) -> list[EventLine]:
        """The lines that follow from a look: robots that left or failed, or were never heard."""
        lines = []
        self._has_looked = True
        for name in sorted(view.members.keys() | view.roster):
            text = _absence(view.members.get(name))
            if text and self._absent.get(name) != text:
                self._absent[name] = text
                age = view.members[name].age if name in view.members else 0.0
                lines.append(EventLine(now - age, name, "watch", text))
        return lines

    def advance(self, now: float) -> list[EventLine]:
        """The lines that follow from the time: robots that fell silent, and left-out events."""
        lines = []
        for name, (_, at) in self._last.items():
            if now - at > STATUS_SILENCE and name not in self._absent:
                self._absent[name] = "silent"
                text = f"silent: no status for {now - at:.0f} s"
                lines.append(EventLine(now, name, "watch", text))
        for name, count in list(self._left_out.items()):
            if self._budgets[name].take(1.0, now):
                del self._left_out[name]
                lines.append(EventLine(now, name, "gap", f"{count} more events were left out here"))
        return lines

    def _logged(self, before: Status | None, status: Status, now: float) -> list[EventLine]:
        """The events that the status before did not have, and a change of the hold."""
        name = status.robot
        events = status.events
        new = events if before is None else _new(before.events, events)
        is_full = len(events) == MAX_EVENTS  # earlier events may have been dropped
        lines = [
            EventLine(now - max(status.uptime - event.at, 0.0), name, "event", event.text)
            for event in new
        ]
        if before is None:
            lines = [line for line in lines if now - line.at <= self._since]
            if is_full and len(lines) == MAX_EVENTS:
                text = f"events before this one are not known: a robot keeps {MAX_EVENTS}"
                lines.insert(0, EventLine(lines[0].at, name, "gap", text))
        elif before.events and is_full and len(new) == MAX_EVENTS:
            text = "events before this one may be missing: more came than a robot keeps"
            lines.insert(0, EventLine(lines[0].at, name, "gap", text))
        hold = _hold(status)
        earlier = None if before is None else _hold(before)
        if hold != earlier and hold is not None:
            detail = f": {status.detail}" if status.detail else ""
            lines.append(EventLine(now, name, "hold", f"held by {hold}{detail}"))
        elif hold != earlier and status.state is State.RUNNING:
            lines.append(EventLine(now, name, "hold", f"no longer held by {earlier}"))
        return lines

    def _limited(self, name: str, lines: list[EventLine], now: float) -> list[EventLine]:
        budget = self._budgets.setdefault(name, TokenBucket(RATE, BURST))
        passed = [line for line in lines if budget.take(1.0, now)]
        if len(passed) < len(lines):
            self._left_out[name] = self._left_out.get(name, 0) + len(lines) - len(passed)
        return passed


def together(lines: Iterable[EventLine]) -> list[tuple[EventLine, tuple[str, ...]]]:
    """The lines, each with its robots: equal texts of several robots within TOGETHER make one line.

    A number that differs among the robots, such as the port of a request, is shown as `..`.
    """
    groups: dict[tuple[str, str], list[list[EventLine]]] = {}
    ordered: list[list[EventLine]] = []
    for line in sorted(lines):
        of_key = groups.setdefault((line.kind, _NUMBER.sub("#", line.text)), [])
        last = of_key[-1] if of_key else None
        if last is None or line.at - last[0].at > TOGETHER or line.robot in {o.robot for o in last}:
            of_key.append([line])
            ordered.append(of_key[-1])
        else:
            last.append(line)
    return [
        (
            replace(group[0], text=_common(line.text for line in group)),
            tuple(line.robot for line in group),
        )
        for group in ordered
    ]


def _common(texts: Iterable[str]) -> str:
    """The common text of texts that differ only in numbers."""
    pieces = zip(*map(_NUMBER.split, texts), strict=True)
    return "".join(same[0] if len({*same}) == 1 else ".." for same in pieces)


def _new(
    before: tuple[LoggedEvent, ...], events: tuple[LoggedEvent, ...]
) -> tuple[LoggedEvent, ...]:
    """The events that `before` lacks. `events` begins with the last events of `before`."""
    for shared in range(min(len(before), len(events)), 0, -1):
        if before[-shared:] == events[:shared]:
            return events[shared:]
    return events


def _is_overtaken(status: Status, last: Status) -> bool:
    """True if a status is older than the last one, such as from a robot that was frozen."""
    return status.instance == last.instance and status.uptime < last.uptime


def _hold(status: Status) -> Reason | None:
    is_held = status.state is State.RUNNING and status.reason not in _NO_HOLD
    return status.reason if is_held else None


def _absence(member: SeenMember | None) -> str:
    if member is None:
        return "on the roster, and not seen by any robot"
    if member.presence is Presence.LEFT:
        return "left in order"
    if member.presence is Presence.FAILED:
        return "failed: it is no longer heard"
    return ""
