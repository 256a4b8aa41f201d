"""`swarmctl events`: what happened to robots, and with -f what happens."""

from __future__ import annotations

import time
from collections.abc import Iterable
from datetime import datetime
from typing import TYPE_CHECKING, Any

import click

from swarmd.core.messages import MAX_EVENTS
from swarmd.operator.cli.options import CommonOptions, Duration, common_options
from swarmd.operator.cli.output import print_json, signals_end, warn
from swarmd.operator.cli.send import exit_code_of, known_members, session_of
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.targets import Targets, robots_of
from swarmd.operator.texts.values import printable, seconds

if TYPE_CHECKING:
    from swarmd.operator.session.session import Session
    from swarmd.operator.verbs.events.feed import EventFeed, EventLine

PERIOD = 0.5  # s for which equal events of further robots are awaited
NAME_WIDTH = 10


@click.command()
@takes_targets(is_required=False)
@click.option("-f", "--follow", is_flag=True, help="Go on with new events until Ctrl-C.")
@click.option("--since", type=Duration(), help="Only events of this last time, such as 5m.")
@common_options
def events(options: CommonOptions, targets: Targets, follow: bool, since: float | None) -> None:
    """Print what happened to TARGETS, or to all robots: states, requests, holds, faults, drivers.

    Each robot keeps its last 10 events. With -f the command continues, and prints also holds as
    they begin and end, and robots that fall silent and return; with -o json a document a line.
    """
    from swarmd.operator.verbs.events.ask import events_of
    from swarmd.operator.verbs.events.feed import EventFeed

    longest_age = float("inf") if since is None else since  # s
    feed = EventFeed(longest_age)
    with options.operator() as operator:
        if follow:
            session = session_of(options, operator)
            followed_targets = session.named_now(targets)  # labels replaced by names
            with signals_end():  # a signal ends the program
                _follow(session, feed, followed_targets, is_json=options.is_json)
        else:
            view = known_members(options, operator)
            robots = robots_of(view, targets)
            lines = events_of(feed, view, robots)
            if options.is_json:
                records = [_record(line) for line in lines]
                missing = [name for name in view.missing if name in robots]
                print_json("Events", {"events": records, "missing": missing})
            else:
                _print(lines)
                if not lines:
                    period = "" if since is None else f" of the last {seconds(since)}"
                    warn(f"no event{period} is known; each robot keeps its last {MAX_EVENTS}")
            click.get_current_context().exit(exit_code_of(view, robots))


def _follow(session: Session, feed: EventFeed, targets: Targets, *, is_json: bool) -> None:
    """Print events until a signal."""
    from swarmd.operator.verbs.events.ask import follow_events

    held: list[EventLine] = []
    due = 0.0
    for lines in follow_events(session, feed, targets):
        if is_json:
            for line in lines:
                print_json("Event", _record(line), indent=None)
            continue
        now = time.monotonic()
        due = due if held else now + PERIOD  # what others tell of the same comes meanwhile
        held += lines
        if now >= due:
            _print(held)
            held = []


def _print(lines: Iterable[EventLine]) -> None:
    from swarmd.operator.verbs.events.feed import together

    for line, robots in together(lines):
        at = _time(line)
        shown = f"{at:%H:%M:%S}" if at.date() == datetime.now().date() else f"{at:%m-%d %H:%M:%S}"
        name = line.robot
        text = line.text
        if len(robots) > 1:
            name = f"{len(robots)} robots"
            text = f"{text}: {', '.join(sorted(robots))}"
        click.echo(printable(f"{shown}  {name.ljust(NAME_WIDTH)}  {text}"))


def _record(line: EventLine) -> dict[str, Any]:
    return {
        "time": _time(line).astimezone().isoformat(timespec="milliseconds"),
        "age": round(max(time.monotonic() - line.at, 0.0), 3),
        "robot": line.robot,
        "event": line.kind,
        "text": line.text,
    }


def _time(line: EventLine) -> datetime:
    return datetime.fromtimestamp(time.time() - (time.monotonic() - line.at))
