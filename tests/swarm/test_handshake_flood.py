"""Floods of TLS handshakes, and of links with a certificate, at the port of a robot."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from swarmd.core.messages import State
from swarmd.core.verbs import ResetRequest, RunRequest
from swarmd.operator.session.outcome import Outcome
from tests.support.handshakes import KINDS
from tests.support.keys import SwarmKeys
from tests.support.processes import wait_until
from tests.support.secured_swarm import SecuredSwarm
from tests.support.swarmctl import await_applied

pytestmark = pytest.mark.integration

ROBOTS = ("r1", "r2")
FLOOD_TIME = 300.0  # s; it is ended when the test has seen enough
SPARE_FILES = 20  # that a daemon may have opened meanwhile, for a run and its log


class Flooded(SecuredSwarm):
    """A swarm whose robot `r1` is flooded with handshakes at its port."""

    def flood(self, kind: str, at_once: int, rate: float = 0.0) -> subprocess.Popen[bytes]:
        """Begin a flood; it is gone after the test."""
        foreign = SwarmKeys(self._folder / "foreign", self.name, ROBOTS, operators=["anna"])
        port = self.endpoint.rpartition(":")[2]
        words = [kind, port, at_once, FLOOD_TIME, foreign.folder_of("anna"), rate]
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.handshakes", *map(str, words)],
            stdout=subprocess.DEVNULL,
        )
        self._left.callback(process.wait)
        self._left.callback(process.kill)
        return process

    def states(self) -> dict[str, State]:
        """The states of the robots that answer a new operator over a link."""
        with self.operator() as anna:
            members = anna.members(timeout=5.0).members
        return {name: one.status.state for name, one in members.items() if one.status is not None}

    def files(self) -> int:
        """The files that `r1` has open."""
        return len(os.listdir(f"/proc/{self.daemons['r1'].process.pid}/fd"))


@pytest.fixture
def flooded(tmp_path: Path) -> Iterator[Flooded]:
    with contextlib.ExitStack() as left:
        made = Flooded(tmp_path, left, listens=True)
        made.start()
        yield made


def is_reset(flooded: Flooded) -> bool:
    """Reset all robots; False if a latch came from a peer meanwhile."""
    with flooded.operator() as anna:
        view = anna.members(timeout=20.0)
        ids = tuple(view.latches(ROBOTS))
        done = anna.request(ResetRequest, view.epochs(ROBOTS), ids=ids, timeout=20.0)
    return done.exit_code == 0


def run_and_stop(flooded: Flooded) -> None:
    """An operator without a link runs all robots, stops them, latches them and resets them."""
    with flooded.operator() as anna:

        def run() -> Outcome:
            view = anna.members(timeout=20.0)
            return anna.request(RunRequest, view.epochs(ROBOTS), pattern="drive", timeout=20.0)

        await_applied(run, "both run")
        for verb in ("stop", "estop"):
            assert anna.send_stop(verb).exit_code == 0
    wait_until(lambda: is_reset(flooded), "both are reset")


def check(flooded: Flooded, kind: str, at_once: int, rate: float = 0.0) -> None:
    before = flooded.files()
    flood = flooded.flood(kind, at_once, rate)
    log = flooded.daemons["r1"]
    wait_until(lambda: "connections wait at the port" in log.text(), "r1 notices the flood")
    wait_until(lambda: set(flooded.states()) == set(ROBOTS), "both answer in the flood")
    run_and_stop(flooded)
    assert flood.poll() is None
    wait_until(lambda: flooded.files() <= before + SPARE_FILES, "its files are closed again")
    flood.kill()
    flood.wait()
    wait_until(lambda: set(flooded.states()) == set(ROBOTS), "both answer after the flood")
    assert log.terminate() == 0


@pytest.mark.parametrize(("kind", "at_once", "rate"), [("abort", 8, 50.0), ("silent", 300, 0.0)])
def test_a_flood_of_handshakes_keeps_no_operator_out(
    flooded: Flooded, kind: str, at_once: int, rate: float
) -> None:
    check(flooded, kind, at_once, rate)


@pytest.mark.evidence
@pytest.mark.parametrize("kind", KINDS)
def test_a_great_flood_of_handshakes_keeps_no_operator_out(flooded: Flooded, kind: str) -> None:
    check(flooded, kind, 2000 if kind in ("silent", "half", "slow") else 100)


@pytest.mark.evidence
@pytest.mark.parametrize("name", ["class", "r2"])
def test_a_flood_of_links_of_one_certificate_keeps_no_operator_out(
    flooded: Flooded, name: str
) -> None:
    """1,000 links take all that Zenoh gives, from the host of the operator."""
    words = [flooded.keys.folder_of(name), flooded.endpoint, 1000, FLOOD_TIME]
    command = [sys.executable, "-m", "tests.support.link_flood", *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as flood:
        try:
            assert flood.stdout is not None
            assert flood.stdout.readline() == b"begun\n"
            log = flooded.daemons["r1"]
            wait_until(lambda: f"certificate of '{name}'" in log.text(), "r1 tells of it")
            wait_until(lambda: set(flooded.states()) == set(ROBOTS), "both answer in the flood")
            run_and_stop(flooded)
            assert flood.poll() is None
        finally:
            flood.kill()
    wait_until(lambda: set(flooded.states()) == set(ROBOTS), "both answer after the flood")
    assert log.terminate() == 0
