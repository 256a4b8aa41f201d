"""The access rules of a Zenoh session: the messages that each name of a roster may send. Pure.

A roster and the own name give the value of Zenoh's `access_control`, which Zenoh enforces. Zenoh
drops a message that no rule allows, without notice to its sender. The subject of a rule is the
common name in the certificate of the other end of a link, which must be equal. A session keeps its
rules until it is closed: another roster needs another session.

Directions are seen from the session that has the rules: `ingress` is what it receives from the
named end of the link, `egress` what it sends to that end.

- A robot receives queries on `control/<verb>/<asker>` from the operator of that name, and from the
  viewer of that name for verbs whose row in `core/verbs.py` permits viewers. It sends `state/*` and
  `message/**` to operators and viewers, and answers `shared/<what>/<asker>` to each name of the
  roster. It receives puts (messages) from operators only: a vote may move a robot.
- Operators and viewers receive a robot's keys from the robot of that name only.
- Robots, operators and viewers see each other's liveliness tokens; each may declare only the token
  of its own name.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from swarmd.core.errors import ConfigError
from swarmd.core.keys import ANY, CONTROL, MESSAGE, ROOT, SHARED, build, token
from swarmd.core.verbs import VERBS
from swarmd.security.roster import Role, Roster

OPERATOR_SENDERS = "operator-$*"
"""The senders of datagrams by routers that are operators or viewers, see `routed.py`."""
_LIVELINESS = ["declare_liveliness_subscriber", "liveliness_query"]
_ALL_MESSAGES = [
    *("put", "delete", "query", "reply", "declare_subscriber", "declare_queryable"),
    *("liveliness_token", *_LIVELINESS),
]
Access = dict[str, Any]
_IN, _OUT = "ingress", "egress"


def may_ask(role: Role, verb: str) -> bool:
    """True if a name with this role may ask `control/<verb>` of a robot."""
    row = VERBS.get(verb)
    is_for_viewers = row is not None and row.is_for_viewers
    return role is Role.OPERATOR or (role is Role.VIEWER and is_for_viewers)


def robot_access(roster: Roster, robot: str) -> Access:
    """The `access_control` of the session on which a robot listens.

    Raises ConfigError if the roster lacks the robot, or has no operator.
    """
    if roster.role_of(robot) is not Role.ROBOT:
        raise ConfigError(f"{robot} is no robot of roster {roster.generation} of {roster.swarm}")
    if not roster.operators:
        raise ConfigError(
            f"roster {roster.generation} of {roster.swarm} has no operator, so that no name could"
            " command this robot; add one with `swarmctl keys add`"
        )
    readers = (*roster.operators, *roster.viewers)
    state = build(roster.swarm, robot, "state", ANY)
    control = build(roster.swarm, robot, CONTROL, ANY, ANY)
    shared = build(roster.swarm, robot, SHARED, ANY, ANY)
    states = [build(roster.swarm, ANY, "state", ANY)]
    tokens = [token(roster.swarm, ANY)]
    messages = [build(roster.swarm, ANY, MESSAGE, ANY, ANY)]
    rules = _Rules()
    rules.allow(readers, _OUT, ["put"], [state, build(roster.swarm, robot, MESSAGE, ANY, ANY)])
    rules.allow(readers, _OUT, ["reply", "declare_queryable"], [state, control, shared])
    rules.allow(readers, _OUT, ["liveliness_token"], [token(roster.swarm, robot)])
    rules.allow(readers, _OUT, _LIVELINESS, tokens)
    rules.allow(readers, _IN, _LIVELINESS, tokens)
    rules.allow(roster.operators, _OUT, ["declare_subscriber"], messages)
    rules.allow(readers, _IN, ["query", "declare_subscriber"], states)
    rules.allow(readers, _IN, ["declare_subscriber"], messages)
    for name in readers:
        rules.allow([name], _IN, ["liveliness_token"], [token(roster.swarm, name)])
    for name in roster.operators:
        own = build(roster.swarm, name, MESSAGE, ANY, ANY)
        rules.allow([name], _IN, ["put"], [own])
    rules.allow(roster.robots, _OUT, ["reply", "declare_queryable"], [shared])
    for name in (*readers, *roster.robots):
        own = build(roster.swarm, robot, SHARED, ANY, name)
        rules.allow([name], _IN, ["query"], [*_questions(roster, name), own])
    return rules.access()


def asker_access(roster: Roster, name: str) -> Access:
    """The `access_control` of a session that dials robots, as operator, viewer or pulling robot.

    Raises ConfigError if the roster lacks the name, or has no robot.
    """
    role = roster.role_of(name)
    if role is None:
        raise ConfigError(f"{name} is not on roster {roster.generation} of {roster.swarm}")
    if not roster.robots:
        raise ConfigError(
            f"roster {roster.generation} of {roster.swarm} has no robot; add one with"
            " `swarmctl keys add`"
        )
    states = [] if role is Role.ROBOT else [build(roster.swarm, ANY, "state", ANY)]
    shared = build(roster.swarm, ANY, SHARED, ANY, name)
    rules = _Rules()
    if role is not Role.ROBOT:
        messages = [build(roster.swarm, ANY, MESSAGE, ANY, ANY)]
        rules.allow(roster.robots, _OUT, ["declare_subscriber"], messages)
        rules.allow(roster.robots, _OUT, ["liveliness_token"], [token(roster.swarm, name)])
        for flow in (_IN, _OUT):
            rules.allow(roster.robots, flow, _LIVELINESS, [token(roster.swarm, ANY)])
    if role is Role.OPERATOR:
        own = build(roster.swarm, name, MESSAGE, ANY, ANY)
        rules.allow(roster.robots, _OUT, ["put"], [own])
        rules.allow(roster.robots, _IN, ["declare_subscriber"], messages)
    rules.allow(roster.robots, _OUT, ["query"], [*_questions(roster, name), shared, *states])
    rules.allow(roster.robots, _OUT, ["declare_subscriber"], states)
    for robot in roster.robots:  # one rule each: Zenoh takes 0.1 ms for a rule at each opening
        rules.allow(
            [robot],
            _IN,
            ["put", "reply", "declare_queryable", "liveliness_token"],
            [subtree(roster, robot)],
        )
    return rules.access()


def router_access(roster: Roster, router: str) -> Access:
    """The `access_control` of a Zenoh router of profile routed, for links to names of the roster.

    The ingress rules decide what each name may send, query and subscribe to. The egress rules allow
    everything of the swarm: a router sends to a link only the keys to which the other end
    subscribed, and replies. `router`: the name in the certificates of all routers of the swarm.
    """
    swarm, everyone = roster.swarm, [f"{ROOT}/{roster.swarm}/**"]
    heard = build(swarm, ANY, "multicast", "all")
    states = build(swarm, ANY, "state", ANY)
    names = (*roster.robots, *roster.operators, *roster.viewers)
    rules = _Rules()
    rules.allow([router], _IN, _ALL_MESSAGES, everyone)
    rules.allow(dict.fromkeys((*names, router)), _OUT, _ALL_MESSAGES, everyone)
    for name in names:
        is_robot = roster.role_of(name) is Role.ROBOT
        sender = name if is_robot else OPERATOR_SENDERS
        own = [subtree(roster, name)] if is_robot else [f"{ROOT}/{swarm}/{sender}/*/*"]
        asked = [*_questions(roster, name), build(swarm, ANY, SHARED, ANY, name)]
        wanted = [heard, build(swarm, ANY, "unicast", sender)]
        rules.allow([name], _IN, ["put"], own)
        rules.allow([name], _IN, ["query"], asked if is_robot else [*asked, states])
        rules.allow([name], _IN, ["declare_subscriber"], wanted if is_robot else [*wanted, states])
        rules.allow([name], _IN, ["liveliness_token"], [token(swarm, name)])
        rules.allow([name], _IN, _LIVELINESS, [token(swarm, ANY)])
        if is_robot:
            rules.allow([name], _IN, ["reply", "declare_queryable"], own)
    return rules.access()


def subtree(roster: Roster, robot: str) -> str:
    """All keys of a robot."""
    return f"{ROOT}/{roster.swarm}/{robot}/**"


def _questions(roster: Roster, name: str) -> list[str]:
    """The keys of `control`, of each robot and of all, that a name may ask."""
    role = roster.role_of(name)
    if role is None:
        return []
    if role is Role.OPERATOR:
        return [build(roster.swarm, ANY, CONTROL, ANY, name)]
    verbs = sorted(verb for verb in VERBS if may_ask(role, verb))
    return [build(roster.swarm, ANY, CONTROL, verb, name) for verb in verbs]


class _Rules:
    """Collects rules, and makes them the value of `access_control`."""

    def __init__(self) -> None:
        self._rules: list[Access] = []
        self._subjects: dict[tuple[str, ...], str] = {}
        self._policies: list[Access] = []

    def allow(self, names: Iterable[str], flow: str, messages: list[str], keys: list[str]) -> None:
        """Allow these kinds of messages on these keys, on links to these names.

        `flow`: _IN for messages from these names, _OUT for messages to these names.
        """
        who = tuple(names)
        if not who or not keys:  # Zenoh takes an empty list of names for all names
            return
        subject = self._subjects.setdefault(who, f"names{len(self._subjects)}")
        rule = f"rule{len(self._rules)}"
        self._rules.append(
            {
                "id": rule,
                "permission": "allow",
                "flows": [flow],
                "messages": messages,
                "key_exprs": keys,
            }
        )
        self._policies.append({"rules": [rule], "subjects": [subject]})

    def access(self) -> Access:
        """The value of `access_control`."""
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": self._rules,
            "subjects": [
                {"id": subject, "cert_common_names": list(names)}
                for names, subject in self._subjects.items()
            ],
            "policies": self._policies,
        }
