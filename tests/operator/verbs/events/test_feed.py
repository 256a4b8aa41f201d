"""What happened to robots, from statuses and looks."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.messages import (
    MAX_EVENTS,
    STATUS_SILENCE,
    LoggedEvent,
    Presence,
    Reason,
    State,
    Status,
)
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.verbs.events.feed import BURST, EventFeed, EventLine, together
from tests.support.statuses import make_member, status

START = 1000.0


def having(count: int, first: int = 0, **changes: Any) -> Status:
    """A status 1 s after the last of its events, which happened at 1 s intervals."""
    events = tuple(LoggedEvent(at=float(n), text=f"event {n}") for n in range(first, first + count))
    return status(events=events, uptime=float(first + count), **changes)


def texts(lines: list[EventLine]) -> list[str]:
    return [line.text for line in lines]


def test_the_first_status_gives_the_events_with_their_times() -> None:
    lines = EventFeed().on_status(having(3), START)
    assert [(line.at, line.text) for line in lines] == [
        (997.0, "event 0"),
        (998.0, "event 1"),
        (999.0, "event 2"),
    ]


def test_events_before_since_are_left_out() -> None:
    assert texts(EventFeed(since=2.5).on_status(having(3), START)) == ["event 1", "event 2"]


def test_a_later_status_gives_only_what_is_new() -> None:
    feed = EventFeed()
    feed.on_status(having(MAX_EVENTS), START)
    assert feed.on_status(having(MAX_EVENTS), START + 1.0) == []
    lines = feed.on_status(having(MAX_EVENTS, first=2), START + 2.0)
    assert texts(lines) == [f"event {MAX_EVENTS}", f"event {MAX_EVENTS + 1}"]


def test_a_status_that_arrives_after_a_later_one_repeats_nothing() -> None:
    feed = EventFeed()
    feed.on_status(having(MAX_EVENTS), START)
    feed.on_status(having(MAX_EVENTS, first=1), START + 1.0)
    assert feed.on_status(having(MAX_EVENTS), START + 1.1) == []
    lines = feed.on_status(having(MAX_EVENTS, first=2), START + 2.0)
    assert texts(lines) == [f"event {MAX_EVENTS + 1}"]


def test_a_full_log_tells_that_earlier_events_are_not_known() -> None:
    lines = EventFeed().on_status(having(MAX_EVENTS), START)
    assert [line.kind for line in lines] == ["gap", *["event"] * MAX_EVENTS]


def test_more_events_than_a_robot_keeps_are_a_gap() -> None:
    feed = EventFeed()
    feed.on_status(having(3), START)
    lines = feed.on_status(having(MAX_EVENTS, first=30), START + 1.0)
    assert [line.kind for line in lines] == ["gap", *["event"] * MAX_EVENTS]


def test_a_hold_is_told_when_it_begins_and_ends() -> None:
    feed = EventFeed()
    feed.on_status(status(), START)
    held = status(reason=Reason.STALE_SCAN, detail="0.6 s")
    assert texts(feed.on_status(held, START + 1.0)) == ["held by stale_scan: 0.6 s"]
    assert feed.on_status(held, START + 2.0) == []
    assert texts(feed.on_status(status(), START + 3.0)) == ["no longer held by stale_scan"]


@pytest.mark.parametrize(
    ("state", "reason"),
    [(State.RUNNING, Reason.PROTECTION), (State.STOPPED, Reason.OPERATOR)],
)
def test_other_standstills_are_no_holds(state: State, reason: Reason) -> None:
    feed = EventFeed()
    feed.on_status(status(), START)
    assert feed.on_status(status(state=state, reason=reason), START + 1.0) == []


def test_silence_is_told_once_and_so_is_the_return() -> None:
    feed = EventFeed()
    feed.on_status(status(), START)
    assert feed.advance(START + STATUS_SILENCE) == []
    assert [line.kind for line in feed.advance(START + STATUS_SILENCE + 1.0)] == ["watch"]
    assert feed.advance(START + STATUS_SILENCE + 2.0) == []
    assert texts(feed.on_status(status(), START + 9.0)) == ["answers again"]


def test_a_restart_of_the_daemon_is_told_and_its_new_events() -> None:
    feed = EventFeed()
    feed.on_status(having(3), START)
    lines = feed.on_status(having(1, instance="b" * 12), START + 1.0)
    assert texts(lines) == ["its daemon was started anew", "event 0"]


@pytest.mark.parametrize("presence", [Presence.FAILED, Presence.LEFT])
def test_a_robot_that_is_gone_is_told_once(presence: Presence) -> None:
    feed = EventFeed()
    view = MembersView({"r1": make_member(presence=presence, age=2.0)})
    assert [(line.at, line.robot) for line in feed.on_view(view, START)] == [(998.0, "r1")]
    assert feed.on_view(view, START + 1.0) == []


def test_robots_of_the_roster_that_were_not_seen_are_named_and_later_ones_join() -> None:
    feed = EventFeed()
    assert [one.robot for one in feed.on_view(MembersView({}, roster=frozenset("a")), START)] == [
        "a"
    ]
    assert texts(feed.on_status(having(0), START + 1.0)) == ["joined"]


def test_what_robots_tell_at_once_is_one_line_and_their_figures_are_left_out() -> None:
    def line(at: float, robot: str, text: str) -> EventLine:
        return EventLine(at, robot, "event", text)

    ports = (45054, 45054, 39916)
    names = ("r3", "r1", "r2")
    rows = [line(START + i / 10, name, "estopped by bob") for i, name in enumerate(names)]
    rows += [
        line(START + 0.3 + i / 10, name, f"estop, by bob from 10.0.0.2:{port}: applied")
        for i, (name, port) in enumerate(zip(names, ports, strict=True))
    ]
    rows += [line(START + 0.5, "r1", "estopped by bob"), line(START + 2.0, "r2", "estopped by bob")]
    assert [(one.text, robots) for one, robots in together(rows)] == [
        ("estopped by bob", names),
        ("estop, by bob from 10.0.0.2:..: applied", names),
        ("estopped by bob", ("r1",)),
        ("estopped by bob", ("r2",)),
    ]


def test_a_flood_of_one_robot_is_counted_and_leaves_the_others_alone() -> None:
    feed = EventFeed()
    passed = 0
    for n in range(1, 101):
        log = (LoggedEvent(at=float(n), text=f"event {n}"),)
        passed += len(feed.on_status(status(events=log, uptime=float(n)), START))
    assert passed == BURST
    other = feed.on_status(status("r2", events=(LoggedEvent(at=1.0, text="quiet"),)), START)
    assert texts(other) == ["quiet"]
    (counted,) = feed.advance(START + 1.0)
    assert counted.kind == "gap"
    assert counted.text.startswith(f"{100 - BURST:.0f} ")
