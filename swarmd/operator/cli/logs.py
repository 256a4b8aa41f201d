"""`swarmctl logs`: the logs of daemons and what their patterns print, and with -f what follows."""

from __future__ import annotations

import logging
import queue
import sys
import time
from collections.abc import Collection, Iterable, Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import click

from swarmd.core.codec import Decoder
from swarmd.core.log_ring import matching
from swarmd.core.verbs import LOG_PAGE, LOGS, LogBatch, LogRecord, LogsQuery
from swarmd.operator.cli.ask_robots import ask_robots, end
from swarmd.operator.cli.options import CommonOptions, common_options
from swarmd.operator.cli.output import has_colour, print_json, signals_end, warn
from swarmd.operator.cli.send import known_members
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.session import MAX_ANSWER, gap, in_reach
from swarmd.operator.session.targets import Targets, robots_of
from swarmd.operator.texts.values import printable

if TYPE_CHECKING:
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator

LEVELS = {
    "debug": logging.DEBUG,
    "info": logging.INFO,
    "warning": logging.WARNING,
    "error": logging.ERROR,
}
LOOK_PERIOD = 5.0  # s between two looks for robots that are new or have returned
MAX_WAITING = 2000  # batches that the terminal has not taken yet
_COLOURS = ("cyan", "green", "magenta", "blue", "yellow")  # the colours of the robots, in turn
_LEVEL_COLOURS = {logging.WARNING: "yellow", logging.ERROR: "red", logging.CRITICAL: "red"}


class _Line(NamedTuple):
    """A log record of a robot; its time is in s since 1970 on this machine's clock."""

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
        printer = _Printer(robots, query, is_json=options.is_json)
        if follow:
            with signals_end():  # a signal ends the program
                _Follower(options, operator, targets, view, printer).run()
        else:
            replies = ask_robots(options, operator, in_reach(view, robots), LOGS, query)
            if options.is_json:
                _print_json(robots, replies, printer.new_lines(replies.values()))
            else:
                printer.print_new(replies.values())
            end(robots, replies)


def _print_json(
    robots: Collection[str], replies: Mapping[str, LogBatch], lines: Iterable[_Line]
) -> None:
    """Print lines as one document. `robots`: those that were queried."""
    content = {
        "records": [_record(line) for line in lines],
        # By robot, the count of lines that the daemon dropped at its limit.
        "left_out": {robot: reply.left_out for robot, reply in replies.items() if reply.left_out},
        "missing": sorted(set(robots) - replies.keys()),
    }
    print_json("Logs", content)


class _Follower:
    """Prints log lines as they arrive, until a signal ends the program.

    Robots publish new lines in batches. Earlier lines are queried when a robot is heard for the
    first time, after its daemon has restarted, and after a lost batch. Robots that join later are
    followed if their names match `targets`.
    """

    def __init__(
        self,
        options: CommonOptions,
        operator: Operator,
        targets: Targets,
        view: MembersView,
        printer: _Printer,
    ) -> None:
        self._options = options
        self._operator = operator
        self._targets = targets
        self._view = view  # the result of the last query
        self._printer = printer
        self._robots = set(robots_of(view, targets))
        self._batches: queue.Queue[LogBatch] = queue.Queue(MAX_WAITING)
        self._decode = Decoder(LogBatch, MAX_ANSWER)
        self._instances: dict[str, str] = {}  # by robot, the id of the last daemon process
        self._silent: set[str] = set()

    def run(self) -> NoReturn:
        """Follow the robots; look for new, restarted and silent robots every LOOK_PERIOD."""
        next_look_at = 0.0
        while True:
            if time.monotonic() >= next_look_at:
                next_look_at = time.monotonic() + LOOK_PERIOD
                present = self._present_instances()
                self._follow_started(present)
                self._warn_of_silence(present)
                self._look()
            try:
                batch = self._batches.get(timeout=max(next_look_at - time.monotonic(), 0.01))
            except queue.Empty:
                continue
            if self._printer.has_gap(batch):
                self._print_earlier([batch.robot])
            self._printer.print_new([batch])

    def _present_instances(self) -> dict[str, str]:
        """By robot in reach: the id of its daemon process, which differs after a restart."""
        members = self._view.members
        return {robot: members[robot].instance for robot in in_reach(self._view, self._robots)}

    def _follow_started(self, present: Mapping[str, str]) -> None:
        """Subscribe to new robots, and print the earlier lines of new and restarted robots."""
        for robot in present.keys() - self._instances.keys():
            self._operator.watch("log", self._on_batch, robot)
        started = [
            robot for robot, instance in present.items() if self._instances.get(robot) != instance
        ]
        self._print_earlier(started)
        self._instances |= present

    def _warn_of_silence(self, present: Mapping[str, str]) -> None:
        silent_now = self._instances.keys() - present.keys()
        for robot in sorted(silent_now - self._silent):
            warn(gap(self._view, robot))
        for robot in sorted(self._silent - silent_now):
            warn(f"{robot} is heard again")
        self._silent = silent_now

    def _look(self) -> None:
        """Query all members, for the next look; adds robots that have joined."""
        self._view = self._operator.members(timeout=1.0, needs_status=False)
        if not self._targets.labels:  # labels are in statuses, which this query leaves out
            self._robots |= set(self._targets.matching(self._view.members))

    def _on_batch(self, robot: str, payload: bytes) -> None:
        """In a thread of Zenoh: queue a batch; if the queue is full, `run` notices the gap."""
        batch = self._decode(payload)
        if batch.robot == robot and not self._batches.full():
            self._batches.put(batch)

    def _print_earlier(self, robots: Collection[str]) -> None:
        if robots:
            replies = ask_robots(self._options, self._operator, robots, LOGS, self._printer.query)
            self._printer.print_new(replies.values())


class _Printer:
    """Prints each record once, with `is_json` as a document; `query` selects the records."""

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
            last = self._last.get(life, 0)
            now = time.time()
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
                print_json("LogRecord", _record(line), indent=None)
                continue
            record = line.record
            name = line.robot.ljust(self._width)
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
