"""The operator's side against light daemons: real sessions, real processes."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core import codec
from swarmd.core.messages import Code, Epoch, Presence, ResetRequest, RunRequest
from swarmd.network import operator as operator_module
from swarmd.network.datagram import Address, Beacon, Solicit, Stop, pack, tag_of, unpack
from swarmd.network.operator import Operator, StopVerb, operator_name
from swarmd.network.outcome import NO_TARGET, PARTIAL
from swarmd.network.settings import NetworkSettings
from swarmd.network.udp import UdpCarrier
from tests.support.fake_daemon import FakeSwarm
from tests.support.operator_threads import is_closing
from tests.support.processes import run_command, wait_until

Robots = Callable[..., FakeSwarm]


@pytest.fixture
def robots(settings: NetworkSettings) -> Iterator[Robots]:
    """Starts light daemons on a loop of their own; all are gone after the test."""
    made: list[FakeSwarm] = []

    def start(*names: str, **options: Any) -> FakeSwarm:
        swarm = FakeSwarm(settings, names, **options)
        made.append(swarm)
        return swarm

    yield start
    for swarm in made:
        swarm.close()


def test_members_come_with_their_own_status(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "b", "c")
    with Operator(settings) as operator:
        view = operator.members()
    assert view.alive == ("a", "b", "c")
    assert view.answered == {"a", "b", "c"}
    assert view.epochs(["b"]) == {"b": Epoch(instance=swarm["b"].instance, revision=0)}


def test_a_swarm_without_daemons_is_an_empty_view(settings: NetworkSettings) -> None:
    with Operator(settings) as operator:
        assert operator.members(timeout=0.2).members == {}
        assert operator.request(RunRequest, {}, pattern="x").exit_code == NO_TARGET
        outcome = operator.send_stop("stop", timeout=0.2)
    assert (outcome.exit_code, outcome.reached) == (NO_TARGET, 0)


def test_robots_that_join_are_dialled_by_an_operator_that_stays(
    settings: NetworkSettings, robots: Robots
) -> None:
    with Operator(settings) as operator:
        for number, name in enumerate("abc", 1):
            robots(name)
            assert len(operator.members().answered) == number


def test_those_that_left_or_failed_are_listed(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "polite", "rude")
    swarm.call(swarm["polite"].leave)
    swarm.call(swarm["rude"].vanish)
    swarm.until(lambda: swarm["a"].network.members["rude"].presence is Presence.FAILED)
    with Operator(settings) as operator:
        members = operator.members().members
    assert {name: member.presence for name, member in members.items()} == {
        "a": Presence.ALIVE,
        "polite": Presence.LEFT,
        "rude": Presence.FAILED,
    }


def test_a_request_reaches_its_targets_alone(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "b", "c")
    with Operator(settings, name="anna@laptop") as operator:
        targets = operator.members().epochs(["a", "b"])
        outcome = operator.request(RunRequest, targets, pattern="attraction")
    assert outcome.line == "2 targeted, 2 applied"
    [request] = swarm["a"].requests
    assert request == RunRequest(
        id=request.id, operator="anna@laptop", targets=targets, pattern="attraction"
    )
    assert swarm["b"].requests == [request]
    assert swarm["c"].requests == []


def test_a_request_waits_for_links_that_are_not_up_when_it_begins(
    settings: NetworkSettings, robots: Robots
) -> None:
    swarm = robots("a", "b", "c")
    with Operator(settings) as operator:
        view = operator.members(needs_status=False)
        targets = view.epochs(["a", "b"])
        outcome = operator.request(RunRequest, targets, pattern="x", least=20.0)
    assert view.missing == ()
    assert targets["a"] == swarm["a"].status().epoch
    assert outcome.line == "2 targeted, 2 applied"
    assert len(swarm["a"].requests) == 1
    assert swarm["c"].requests == []


def test_refusals_and_silence_are_named(settings: NetworkSettings, robots: Robots) -> None:
    robots("a")
    robots("b", answer=lambda request: Code.REFUSED)
    robots("c", answer=lambda request: None)
    with Operator(settings) as operator:
        targets = operator.members().epochs(["a", "b", "c"])
        outcome = operator.request(RunRequest, {**targets, "d": None}, pattern="x", timeout=0.5)
    assert outcome.line == "4 targeted, 1 applied, 1 refused (b), 2 no answer (c, d)"
    assert outcome.exit_code == PARTIAL


def test_a_request_is_repeated_to_robots_without_a_reply(
    settings: NetworkSettings, robots: Robots
) -> None:
    swarm = robots("a")
    deaf = robots("deaf", answer=lambda request: Code.APPLIED if count() > 2 else None)

    def count() -> int:
        return len(deaf["deaf"].requests)

    with Operator(settings) as operator:
        targets = operator.members().epochs(["a", "deaf"])
        outcome = operator.request(RunRequest, targets, pattern="x", timeout=20.0)
    assert outcome.line == "2 targeted, 2 applied"
    [request] = swarm["a"].requests
    assert deaf["deaf"].requests == [request] * 3


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_reaches_all_without_waiting_for_members(
    settings: NetworkSettings, robots: Robots, verb: StopVerb
) -> None:
    swarm = robots("a", "b", "c")
    with Operator(settings) as operator:
        outcome = operator.send_stop(verb, reason="test")
    assert outcome.line == "3 targeted, 3 applied"
    for name in "abc":
        heard = swarm[name].requests
        assert {(one.verb, one.targets) for one in heard} == {(verb, None)}
        assert len({one.id for one in heard}) == 1
        reason = "test" if verb == "estop" else ""
        assert all(one.reason == reason for one in heard if isinstance(one, Stop))


def test_a_stop_is_repeated_until_all_acked(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a")
    deaf = robots("deaf", answer=lambda request: Code.APPLIED if count() > 5 else None)

    def count() -> int:
        return len(deaf["deaf"].requests)

    with Operator(settings) as operator:
        outcome = operator.send_stop("stop", timeout=20.0)
    assert outcome.line == "2 targeted, 2 applied"
    assert count() > 5
    assert len({one.id for one in (*swarm["a"].requests, *deaf["deaf"].requests)}) == 1


def test_deaf_and_failed_robots_are_named_by_a_stop(
    settings: NetworkSettings, robots: Robots
) -> None:
    swarm = robots("a", "lost")
    robots("deaf", answer=lambda request: None)
    swarm.call(swarm["lost"].vanish)
    swarm.until(lambda: swarm["a"].network.members["lost"].presence is Presence.FAILED)
    with Operator(settings) as operator:
        outcome = operator.send_stop("estop", timeout=0.5)
    assert outcome.line == "3 targeted, 1 applied, 2 no answer (deaf, lost)"
    assert outcome.exit_code == PARTIAL


def test_a_stop_reaches_a_robot_that_joins_meanwhile(
    settings: NetworkSettings, robots: Robots
) -> None:
    robots("a")
    starting = threading.Thread(target=lambda: robots("late"))
    with Operator(settings, roster=["late"]) as operator:
        starting.start()
        outcome = operator.send_stop("estop", timeout=20.0)
        starting.join()
    assert outcome.line == "2 targeted, 2 applied"


def test_other_swarms_can_be_seen(settings: NetworkSettings, robots: Robots) -> None:
    robots("a")
    with Operator(replace(settings, swarm="another")) as operator:
        assert settings.swarm in operator.swarms()


def test_a_named_stop_is_for_named_robots(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "b")
    with Operator(settings) as operator:
        picked = operator.send_stop("stop", select=lambda known: [n for n in known if n == "b"])
        named = operator.send_stop("estop", select=lambda known: (), names=("b",))
    assert (picked.line, named.line) == ("1 targeted, 1 applied", "1 targeted, 1 applied")
    assert swarm["a"].requests == []
    scopes = {(one.verb, one.scope) for one in swarm["b"].requests if isinstance(one, Stop)}
    assert ("estop", "robots") in scopes


def test_until_all_goes_on_until_the_last_robot_has_acked(
    settings: NetworkSettings, robots: Robots
) -> None:
    robots("a")
    shown: list[tuple[str, ...]] = []
    starting: list[threading.Thread] = []

    def on_progress(missing: tuple[str, ...]) -> None:
        shown.append(missing)
        if not starting:
            starting.append(threading.Thread(target=lambda: robots("late")))
            starting[0].start()

    with Operator(settings, roster=["late"]) as operator:
        outcome = operator.send_stop("estop", until_all=True, timeout=0.1, on_progress=on_progress)
        starting[0].join()
    assert outcome.line == "2 targeted, 2 applied"
    assert shown[0] == ("late",)


def test_an_interrupt_of_until_all_gives_what_was_reached(
    settings: NetworkSettings, robots: Robots
) -> None:
    robots("a")

    def interrupt(missing: tuple[str, ...]) -> None:
        raise KeyboardInterrupt

    with Operator(settings, roster=["lost"]) as operator:
        outcome = operator.send_stop("estop", until_all=True, on_progress=interrupt)
    assert outcome.line == "2 targeted, 1 applied, 1 no answer (lost)"


class Hole:
    """A robot that is heard, and whose TCP port takes no connection: SYNs are dropped."""

    def __init__(self, settings: NetworkSettings, robot: str) -> None:
        self._robot = robot
        self._tag = tag_of(settings.profile, settings.swarm)
        self._server = socket.create_server(("127.0.0.1", 0), backlog=0)
        name = self._server.getsockname()
        self._fillers = [socket.socket() for _ in range(4)]
        for one in self._fillers:
            one.setblocking(False)
            one.connect_ex(name)
        self._carrier = UdpCarrier(settings, self._tag, port=name[1])
        self._carrier.start_thread(self._on_datagram)
        self._sequence = 0

    def _on_datagram(self, payload: bytes, source: tuple[str, int], by_group: bool) -> None:
        body = unpack(self._tag, payload)
        if not isinstance(body, Solicit):
            return
        self._sequence += 1
        beacon = Beacon(
            robot=self._robot,
            instance=b"hollow",
            sequence=self._sequence,
            wire=codec.VERSION,
            state=0,
            revision=0,
            echo=body.echo,
        )
        self._carrier.send_to(pack(self._tag, beacon), source)

    def close(self) -> None:
        self._carrier.close()
        for one in (self._server, *self._fillers):
            one.close()


def test_a_robot_that_takes_no_connection_changes_neither_the_answer_nor_the_exit_code(
    settings: NetworkSettings, robots: Robots, tmp_path: Path
) -> None:
    robots("a")
    with contextlib.closing(Hole(settings, "hole")):
        words = ("members", "--swarm", settings.swarm, "-o", "json")
        done = run_command("swarmctl", *words, cwd=tmp_path)
    assert done.returncode == PARTIAL
    answer = json.loads(done.stdout)
    assert answer["missing"] == ["hole"]
    contacts = {one["robot"]: one["contact"] for one in answer["members"]}
    assert contacts == {"a": "answered", "hole": "no answer"}
    assert done.stderr.startswith("view not complete: hole heard ")
    assert done.stderr.count("\n") == 1


class Stubborn:
    """A session whose end takes long, or fails."""

    def __init__(self, act: Callable[[], object]) -> None:
        self.close = act


def test_a_close_that_hangs_or_fails_holds_nobody_up(
    settings: NetworkSettings, robots: Robots
) -> None:
    robots("a")
    go_on = threading.Event()

    def fail() -> None:
        raise RuntimeError("close operation timed out!")

    with Operator(settings) as operator:
        assert operator.members().answered == {"a"}
        operator._sessions += [Stubborn(go_on.wait), Stubborn(fail)]  # type: ignore[list-item]
    assert is_closing()
    go_on.set()
    wait_until(lambda: not is_closing(), "all sessions are closed")


def test_an_operator_name_that_is_no_utf8_is_mended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOGNAME", "\udcff\udcfe" + "x" * 300)
    name = operator_name()
    assert name.startswith("??x")
    assert len(name.encode()) == 128


@pytest.mark.parametrize(
    ("reason", "kept"), [("ä" * 300, "ä" * 256), ("out\udcff of paint", "out? of paint")]
)
@pytest.mark.parametrize("verb", ["estop", "reset"])
def test_a_reason_that_cannot_be_sent_is_mended_and_never_refused(
    settings: NetworkSettings, robots: Robots, verb: str, reason: str, kept: str
) -> None:
    swarm = robots("a")
    with Operator(settings, name="\udcff" * 200) as operator:
        if verb == "reset":
            epochs = operator.members().epochs(["a"])
            outcome = operator.request(ResetRequest, epochs, reason=reason)
        else:
            outcome = operator.send_stop("estop", reason=reason)
    assert outcome.line == "1 targeted, 1 applied"
    request = swarm["a"].requests[-1]
    assert isinstance(request, Stop | ResetRequest)
    assert (request.operator, request.reason) == ("?" * 128, kept)


def test_an_endpoint_that_zenoh_refuses_ends_no_look(
    settings: NetworkSettings, robots: Robots, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One wrong endpoint among those dialled together costs no other robot its link."""
    robots("a", "b")
    first, endpoint = [True], operator_module._endpoint

    def spoil(address: Address) -> str:
        return "tcp/[a b/c#?]:1" if first and first.pop() else endpoint(address)

    monkeypatch.setattr(operator_module, "_endpoint", spoil)
    with Operator(settings) as operator:
        assert operator.members(timeout=20.0).answered == {"a", "b"}


@pytest.mark.parametrize(("where", "code"), [(">&-", 0), (">/dev/full", 1), ("2>&-", 0)])
def test_a_stop_that_was_applied_is_not_lost_with_stdout(
    settings: NetworkSettings, robots: Robots, tmp_path: Path, where: str, code: int
) -> None:
    robots("a")
    swarmctl = Path(sys.executable).with_name("swarmctl")
    done = subprocess.run(
        ["sh", "-c", f"{swarmctl} estop --swarm {settings.swarm} {where}"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, "1 targeted, 1 applied" in done.stderr + done.stdout) == (code, True)
    assert "Traceback" not in done.stderr


class Suspended:
    """A carrier on a machine that is suspended for 100 s after the first stop was sent."""

    def __init__(self, clock: list[float]) -> None:
        self._clock = clock
        self.ages: list[int] = []

    def send(self, payload: bytes) -> None:
        body = unpack(tag_of("dev", "x"), payload)
        if isinstance(body, Stop):
            self.ages.append(body.age)
            self._clock[0] += 100.0
            if len(self.ages) == 2:
                raise KeyboardInterrupt

    def send_to(self, payload: bytes, address: Address) -> None:
        raise AssertionError("no robot is known")

    def confirm(self, source: Address) -> None:
        """Nothing."""

    def start_thread(self, on_datagram: object) -> None:
        """Nothing arrives."""

    def close(self) -> None:
        """Nothing is open."""


def test_the_age_of_a_stop_counts_the_time_in_suspend(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(operator_module, "boottime", lambda: clock[0])
    carrier = Suspended(clock)
    with Operator(NetworkSettings(swarm="x"), carrier=carrier) as operator:
        operator.send_stop("estop", until_all=True)
    assert carrier.ages == [0, 100_000]
