"""Asks for incidents, for `swarmctl`, the page and Python: list, fetch, mark; no printing.

Each robot may say of an incident what it likes, so its words are its own: they count once, as those
of the robot that tells them, and hide the words of no other robot.
"""

from __future__ import annotations

import secrets
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from msgspec import to_builtins
from msgspec.structs import asdict

from swarmd.core.bounds import MAX_REASON
from swarmd.core.clock import FIRST_WALL
from swarmd.core.errors import ConfigError, RequestError
from swarmd.core.incident import Incident, IncidentKind, mark_part
from swarmd.core.verbs import (
    INCIDENTS,
    IncidentsReply,
    KeptIncident,
    MarkRequest,
    RecordingFile,
    mark_text,
    shortened,
)
from swarmd.operator.session.exit_codes import NO_TARGET, code_of_answers
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import ask_robots, in_reach
from swarmd.operator.verbs.record.ask import Fetched, OnBytes, fetch_files
from swarmd.plugins import need

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.session import Session, TargetedView

_SILENCE = (IncidentKind.SILENT, IncidentKind.STALL)


class Account(NamedTuple):
    """What robots say alike of an incident. `tellers`: these robots. `robots`: those that had it.

    `incident`: in the words of the robot that had it, if it is among them.
    """

    incident: Incident
    tellers: tuple[str, ...]
    robots: tuple[str, ...]


class SwarmIncident(NamedTuple):
    """An incident, and what each robot keeps of it, by robot. `age`: s since then, None: unknown.

    `accounts`: what robots say of it; first what most say. Others contradict it.
    """

    incident: Incident
    age: float | None
    kept: Mapping[str, KeptIncident]
    accounts: tuple[Account, ...]

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots that had it: several had an emergency stop, or were marked."""
        return self.accounts[0].robots

    def row(self) -> dict[str, Any]:
        """The incident as JSON."""
        kept = [
            {
                "robot": robot,
                **to_builtins(one),
                "incident": self.incident.id,
                "told": _as_json(one.incident),
            }
            for robot, one in self.kept.items()
        ]
        accounts = [
            {**_as_json(one.incident), "tellers": list(one.tellers), "robots": list(one.robots)}
            for one in self.accounts
        ]
        more = {"robots": list(self.robots), "age": self.age, "kept": kept, "accounts": accounts}
        return {**_as_json(self.incident), **more}


def _as_json(incident: Incident) -> dict[str, Any]:
    """An incident as JSON, without the signature."""
    fields: dict[str, Any] = to_builtins(incident)
    del fields["signature"]
    return fields


class Incidents(NamedTuple):
    """The incidents that robots keep, oldest first.

    `faults`: by robot why it keeps nothing. `missing`: the robots that did not answer; `answered`:
    those that did.
    """

    incidents: tuple[SwarmIncident, ...]
    faults: Mapping[str, str]
    missing: tuple[str, ...]
    exit_code: int
    answered: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The content of the JSON document."""
        rows = [one.row() for one in self.incidents]
        return {
            "incidents": rows,
            "faults": dict(self.faults),
            "missing": list(self.missing),
            "answered": list(self.answered),
        }


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
    code = code_of_answers(names, replies)
    return Incidents(gathered(replies), faults, missing, code, tuple(replies))


def incident_named(found: Incidents, prefix: str) -> SwarmIncident:
    """The incident whose id begins with `prefix`.

    RequestError if there is none, ConfigError if there are several.
    """
    matching = [one for one in found.incidents if one.incident.id.startswith(prefix)]
    if not matching:
        text = f"no robot keeps an incident {prefix}; see `swarmctl incidents`"
        raise RequestError(text, NO_TARGET)
    if len(matching) > 1:
        ids = ", ".join(one.incident.id for one in matching)
        raise ConfigError(f"{prefix} begins {len(matching)} ids ({ids}); type more of it")
    return matching[0]


def fetch(
    session: Session,
    found: Incidents,
    chosen: SwarmIncident,
    folder: Path | None = None,
    on_bytes: OnBytes = lambda robot, file, received, size: None,
) -> Fetched:
    """Copy what robots keep of the incident `chosen` of `found` to this machine.

    Each copy becomes a recording beside it. `folder`: by default incidents/ID below the current
    one. Errors as of `fetch_files`; PluginError without the packages that write recordings.
    """
    need("mcap", "rosbags", extra="record")
    from swarmd.daemon.recording.fetch import INCIDENT

    id = chosen.incident.id
    files = {
        robot: (
            RecordingFile(name=f"{id}{INCIDENT.suffix}", size=one.size, is_open=False, crc=one.crc),
        )
        for robot, one in chosen.kept.items()
        if one.size
    }
    if awaited := sorted(chosen.kept.keys() - files.keys()):
        session.tell(f"no file so far: {shortened(', '.join(awaited))}; fetch again in 10 s")
    failed = [*found.missing, *awaited]
    return fetch_files(session, files, failed, folder or Path("incidents", id), INCIDENT, on_bytes)


class MarkOutcome(Outcome, frozen=True):
    """The outcome of a mark; `incident`: the id that all robots keep it by."""

    incident: str = ""


def check_mark(words: str) -> None:
    """ConfigError for words that no incident can have."""
    if not isinstance(words, str):
        raise ConfigError(f"words are {words!r}; expected a text")
    if not words.strip() or len(words) > MAX_REASON:
        wanted = f"WORDS have {len(words)} characters; expected 1 to {MAX_REASON}"
        raise ConfigError(f"{wanted}, such as 'it hit the chair'")


def mark(targeted: TargetedView, words: str) -> MarkOutcome:
    """Begin an incident with these words on robots, which keep their last minute."""
    id = secrets.token_hex(6)
    outcome = targeted.request(MarkRequest, **mark_fields(targeted.operator, words, id))
    return MarkOutcome(**asdict(targeted.counted(outcome)), incident=id)


def mark_fields(operator: Operator, words: str, id: str) -> dict[str, Any]:
    """The fields of a `MarkRequest`, in a secured swarm with the signature of the operator."""
    fields: dict[str, Any] = {"words": words, "incident": id}
    if operator.identity is None:
        return fields
    from swarmd.link.keys.content_signature import Purpose, sign
    from swarmd.link.keys.private_keys import load_private_key

    wall = time.time()
    marked = wall if wall >= FIRST_WALL else 0.0
    part = mark_part(id, operator.name, mark_text(operator.name, words), marked)
    signature = sign(load_private_key(operator.identity.key), Purpose.MARK, part)
    return {**fields, "marked": marked, "signature": signature}


def gathered(replies: Mapping[str, IncidentsReply]) -> tuple[SwarmIncident, ...]:
    """The incidents in the answers of robots, oldest first; those of unknown age come first."""
    by_id: dict[str, dict[str, KeptIncident]] = {}
    for robot, reply in sorted(replies.items()):
        for one in reply.incidents:
            by_id.setdefault(one.incident.id, {})[robot] = one
    found = []
    for kept in by_id.values():
        accounts = accounts_of({robot: one.incident for robot, one in kept.items()})
        incident = accounts[0].incident
        # The age of the robot that had it, else of the first robot that keeps the same words.
        order = sorted(kept, key=lambda robot: _distance(robot, kept[robot].incident, incident))
        ages = [age for robot in order if (age := kept[robot].age) is not None]
        found.append(SwarmIncident(incident, ages[0] if ages else None, kept, accounts))
    return tuple(sorted(found, key=lambda one: -1e9 if one.age is None else -one.age))


def _distance(robot: str, held: Incident, incident: Incident) -> tuple[bool, bool]:
    """How far a robot is from the words of an incident: its teller, one that heard them, others."""
    return robot != incident.by, (held.kind, held.text) != (incident.kind, incident.text)


def accounts_of(held: Mapping[str, Incident]) -> tuple[Account, ...]:
    """What robots say of one incident; `held`: by robot, what it keeps. Not empty. Pure.

    1. A robot speaks for itself. What others keep in its name counts if it does not answer; then
       what most of them keep.
    2. Robots that say the same give one account. Peers that found a robot silent say the same as
       that robot, which says why.
    3. That of most tellers comes first; of equal ones that of a robot that had it, then that which
       most robots keep.
    """
    stories = _stories(held)
    groups: dict[tuple[str, str], dict[str, Incident]] = {}
    for teller, story in stories.items():
        own = stories.get(story.robot)
        is_witness = story.kind == IncidentKind.SILENT and story.robot != teller
        if is_witness and own is not None and own.robot == story.robot and own.kind in _SILENCE:
            groups.setdefault((own.kind, own.text), {})[teller] = story
        else:
            groups.setdefault((story.kind, story.text), {})[teller] = story
    keepers = Counter(one.by for one in held.values())

    def rank(group: Mapping[str, Incident]) -> tuple[int, bool, int]:
        has_own = any(story.robot == teller for teller, story in group.items())
        return -len(group), not has_own, -sum(keepers[teller] for teller in group)

    return tuple(
        Account(
            min(group.items(), key=lambda item: (item[1].robot != item[0], item[0]))[1],
            tuple(sorted(group)),
            tuple(sorted({story.robot for story in group.values()})),
        )
        for group in sorted(groups.values(), key=rank)
    )


def _stories(held: Mapping[str, Incident]) -> dict[str, Incident]:
    """By robot that tells an incident, its words."""
    claims: dict[str, list[Incident]] = {}
    for _, incident in sorted(held.items()):
        claims.setdefault(incident.by, []).append(incident)
    stories = {}
    for teller, told in sorted(claims.items()):
        own = held.get(teller)
        stories[teller] = own if own is not None and own.by == teller else _most(told)
    return stories


def _most(told: Sequence[Incident]) -> Incident:
    """The words that most of these have; of equal ones the first."""
    counts = Counter((one.kind, one.text, one.robot) for one in told)
    return max(told, key=lambda one: counts[one.kind, one.text, one.robot])
