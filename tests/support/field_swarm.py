"""Real daemons in profile field, each on a host of its own, and operators on laptops."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import yaml

from tests.support.field import BODIES, ROOT, Field
from tests.support.keys import SwarmKeys
from tests.support.processes import CAP, DaemonProcess, unique_swarm, wait_until
from tests.support.swarmctl import Finished, Running, ask_in_time

USERS = ("anna", "bob")
"""The operators of a secured swarm."""


class Lines:
    """A process that answers each line of its standard input with one of JSON."""

    def __init__(self, command: Sequence[str]) -> None:
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, cwd=ROOT)

    @property
    def pid(self) -> int:
        return self._process.pid

    def say(self, *words: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(" ".join(words) + "\n")
        self._process.stdin.flush()

    def hear(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, f"it ended with {self._process.wait(CAP)}"
        return json.loads(line)

    def ask(self, *words: str) -> Any:
        self.say(*words)
        return self.hear()

    def close(self) -> None:
        with self._process as process:
            process.communicate(timeout=CAP)


class FieldSwarm:
    """A swarm on a field, under a name of its own; a context manager.

    Every host of `field` that is in `robots` gets a daemon with a fake body; `swarmctl` runs on
    any host. `is_secured`: robots and operators (USERS) have keys. `network`: settings of all,
    `options` those of daemons alone; `is_forked` as of `DaemonProcess`.
    """

    def __init__(
        self,
        folder: Path,
        field: Field,
        robots: Sequence[str],
        options: dict[str, object] | None = None,
        *,
        network: dict[str, object] | None = None,
        is_secured: bool = False,
        is_forked: bool = True,
    ) -> None:
        self.name = unique_swarm()
        self.field = field
        self.robots = tuple(robots)
        self.daemons: dict[str, DaemonProcess] = {}
        self.folder = folder
        self._network: dict[str, Any] = {"profile": "field", "interface": "eth0", **(network or {})}
        self._options: dict[str, Any] = options or {}
        self._is_forked = is_forked
        self._lives = 0
        self._left = contextlib.ExitStack()
        self.keys = (
            SwarmKeys(folder / "keys", self.name, robots, operators=USERS) if is_secured else None
        )
        self.config = folder / "swarm.yaml"
        self.config.write_text(yaml.safe_dump({"swarm": self.name, **self._network}))

    def __enter__(self) -> Self:
        self._bodies = self.talk(
            "hub", "tests.support.bodies", "--swarm", self.name, "--address", BODIES, *self.robots
        )
        self._endpoints: dict[str, str] = self._bodies.hear()["endpoints"]
        return self

    def __exit__(self, *_: object) -> None:
        for daemon in self.daemons.values():  # all at once: each takes a while to end
            daemon.process.kill()
        self._left.close()

    def talk(self, host: str, module: str, *words: str) -> Lines:
        """A module that runs on a host."""
        made = Lines([*self.field.prefix(host), sys.executable, "-m", module, *words])
        self._left.callback(made.close)
        return made

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
                **self._network,
                **self._credentials(robot),
                "state_dir": str(self.folder / state),
                **self._options,
            },
            namespace=self.field.namespace(robot),
            environ=environ,
            is_forked=self._is_forked,
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
        self._bodies.ask("moving", *robots)

    def await_standing(self, *robots: str) -> None:
        """Return once each of these robots, or of all, has been commanded zero."""
        self._bodies.ask("standing", *robots)

    def moved(self) -> set[str]:
        """The robots that were commanded to move since the last call."""
        return {robot for robot, has_moved in self._bodies.ask("mark")["mark"].items() if has_moved}

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
        environ = {"SWARM_CONFIG": str(self.config), "LOGNAME": user, "HOME": str(home)}
        given = ["--insecure"]
        if self.keys is not None and not is_insecure:
            given = ["--identity", str(self.keys.folder_of(user))]
        return Running(*given, *words, environ=environ, namespace=self.field.namespace(host))

    def ctl(self, host: str, *words: str, user: str = "anna") -> Finished:
        """Asked again if a stall of the machine refused it."""
        return ask_in_time(lambda: self.begin(host, *words, user=user).finish())

    def members(self, host: str) -> dict[str, dict[str, Any]]:
        """The members that `swarmctl members` lists on a host, by name; {} if there are none."""
        answer = self.ctl(host, "members", "-o", "json").json
        return {} if answer is None else {one["robot"]: one for one in answer["members"]}

    def keepers(self, host: str, words: str) -> set[str]:
        """The robots whose files of the incident with these words a host lists."""
        listed = self.ctl(host, "incidents", "-o", "json").json or {"incidents": []}
        found = [one for one in listed["incidents"] if words in one["text"]]
        return {kept["robot"] for one in found for kept in one["kept"] if kept["size"]}

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
