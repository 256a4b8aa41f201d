"""Real daemons in profile field, each on a host of its own, and operators on laptops."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import yaml

from tests.support.field import BODIES, ROOT, Field
from tests.support.keys import SwarmKeys
from tests.support.processes import CAP, DaemonProcess, unique_swarm, wait_until

USERS = ("anna", "bob")
"""The operators of a secured swarm."""
_SWARMCTL = (sys.executable, "-c", "from swarmd.cli.swarmctl import main; main()")


@dataclass(frozen=True, slots=True)
class Answer:
    """The exit code and output of a `swarmctl`, and the seconds from its start to its end."""

    code: int
    out: str
    err: str
    seconds: float

    @property
    def json(self) -> Any:
        """Its answer with `-o json`; None if it printed none."""
        try:
            return json.loads(self.out)
        except ValueError:
            return None


class Running:
    """A `swarmctl` that is under way."""

    def __init__(self, command: Sequence[str], environ: dict[str, str]) -> None:
        self._began = time.monotonic()
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONFAULTHANDLER": "1", **environ},
        )

    def finish(self, cap: float = CAP) -> Answer:
        """Its answer; a swarmctl that has not ended after `cap` s is aborted and shows where."""
        with self.process as process:
            try:
                out, err = process.communicate(timeout=cap)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGABRT)
                out, err = process.communicate()
            return Answer(process.returncode, out, err, time.monotonic() - self._began)


class FieldSwarm:
    """A swarm on a field, under a name of its own; a context manager.

    Every host of `field` that is in `robots` gets a daemon with a fake body; `swarmctl` runs on
    any host. `is_secured`: robots and operators (USERS) have keys.
    """

    def __init__(
        self,
        folder: Path,
        field: Field,
        robots: Sequence[str],
        options: dict[str, object] | None = None,
        *,
        is_secured: bool = False,
    ) -> None:
        self.name = unique_swarm()
        self.field = field
        self.robots = tuple(robots)
        self.daemons: dict[str, DaemonProcess] = {}
        self.folder = folder
        self._options = options or {}
        self._lives = 0
        self._left = contextlib.ExitStack()
        self.keys = (
            SwarmKeys(folder / "keys", self.name, robots, operators=USERS) if is_secured else None
        )
        network = {"swarm": self.name, "profile": "field", "interface": "eth0"}
        self._config = folder / "swarm.yaml"
        self._config.write_text(yaml.safe_dump(network))

    def __enter__(self) -> Self:
        self._bodies = self._left.enter_context(
            subprocess.Popen(
                [*self.field.prefix("hub"), sys.executable, "-m", "tests.swarm.bodies",
                 "--swarm", self.name, "--address", BODIES, *self.robots],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
            )
        )  # fmt: skip
        self._endpoints: dict[str, str] = self._hear()["endpoints"]
        return self

    def __exit__(self, *_: object) -> None:
        for daemon in self.daemons.values():  # all at once: each takes a while to end
            daemon.process.kill()
        assert self._bodies.stdin is not None
        self._bodies.stdin.close()
        self._left.close()

    # Robots

    def spawn(
        self, robot: str, state: str = "state", environ: Mapping[str, str] | None = None
    ) -> DaemonProcess:
        """A daemon that is starting; its lives share the state folder of this name."""
        self._lives += 1
        daemon = DaemonProcess(
            self.folder / f"life{self._lives}",
            swarm=self.name,
            robot=robot,
            endpoint=self._endpoints[robot],
            options={
                "profile": "field",
                "interface": "eth0",
                **self._credentials(robot),
                "state_dir": str(self.folder / state),
                **self._options,  # type: ignore[dict-item]
            },
            prefix=self.field.prefix(robot),
            environ=environ,
        )
        self.daemons[robot] = daemon
        return self._left.enter_context(daemon)

    def start(self, robots: Iterable[str] | None = None, state: str = "state") -> None:
        """Start daemons, all of them without names; return once they are ready."""
        names = self.robots if robots is None else robots
        for daemon in [self.spawn(robot, state) for robot in names]:
            daemon.wait_ready()

    def revive(self) -> None:
        """Thaw the daemons that are frozen and start those that have ended."""
        for daemon in self.daemons.values():
            if daemon.process.poll() is None:
                daemon.thaw()
        self.start([robot for robot in self.robots if not self.is_alive(robot)])

    def is_alive(self, robot: str) -> bool:
        """True if its daemon's process has not ended."""
        return self.daemons[robot].process.poll() is None

    # Bodies

    def await_moving(self, *robots: str) -> None:
        """Return once each of these robots, or of all, has been commanded to move."""
        self._ask("moving", *robots)

    def await_standing(self, *robots: str) -> None:
        """Return once each of these robots, or of all, has been commanded zero."""
        self._ask("standing", *robots)

    def moved(self) -> set[str]:
        """The robots that were commanded to move since the last call."""
        return {robot for robot, has_moved in self._ask("mark")["mark"].items() if has_moved}

    def _ask(self, *words: str) -> Any:
        assert self._bodies.stdin is not None
        self._bodies.stdin.write(" ".join(words) + "\n")
        self._bodies.stdin.flush()
        return self._hear()

    def _hear(self) -> Any:
        assert self._bodies.stdout is not None
        line = self._bodies.stdout.readline()
        assert line, f"the bodies ended with {self._bodies.wait(CAP)}"
        return json.loads(line)

    # Operators

    def _credentials(self, name: str) -> dict[str, Any]:
        """The settings of a daemon with this name, or of this operator."""
        if self.keys is None:
            return {"insecure": True}
        return {"identity": str(self.keys.folder_of(name))}

    def begin(
        self, host: str, *words: str, user: str = "anna", is_insecure: bool = False
    ) -> Running:
        home = self.folder / host
        home.mkdir(exist_ok=True)
        environ = {"SWARM_CONFIG": str(self._config), "LOGNAME": user, "HOME": str(home)}
        given = ["--insecure"]
        if self.keys is not None and not is_insecure:
            given = ["--identity", str(self.keys.folder_of(user))]
        return Running([*self.field.prefix(host), *_SWARMCTL, *given, *words], environ)

    def ctl(self, host: str, *words: str, user: str = "anna") -> Answer:
        return self.begin(host, *words, user=user).finish()

    def members(self, host: str) -> dict[str, dict[str, Any]]:
        """The members that `swarmctl members` lists on a host, by name; {} if there are none."""
        answer = self.ctl(host, "members", "-o", "json").json
        return {} if answer is None else {one["robot"]: one for one in answer["members"]}

    def states(self, host: str) -> dict[str, str]:
        """The states of the robots that tell theirs to a host, such as `running`."""
        return {
            robot: member["status"]["state"]
            for robot, member in self.members(host).items()
            if member["presence"] == "alive" and member["status"] is not None
        }

    def await_states(self, host: str, state: str, robots: Iterable[str] = ()) -> None:
        """Return once these robots, or all, tell a host that they are in this state."""
        wanted = dict.fromkeys(robots or self.robots, state)
        seen: dict[str, str] = {}

        def look() -> bool:
            seen.update(self.states(host))
            return wanted.items() <= seen.items()

        try:
            wait_until(look, f"all of them {state}")
        except AssertionError as error:
            raise AssertionError(f"{error}; {host} sees {seen}") from None
