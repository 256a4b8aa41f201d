"""The access rules of a Zenoh session: the messages that each name of a roster may send. Pure.

A roster is the signed list of a swarm's robots, operators and viewers. A roster and the own name
give the value of Zenoh's `access_control`, which Zenoh enforces. Zenoh drops a message that no rule
permits, without notice to the sender. A rule applies to the links to certain names: a link has the
common name in the certificate at its far end. A session keeps its rules until it is closed: another
roster needs another session.

Directions are seen from the session that has the rules: `ingress` messages come from the far end of
the link, `egress` messages go there.

- A robot receives queries on `control/<verb>/<asker>` from the operator of that name, and from the
  viewer of that name for verbs whose row in `core/verbs.py` permits viewers. From a name with a
  permit it receives all requests, so that it answers what the key may, and the questions of
  viewers. A robot sends `state/*` and `message/**` to operators, viewers and names with a permit,
  and answers `shared/<what>/<asker>` to each name of the roster. A robot receives puts, the
  messages of programs to patterns, from operators only: such a message may move the robot.
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
from swarmd.link.keys.roster import Role, Roster

OPERATOR_SENDERS = "operator-$*"
"""The senders that are operators or viewers, of datagrams by routers (`routed.py`)."""
# Asks for tokens; a token itself is of the kind `liveliness_token`.
_LIVELINESS = ["declare_liveliness_subscriber", "liveliness_query"]
_ALL_MESSAGES = [
    *("put", "delete", "query", "reply", "declare_subscriber", "declare_queryable"),
    *("liveliness_token", *_LIVELINESS),
]
Access = dict[str, Any]
_IN = "ingress"
_OUT = "egress"


def may_ask(role: Role, verb: str) -> bool:
    """True if a name with this role may ask `control/<verb>` of a robot.

    A name with a permit may send each request: the robot judges it, and answers what the key may.
    """
    row = VERBS.get(verb)
    if role is Role.OPERATOR:
        return True
    if row is None or role is Role.ROBOT:
        return False
    return row.is_for_viewers or (role is Role.PERMIT and row.is_request)


def robot_access(roster: Roster, robot: str) -> Access:
    """Zenoh's `access_control` for the session on which the robot `robot` listens.

    Raises ConfigError if the roster lacks the robot, or has no operator.
    """
    if roster.role_of(robot) is not Role.ROBOT:
        raise ConfigError(f"{robot} is no robot of roster {roster.generation} of {roster.swarm}")
    if not roster.operators:
        raise ConfigError(
            f"roster {roster.generation} of {roster.swarm} has no operator, so that no name could"
            " command this robot; add one with `swarmctl keys add`"
        )
    rules = _Rules()
    _allow_robot_to_readers(rules, roster, robot)
    _allow_readers_to_robot(rules, roster)
    for name in roster.operators:  # messages, each under the name of its operator
        rules.allow([name], _IN, ["put"], [build(roster.swarm, name, MESSAGE, ANY, ANY)])
    # Requests, and pulls of shared files such as a roster. A key ends with the asker's name.
    robot_shared = build(roster.swarm, robot, SHARED, ANY, ANY)
    rules.allow(roster.robots, _OUT, ["reply", "declare_queryable"], [robot_shared])
    for name in (*roster.askers, *roster.robots):
        pulled = build(roster.swarm, robot, SHARED, ANY, name)
        rules.allow([name], _IN, ["query"], [*_request_keys(roster, name), pulled])
    return rules.access()


def _allow_robot_to_readers(rules: _Rules, roster: Roster, robot: str) -> None:
    """Let a robot send state, messages, replies and its liveliness token to all readers.

    A reader is an operator, a viewer or a name with a permit.
    """
    readers = roster.askers
    state = build(roster.swarm, robot, "state", ANY)
    control = build(roster.swarm, robot, CONTROL, ANY, ANY)
    messages = build(roster.swarm, robot, MESSAGE, ANY, ANY)
    shared = build(roster.swarm, robot, SHARED, ANY, ANY)
    rules.allow(readers, _OUT, ["put"], [state, messages])
    rules.allow(readers, _OUT, ["reply", "declare_queryable"], [state, control, shared])
    rules.allow(readers, _OUT, ["liveliness_token"], [token(roster.swarm, robot)])
    for flow in (_OUT, _IN):  # both ends look for the tokens of the other end
        rules.allow(readers, flow, _LIVELINESS, [token(roster.swarm, ANY)])
    # The robot subscribes to messages of operators only, since viewers may send none.
    all_messages = [build(roster.swarm, ANY, MESSAGE, ANY, ANY)]
    rules.allow(roster.operators, _OUT, ["declare_subscriber"], all_messages)


def _allow_readers_to_robot(rules: _Rules, roster: Roster) -> None:
    """Let readers subscribe at a robot, and show their liveliness tokens.

    They query and subscribe with a wildcard in place of the robot's name.
    """
    readers = roster.askers
    all_states = [build(roster.swarm, ANY, "state", ANY)]
    rules.allow(readers, _IN, ["query", "declare_subscriber"], all_states)
    all_messages = [build(roster.swarm, ANY, MESSAGE, ANY, ANY)]
    rules.allow(readers, _IN, ["declare_subscriber"], all_messages)
    for name in readers:
        rules.allow([name], _IN, ["liveliness_token"], [token(roster.swarm, name)])


def asker_access(roster: Roster, name: str) -> Access:
    """Zenoh's `access_control` for a session that dials robots.

    `name`: the operator or viewer that dials, or the robot that pulls a file from another robot.
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
    rules = _Rules()
    queried = [*_request_keys(roster, name), build(roster.swarm, ANY, SHARED, ANY, name)]
    if role is Role.ROBOT:
        rules.allow(roster.robots, _OUT, ["query"], queried)
    else:
        _allow_messages_and_tokens(rules, roster, name)
        states = build(roster.swarm, ANY, "state", ANY)
        rules.allow(roster.robots, _OUT, ["query"], [*queried, states])
        rules.allow(roster.robots, _OUT, ["declare_subscriber"], [states])
    # What each robot may send back under its own name. Only one rule for each robot: Zenoh takes
    # 0.1 ms for a rule whenever a link opens.
    for robot in roster.robots:
        rules.allow(
            [robot],
            _IN,
            ["put", "reply", "declare_queryable", "liveliness_token"],
            [subtree(roster, robot)],
        )
    return rules.access()


def _allow_messages_and_tokens(rules: _Rules, roster: Roster, name: str) -> None:
    """Let an operator or viewer subscribe to messages at robots, and see liveliness tokens.

    An operator may also send messages to robots, under its own name.
    """
    messages = [build(roster.swarm, ANY, MESSAGE, ANY, ANY)]
    rules.allow(roster.robots, _OUT, ["declare_subscriber"], messages)
    rules.allow(roster.robots, _OUT, ["liveliness_token"], [token(roster.swarm, name)])
    for flow in (_IN, _OUT):  # both ends look for the tokens of the other end
        rules.allow(roster.robots, flow, _LIVELINESS, [token(roster.swarm, ANY)])
    if roster.role_of(name) is Role.OPERATOR:
        own_messages = build(roster.swarm, name, MESSAGE, ANY, ANY)
        rules.allow(roster.robots, _OUT, ["put"], [own_messages])
        # The robots subscribe to messages of operators.
        rules.allow(roster.robots, _IN, ["declare_subscriber"], messages)


def router_access(roster: Roster, router: str) -> Access:
    """Zenoh's `access_control` for a router of profile `routed`.

    `router`: the name in the certificates of all routers of the swarm. The ingress rules decide
    what each name of the roster may send, query and subscribe to. The egress rules permit all keys
    of the swarm: a router sends to a link only replies, and messages on keys to which the far end
    was allowed to subscribe.
    """
    all_keys = [f"{ROOT}/{roster.swarm}/**"]
    names = roster.names
    rules = _Rules()
    rules.allow([router], _IN, _ALL_MESSAGES, all_keys)
    rules.allow(dict.fromkeys((*names, router)), _OUT, _ALL_MESSAGES, all_keys)
    for name in names:
        _allow_at_router(rules, roster, name)
    return rules.access()


def _allow_at_router(rules: _Rules, roster: Roster, name: str) -> None:
    """Let a robot, operator or viewer send, query and subscribe through a router.

    All datagrams go through the router: on keys multicast/all and unicast/<receiver>, under the
    sender's name. Operators and viewers send under a random name of OPERATOR_SENDERS.
    """
    swarm = roster.swarm
    is_robot = roster.role_of(name) is Role.ROBOT
    sender = name if is_robot else OPERATOR_SENDERS
    own_keys = [subtree(roster, name)] if is_robot else [f"{ROOT}/{swarm}/{sender}/*/*"]
    queried = [*_request_keys(roster, name), build(swarm, ANY, SHARED, ANY, name)]
    subscribed = [build(swarm, ANY, "multicast", "all"), build(swarm, ANY, "unicast", sender)]
    if not is_robot:
        states = build(swarm, ANY, "state", ANY)
        queried.append(states)
        subscribed.append(states)
    rules.allow([name], _IN, ["put"], own_keys)
    rules.allow([name], _IN, ["query"], queried)
    rules.allow([name], _IN, ["declare_subscriber"], subscribed)
    rules.allow([name], _IN, ["liveliness_token"], [token(swarm, name)])
    rules.allow([name], _IN, _LIVELINESS, [token(swarm, ANY)])
    if is_robot:
        rules.allow([name], _IN, ["reply", "declare_queryable"], own_keys)


def subtree(roster: Roster, robot: str) -> str:
    """All keys of a robot."""
    return f"{ROOT}/{roster.swarm}/{robot}/**"


def _request_keys(roster: Roster, name: str) -> list[str]:
    """The keys `control/<verb>/<name>` of any robot on which `name` may send requests."""
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
        """Permit these kinds of Zenoh messages on these keys, over links to these names.

        `flow`, seen from the session that has the rules: _IN for messages from these names, _OUT
        for messages to these names. Without names or keys no rule is added.
        """
        link_names = tuple(names)
        if not link_names or not keys:  # Zenoh takes an empty list of names for all names
            return
        subject = self._subjects.setdefault(link_names, f"names{len(self._subjects)}")
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
