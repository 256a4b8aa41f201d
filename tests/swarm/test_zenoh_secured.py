"""Zenoh programs at a secured swarm: what the certificate of each role lets them do."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zenoh

from swarmd.core.keys import ANY, CONTROL, MESSAGE, STATE, build, token
from swarmd.core.messages import State
from swarmd.core.verbs import RunRequest
from swarmd.operator.session.outcome import Outcome
from swarmd.settings.settings import load_platform
from tests.support.fake_body import Body
from tests.support.processes import CAP, wait_until
from tests.support.secured_swarm import RUNNING, SecuredSwarm
from tests.support.swarmctl import await_applied, swarmctl

pytestmark = pytest.mark.integration

VOTE = ("voter_model", "opinion")
PROGRAM, VIEWER = "teacher", "class"
BARRED = {"viewer": VIEWER, "robot": RUNNING[1], "nobody": ""}
"""Names of certificates that may not command, by role."""


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredSwarm]:
    """Robots r1 and r2 with bodies; teacher is an operator, class a viewer."""
    with contextlib.ExitStack() as left:
        folder = tmp_path_factory.mktemp("secured")
        made = SecuredSwarm(folder, left, operators=("anna", PROGRAM))
        for robot in RUNNING:
            body = Body(load_platform("waffle_pi"), swarm=made.name, robot=robot)
            made.bodies[robot] = left.enter_context(body).endpoint
        yield made.start()


def config_of(secured: SecuredSwarm, name: str, file: Path, *words: str) -> dict[str, Any]:
    """What `swarmctl zenoh` writes for an identity."""
    where = ("--swarm", secured.name, "--identity", str(secured.keys.folder_of(name)))
    done = swarmctl("zenoh", *where, *words, "--out", str(file))
    assert done.code == 0, done
    written: dict[str, Any] = json.loads(file.read_text())
    return written


@contextlib.contextmanager
def session_of(config: dict[str, Any]) -> Iterator[zenoh.Session]:
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        yield session


def run(secured: SecuredSwarm) -> None:
    """Let both robots vote, on nothing but what they hear."""

    def ask() -> Outcome:
        view = secured.anna.members()
        params = {"share_period": 0.2}
        return secured.anna.request(
            RunRequest, view.epochs(RUNNING), pattern=VOTE[0], params=params, timeout=CAP
        )

    await_applied(ask, "both run")


def heard(secured: SecuredSwarm) -> list[int]:
    """From how many voters each robot hears; a robot that a stall of the machine stopped runs."""
    statuses = [secured.status(robot) for robot in RUNNING]
    if any(status.state is not State.RUNNING for status in statuses):
        run(secured)
    return [int(status.report.get("heard", 0)) for status in statuses]


def stops(secured: SecuredSwarm) -> list[tuple[str, str]]:
    """The requests that robots have answered, by operator, but those by which they vote."""
    where = ("--swarm", secured.name, "--identity", str(secured.keys.folder_of("anna")))
    entries: list[dict[str, Any]] = []

    def is_read() -> bool:
        found = swarmctl("audit", *where, "-o", "json").json or {}
        entries[:] = found.get("entries", ())
        return (found.get("faults"), found.get("missing")) == ({}, [])

    wait_until(is_read, "both audit logs are read")
    verbs = [(entry["operator"], entry["verb"]) for entry in entries]
    return [one for one in verbs if one != ("anna", "run")]


def answers(session: zenoh.Session, key: str, seconds: float, **fields: Any) -> dict[str, Any]:
    """The answers of robots, by name; `fields` of a request, or none."""
    payload = b"\x01" + msgpack.packb(fields) if fields else None
    found = {}
    for reply in session.get(key, target=zenoh.QueryTarget.ALL, payload=payload, timeout=seconds):
        if reply.ok is not None:
            answer = msgpack.unpackb(reply.ok.payload.to_bytes()[1:])
            found[answer["robot"]] = answer
    return found


def test_an_operator_lists_reads_votes_and_stops_in_the_name_of_its_certificate(
    secured: SecuredSwarm, tmp_path: Path
) -> None:
    run(secured)
    config = config_of(secured, PROGRAM, tmp_path / "teacher.json5")
    assert config["connect"]["endpoints"] == []  # it finds the robots by scouting
    name, told = secured.name, set[str]()
    with session_of(config) as session:

        def lists() -> bool:
            replies = session.liveliness().get(token(name, ANY), timeout=CAP)
            told.update(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)
            return told >= {token(name, robot) for robot in RUNNING}

        wait_until(lists, "the program lists both robots")
        key = build(name, ANY, STATE, "status")
        wait_until(
            lambda: answers(session, key, CAP).keys() == {*RUNNING}, "it reads both statuses"
        )
        vote = b"\x01" + msgpack.packb(2)

        def is_heard() -> bool:
            session.put(build(name, PROGRAM, MESSAGE, *VOTE), vote)
            return heard(secured) == [2, 2]

        wait_until(is_heard, "both robots hear the program beside each other")
        key = build(name, ANY, CONTROL, "stop", PROGRAM)

        def is_applied() -> bool:
            stop = {"verb": "stop", "id": "stop-of-teacher", "operator": "anna"}
            found = answers(session, key, CAP, **stop)
            return {r: one["code"] for r, one in found.items()} == dict.fromkeys(RUNNING, "applied")

        wait_until(is_applied, "both robots apply the stop")
    assert [one for one in stops(secured) if one[1] == "stop"] == [(PROGRAM, "stop")] * 2


@pytest.mark.parametrize("role", BARRED)
def test_a_certificate_of_another_role_commands_no_robot_and_speaks_for_none(
    secured: SecuredSwarm, tmp_path: Path, role: str
) -> None:
    """Even if it leaves its own access rules out, or shows no certificate at all."""
    run(secured)
    name, own = secured.name, BARRED[role] or VIEWER
    config = config_of(secured, PROGRAM, tmp_path / "operator.json5", "--dial")
    del config["access_control"]
    if BARRED[role]:
        folder = secured.keys.folder_of(own)
        for end in ("listen", "connect"):
            for part in ("certificate", "private_key"):
                file = Path(config["transport"]["link"]["tls"][f"{end}_{part}"]).name
                config["transport"]["link"]["tls"][f"{end}_{part}"] = str(folder / file)
    else:
        tls = config["transport"]["link"]["tls"]
        config["transport"]["link"]["tls"] = {
            "root_ca_certificate": tls["root_ca_certificate"],
            "verify_name_on_connect": False,
        }
    good = config_of(secured, PROGRAM, tmp_path / "teacher.json5")
    vote = b"\x01" + msgpack.packb(2)
    before = stops(secured)
    with session_of(config) as hostile, session_of(good) as session:
        status = build(name, ANY, STATE, "status")
        if BARRED[role]:
            wait_until(lambda: len(hostile.info.links()) == len(RUNNING), "it has both links")
        if role == "viewer":
            wait_until(
                lambda: answers(hostile, status, CAP).keys() >= {*RUNNING}, "the viewer reads"
            )
        else:
            assert not answers(hostile, status, 1.0)
        for verb in ("stop", "estop", "run"):
            for asker in (own, PROGRAM):
                request = {"verb": verb, "id": f"{verb}-{role}", "operator": "anna"}
                more = {"pattern": "drive", "targets": dict.fromkeys(RUNNING)}
                key = build(name, ANY, CONTROL, verb, asker)
                fields = request | (more if verb == "run" else {})
                assert not answers(hostile, key, 0.3, **fields)

        def is_heard() -> bool:
            for sender in (own, *RUNNING, "r3", PROGRAM):
                hostile.put(build(name, sender, MESSAGE, *VOTE), vote)
            session.put(build(name, PROGRAM, MESSAGE, *VOTE), vote)
            counts = heard(secured)
            assert max(counts) <= 2  # of the other robot and of the operator's program
            return counts == [2, 2]

        wait_until(is_heard, "both robots hear the operator's program")
        assert BARRED[role] or not hostile.info.links()
    assert stops(secured) == before
