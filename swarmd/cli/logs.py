"""`swarmctl logs`: the logs of daemons and what their patterns print, and with -f what follows."""

from __future__ import annotations

import logging
import queue
import sys
import time
from collections.abc import Collection, Iterable
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from swarmd.cli.ask_robots import ask_robots, end
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import has_colour, print_json, print_line, signals_end, warn
from swarmd.cli.send import known_members
from swarmd.cli.targets import takes_targets
from swarmd.client.ask_robots import MAX_ANSWER, in_reach
from swarmd.client.session import gap
from swarmd.client.targets import Targets, robots_of
from swarmd.core.codec import Decoder
from swarmd.core.log_ring import matching
from swarmd.core.verbs import LOG_PAGE, LOGS, LogBatch, LogRecord, LogsQuery
from swarmd.texts.values import printable

if TYPE_CHECKING:
    from swarmd.network.operator.members_view import MembersView
    from swarmd.network.operator.operator import Operator

LEVELS = {
    "debug": logging.DEBUG,
    "info": logging.INFO,
    "warning": logging.WARNING,
    "error": logging.ERROR,
}
LOOK_PERIOD = 5.0  # s between two looks for robots that are new or have returned
MAX_WAITING = 2000  # batches that the terminal has not taken yet
_COLOURS = ("cyan", "green", "magenta", "blue", "yellow")  # of robots
_LEVEL_COLOURS = {logging.WARNING: "yellow", logging.ERROR: "red", logging.CRITICAL: "red"}


class _Line(NamedTuple):
    """A log record of a robot, with its time by this machine's clock, in s since 1970."""

    at: float
    robot: str
    record: LogRecord


@click.command()
@takes_targets(is_required=False)
@click.option("-f", "--follow", is_flag=True, help="Go on with new lines until Ctrl-C.")
@click.option("--grep", metavar="TEXT", default="", help="Only lines with this text, in any case.")
@click.option("--level", type=click.Choice([*LEVELS]), default="debug", help="The least level.")
@click.option(
    "-n",
    "--count",
    type=click.IntRange(1, LOG_PAGE),
    default=50,
    help="The last lines of each robot, at most [50].",
)
@common_options
def logs(
    options: CommonOptions, targets: Targets, follow: bool, grep: str, level: str, count: int
) -> None:
    """Print the log of TARGETS, or of all robots, and what their patterns print.

    A daemon keeps its last 1000 lines, at most 50 a second of each module, and at most 20 a second
    of its pattern. `--grep` takes the text as it is: no character has a meaning of its own.
    """
    query = LogsQuery(count=count, level=LEVELS[level], grep=grep)
    with options.operator() as operator:
        view = known_members(options, operator)
        robots = robots_of(view, targets)
        printer = _Printer(robots, query, is_json=options.is_json and follow)
        if follow:
            with signals_end():
                # Does not return: a signal ends the program.
                _follow(options, operator, targets, view, printer)
        replies = ask_robots(options, operator, in_reach(view, robots), LOGS, query)
        lines = printer.new_lines(replies.values())
        if options.is_json:
            # `left_out`: by robot, the count of lines that the daemon dropped at its limit.
            left_out = {robot: reply.left_out for robot, reply in replies.items() if reply.left_out}
            missing = sorted(set(robots) - replies.keys())
            records = [_record(line) for line in lines]
            print_json("Logs", {"records": records, "left_out": left_out, "missing": missing})
        else:
            printer.show(lines)
            printer.tell_left_out(replies.values())
        end(robots, replies)


def _follow(
    options: CommonOptions,
    operator: Operator,
    targets: Targets,
    view: MembersView,
    printer: _Printer,
) -> None:
    """Print log lines as they arrive, until a signal ends the program.

    Robots publish new lines in batches. Earlier lines are queried when a robot is heard for the
    first time, after its daemon has restarted, and after a lost batch. Robots that join later are
    followed if their names match `targets`.
    """
    robots = set(robots_of(view, targets))
    batches: queue.Queue[LogBatch] = queue.Queue(MAX_WAITING)
    decode = Decoder(LogBatch, MAX_ANSWER)

    def on_batch(robot: str, payload: bytes) -> None:  # in a thread of Zenoh
        batch = decode(payload)
        # A full queue drops the batch: step 2 notices the missing lines, and queries them.
        if batch.robot == robot and not batches.full():
            batches.put(batch)

    def print_earlier(robots: Iterable[str]) -> None:
        replies = ask_robots(options, operator, robots, LOGS, printer.query) if robots else {}
        printer.print_new(replies.values())

    instances: dict[str, str] = {}  # by robot, the id of the daemon process that was heard last
    silent: set[str] = set()
    next_query_at = 0.0
    while True:
        # 1. Every LOOK_PERIOD: subscribe to new robots, and warn of robots that fall silent.
        if time.monotonic() >= next_query_at:
            next_query_at = time.monotonic() + LOOK_PERIOD
            present = {robot: view.members[robot].instance for robot in in_reach(view, robots)}
            for robot in present.keys() - instances.keys():
                operator.watch("log", on_batch, robot)
            started = [
                robot for robot, instance in present.items() if instances.get(robot) != instance
            ]
            print_earlier(started)
            instances |= present
            silent_now = instances.keys() - present.keys()
            for robot in sorted(silent_now - silent):
                warn(gap(view, robot))
            for robot in sorted(silent - silent_now):
                warn(f"{robot} is heard again")
            silent = silent_now
            view = operator.members(timeout=1.0, needs_status=False)
            if not targets.labels:  # labels are in statuses, which this query leaves out
                robots |= set(targets.matching(view.members))
        # 2. Print the next batch, after the lines of lost batches.
        try:
            batch = batches.get(timeout=max(next_query_at - time.monotonic(), 0.01))
        except queue.Empty:
            continue
        if printer.has_gap(batch):
            print_earlier([batch.robot])
        printer.print_new([batch])


class _Printer:
    """Prints each record once; `query` selects the records."""

    def __init__(self, names: Iterable[str], query: LogsQuery, *, is_json: bool) -> None:
        self.query = query
        self._is_json = is_json
        self._is_coloured = has_colour(sys.stdout is not None and sys.stdout.isatty())
        self._colours: dict[str, str] = {}
        self._width = max(map(len, names), default=0)
        self._last: dict[tuple[str, str], int] = {}
        self._left_out: dict[tuple[str, str], int] = {}

    def new_lines(self, batches: Iterable[LogBatch]) -> list[_Line]:
        """The records that were not printed yet, in the order of time."""
        lines = []
        for batch in batches:
            life = batch.robot, batch.instance
            last, now = self._last.get(life, 0), time.time()
            self._last[life] = max(last, batch.last)
            for one in matching(batch.records, self.query.level, self.query.grep):
                if one.seq > last:
                    lines.append(_Line(now - max(batch.now - one.at, 0.0), batch.robot, one))
        return sorted(lines, key=lambda line: (line.at, line.robot, line.record.seq))

    def has_gap(self, batch: LogBatch) -> bool:
        """True if records before a batch did not arrive."""
        last = self._last.get((batch.robot, batch.instance), 0)
        return bool(batch.records) and batch.records[0].seq > last + 1

    def print_new(self, batches: Collection[LogBatch]) -> None:
        """Print the records that were not printed yet, and report left-out lines."""
        self.show(self.new_lines(batches))
        self.tell_left_out(batches)

    def show(self, lines: Iterable[_Line]) -> None:
        """Print lines, each with its robot."""
        for line in lines:
            if self._is_json:
                print_line("LogRecord", _record(line))
                continue
            record, name = line.record, line.robot.ljust(self._width)
            level = logging.getLevelName(record.level).lower()
            text = f"{level.ljust(7)}  {record.source}: {record.text}"
            if self._is_coloured:
                colour = self._colours.setdefault(
                    line.robot, _COLOURS[len(self._colours) % len(_COLOURS)]
                )
                name = click.style(name, fg=colour)
                text = click.style(printable(text), fg=_LEVEL_COLOURS.get(record.level))
            else:
                text = printable(text)
            click.echo(f"{datetime.fromtimestamp(line.at):%H:%M:%S}  {name}  {text}")

    def tell_left_out(self, batches: Iterable[LogBatch]) -> None:
        """Report on stderr how many lines a robot did not keep, when that number changes."""
        for batch in batches:
            life = batch.robot, batch.instance
            if batch.left_out > self._left_out.get(life, 0):
                self._left_out[life] = batch.left_out
                warn(f"{batch.robot}: {batch.left_out} lines were left out: too many at once")


def _record(line: _Line) -> dict[str, Any]:
    moment = datetime.fromtimestamp(line.at).astimezone()
    return {
        "time": moment.isoformat(timespec="milliseconds"),
        "robot": line.robot,
        "level": logging.getLevelName(line.record.level).lower(),
        "source": line.record.source,
        "text": line.record.text,
    }
