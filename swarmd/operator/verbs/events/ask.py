"""Past events of robots by one look, and events as they happen."""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from swarmd.core.messages import Status
from swarmd.operator.session.looks import SwarmWatch
from swarmd.operator.verbs.events.feed import EventFeed, EventLine

if TYPE_CHECKING:
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.session import Session
    from swarmd.operator.session.targets import Targets

PERIOD = 0.5  # s after which a wait for news is interrupted


def events_of(feed: EventFeed, view: MembersView, names: Sequence[str]) -> list[EventLine]:
    """The events that one look shows, in the order of time."""
    now = time.monotonic()
    lines = []
    for name in names:
        member = view.members.get(name)
        if member is not None and member.status is not None:
            lines += feed.on_status(member.status, now - member.age)
    return sorted([*lines, *feed.on_view(view, now)])


def follow_events(session: Session, feed: EventFeed, targets: Targets) -> Iterator[list[EventLine]]:
    """Yield lists of new events until the session is cancelled or the iterator is closed.

    The first list has the events so far, in the order of time. An empty list comes after each 0.5 s
    without an event, so that the caller can end the iterator.
    """
    news: queue.SimpleQueue[Status | MembersView] = queue.SimpleQueue()
    watch = SwarmWatch(session.operator, on_status=news.put, on_view=news.put)
    watch.start()
    early: list[EventLine] | None = []  # until the first look; None afterwards
    try:
        while not session.is_cancelled():
            status_or_view = _next(news)
            now = time.monotonic()
            lines = _lines_of(feed, status_or_view, now) + feed.advance(now)
            if early is not None:
                early += lines
                if status_or_view is None or isinstance(status_or_view, Status):
                    continue
                session.tell_awaited(status_or_view, targets)
                lines = sorted(early)
                early = None
            yield [line for line in lines if targets.matching([line.robot])]
    finally:
        watch.close()


def _next(news: queue.SimpleQueue[Status | MembersView]) -> Status | MembersView | None:
    """The next status or look; None if neither comes within the period."""
    try:
        return news.get(timeout=PERIOD)
    except queue.Empty:
        return None


def _lines_of(feed: EventFeed, news: Status | MembersView | None, now: float) -> list[EventLine]:
    if news is None:
        return []
    return feed.on_status(news, now) if isinstance(news, Status) else feed.on_view(news, now)
