"""Access rules of links: what a roster grants, and to which names."""

from __future__ import annotations

import msgspec
import pytest
import zenoh

from swarmd.core.errors import ConfigError
from swarmd.core.keys import ANY, CONTROL, MESSAGE, SHARED, build, token
from swarmd.core.verbs import VERBS
from swarmd.link.access import (
    Access,
    asker_access,
    may_ask,
    robot_access,
    router_access,
)
from swarmd.link.keys.roster import KeyPermit, Role, Roster

ROSTER = Roster(
    swarm="lab",
    generation=3,
    robots=("r1", "r2"),
    operators={"alice": bytes(64), "bob": bytes(64)},
    viewers=("class",),
    secret_digest=bytes(32),
    permits={
        "pupil": KeyPermit(role="pupils", key=bytes(64), may=("stop", "run drive"), until=2**32)
    },
)


def allows(access: Access, name: str, flow: str, message: str, key: str) -> bool:
    """What Zenoh decides: a rule allows a key that its own includes."""
    names = {one["id"]: one["cert_common_names"] for one in access["subjects"]}
    rules = {one["id"]: one for one in access["rules"]}
    return any(
        flow in rules[rule]["flows"]
        and message in rules[rule]["messages"]
        and any(zenoh.KeyExpr(own).includes(zenoh.KeyExpr(key)) for own in rules[rule]["key_exprs"])
        for policy in access["policies"]
        if any(name in names[subject] for subject in policy["subjects"])
        for rule in policy["rules"]
    )


def may_query(name: str, key: str) -> bool:
    """True if robot r1 lets a query of this name pass."""
    return allows(robot_access(ROSTER, "r1"), name, "ingress", "query", key)


@pytest.mark.parametrize("robot", ["r1", "*"])
def test_a_name_asks_with_its_own_chunk_and_what_its_role_may(robot: str) -> None:
    asked = {
        (name, asker, verb)
        for name in ("alice", "bob", "class", "r2", "mallory")
        for asker in ("alice", "bob", "class", "r2", "*")
        for verb in ("run", "members", "*")
        if may_query(name, build("lab", robot, CONTROL, verb, asker))
    }
    assert asked == {
        *(("alice", "alice", verb) for verb in ("run", "members", "*")),
        *(("bob", "bob", verb) for verb in ("run", "members", "*")),
        ("class", "class", "members"),
    }


@pytest.mark.parametrize("robot", ["r1", "*"])
def test_a_name_with_a_permit_sends_each_request_in_its_name_and_the_questions_of_viewers(
    robot: str,
) -> None:
    """The robot judges the requests, and answers what the key may."""
    passing = {
        verb for verb in VERBS if may_query("pupil", build("lab", robot, CONTROL, verb, "pupil"))
    }
    assert passing == {*VERBS} - {"audit", "incident"}
    for asker in ("alice", "class", "*"):
        assert not may_query("pupil", build("lab", robot, CONTROL, "run", asker))
    assert not may_query("pupil", build("lab", robot, CONTROL, "*", "pupil"))


def test_a_name_with_a_permit_sends_patterns_no_messages() -> None:
    access = robot_access(ROSTER, "r1")
    for sender in ("pupil", "alice", "r1"):
        key = build("lab", sender, MESSAGE, "voter", "opinion")
        assert not allows(access, "pupil", "ingress", "put", key)
    own = asker_access(ROSTER, "pupil")
    assert not allows(
        own, "r1", "egress", "put", build("lab", "pupil", MESSAGE, "voter", "opinion")
    )
    assert allows(own, "r1", "egress", "query", build("lab", "r1", CONTROL, "run", "pupil"))
    assert allows(access, "pupil", "egress", "put", build("lab", "r1", "state", "status"))


def test_shared_blobs_are_for_each_name_of_the_roster() -> None:
    for name in ("alice", "class", "r2"):
        assert may_query(name, build("lab", "r1", SHARED, "roster", name))
        assert not may_query(name, build("lab", "r2", SHARED, "roster", name))
        assert not may_query(name, build("lab", "r1", SHARED, "roster", "bob"))
    assert not may_query("mallory", build("lab", "r1", SHARED, "roster", "mallory"))


def test_messages_of_programs_come_from_operators_in_their_own_names() -> None:
    access = robot_access(ROSTER, "r1")
    may_put = {
        (name, sender)
        for name in ("alice", "bob", "class", "r2", "mallory")
        for sender in ("alice", "bob", "class", "r1", "r2", "mallory", "*")
        if allows(access, name, "ingress", "put", build("lab", sender, MESSAGE, "voter", "opinion"))
    }
    assert may_put == {("alice", "alice"), ("bob", "bob")}
    own = asker_access(ROSTER, "alice")
    assert allows(own, "r1", "egress", "put", build("lab", "alice", MESSAGE, "voter", "opinion"))
    assert not allows(own, "r1", "egress", "put", build("lab", "bob", MESSAGE, "voter", "opinion"))


def test_each_name_holds_its_own_token_alone() -> None:
    names = ("alice", "class", "r1", "r2", "mallory")
    for access, holders in (
        (robot_access(ROSTER, "r1"), ("alice", "class")),
        (asker_access(ROSTER, "alice"), ("r1", "r2")),
        (router_access(ROSTER, "router"), ("alice", "class", "r1", "r2")),
    ):
        held = {
            (name, holder)
            for name in names
            for holder in (*names, "*")
            if allows(access, name, "ingress", "liveliness_token", token("lab", holder))
        }
        assert held == {(name, name) for name in holders}


@pytest.mark.parametrize("key", ["**", "swarm/**", "swarm/lab/**", "swarm/lab/*/state/*/**"])
def test_nothing_is_allowed_on_wild_keys(key: str) -> None:
    for access in (robot_access(ROSTER, "r1"), asker_access(ROSTER, "alice")):
        for flow in ("ingress", "egress"):
            for message in ("put", "query", "reply", "declare_subscriber", "declare_queryable"):
                for name in ("alice", "class", "r1", "r2"):
                    assert not allows(access, name, flow, message, key)


def test_states_go_to_operators_and_viewers_and_nothing_comes_in() -> None:
    access, own = robot_access(ROSTER, "r1"), build("lab", "r1", "state", "status")
    heard = [n for n in ("alice", "class", "r2") if allows(access, n, "egress", "put", own)]
    assert heard == ["alice", "class"]
    assert not allows(access, "alice", "egress", "put", build("lab", "r2", "state", "status"))
    assert not any(
        allows(access, name, "ingress", message, own)
        for name in ("alice", "class", "r2")
        for message in ("put", "delete", "declare_queryable", "reply", "liveliness_token")
    )


def test_an_operator_takes_a_key_of_a_robot_from_that_robot_alone() -> None:
    access = asker_access(ROSTER, "alice")
    for message, key in (
        ("put", build("lab", "r1", "state", "status")),
        ("reply", build("lab", "r1", CONTROL, "run", "alice")),
        ("declare_queryable", build("lab", "r1", CONTROL, "run", "*")),
    ):
        found = [n for n in ("r1", "r2", "bob") if allows(access, n, "ingress", message, key)]
        assert found == ["r1"]


def test_a_robot_that_dials_may_only_pull() -> None:
    access = asker_access(ROSTER, "r2")
    assert allows(access, "r1", "egress", "query", build("lab", "r1", SHARED, "roster", "r2"))
    for key in (build("lab", "r1", CONTROL, "run", "r2"), build("lab", "r1", "state", "status")):
        assert not allows(access, "r1", "egress", "query", key)


def test_a_router_lets_names_send_and_hear_what_their_roles_may() -> None:
    access = router_access(ROSTER, "class")

    def senders(message: str, key: str) -> list[str]:
        names = ("alice", "bob", "r1", "r2")
        return [name for name in names if allows(access, name, "ingress", message, key)]

    assert senders("query", build("lab", "r1", CONTROL, "run", "alice")) == ["alice"]
    assert senders("query", build("lab", "r1", CONTROL, "run", ANY)) == []
    assert senders("put", build("lab", "r1", "state", "status")) == ["r1"]
    assert senders("put", build("lab", "r1", "multicast", "all")) == ["r1"]
    assert senders("put", "swarm/lab/operator-12/multicast/all") == ["alice", "bob"]
    assert senders("declare_subscriber", build("lab", ANY, "unicast", "r1")) == ["r1"]
    assert senders("declare_subscriber", build("lab", ANY, "state", "status")) == ["alice", "bob"]
    assert senders("declare_subscriber", "swarm/lab/**") == []


def test_a_viewer_may_ask_what_the_page_lists() -> None:
    """The table of roles in docs/security.md, and the verbs behind its commands."""
    asked = {verb for verb in VERBS if may_ask(Role.VIEWER, verb)}
    asked -= {"members", "logs", "links", "doctor", "plugins"}
    assert asked == {"recordings", "fetch", "incidents"}
    assert (may_ask(Role.VIEWER, "run"), may_ask(Role.VIEWER, "members")) == (False, True)
    assert (may_ask(Role.OPERATOR, "run"), may_ask(Role.ROBOT, "members")) == (True, False)


def test_a_roster_that_grants_nothing_is_refused() -> None:
    empty = msgspec.structs.replace(ROSTER, operators={})
    with pytest.raises(ConfigError, match="operator"):
        robot_access(empty, "r1")
    with pytest.raises(ConfigError, match="r9"):
        robot_access(ROSTER, "r9")
    with pytest.raises(ConfigError, match="robot"):
        asker_access(msgspec.structs.replace(ROSTER, robots=()), "alice")
    with pytest.raises(ConfigError, match="mallory"):
        asker_access(ROSTER, "mallory")


def test_no_subject_has_an_empty_list_of_names() -> None:
    """Zenoh takes an empty list for all names."""
    alone = msgspec.structs.replace(ROSTER, viewers=(), robots=("r1",))
    for access in (robot_access(alone, "r1"), asker_access(alone, "alice")):
        assert all(one["cert_common_names"] for one in access["subjects"])
