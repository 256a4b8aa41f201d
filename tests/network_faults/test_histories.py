"""Random histories of real daemons, of the same kinds as those of `tests/histories`.

The bodies show whether a robot moves after a stop that was counted (rule `stopped` of
`tests/histories/invariants.py`), and the statuses whether the robots agree ten seconds after all is
healed (rule `agreement`).
"""

from __future__ import annotations

import contextlib
import secrets
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.messages import State
from tests.histories.history import HistoryStep, draw, script
from tests.histories.invariants import HEAL_TIME
from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR
from tests.support.processes import wait_until

pytestmark = [pytest.mark.integration, pytest.mark.evidence]

ROBOTS = ("r1", "r2", "r3", "r4")
HISTORIES = range(20)
HOSTS = {"anna": FAR, "bob": NEAR}
COMMANDS = ("run", "stop", "estop", "reset", "resume", "undo")
OPTIONS = {"on_join": "--on-join", "valid": "--valid", "seconds": "--for", "ahead": "--at"}


class RealHistory:
    """Lets steps happen to a swarm of daemons, and watches the robots that have to stand.

    `standing`: since a stop of theirs was counted. `latched`: those that also need a reset.
    """

    def __init__(self, swarm: FieldSwarm) -> None:
        self._swarm = swarm
        self._folder = swarm.folder
        self._states = dict.fromkeys(swarm.robots, "state")
        self._old: Path | None = None
        self._frozen: set[str] = set()
        self.standing: set[str] = set()
        self.latched: set[str] = set()

    def carry_out(self, one: HistoryStep) -> None:
        """Wait, check which robots move, and let the step happen."""
        threading.Event().wait(one.gap)
        self.check_standing()
        if one.name in COMMANDS:
            self._command(one)
        elif one.name in ("kill", "leave", "freeze", "thaw", "start"):
            robot = one.args["robot"]
            if robot in self._swarm.robots:
                getattr(self, f"_{one.name}")(robot, **_without_robot(one.args))
        elif one.name in ("split", "cut", "disturb", "heal"):
            getattr(self, f"_{one.name}")(**one.args)

    def keep_disks(self) -> None:
        """Keep the present state folders for robots that restart with an old disk."""
        self._old = self._folder / _new_name("old")
        with contextlib.suppress(shutil.Error, FileNotFoundError):  # daemons write meanwhile
            shutil.copytree(self._folder / "state", self._old)

    def check_standing(self) -> None:
        """The rule `stopped`."""
        moved = self._swarm.moved() & self.standing
        assert not moved, f"{sorted(moved)} move after a stop that was counted"

    def end(self) -> None:
        """Heal all, start all, wait, and check rules 1 and 4."""
        swarm = self._swarm
        swarm.field.heal()
        swarm.field.clear()
        swarm.revive()
        threading.Event().wait(HEAL_TIME)
        self.check_standing()

        def agree() -> bool:
            members = swarm.members(NEAR)
            statuses = [one["status"] for one in members.values() if one["status"] is not None]
            return len(statuses) == len(swarm.robots) and _agree(statuses)

        wait_until(agree, "the robots agree", 2.0 * HEAL_TIME)

    def _command(self, one: HistoryStep) -> None:
        swarm, args = self._swarm, dict(one.args)
        host, user = HOSTS[args.pop("by")], "anna"
        targets = tuple(name for name in args.pop("targets", ()) if name in swarm.robots)
        if one.name == "run" and (unknown := {*args} - {"pattern", *OPTIONS}):
            for key in unknown:
                del args[key]
        words = [*_words(one.name, args, targets), "-o", "json"]
        if one.name in ("run", "resume", "undo"):
            self.standing = set(self.latched)
        elif one.name == "reset":
            self.latched -= set(targets or swarm.robots)
        answer = swarm.ctl(host, *words, user=user).json or {}
        if one.name in ("stop", "estop"):
            counted = set(answer.get("applied", ()))
            swarm.moved()
            self.standing |= counted
            self.latched |= counted if one.name == "estop" else set()

    def _kill(self, robot: str) -> None:
        if self._swarm.is_alive(robot):
            self._swarm.daemons[robot].kill()

    def _leave(self, robot: str) -> None:
        if self._swarm.is_alive(robot) and robot not in self._frozen:
            self._swarm.daemons[robot].process.terminate()
            self._swarm.daemons[robot].process.wait()

    def _freeze(self, robot: str) -> None:
        if self._swarm.is_alive(robot):
            self._frozen.add(robot)
            self._swarm.daemons[robot].freeze()

    def _thaw(self, robot: str) -> None:
        self._frozen.discard(robot)
        if self._swarm.is_alive(robot):
            self._swarm.daemons[robot].thaw()

    def _start(self, robot: str, disk: str = "kept", age: float = 0.0) -> None:
        """An old disk is that which `keep_disks` has kept."""
        self._thaw(robot)
        self._kill(robot)
        if disk != "kept":
            self.standing.discard(robot)
            self.latched.discard(robot)
            self._states[robot] = _new_name("state")
            if disk == "old" and self._old is not None:
                shutil.copytree(self._old, self._folder / self._states[robot])
        self._swarm.spawn(robot, self._states[robot])

    def _split(self, groups: tuple[tuple[str, ...], ...]) -> None:
        self._swarm.field.heal()
        parts = [_hosts(group) for group in groups]
        for number, part in enumerate(parts):
            for other in parts[number + 1 :]:
                self._swarm.field.set_between(part, other, is_cut=True)

    def _cut(self, senders: tuple[str, ...], receivers: tuple[str, ...]) -> None:
        for one in _hosts(senders):
            for other in _hosts(receivers):
                self._swarm.field.set(source=one, target=other, is_cut=True)

    def _heal(self) -> None:
        self._swarm.field.clear()

    def _disturb(self, loss: float = 0.0, delay: float = 0.0) -> None:
        self._swarm.field.set(loss=loss, delay=delay)


def _new_name(prefix: str) -> str:
    return f"{prefix}-{secrets.token_hex(4)}"


def _without_robot(args: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in args.items() if key != "robot"}


def _hosts(names: tuple[str, ...]) -> list[str]:
    return [HOSTS.get(name, name) for name in names if name in (*ROBOTS, *HOSTS)]


def _words(verb: str, args: dict[str, Any], targets: tuple[str, ...]) -> Iterator[str]:
    yield verb
    if verb == "run":
        yield "drive"
        for key, option in OPTIONS.items():
            if key in args:
                value = args[key]
                text = value if isinstance(value, str) else f"{value:g}s"
                yield from (option, f"+{text}" if key == "ahead" else text)
    if verb in ("run", "reset", "resume"):
        yield from targets or ("--all",)
        if verb == "reset":
            yield "--yes"
    elif verb != "undo":
        yield from targets


def _agree(statuses: list[dict[str, Any]]) -> bool:
    goals = {_held(one) for one in statuses}
    latches = {
        tuple(sorted(id for id, latch in one["latches"].items() if latch["scope"] == "swarm"))
        for one in statuses
    }
    is_state = all((one["state"] == State.ESTOPPED) == bool(one["latches"]) for one in statuses)
    return len(goals) == len(latches) == 1 and is_state


def _held(status: dict[str, Any]) -> str:
    goal = status["goal"]
    return "" if goal is None or goal["held"] is None else str(goal["held"]["digest"])


@pytest.mark.parametrize("seed", HISTORIES)
def test_a_history_of_real_daemons(swarm: FieldSwarm, seed: int) -> None:
    count, steps = draw(seed)
    history = RealHistory(swarm)
    try:
        for number, one in enumerate(steps):
            history.carry_out(one)
            if number == len(steps) // 3:
                history.keep_disks()
        history.end()
    except AssertionError as error:
        pytest.fail(f"{error}\n{script(count, steps, seed)}", pytrace=False)
