"""Stops of light daemons: sent at once, repeated, counted."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from swarmd.core.messages import Code, Presence
from swarmd.link.datagram import Address, Stop, tag_of, unpack
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session import operator as operator_module
from swarmd.operator.session import senders as stop_sender
from swarmd.operator.session.exit_codes import PARTIAL
from swarmd.operator.session.operator import Operator, StopVerb
from tests.link.conftest import Robots


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


@pytest.mark.long
def test_deaf_and_failed_robots_are_named_by_a_stop(
    settings: NetworkSettings, robots: Robots
) -> None:
    swarm = robots("a", "lost")
    deaf = robots("deaf", answer=lambda request: None)["deaf"]
    swarm.call(swarm["lost"].vanish)
    swarm.until(lambda: swarm["a"].network.members["lost"].presence is Presence.FAILED)
    with Operator(settings) as operator:
        outcome = operator.send_stop(
            "estop",
            timeout=20.0,
            is_ended=lambda: len(deaf.requests) > 5,  # the others were sent as many
        )
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


def test_a_named_stop_is_for_named_robots(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "b")
    with Operator(settings) as operator:
        picked = operator.send_stop("stop", select=lambda known: [n for n in known if n == "b"])
        named = operator.send_stop("estop", select=lambda known: (), names=("b",))
    assert (picked.line, named.line) == ("1 targeted, 1 applied", "1 targeted, 1 applied")
    assert swarm["a"].requests == []
    scopes = {(one.verb, one.scope) for one in swarm["b"].requests if isinstance(one, Stop)}
    assert ("estop", "robots") in scopes


@pytest.mark.long
def test_until_all_goes_on_until_the_last_robot_has_acked(
    settings: NetworkSettings, robots: Robots
) -> None:
    robots("a")
    shown: list[tuple[str, ...]] = []
    starting: list[threading.Thread] = []

    def on_progress(missing: tuple[str, ...]) -> None:
        shown.append(missing)
        if missing == ("late",) and not starting:
            starting.append(threading.Thread(target=lambda: robots("late")))
            starting[0].start()

    with Operator(settings, roster=["late"]) as operator:
        outcome = operator.send_stop("estop", until_all=True, timeout=0.1, on_progress=on_progress)
        starting[0].join()
    assert outcome.line == "2 targeted, 2 applied"
    assert ("late",) in shown


@pytest.mark.long
def test_until_all_names_a_robot_that_moved_when_it_was_heard_last(
    settings: NetworkSettings, robots: Robots
) -> None:
    robots("a")["a"].is_moving = True
    shown: list[tuple[str, ...]] = []
    with Operator(settings) as operator:
        outcome = operator.send_stop(
            "estop",
            until_all=True,
            on_progress=shown.append,
            is_ended=lambda: bool(shown),
        )
    assert shown == [("a",)]
    assert outcome.failed == ("a",)


@pytest.mark.long
def test_an_interrupt_of_until_all_gives_what_was_reached(
    settings: NetworkSettings, robots: Robots
) -> None:
    robots("a")

    def interrupt(missing: tuple[str, ...]) -> None:
        if missing == ("lost",):
            raise KeyboardInterrupt

    with Operator(settings, roster=["lost"]) as operator:
        outcome = operator.send_stop("estop", until_all=True, on_progress=interrupt)
    assert outcome.line == "2 targeted, 1 applied, 1 no answer (lost)"


@pytest.mark.integration
@pytest.mark.parametrize(("where", "code"), [(">&-", 0), (">/dev/full", 1), ("2>&-", 0)])
def test_a_stop_that_was_applied_is_not_lost_with_stdout(
    settings: NetworkSettings, robots: Robots, tmp_path: Path, where: str, code: int
) -> None:
    robots("a")
    swarmctl = Path(sys.executable).with_name("swarmctl")
    done = subprocess.run(
        ["sh", "-c", f"{swarmctl} estop --swarm {settings.swarm} {where}"],
        cwd=tmp_path,
        env={name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, "1 targeted, 1 applied" in done.stderr + done.stdout) == (code, True)
    assert "Traceback" not in done.stderr


class Silent:
    """A carrier without robots. With each stop that is sent, `step` s pass.

    Raises `end` with the stop number `most`.
    """

    def __init__(self, clock: list[float], step: float, most: int, end: BaseException) -> None:
        self._clock = clock
        self._step = step
        self._most = most
        self._end = end
        self.ages: list[int] = []

    def send(self, payload: bytes) -> None:
        body = unpack(tag_of("dev", "x"), payload)
        if isinstance(body, Stop):
            self.ages.append(body.age)
            self._clock[0] += self._step
            if len(self.ages) == self._most:
                raise self._end

    def send_to(self, payload: bytes, address: Address) -> None:
        raise AssertionError("no robot is known")

    def confirm(self, source: Address) -> None:
        """Nothing."""

    def start_thread(self, on_datagram: object) -> None:
        """Nothing arrives."""

    def close(self) -> None:
        """Nothing is open."""


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time in s, which a `Silent` carrier moves."""
    now = [0.0]
    for module in (operator_module, stop_sender):
        monkeypatch.setattr(module, "boottime", lambda: now[0])
    return now


def test_the_age_of_a_stop_counts_the_time_in_suspend(clock: list[float]) -> None:
    carrier = Silent(clock, 100.0, most=2, end=KeyboardInterrupt())
    with Operator(NetworkSettings(swarm="x"), carrier=carrier) as operator:
        operator.send_stop("estop", until_all=True)
    assert carrier.ages == [0, 100_000]


def test_a_stop_of_robots_that_are_not_heard_ends_after_its_wait(clock: list[float]) -> None:
    carrier = Silent(clock, 1.0, most=30, end=AssertionError("the stop does not end"))
    with Operator(NetworkSettings(swarm="x"), carrier=carrier, roster=["a"]) as operator:
        outcome = operator.send_stop("stop")
    assert outcome.line == "1 targeted, 0 applied, 1 no answer (a)"
    assert carrier.ages == [0, 1000, 2000]  # STOP_WAIT is 3 s
