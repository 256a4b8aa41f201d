"""A swarm of real daemons on loopback, its operators, and a session that only looks."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import pytest

from swarmd.core.codec import Decoder
from swarmd.core.keys import ANYONE, CONTROL, build
from swarmd.core.messages import PeerView, Presence, State, Status
from swarmd.core.values import Value
from swarmd.link.carriers.session import MAX_WIRE
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.settings.settings import load_platform
from tests.support.fake_body import Body, resting_body
from tests.support.processes import DAEMON, DaemonProcess, attempts, unique_swarm, wait_until
from tests.support.swarmctl import STALLED, Finished, Running, swarmctl, swarmctl_in_time
from tests.support.viewer import Viewer

T = TypeVar("T", bound=msgspec.Struct)


class Swarm:
    """Daemons under one swarm name; all of them, bodies and sessions are gone after `close`."""

    def __init__(self, folder: Path) -> None:
        self.name = unique_swarm()
        self.folder = folder
        self.home = folder / "home"
        self._left = contextlib.ExitStack()
        self._lives = 0
        self._viewer: Viewer | None = None
        self._operator: Operator | None = None

    def close(self) -> None:
        self._left.close()

    # Start

    def body(self, robot: str, rate: float | None = None) -> Body:
        body = Body(load_platform("waffle_pi"), swarm=self.name, robot=robot, rate=rate)
        return self._left.enter_context(body)

    def resting(self, robot: str) -> Body:
        """The body of a robot that is to be stopped and not to move."""
        return self._left.enter_context(resting_body(self.name, robot))

    def spawn(
        self,
        robot: str,
        body: Body | None = None,
        options: Mapping[str, Value] | None = None,
        prefix: Sequence[str] = (),
        module: Sequence[str] = DAEMON,
    ) -> DaemonProcess:
        """A daemon that is starting; without a body its driver does not connect.

        All lives of one robot share its state, each has a log of its own.
        """
        self._lives += 1
        daemon = DaemonProcess(
            self.folder / f"life{self._lives}",
            swarm=self.name,
            robot=robot,
            endpoint="tcp/127.0.0.1:9" if body is None else body.endpoint,
            options={"state_dir": str(self.folder / "state"), **(options or {})},
            prefix=prefix,
            module=module,
        )
        return self._left.enter_context(daemon)

    def start(
        self,
        robot: str,
        body: Body | None = None,
        options: Mapping[str, Value] | None = None,
        prefix: Sequence[str] = (),
    ) -> DaemonProcess:
        return self.spawn(robot, body, options, prefix).wait_ready()

    @property
    def settings(self) -> NetworkSettings:
        return NetworkSettings(swarm=self.name)

    @property
    def viewer(self) -> Viewer:
        """A visitor that is neither a robot nor an operator."""
        if self._viewer is None:
            self._viewer = self._left.enter_context(Viewer(self.settings))
        return self._viewer

    @property
    def operator(self) -> Operator:
        if self._operator is None:
            self._operator = self._left.enter_context(Operator(self.settings, name="zoe@test"))
        return self._operator

    # Operate

    def environ(self, user: str = "anna") -> dict[str, str]:
        """What the environment of a `swarmctl` of this user has besides that of the test."""
        homes = {"HOME": str(self.home), "XDG_CACHE_HOME": str(self.home / ".cache")}
        return {"LOGNAME": user, "SWARM": self.name, **homes}

    def begin(self, *words: str, user: str = "anna") -> Running:
        """A `swarmctl` by this user in a process of its own, under way."""
        return self._left.enter_context(Running(*words, environ=self.environ(user)))

    def begin_until(
        self, condition: Callable[[], bool], what: str, *words: str, user: str = "anna"
    ) -> Running:
        """`begin`, once the condition holds; begun again if a stall of the machine ended it."""
        for _ in attempts(what):
            process = self.begin(*words, user=user)
            if process.goes_on_until(condition, what):
                break
            done = process.finish()
            assert STALLED.search(done.err), done
            if condition():  # the next one, not the one that has ended, is to bring it about
                self.ctl("stop")
        return process

    def ctl(self, *words: str, user: str = "anna") -> Finished:
        """A `swarmctl` in this process; asked again if the machine was too busy to answer it."""
        return swarmctl_in_time(*words, environ=self.environ(user))

    def ctl_once(self, *words: str, user: str = "anna") -> Finished:
        """A `swarmctl` in this process, whose failure is the answer."""
        return swarmctl(*words, environ=self.environ(user))

    def audit(self, *robots: str) -> list[dict[str, Any]]:
        """The entries of robots, or of all, once each has answered and no disk lacks any."""
        found: dict[str, Any] = {}

        def look() -> bool:
            found.update(self.ctl("audit", *robots, "-o", "json").json or {})
            return (found.get("faults"), found.get("missing")) == ({}, [])

        wait_until(look, "all audit logs are read")
        entries: list[dict[str, Any]] = found["entries"]
        return entries

    def run_drive(self, *robots: str) -> None:
        done = self.ctl("run", "drive", *robots)
        assert done.code == 0, done

    # Look

    def look(self, robot: str, plane: str, name: str, kind: type[T]) -> list[T]:
        """The answers of every daemon with this id on a key; changes nothing."""
        decode = Decoder(kind, MAX_WIRE)
        asker = ANYONE if plane == CONTROL else ""
        answers = self.viewer.get(build(self.name, robot, plane, name, asker))
        return [decode(answer.payload.to_bytes()) for answer in answers]

    def statuses(self, robot: str) -> list[Status]:
        return self.look(robot, "state", "status", Status)

    def status(self, robot: str) -> Status:
        """The robot's status; waits until it answers."""
        return self.await_status(robot, "there", lambda status: True)

    def presences(self, peer: str) -> dict[str, Presence]:
        """The presence of the others in the view of `peer`."""
        views = self.look(peer, CONTROL, "members", PeerView)
        return {member.robot: member.presence for view in views for member in view.members}

    def await_presence(self, peer: str, robot: str, presence: Presence) -> float:
        """Wait until `peer` lists the robot so; the seconds it took."""
        began = time.monotonic()
        wait_until(
            lambda: self.presences(peer).get(robot) is presence,
            f"{peer} lists {robot} as {presence}",
        )
        return time.monotonic() - began

    def await_status(self, robot: str, what: str, holds: Callable[[Status], bool]) -> Status:
        """The first status of the robot, whichever daemon's it is, for which `holds` is true."""
        found: list[Status] = []

        def look() -> bool:
            found[:] = [status for status in self.statuses(robot) if holds(status)]
            return bool(found)

        wait_until(look, f"{robot} is {what}")
        return found[0]

    def await_state(self, robot: str, state: State) -> Status:
        return self.await_status(robot, state, lambda status: status.state is state)

    def are(self, state: State, *robots: str) -> bool:
        """True if each of the robots is in the state now."""
        return all(self.status(robot).state is state for robot in robots)


@pytest.fixture
def swarm(tmp_path: Path) -> Iterator[Swarm]:
    """A swarm without robots yet, under a name of its own."""
    with contextlib.closing(Swarm(tmp_path)) as made:
        yield made


@pytest.fixture(scope="module")
def shared_swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Swarm]:
    """A swarm for all tests of a module."""
    with contextlib.closing(Swarm(tmp_path_factory.mktemp("swarm"))) as made:
        yield made
