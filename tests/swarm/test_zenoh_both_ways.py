"""Zenoh programs find robots by scouting, list them, vote with them and stop them; no endpoint."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zenoh

from swarmd.core.keys import ANY, ANYONE, CONTROL, MESSAGE, build, token
from swarmd.core.messages import Presence, State
from tests.support.processes import CAP, wait_until
from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples" / "zenoh"
PAGE_BLOCKS = re.findall(
    r"^```python\n(.*?)^```", (ROOT / "docs/zenoh.md").read_text(), re.MULTILINE | re.DOTALL
)
ROBOTS = ("r01", "r02", "r03")
VOTE = ("voter_model", "opinion")


@pytest.fixture(scope="module")
def voting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Swarm]:
    """A swarm of three robots."""
    with contextlib.closing(Swarm(tmp_path_factory.mktemp("voting"))) as swarm:
        for daemon in [swarm.spawn(robot, swarm.body(robot)) for robot in ROBOTS]:
            daemon.wait_ready()
        for robot in ROBOTS:
            for other in {*ROBOTS} - {robot}:
                swarm.await_presence(robot, other, Presence.ALIVE)
        yield swarm


@pytest.fixture
def session() -> Iterator[zenoh.Session]:
    """A program with the configuration that Zenoh has by default."""
    with zenoh.open(zenoh.Config()) as opened:
        yield opened


def run(swarm: Swarm) -> None:
    """Let all robots vote, on nothing but what they hear."""
    swarm.ctl("reset", "--all", "--yes")
    done = swarm.ctl("run", "voter_model", "--all", "-p", "share_period=0.2")
    assert done.code == 0, done


def example(name: str, *words: str) -> subprocess.CompletedProcess[str]:
    """An example that has ended."""
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=CAP, check=False)


def stop_all(swarm: Swarm, *absent: str) -> None:
    """Run stop.py with the names of all robots until all have answered.

    On a loaded machine 5 s may not suffice to find all. Each run names the robots that have not
    answered, such as those that are `absent`, and exits with 0 only if there are none.
    """

    def all_answer() -> bool:
        done = example("stop", swarm.name, *ROBOTS, *absent)
        codes = dict(line.split()[:2] for line in done.stdout.splitlines())
        assert codes.keys() == {*ROBOTS, *absent}, done
        assert {codes[robot] for robot in absent} <= {"has"}, done  # has not answered
        assert bool(done.returncode) == ({*codes.values()} != {"applied"}), done
        return {codes[robot] for robot in ROBOTS} == {"applied"}

    wait_until(all_answer, "stop.py has the answers of all robots")


def ask(
    session: zenoh.Session, swarm: Swarm, verb: str, *robots: str, **fields: Any
) -> dict[str, dict[str, Any]]:
    """The last answer of each robot to a request that is repeated until all `robots` answered."""
    payload = b"\x01" + msgpack.packb({"verb": verb, "operator": "prog", **fields})
    answers: dict[str, dict[str, Any]] = {}

    def have_answered() -> bool:
        for reply in session.get(
            build(swarm.name, ANY, CONTROL, verb, ANYONE),
            target=zenoh.QueryTarget.ALL,
            payload=payload,
            timeout=CAP,
        ):
            if reply.ok is not None:
                answer = msgpack.unpackb(reply.ok.payload.to_bytes()[1:])
                answers[answer["robot"]] = answer
        return answers.keys() >= {*robots}

    wait_until(have_answered, f"answers to {verb} of {robots}")
    return answers


def await_links(session: zenoh.Session, swarm: Swarm) -> None:
    """Wait until the program sees the token of each robot, and may question all."""

    def is_linked() -> bool:
        replies = session.liveliness().get(token(swarm.name, ANY), timeout=CAP)
        return {str(one.ok.key_expr) for one in replies if one.ok is not None} >= {
            token(swarm.name, robot) for robot in ROBOTS
        }

    wait_until(is_linked, "the program sees all tokens")


def test_a_program_finds_all_robots_and_those_that_start_later(
    voting: Swarm, session: zenoh.Session
) -> None:
    seen, gone = threading.Event(), threading.Event()

    def on_token(sample: zenoh.Sample) -> None:
        if str(sample.key_expr) == token(voting.name, "late"):
            (seen if sample.kind == zenoh.SampleKind.PUT else gone).set()

    await_links(session, voting)
    session.liveliness().declare_subscriber(token(voting.name, ANY), on_token, history=True)
    late = voting.start("late", voting.body("late"))
    assert seen.wait(CAP)
    late.terminate()
    assert gone.wait(CAP)
    voting.ctl("members", "forget", "late")


def test_list_vote_and_stop_need_the_name_of_the_swarm_alone(voting: Swarm) -> None:
    def lists_all() -> bool:
        done = example("list", voting.name, "0.5")
        return {f"{robot} here" for robot in ROBOTS} <= {*done.stdout.splitlines()}

    wait_until(lists_all, "list.py sees all robots")
    run(voting)
    heard = {robot: 0 for robot in ROBOTS}

    def is_counted() -> bool:
        reports = {robot: voting.status(robot).report for robot in ROBOTS}
        heard.update({robot: int(report.get("heard", 0)) for robot, report in reports.items()})
        return all(count >= len(ROBOTS) for count in heard.values())  # both others, and a program

    def is_listed() -> bool:
        return (voting.ctl("members", "-o", "json").json or {}).get("programs") == ["teacher"]

    with subprocess.Popen(
        [sys.executable, str(EXAMPLES / "vote.py"), voting.name, "teacher", "2", str(CAP)]
    ) as program:
        try:
            wait_until(is_counted, f"all robots hear the program: {heard}")
            wait_until(is_listed, "members lists the program")
        finally:
            program.kill()
    assert voting.ctl("members", "-o", "json").json["missing"] == []
    stop_all(voting, "r09")
    for robot in ROBOTS:
        voting.await_state(robot, State.STOPPED)


def test_the_query_of_the_page_reaches_each_robot_and_names_an_absent_one(
    voting: Swarm, capsys: pytest.CaptureFixture[str]
) -> None:
    wait, query = (
        next(block for block in PAGE_BLOCKS if text in block)
        for text in ("def await_robots", "missing = await_robots")
    )
    known: dict[str, Any] = {}
    exec(wait, known)
    named = query.replace("meadow", voting.name).replace('"tb3-02"', '"r02", "r03", "r09"')

    def reaches_all() -> bool:
        exec(named.replace("tb3-01", "r01"), known)
        assert "r09" in known["missing"]
        return {*ROBOTS} <= {*re.findall(r"^(r\d+) \w+$", capsys.readouterr().out, re.MULTILINE)}

    wait_until(reaches_all, "the query of the page reaches all robots")


@pytest.mark.evidence
def test_each_of_thirty_new_sessions_stops_all_robots_beside_another_swarm(
    voting: Swarm, tmp_path: Path
) -> None:
    """The program of the page, whose session may be linked to a robot of the other swarm first."""
    program = tmp_path / "stop.py"
    program.write_text(next(block for block in PAGE_BLOCKS if block.startswith('"""Stop all')))
    with contextlib.closing(Swarm(tmp_path / "other")) as other:
        for daemon in [other.spawn(robot, other.body(robot)) for robot in ROBOTS]:
            daemon.wait_ready()
        for _ in range(30):
            command = [sys.executable, str(program), voting.name, *ROBOTS]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            codes = dict(line.split()[:2] for line in done.stdout.splitlines())
            assert codes == dict.fromkeys(ROBOTS, "applied")


def test_a_program_hears_what_patterns_send(voting: Swarm, session: zenoh.Session) -> None:
    run(voting)
    heard = dict[str, int]()

    def on_vote(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        assert payload[0] == 1
        heard[str(sample.key_expr).split("/")[2]] = msgpack.unpackb(payload[1:])

    session.declare_subscriber(build(voting.name, ANY, MESSAGE, ANY, ANY), on_vote)
    wait_until(lambda: heard.keys() == {*ROBOTS}, "all robots send votes")
    assert set(heard.values()) <= {0, 1, 2}
    stop_all(voting)


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_is_carried_out_answered_at_each_repeat_and_audited(
    voting: Swarm, session: zenoh.Session, verb: str
) -> None:
    await_links(session, voting)
    run(voting)
    state = State.STOPPED if verb == "stop" else State.ESTOPPED
    one = ask(session, voting, verb, ROBOTS[0], id=f"{verb}-one", targets={ROBOTS[0]: None})
    assert one.keys() == {ROBOTS[0]}
    assert one[ROBOTS[0]]["code"] == "applied"
    voting.await_state(ROBOTS[0], state)
    everyone = ask(session, voting, verb, *ROBOTS, id=f"{verb}-all")
    assert everyone.keys() == {*ROBOTS}
    assert {answer["code"] for answer in everyone.values()} == {"applied"}
    for robot in ROBOTS:
        voting.await_state(robot, state)
    again = ask(session, voting, verb, *ROBOTS, id=f"{verb}-all")
    assert {robot: answer["code"] for robot, answer in again.items()} == dict.fromkeys(
        ROBOTS, "applied"
    )
    entries = [entry for entry in voting.audit(*ROBOTS) if entry.get("operator") == "prog"]
    assert len([entry for entry in entries if verb in str(entry)]) >= len(ROBOTS)


def test_what_programs_may_not_send_is_counted_and_moves_nothing(
    voting: Swarm, session: zenoh.Session
) -> None:
    await_links(session, voting)
    run(voting)
    name = voting.name
    key = build(name, "prog", MESSAGE, *VOTE)
    good = b"\x01" + msgpack.packb(1)
    bad = {
        "message:malformed": [(key, b""), (key, b"\x02\x01"), (key, b"\x01\xc1")],
        "message:oversized": [(key, b"\x01" + msgpack.packb("x" * 2000))],
        "message:robot": [(build(name, robot, MESSAGE, *VOTE), good) for robot in ROBOTS],
        "message:key": [
            (f"swarm/{name}/Prog/message/voter_model/opinion", good),
            (f"swarm/{name}/*/message/voter_model/opinion", good),
            (f"swarm/{name}/{'p' * 10_000}/message/voter_model/opinion", good),
            (f"swarm/{name}/prog/message/voter_model/Opinion", good),
        ],
        "message:limit": [(key, good)] * 200,
    }
    tokens = [session.liveliness().declare_token(token(name, f"t{i}")) for i in range(1000)]
    tokens += [session.liveliness().declare_token(token(name, robot)) for robot in ROBOTS]

    def are_counted() -> bool:
        for puts in bad.values():
            for place, payload in puts:
                session.put(place, payload)
        dropped = [voting.status(robot).health.dropped for robot in ROBOTS]
        return all(bad.keys() <= counts.keys() for counts in dropped)

    wait_until(are_counted, "each robot counts each kind")
    flood = threading.Event()

    def send() -> None:
        for _ in range(50_000):
            if flood.is_set():
                return
            session.put(key, good, congestion_control=zenoh.CongestionControl.DROP)

    sender = threading.Thread(target=send)
    sender.start()
    try:
        done = voting.ctl("estop", "--reason", "flood")
    finally:
        flood.set()
        sender.join()
    assert done.code == 0, done
    for robot in ROBOTS:
        status = voting.await_state(robot, State.ESTOPPED)
        assert not status.decision.safe_linear
    members = voting.ctl("members", "-o", "json").json
    assert {one["robot"] for one in members["members"]} == {*ROBOTS}
    assert len(members["programs"]) <= 2 * 64
    del tokens
