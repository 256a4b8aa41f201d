"""A daemon whose base a test holds, and the person who carries the acceptance test out on it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

import yaml

from tests.operator.acceptance.person import Person, person
from tests.support.processes import unique_swarm
from tests.support.swarmctl import Running


class DaemonRig:
    """A daemon of `robot` with `driver` and its options; all that it starts ends with `left`."""

    def __init__(
        self,
        folder: Path,
        left: ExitStack,
        robot: str,
        platform: str,
        driver: str,
        options: Mapping[str, object],
    ) -> None:
        self.swarm, self.robot, self._left = unique_swarm(), robot, left
        self.results, self.config = folder / "results", folder / "robot.yaml"
        settings = {
            "id": robot,
            "swarm": self.swarm,
            "platform": platform,
            "driver": driver,
            "driver_options": dict(options),
            "state_dir": str(folder / "state"),
        }
        self.config.write_text(yaml.safe_dump(settings))
        self.start()

    def start(self) -> None:
        words = ("--config", str(self.config))
        self.daemon = self._left.enter_context(Running(*words, program="swarmd"))

    def restart(self) -> None:
        self.daemon.terminate()
        self.daemon.wait(20.0)
        self.start()

    def kill(self) -> None:
        self.daemon.kill()
        self.daemon.wait(10.0)

    def asked(self, only: str) -> Person:
        """The person whom the test asks for these steps."""
        words = ("--only", only, "--folder", str(self.results))
        return self._left.enter_context(person(self.swarm, self.robot, *words))
