"""`swarmctl links`: which robots hear which, by the beacons that arrive."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import click

from swarmd.core.verbs import LINKS, LinkReport, LinksQuery, LinksReply
from swarmd.operator.cli.ask_robots import ask_robots, end
from swarmd.operator.cli.options import CommonOptions, common_options
from swarmd.operator.cli.output import print_json, print_table
from swarmd.operator.cli.send import known_members
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.session import in_reach
from swarmd.operator.session.targets import Targets, robots_of
from swarmd.operator.texts.values import NOTHING, counted, printable, seconds

PING_TIME = 0.6  # s at least for robots to measure round trips, between two questions
MAX_ROWS = 60
HEADER = ("ROBOT", "HEARS", "LOSS", "ROUND TRIP", "AGE", "WAY")


class _Pair(NamedTuple):
    """How well `robot` hears `other`; `link` None: not known."""

    robot: str
    other: str
    link: LinkReport | None

    @property
    def loss(self) -> float:
        """From 0 to 1."""
        if self.link is None:
            return 1.0
        return self.link.lost / max(self.link.received + self.link.lost, 1)


@click.command()
@takes_targets(is_required=False)
@click.option("--every", is_flag=True, help=f"All pairs, not only the {MAX_ROWS} worst.")
@common_options
def links(options: CommonOptions, targets: Targets, every: bool) -> None:
    """Show how well each of TARGETS, or of all robots, hears all other robots.

    LOSS is the share of the beacons of HEARS, in about the last 30 s, that did not arrive at ROBOT.
    ROUND TRIP is measured now, from each robot to up to 20 other robots; `-`: no answer. AGE is the
    time since the last beacon.
    """
    with options.operator() as operator:
        view = known_members(options, operator)
        robots = robots_of(view, targets)
        # This query starts a measurement of round trips, which the next query reads.
        start_query = LinksQuery(measures=True)
        replies = ask_robots(options, operator, in_reach(view, robots), LINKS, start_query)
        if any(reply.links for reply in replies.values()):
            # The time for the measurement: two robots may be as far apart as a robot and this
            # machine.
            time.sleep(max(PING_TIME, 2.0 * view.round_trip))
            replies |= ask_robots(options, operator, replies, LINKS, LinksQuery())
        robots_to_hear = {*view.expected, *replies}
        pairs = pairs_of(replies, robots_to_hear)
        if options.is_json:
            missing = sorted(set(robots) - replies.keys())
            print_json("Links", {"links": [_record(pair) for pair in pairs], "missing": missing})
        else:
            listed_pairs = pairs if every else pairs[:MAX_ROWS]
            by_name = sorted(listed_pairs, key=lambda pair: (pair.robot, pair.other))
            print_table(HEADER, [_row(pair) for pair in by_name])
            for line in summary(pairs, len(listed_pairs)):
                click.echo(printable(f"# {line}"))
        end(robots, replies)


def pairs_of(replies: Mapping[str, LinksReply], expected: Iterable[str]) -> list[_Pair]:
    """Each pair of an answering robot and a known or expected robot; the worst come first."""
    found = []
    for robot, reply in replies.items():
        known = {link.robot: link for link in reply.links}
        lacking = set() if reply.unlisted else set(expected) - known.keys() - {robot}
        found += [_Pair(robot, other, known.get(other)) for other in {*known, *lacking}]
    return sorted(found, key=lambda pair: (-pair.loss, pair.robot, pair.other))


def summary(pairs: list[_Pair], shown: int) -> Iterable[str]:
    """The conspicuous pairs: no beacons, many losses, or only one direction."""
    yield counted(len(pairs), "pair") + (f", the {shown} worst shown" if shown < len(pairs) else "")
    deaf = {(pair.robot, pair.other) for pair in pairs if pair.loss >= 1.0}
    asked = {pair.robot for pair in pairs}
    for robot, other in sorted(deaf):
        is_one_way = other in asked and (other, robot) not in deaf
        yield f"{robot} does not hear {other}" + (", which hears it" if is_one_way else "")
    bad = [pair for pair in pairs if 0.2 <= pair.loss < 1.0]
    if bad:
        yield f"{counted(len(bad), 'pair')} with a loss of a fifth of the beacons or more"


def _row(pair: _Pair) -> tuple[str, ...]:
    link = pair.link
    if link is None:
        return (pair.robot, pair.other, "100 %", NOTHING, "never", NOTHING)
    trip = NOTHING if link.round_trip is None else f"{1000.0 * link.round_trip:.1f} ms"
    way = ", ".join(link.ways) or NOTHING
    return (pair.robot, pair.other, f"{100.0 * pair.loss:.0f} %", trip, seconds(link.age), way)


def _record(pair: _Pair) -> dict[str, Any]:
    link = pair.link
    record: dict[str, Any] = {"robot": pair.robot, "hears": pair.other}
    if link is None:
        return record | {"received": 0, "lost": None, "loss": 1.0, "round_trip": None, "age": None}
    return record | {
        "received": link.received,
        "lost": link.lost,
        "loss": round(pair.loss, 4),
        "round_trip": None if link.round_trip is None else round(link.round_trip, 5),
        "age": round(link.age, 3),
        "ways": list(link.ways),
    }
