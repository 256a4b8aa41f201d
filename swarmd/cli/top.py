"""`swarmctl top`: the robots by load."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import click

from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import (
    need_terminal,
    print_json,
    print_line,
    print_table,
    signals_end,
    table_lines,
)
from swarmd.cli.send import exit_code_of, known_members, session_of
from swarmd.cli.targets import takes_targets
from swarmd.client.session import gap
from swarmd.client.targets import Targets, robots_of
from swarmd.core.messages import STATUS_SILENCE, Presence, ProcessUsage, Status
from swarmd.texts.values import NOTHING, megabytes, seconds
from swarmd.texts.why import lost_base

if TYPE_CHECKING:
    from rich.text import Text

    from swarmd.client.swarm_watch import SwarmWatch
    from swarmd.network.operator.members_view import MembersView

HEADER = (
    *("NAME", "STATE", "CPU", "P-CPU", "MEM", "P-MEM", "LOOP99", "SCAN", "DELAY", "DROPS"),
    *("SEEN", "PATTERN"),
)
SORTS = {"c": "cpu", "m": "memory", "l": "loop", "d": "delay", "p": "drops", "a": "age",
         "s": "scan", "n": "name"}  # fmt: skip
PERIOD = 1.0  # s between two tables

Known = Mapping[str, tuple[Status, float]]
"""The statuses of robots, with their ages in s."""


@click.command()
@takes_targets(is_required=False)
@click.option("--sort", type=click.Choice([*SORTS.values()]), default="cpu", help="Order [cpu].")
@click.option("--once", is_flag=True, help="Print the figures once and end.")
@common_options
def top(options: CommonOptions, targets: Targets, sort: str, once: bool) -> None:
    """Show the robots by load: processor, memory, lateness of the loop, rate and delay of scans.

    STATE also shows that the base of a robot is lost. CPU and MEM are those of the daemon, P-CPU
    and P-MEM those of its pattern host; 100% is one core. On a terminal the table is renewed until
    q, and the line above the table names the robots whose base is lost. With -o json each robot
    gets a line every second, until Ctrl-C.
    """
    if once:
        _print_once(options, targets, sort)
    else:
        _follow(options, targets, sort)


def _print_once(options: CommonOptions, targets: Targets, sort: str) -> NoReturn:
    """Query all members, print the figures of the targets, and end with the exit code."""
    with options.operator() as operator:
        view = known_members(options, operator)
        robots = robots_of(view, targets)
        statuses = {
            name: (member.status, member.age)
            for name, member in view.members.items()
            if member.status is not None
        }
        if options.is_json:
            print_json("Load", {"robots": list(records(view, robots, statuses))})
        else:
            print_table(HEADER, rows(view, robots, statuses, sort))
        click.get_current_context().exit(exit_code_of(view, robots))


def _follow(options: CommonOptions, targets: Targets, sort: str) -> None:
    """Show what robots publish, as a table until `q`, or as lines of JSON until a signal."""
    if not options.is_json:
        need_terminal("top", "add --once or -o json")
    from swarmd.client.swarm_watch import SwarmWatch

    with options.operator() as operator, signals_end():
        watched_targets = session_of(options, operator).named_now(targets)  # labels become names
        watch = SwarmWatch(operator)
        watch.start()
        try:
            show = _print_records if options.is_json else _show
            show(watch, watched_targets, sort)
        finally:
            watch.close()


def records(view: MembersView, names: Sequence[str], known: Known) -> Iterator[dict[str, Any]]:
    """The figures of each robot for programs; times in s, memory in bytes."""
    for name in names:
        if not _is_present(view, name, known):
            yield {"robot": name, "answered": False, "text": gap(view, name)}
            continue
        status, age = known[name]
        health, delay = status.health, status.scan_delay
        yield {
            "robot": name,
            "answered": True,
            "state": status.state,
            "lost": lost_base(status),
            "pattern": status.pattern,
            **_usage("", health.usage),
            **_usage("pattern_", health.pattern_usage),
            "loop_p99": health.loop_p99,
            "loop_stalls": health.loop_stalls,
            "scan_rate": health.scan_rate,
            "scan_delay": None if delay is None else delay.declared + delay.added,
            "dropped": sum(health.dropped.values()),
            "age": round(age, 3),
            "uptime": status.uptime,
        }


def rows(view: MembersView, names: Sequence[str], known: Known, sort: str) -> list[list[str]]:
    """The sorted table: the highest figure first, for scan rates the lowest; silent robots last."""
    ranked, silent = [], []
    for record in records(view, names, known):
        if not record["answered"]:
            silent.append(
                [record["robot"], "silent", *[NOTHING] * (len(HEADER) - 3), record["text"]]
            )
        else:
            ranked.append((_rank(record, sort), record["robot"], _row(record)))
    return [row for _, _, row in sorted(ranked)] + silent


def _row(record: Mapping[str, Any]) -> list[str]:
    cpu = [
        NOTHING if record[key] is None else f"{record[key]:.0%}" for key in ("cpu", "pattern_cpu")
    ]
    memory = [
        NOTHING if record[key] is None else megabytes(record[key])
        for key in ("memory", "pattern_memory")
    ]
    return [
        record["robot"],
        f"{record['state']}, base lost" if record["lost"] else record["state"],
        *cpu,
        *memory,
        seconds(record["loop_p99"]),
        f"{record['scan_rate']:.1f} Hz",
        NOTHING if record["scan_delay"] is None else seconds(record["scan_delay"]),
        str(record["dropped"]),
        "now" if record["age"] < 1.5 else f"{seconds(record['age'])} ago",
        record["pattern"] or NOTHING,
    ]


def _rank(record: Mapping[str, Any], sort: str) -> float:
    """The sort key; a row with a low key is shown first."""
    if sort == "name":
        return 0.0
    if sort == "scan":
        return float(record["scan_rate"])
    if sort in ("cpu", "memory"):
        return -float((record[sort] or 0.0) + (record[f"pattern_{sort}"] or 0.0))
    key = {"loop": "loop_p99", "delay": "scan_delay", "drops": "dropped"}.get(sort, sort)
    return -float(record[key] or 0.0)


def _usage(prefix: str, usage: ProcessUsage | None) -> dict[str, Any]:
    cpu, memory = (None, None) if usage is None else (round(usage.cpu, 4), usage.memory)
    return {f"{prefix}cpu": cpu, f"{prefix}memory": memory}


def _is_present(view: MembersView, name: str, known: Known) -> bool:
    """True if the robot's figures are recent."""
    member = view.members.get(name)
    if member is None or member.presence is not Presence.ALIVE or name not in known:
        return False
    _status, age = known[name]
    return age <= STATUS_SILENCE


def _names(view: MembersView, targets: Targets) -> tuple[str, ...]:
    return targets.matching(view.members.keys() | view.roster | set(targets.full_names))


def _print_records(watch: SwarmWatch, targets: Targets, sort: str) -> None:
    del sort  # programs sort by themselves
    while True:
        time.sleep(PERIOD)
        view = watch.view
        for record in records(view, _names(view, targets), watch.statuses()):
            print_line("Load", {"time": round(time.time(), 3), **record})


def _show(watch: SwarmWatch, targets: Targets, sort: str) -> None:
    """Draw the table each second until `q`; letters choose the order."""
    from swarmd.view.screen import KeyDecoder, Screen

    keys = KeyDecoder()
    with Screen() as screen:
        while True:
            screen.paint(_lines(watch, targets, sort, screen.size))
            if not select.select([screen.input], [], [], PERIOD)[0]:
                continue
            data = os.read(screen.input, 4096)
            for key in keys.feed(data):
                sort = SORTS.get(key, sort)
                if key == "q":
                    return
            if not data:  # the terminal is gone
                return


def _lines(watch: SwarmWatch, targets: Targets, sort: str, size: tuple[int, int]) -> list[Text]:
    from rich.text import Text

    view, known = watch.view, watch.statuses()
    names = _names(view, targets)
    table = table_lines(HEADER, rows(view, names, known, sort))
    answered = sum(_is_present(view, name, known) for name in names)
    lost = [n for n in names if _is_present(view, n, known) and lost_base(known[n][0])]
    gone = f", BASE LOST: {', '.join(lost)}" if lost else ""
    title = f"{len(names)} robots, {answered} answer{gone}, by {sort}"
    letters = "  ".join(f"{letter} {name}" for letter, name in SORTS.items())
    room = max(size[1] - 3, 1)
    rest = len(table) - room
    shown = table[:room] if rest <= 0 else [*table[: room - 1], f"... and {rest + 1} more"]
    texts = [(title, "bold"), (shown[0], "bold"), *((line, "") for line in shown[1:])]
    lines = [Text(text, style) for text, style in [*texts, (f"{letters}  q quit", "dim")]]
    for line in lines:
        line.truncate(size[0], overflow="ellipsis")
    return lines
