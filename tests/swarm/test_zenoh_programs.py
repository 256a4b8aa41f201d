"""Programs that read a swarm by Zenoh alone: the keys, `swarmctl zenoh`, and the examples."""

from __future__ import annotations

import ast
import contextlib
import csv
import json
import os
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh

from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder
from swarmd.core.events import PoseInput
from swarmd.core.key_table import PUBLISHED
from swarmd.core.keys import ANY, STATE, build, parse
from swarmd.core.messages import Presence, State
from swarmd.core.values import Pose, SharedPose
from swarmd.driver_api.hw_codec import encode_input
from swarmd.link.carriers.session import MAX_WIRE
from tests.support.fake_body import Body
from tests.support.processes import CAP, wait_until
from tests.support.secured_swarm import RUNNING, SecuredSwarm
from tests.support.swarmctl import swarmctl
from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "zenoh"
ROBOTS = ("r01", "r02")


@pytest.fixture(scope="module")
def voting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Swarm, dict[str, Body]]]:
    """A swarm of two robots that vote, and their bodies."""
    with contextlib.closing(Swarm(tmp_path_factory.mktemp("voting"))) as swarm:
        bodies = {robot: swarm.body(robot) for robot in ROBOTS}
        for daemon in [swarm.spawn(robot, body) for robot, body in bodies.items()]:
            daemon.wait_ready()
        for robot, other in (ROBOTS, ROBOTS[::-1]):
            swarm.await_presence(robot, other, Presence.ALIVE)
        done = swarm.ctl("run", "voter_model", "--all", "-p", "share_period=0.2")
        assert done.code == 0, done
        yield swarm, bodies


@pytest.fixture(scope="module")
def config(voting: tuple[Swarm, dict[str, Body]]) -> Path:
    """The file that `swarmctl zenoh` has written for that swarm."""
    swarm, _ = voting
    file = swarm.folder / "swarm.json5"
    done = swarm.ctl("zenoh", "--dial", "--out", str(file), "-o", "json")
    assert done.code == 0, done
    assert done.json["robots"].keys() == set(ROBOTS)
    assert sorted(done.json["robots"].values()) == done.json["config"]["connect"]["endpoints"]
    assert json.loads(file.read_text()) == done.json["config"]
    return file


@contextlib.contextmanager
def program(name: str, *words: object, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """An example in a process of its own, by its path; killed if it has not ended."""
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *map(str, words)]
    pipe = subprocess.PIPE
    env = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        command, stdout=pipe, stderr=pipe, text=True, cwd=cwd, env=env
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def finished(process: subprocess.Popen[str]) -> list[str]:
    """The lines of an example that has ended well."""
    out, err = process.communicate(timeout=CAP)
    assert process.returncode == 0, err
    return out.splitlines()


def test_each_publication_reaches_a_foreign_session(
    voting: tuple[Swarm, dict[str, Body]], config: Path
) -> None:
    swarm, bodies = voting
    seen: dict[str, dict[str, Any]] = defaultdict(dict)
    decoders = {name: Decoder(row.content, MAX_WIRE) for name, row in PUBLISHED.items()}

    def take(sample: zenoh.Sample) -> None:
        key = parse(str(sample.key_expr))
        assert key is not None
        seen[key.name][key.robot] = decoders[key.name](sample.payload.to_bytes())

    def has_all() -> bool:
        for body in bodies.values():
            shared = SharedPose(boottime(), Pose(1.5, -2.0, 0.5), 0.02, 0.01, "room")
            body.put("pose", encode_input(PoseInput(shared)))
        told = {name for name, robots in seen.items() if robots.keys() == set(ROBOTS)}
        return told >= PUBLISHED.keys() - {"tracks", "log"}

    with zenoh.open(zenoh.Config.from_file(str(config))) as session:
        session.declare_subscriber(build(swarm.name, ANY, STATE, ANY), take)
        wait_until(has_all, "both robots publish all but tracks")
    for robot in ROBOTS:
        pose, decision, message = (seen[one][robot] for one in ("pose", "decision", "message"))
        assert (pose.robot, pose.x, pose.y, pose.frame) == (robot, 1.5, -2.0, "room")
        assert 0.0 <= pose.age < CAP
        assert (decision.robot, decision.state) == (robot, State.RUNNING)
        assert decision.decision.mode == "barrier"
        assert (message.robot, message.channel) == (robot, "voter_model/opinion")
        assert message.value in range(3)


def test_the_examples_read_the_swarm(
    voting: tuple[Swarm, dict[str, Body]], config: Path, tmp_path: Path
) -> None:
    swarm, _ = voting
    words = (config, swarm.name)
    with (
        program("print_states", *words, cwd=tmp_path) as states,
        program("plot_pose", *words, "r02", "--count", 5, cwd=tmp_path) as plot,
        program("record_opinions", *words, "--count", 12, cwd=tmp_path) as opinions,
    ):
        assert states.stdout is not None
        printed = set[tuple[str, ...]]()
        while len(printed) < len(ROBOTS):  # either robot may be heard first, and more than once
            printed.add(tuple(states.stdout.readline().split()[:3]))
        assert printed == {(robot, "running", "voter_model") for robot in ROBOTS}
        assert finished(plot) == ["way.png: 5 poses of r02"]
        assert finished(opinions) == ["opinions.csv: 12 opinions"]
        states.send_signal(signal.SIGINT)
        assert finished(states)[-1].startswith("changes: ")  # and no traceback
    assert (tmp_path / "way.png").read_bytes().startswith(b"\x89PNG")
    with (tmp_path / "opinions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 12
    assert {row["robot"] for row in rows} == set(ROBOTS)
    assert all(int(row["opinion"]) in range(3) for row in rows)
    times = [float(row["at"]) for row in rows if row["robot"] == "r01"]
    assert times == sorted(times)


def test_foxglove_gets_poses_scans_and_states(
    voting: tuple[Swarm, dict[str, Body]], config: Path, tmp_path: Path
) -> None:
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    swarm, _ = voting
    wanted = {"/tf", *(f"/{robot}/{name}" for robot in ROBOTS for name in ("scan", "status"))}
    topics: set[str] = set()
    with program("../foxglove/live", config, swarm.name, "--port", 0, cwd=tmp_path) as live:
        assert live.stdout is not None
        address = live.stdout.readline().split()[-1]
        assert address.startswith("ws://127.0.0.1:")
        with connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")]) as socket:
            while not wanted <= topics:
                message = socket.recv(timeout=CAP)
                told = json.loads(message) if isinstance(message, str) else {}
                topics |= {channel["topic"] for channel in told.get("channels", ())}
        live.send_signal(signal.SIGINT)
        assert finished(live)[-1].startswith("messages: ")  # and no traceback


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.py")), ids=lambda file: file.stem)
def test_an_example_needs_zenoh_and_msgpack_alone(file: Path) -> None:
    tree = ast.walk(ast.parse(file.read_text()))
    modules = {one.name for node in tree if isinstance(node, ast.Import) for one in node.names}
    assert "from " not in file.read_text().partition("def main")[0].partition('"""\n\n')[2]
    standard = {"argparse", "contextlib", "csv", "queue", "sys", "threading", "time", "uuid"}
    assert modules <= standard | {"msgpack", "zenoh", "matplotlib.pyplot"}


def test_a_viewer_of_a_secured_swarm_reads_states_with_its_certificate(tmp_path: Path) -> None:
    with contextlib.ExitStack() as left:
        swarm = SecuredSwarm(tmp_path / "robots", left).start()
        file = tmp_path / "secured.json5"
        identity = swarm.keys.folder_of("class")
        words = ("--swarm", swarm.name, "--identity", str(identity))
        done = swarmctl("zenoh", *words, "--out", str(file))
        assert done.code == 0, done
        found = json.loads(file.read_text())
        assert all(one.startswith("tls/") for one in found["connect"]["endpoints"])
        with program("print_states", file, swarm.name, "--count", 2, cwd=tmp_path) as states:
            *lines, last = finished(states)
        assert sorted(line.split()[:2] for line in lines) == [[r, "idle"] for r in sorted(RUNNING)]
        assert last == "changes: 2, of 2 robots"
        _check_what_a_hostile_viewer_reads(swarm, found, tmp_path)


def _note(keys: set[str], sample: zenoh.Sample) -> None:
    keys.add(str(sample.key_expr))


def _check_what_a_hostile_viewer_reads(
    swarm: SecuredSwarm, found: dict[str, Any], folder: Path
) -> None:
    """A viewer that drops its own access rules reads `state`, asks as itself, and sends nothing."""
    del found["access_control"]
    (folder / "hostile.json5").write_text(json.dumps(found))
    heard, queries = dict[str, set[str]](), list[str]()
    with (
        zenoh.open(zenoh.Config.from_file(str(folder / "hostile.json5"))) as session,
        swarm.operator() as anna,
    ):
        for wanted in ("**", f"swarm/{swarm.name}/**", f"swarm/{swarm.name}/*/state/*"):
            keys = heard.setdefault(wanted, set())
            session.declare_subscriber(wanted, partial(_note, keys))
        states = heard[f"swarm/{swarm.name}/*/state/*"]
        names = {"status", "decision"}
        wait_until(
            lambda: states >= {build(swarm.name, r, STATE, n) for r in RUNNING for n in names},
            "the viewer reads states and decisions",
        )
        planes = {key.split("/")[3] for keys in heard.values() for key in keys}
        assert planes == {STATE}
        answers = {
            name: [
                str(reply.ok.key_expr)
                for reply in session.get(
                    f"swarm/{swarm.name}/*/{name}",
                    target=zenoh.QueryTarget.ALL,
                    timeout=CAP if name == "control/members/class" else 1.0,
                )
                if reply.ok is not None
            ]
            for name in (
                "control/members/class",
                "control/members/anna",
                "control/audit/class",
                "control/run/class",
                "control/run/anna",
                "control/*/anna",
            )
        }
        assert len(answers.pop("control/members/class")) == len(RUNNING)
        assert not any(answers.values()), answers
        everything = f"swarm/{swarm.name}/**"
        session.declare_queryable(everything, lambda one: queries.append(str(one.key_expr)))
        told = list[bytes]()
        anna.watch("status", lambda robot, payload: told.append(payload))
        wait_until(lambda: anna.members().answered == set(RUNNING), "both robots answer")
        session.put(build(swarm.name, "r1", STATE, "status"), b"\x01\x80")
        count = len(told) + 2 * len(RUNNING)
        wait_until(lambda: len(told) >= count, "the operator hears both robots")
        assert b"\x01\x80" not in told
        assert not queries


def test_without_robots_the_configuration_is_an_error(swarm: Swarm) -> None:
    done = swarm.ctl_once("zenoh", "--timeout", "0.3s")
    assert (done.code, done.out) == (6, "")
    assert len(done.err.splitlines()) == 1
    assert swarm.name in done.err
