"""Attacks on the links of a secured swarm, with real daemons and foreign sessions.

Every attack begins with a link that is up, where the attacker can get one, and ends with the same
robots: no attack moves, stops or changes anything, and no attacker hears anything.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zenoh

from swarmd.core.codec import VERSION, Decoder, encode
from swarmd.core.keys import ANY, CONTROL, SHARED, build
from swarmd.core.messages import Code, Epoch, Reply, Status
from swarmd.core.verbs import VERBS, MembersQuery, RunRequest
from swarmd.link.carriers.session import open_with, operator_options, tls_options
from swarmd.link.keys.identity import Identity, load_identity
from swarmd.link.settings import NetworkSettings
from tests.support.fake_daemon import light_status
from tests.support.keys import SwarmKeys
from tests.support.processes import CAP, free_endpoint, wait_until
from tests.support.secured_swarm import SecuredSwarm

pytestmark = pytest.mark.integration

WILD = ("**", "swarm/**", "swarm/*/*/control/**", "swarm/*/r1/state/*")
LINK_TIME = 1.0  # s; an attacker that is let in has its link after 10 ms
REQUESTS = tuple(r.name for r in VERBS.values() if r.is_request and not r.is_datagram)
_reply = Decoder(Reply)


class Besieged(SecuredSwarm):
    """Two daemons of a secured swarm, its operator anna, and what attackers may hold."""

    def __init__(self, folder: Path, left: contextlib.ExitStack) -> None:
        operators = ("anna", "bob", "mallory")
        viewers = ("eve",)
        super().__init__(folder, left, listens=True, operators=operators, viewers=viewers)
        self.revoked = self.keys["mallory"]
        self.keys.authority.change(remove=["mallory"])
        for name in ("r1", "r2", "anna", "bob", "eve"):
            self.keys.authority.issue(name).write(self.keys.folder_of(name))
        self.foreign = SwarmKeys(
            folder / "foreign", self.name, ["r1"], operators=operators, viewers=viewers
        )

    def statuses(self) -> dict[str, Status]:
        view = self.anna.members(timeout=20.0)
        assert view.answered == {"r1", "r2"}
        return {name: one.status for name, one in view.members.items() if one.status is not None}

    def epochs(self) -> dict[str, Epoch]:
        return {name: status.epoch for name, status in self.statuses().items()}

    def request(self, verb: str, operator: str = "anna") -> bytes:
        """A request that a robot would carry out if anna sent it."""
        fields: Mapping[str, dict[str, object]] = {
            "run": {"pattern": "drive"},
            "param": {"params": {"speed": 0.1}},
            "reload": {"pattern": "drive"},
            "forget": {"name": "r9"},
            "record": {"action": "start"},
        }
        packed = {"id": f"attack-{time.monotonic_ns()}", "operator": operator, "verb": verb}
        targets = {
            name: {"instance": e.instance, "revision": e.revision}
            for name, e in self.epochs().items()
        }
        content: bytes = msgpack.packb({**packed, "targets": targets, **fields.get(verb, {})})
        return bytes([VERSION]) + content


class Attacker:
    """A session of its own making, without access rules of its own, linked to r1."""

    def __init__(self, settings: NetworkSettings, endpoint: str, tls: dict[str, object]) -> None:
        options = {**operator_options(settings, [endpoint]), **tls}
        self.session = open_with(options, "an attacker")

    def is_linked(self, within: float = CAP) -> bool:
        """True as soon as it has a link, False if it has no link after that time."""
        until = time.monotonic() + within
        while not list(self.session.info.peers_zid()) and time.monotonic() < until:
            time.sleep(0.01)
        return bool(list(self.session.info.peers_zid()))

    def ask(self, key: str, payload: bytes = b"") -> list[bytes]:
        replies = self.session.get(
            key,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=2.0,
            payload=payload,
        )
        return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


@pytest.fixture(scope="module")
def besieged(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Besieged]:
    with contextlib.ExitStack() as left:
        made = Besieged(tmp_path_factory.mktemp("siege"), left)
        made.start()
        yield made


@contextlib.contextmanager
def unchanged(besieged: Besieged) -> Iterator[None]:
    """AssertionError if an epoch, a state or a latch of a robot differs afterwards."""
    before = {n: (s.epoch, s.state, s.latches) for n, s in besieged.statuses().items()}
    logs = [daemon.text().count("by ") for daemon in besieged.daemons.values()]
    yield
    after = {n: (s.epoch, s.state, s.latches) for n, s in besieged.statuses().items()}
    assert after == before
    assert [daemon.text().count("by ") for daemon in besieged.daemons.values()] == logs


@contextlib.contextmanager
def attacker(
    besieged: Besieged, tls: dict[str, object] | Identity, endpoint: str = ""
) -> Iterator[Attacker]:
    options = tls_options(tls) if isinstance(tls, Identity) else tls
    secured = besieged.endpoint.replace("tcp/", "tls/")
    made = Attacker(besieged.settings, endpoint or secured, options)
    try:
        yield made
    finally:
        made.session.close()


def assert_all_denied(
    besieged: Besieged, attacking: Attacker, askers: tuple[str, ...], verbs: tuple[str, ...]
) -> None:
    """No verb of any of these askers is answered, at r1 or at all robots; no key can be heard."""
    payloads = {verb: besieged.request(verb) for verb in REQUESTS}
    for robot, verb, asker in itertools.product(("r1", ANY), verbs, askers):
        key = build(besieged.name, robot, CONTROL, verb, asker)
        assert attacking.ask(key, payloads.get(verb, b"")) == [], key
    for key in (*WILD, build(besieged.name, ANY, CONTROL, ANY, ANY)):
        assert attacking.ask(key, payloads["run"]) == [], key


def no_certificate(besieged: Besieged, folder: Path) -> dict[str, Any]:
    authority = str(besieged.keys["anna"].authority)
    tls = {"root_ca_certificate": authority, "verify_name_on_connect": False}
    return {"transport/link/tls": tls}


def of_another_authority(besieged: Besieged, folder: Path) -> dict[str, Any]:
    """A certificate that names anna, of an attacker that knows the real authority's."""
    options: dict[str, Any] = tls_options(besieged.foreign["anna"])
    authority = str(besieged.keys["anna"].authority)
    options["transport/link/tls"]["root_ca_certificate"] = authority
    return options


def expired(besieged: Besieged, folder: Path) -> dict[str, Any]:
    besieged.keys.authority.issue("bob", days=-1).write(folder / "bob")
    options: dict[str, Any] = tls_options(besieged.keys["bob"])
    certificate = str(folder / "bob" / "certificate.pem")
    options["transport/link/tls"]["connect_certificate"] = certificate
    return options


@pytest.mark.long
@pytest.mark.parametrize("of", [None, no_certificate, of_another_authority, expired])
def test_without_a_certificate_that_is_valid_there_is_no_link(
    besieged: Besieged, tmp_path: Path, of: Callable[[Besieged, Path], dict[str, Any]] | None
) -> None:
    """`of` None: plain TCP."""
    options = {} if of is None else of(besieged, tmp_path)
    endpoint = besieged.endpoint if of is None else ""
    with unchanged(besieged), attacker(besieged, options, endpoint) as attacking:
        assert not attacking.is_linked(LINK_TIME)


@pytest.mark.evidence
def test_an_open_link_ends_with_the_certificate_of_its_other_end(
    besieged: Besieged, tmp_path: Path
) -> None:
    besieged.keys.authority.issue("eve", days=8.0 / 86400.0).write(tmp_path / "eve")
    with attacker(besieged, load_identity(tmp_path / "eve")) as attacking:
        assert attacking.is_linked(5.0)
        wait_until(lambda: not list(attacking.session.info.peers_zid()), "the link ends", 20.0)
        assert not attacking.is_linked(LINK_TIME)


def test_a_stolen_certificate_of_a_robot_commands_no_other_robot(besieged: Besieged) -> None:
    with unchanged(besieged), attacker(besieged, besieged.keys["r2"]) as attacking:
        assert attacking.is_linked()
        verbs = (*REQUESTS, "members", "audit")
        assert_all_denied(besieged, attacking, ("r2", "anna", ANY), verbs)
        assert attacking.ask(build(besieged.name, "r1", "state", "status")) == []


def test_a_certificate_that_was_revoked_is_denied_logged_and_its_link_ends(
    besieged: Besieged,
) -> None:
    with unchanged(besieged), attacker(besieged, besieged.revoked) as attacking:
        assert attacking.is_linked()
        wait_until(lambda: not list(attacking.session.info.peers_zid()), "the link ends", 20.0)
        assert_all_denied(besieged, attacking, ("mallory", "anna", ANY), ("run", "members"))
        assert attacking.ask(build(besieged.name, "r1", SHARED, "roster", "mallory")) == []
        log = besieged.daemons["r1"]
        wait_until(lambda: "'mallory'" in log.text(), "r1 logs the link of mallory", 10.0)


def test_a_viewer_reads_and_commands_nothing(besieged: Besieged) -> None:
    with unchanged(besieged), attacker(besieged, besieged.keys["eve"]) as attacking:
        assert attacking.is_linked()
        key = build(besieged.name, "r1", CONTROL, "members", "eve")
        wait_until(lambda: attacking.ask(key, encode(MembersQuery())) != [], "eve reads members")
        assert_all_denied(besieged, attacking, ("eve", "anna", ANY), REQUESTS)
        assert attacking.ask(build(besieged.name, "r1", CONTROL, "members", "anna")) == []


def _ignore(reply: zenoh.Reply) -> None:
    pass


def test_no_question_of_a_viewer_ends_a_daemon(besieged: Besieged) -> None:
    files = ("a\0.mcap", "\0", "../r1.yaml", "/etc/passwd", ".mcap", "\ud800.mcap", "x" * 5000)
    with unchanged(besieged), attacker(besieged, besieged.keys["eve"]) as attacking:
        assert attacking.is_linked()
        key = build(besieged.name, "r1", CONTROL, "members", "eve")
        wait_until(lambda: attacking.ask(key, encode(MembersQuery())) != [], "eve reads members")
        for name, file in itertools.product(("fetch", "audit", "logs", "recordings"), files):
            query = {"file": file, "grep": file, "offset": 0, "length": 1, "before": file}
            content = msgpack.packb(query, unicode_errors="surrogatepass")
            attacking.session.get(
                build(besieged.name, "r1", CONTROL, name, "eve"),
                _ignore,
                payload=bytes([VERSION]) + content,
            )
        wait_until(lambda: attacking.ask(key, encode(MembersQuery())) != [], "r1 answers eve")
    drops = besieged.statuses()["r1"].health.dropped
    assert drops["control/fetch:malformed"] > 0
    assert all(daemon.process.poll() is None for daemon in besieged.daemons.values())


def test_an_operator_commands_in_no_other_name(besieged: Besieged) -> None:
    """What a payload claims does not count: the robot logs the name of the certificate."""
    payload = besieged.request("run", operator="anna")
    with attacker(besieged, besieged.keys["bob"]) as attacking:
        assert attacking.is_linked()
        with unchanged(besieged):
            assert_all_denied(besieged, attacking, ("anna", ANY), ("run", "reset"))
        own = build(besieged.name, "r1", CONTROL, "run", "bob")
        (answer,) = attacking.ask(own, payload)
        assert _reply(answer).code is Code.APPLIED
        log = besieged.daemons["r1"]
        wait_until(lambda: "by bob" in log.text(), "r1 logs bob")
        assert "by anna" not in log.text()
    assert "bob" in (besieged.statuses()["r1"].changed_by or "")


@pytest.mark.parametrize("who", ["r2", "eve", "anna"])
def test_puts_reach_nobody(besieged: Besieged, who: str) -> None:
    """Also puts on wild keys, and those of an operator: a robot subscribes to nothing."""
    heard: list[bytes] = []
    besieged.anna.watch("status", lambda robot, payload: heard.append(payload))
    with unchanged(besieged), attacker(besieged, besieged.keys[who]) as attacking:
        assert attacking.is_linked()
        keys = [build(besieged.name, robot, "state", "status") for robot in ("r1", ANY)]
        keys += [build(besieged.name, "r1", CONTROL, "run", "anna"), *WILD]
        forged = besieged.request("run")
        for key in keys:
            attacking.session.put(key, forged)
            attacking.session.delete(key)
    besieged.anna.unwatch("status")
    assert forged not in heard


@pytest.mark.parametrize("who", ["r2", "eve", "bob"])
def test_nobody_listens_to_more_than_states(besieged: Besieged, who: str) -> None:
    """A robot hears nothing of another one, and wild subscriptions give nothing to anybody."""
    heard: list[str] = []
    states = build(besieged.name, ANY, "state", ANY)
    with attacker(besieged, besieged.keys[who]) as attacking:
        assert attacking.is_linked()
        for key in (*WILD, build(besieged.name, ANY, CONTROL, ANY, ANY)):
            attacking.session.declare_subscriber(key, lambda sample: heard.append(who))
        if who == "r2":
            attacking.session.declare_subscriber(states, lambda sample: heard.append(who))
        besieged.anna.watch("status", lambda robot, payload: heard.append("anna"))
        outcome = besieged.anna.request(RunRequest, besieged.epochs(), pattern="drive")
        assert outcome.exit_code == 0
        wait_until(lambda: "anna" in heard, "anna hears a status")
    besieged.anna.unwatch("status")
    assert who not in heard


def test_a_stolen_certificate_of_a_robot_speaks_for_no_other_robot(besieged: Besieged) -> None:
    """An operator that dials the thief takes what is on keys of r2 and nothing else."""
    endpoint = free_endpoint().replace("tcp/", "tls/")
    thief = open_with(
        {
            **tls_options(besieged.keys["r2"]),
            **operator_options(besieged.settings, []),
            "listen/endpoints": [endpoint],
        },
        "a thief",
    )

    def answer(query: zenoh.Query) -> None:
        for robot in ("r1", "r2"):
            own = build(besieged.name, robot, CONTROL, "members", "anna")
            query.reply(own, robot.encode())
        query.drop()

    heard: list[str] = []
    states = build(besieged.name, ANY, "state", ANY)
    anna = open_with(operator_options(besieged.settings, [endpoint], besieged.keys["anna"]), "anna")
    try:
        for robot in ("r1", "r2", ANY):
            thief.declare_queryable(build(besieged.name, robot, CONTROL, "members", ANY), answer)
        anna.declare_subscriber(states, lambda sample: heard.append(str(sample.key_expr)))
        forged = encode(light_status("r1", "0123456789ab"))

        def put_both() -> bool:
            for robot in ("r1", "r2"):
                thief.put(build(besieged.name, robot, "state", "status"), forged)
            return bool(heard)

        wait_until(put_both, "anna hears r2")
        query = build(besieged.name, ANY, CONTROL, "members", "anna")
        found: list[bytes] = []

        def asked() -> bool:
            replies = anna.get(query, target=zenoh.QueryTarget.ALL, timeout=2.0)
            found.extend(one.ok.payload.to_bytes() for one in replies if one.ok is not None)
            return bool(found)

        wait_until(asked, "r2 answers anna")
        assert set(found) == {b"r2"}
        assert set(heard) == {build(besieged.name, "r2", "state", "status")}
    finally:
        anna.close()
        thief.close()


def test_wild_questions_of_an_operator_are_dropped_and_counted(besieged: Besieged) -> None:
    with unchanged(besieged), attacker(besieged, besieged.keys["bob"]) as attacking:
        assert attacking.is_linked()
        key = build(besieged.name, ANY, CONTROL, ANY, "bob")
        assert attacking.ask(key, besieged.request("run")) == []
        wait_until(
            lambda: besieged.statuses()["r1"].health.dropped.get("control/run:key", 0) > 0,
            "r1 counts the wild key",
        )
