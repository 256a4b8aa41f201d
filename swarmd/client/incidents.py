"""The incidents of which robots keep their last minute, as all robots tell them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from msgspec import to_builtins

from swarmd.client.ask_robots import ask_robots, in_reach
from swarmd.core.verbs import INCIDENTS, IncidentsReply, KeptIncident
from swarmd.network.operator.exit_codes import code_of_answers

if TYPE_CHECKING:
    from swarmd.client.session import Session
    from swarmd.core.incident import Incident


class SwarmIncident(NamedTuple):
    """An incident, and what each robot keeps of it, by robot. `age`: s since then, None: unknown.

    The robot that had it describes it if it keeps it, else the robot that told it first.
    """

    incident: Incident
    age: float | None
    kept: Mapping[str, KeptIncident]

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots that had it: several had an emergency stop, or were marked."""
        return tuple(sorted({one.incident.robot for one in self.kept.values()}))

    def row(self) -> dict[str, Any]:
        """The incident as JSON."""
        kept = [
            {"robot": robot, **to_builtins(one), "incident": self.incident.id}
            for robot, one in self.kept.items()
        ]
        more = {"robots": list(self.robots), "age": self.age, "kept": kept}
        return {**to_builtins(self.incident), **more}


class Incidents(NamedTuple):
    """The incidents that robots keep, oldest first.

    `faults`: by robot why it keeps nothing. `missing`: the robots that did not answer.
    """

    incidents: tuple[SwarmIncident, ...]
    faults: Mapping[str, str]
    missing: tuple[str, ...]
    exit_code: int

    def as_json(self) -> dict[str, Any]:
        """The content of the JSON document."""
        rows = [one.row() for one in self.incidents]
        return {"incidents": rows, "faults": dict(self.faults), "missing": list(self.missing)}


def ask_incidents(session: Session) -> Incidents:
    """The incidents of all robots, by a look and a question."""
    view = session.look()
    names = view.expected
    replies = ask_robots(session, in_reach(view, names), INCIDENTS)
    faults = {
        robot: reply.fault or "its black box is off"
        for robot, reply in replies.items()
        if reply.fault or reply.kept is None
    }
    missing = tuple(sorted(set(names) - replies.keys()))
    return Incidents(gathered(replies), faults, missing, code_of_answers(names, replies))


def _rank(robot: str, incident: Incident) -> tuple[bool, bool]:
    """The order in which robots describe an incident: the robot that had it, then its teller."""
    return robot != incident.robot, robot != incident.by


def gathered(replies: Mapping[str, IncidentsReply]) -> tuple[SwarmIncident, ...]:
    """The incidents in the answers of robots, oldest first; those of unknown age come first."""
    by_id: dict[str, dict[str, KeptIncident]] = {}
    for robot, reply in sorted(replies.items()):
        for one in reply.incidents:
            by_id.setdefault(one.incident.id, {})[robot] = one
    found = []
    for kept in by_id.values():
        teller = min(kept, key=lambda robot: _rank(robot, kept[robot].incident))
        ages = [one.age for one in (kept[teller], *kept.values()) if one.age is not None]
        found.append(SwarmIncident(kept[teller].incident, ages[0] if ages else None, kept))
    return tuple(sorted(found, key=lambda one: -1e9 if one.age is None else -one.age))
