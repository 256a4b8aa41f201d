"""`swarmctl plugin list`: the pushed patterns of robots, and where they differ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import click

from swarmd.cli.arguments import Targets, takes_targets
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import fields, print_json, print_table, warn
from swarmd.cli.questions import ask_robots, in_reach
from swarmd.cli.send import gap, known_members, targets_of
from swarmd.core.verbs import PLUGINS, BehaviourReport, BehavioursReply
from swarmd.network.exit_codes import PARTIAL, TIMEOUT
from swarmd.texts.values import NOTHING

if TYPE_CHECKING:
    from swarmd.network.operator.members_view import MembersView
    from swarmd.network.operator.operator import Operator


@click.command("list")
@takes_targets(is_required=False)
@common_options
def list_pushed(options: CommonOptions, targets: Targets) -> None:
    """List the pushed patterns of TARGETS, or all robots: version, hash and standing.

    `!` marks what differs from most of the other robots.
    """
    with options.operator() as operator:
        view = known_members(options, operator, needs_status=bool(targets.labels))
        names = targets_of(view, targets)
        found = behaviours_of(options, operator, view, names)
        missing = [name for name in names if name not in found]
        code = 0 if not missing else PARTIAL if found else TIMEOUT
        marked = _differing(found)
        if options.is_json:
            _print_list_json(found, missing, marked, code)
        else:
            rows = [
                (robot, *_row(one), "!" if (robot, one.name) in marked else "")
                for robot, reply in found.items()
                for one in reply.behaviours
            ]
            header = ("NAME", "PATTERN", "VERSION", "HASH", "STANDING", "FROM", "TEXT", "")
            print_table(header, rows)
        for name in missing:
            warn(f"no answer: {gap(view, name)}")
        click.get_current_context().exit(code)


def behaviours_of(
    options: CommonOptions, operator: Operator, view: MembersView, names: Collection[str]
) -> dict[str, BehavioursReply]:
    """What robots in reach have, by robot; those that do not answer are left out."""
    return ask_robots(options, operator, in_reach(view, names), PLUGINS)


def _row(one: BehaviourReport) -> tuple[str, ...]:
    standing = one.standing
    if standing == "provisional" and one.ran:
        standing += f" ({one.ran:.0f} s)"
    origin = f"{one.issuer}, {one.source}" if one.source else one.issuer
    cells = (one.name, one.version, one.digest, standing, origin, one.text)
    return tuple(cell or NOTHING for cell in cells)


def _differing(found: Mapping[str, BehavioursReply]) -> set[tuple[str, str]]:
    """Robots and names whose hash differs from that of most robots that have the name."""
    hashes: dict[str, Counter[str]] = {}
    for reply in found.values():
        for one in reply.behaviours:
            hashes.setdefault(one.name, Counter())[one.digest] += 1
    return {
        (robot, one.name)
        for robot, reply in found.items()
        for one in reply.behaviours
        if one.digest != hashes[one.name].most_common(1)[0][0]
    }


def _print_list_json(
    found: Mapping[str, BehavioursReply],
    missing: Collection[str],
    marked: Collection[tuple[str, str]],
    code: int,
) -> None:
    robots = {
        robot: [
            {
                **fields(one, "name", "version"),
                "hash": one.digest,
                **fields(one, "pushed", "standing"),
                "ran": round(one.ran, 1),
                **fields(one, "issuer", "generation", "source", "text"),
                "differs": (robot, one.name) in marked,
            }
            for one in reply.behaviours
        ]
        for robot, reply in found.items()
    }
    answer = {"robots": robots, "missing": list(missing), "exit_code": code}
    print_json("Behaviours", answer)
