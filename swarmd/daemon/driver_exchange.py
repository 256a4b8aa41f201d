"""Commands and opinions that a driver exchanges with the robot's own system, such as ROS."""

from __future__ import annotations

from collections.abc import Callable, Collection

from swarmd.core.clock import boottime
from swarmd.core.events import MessageInput
from swarmd.core.values import OPINION, Value
from swarmd.daemon.driver_commands import DriverCommands
from swarmd.daemon.foreign_opinions import ForeignOpinions
from swarmd.daemon.requests import RequestServer
from swarmd.driver_api.command_source import command_source
from swarmd.driver_api.driver import Driver
from swarmd.driver_api.opinion_link import opinion_link
from swarmd.network.carriers.inbound_queue import DropCounter
from swarmd.robot.robot import Robot
from swarmd.security.identity import Identity


class DriverExchange:
    """Connects the extensions of a driver for commands and for opinions; it may have neither."""

    def __init__(
        self,
        driver: Driver,
        robot: Robot,
        requests: RequestServer,
        *,
        identity: Callable[[], Identity | None],
        robots: Callable[[], Collection[str]],
        step: Callable[[MessageInput], None],
        on_event: Callable[[str], None],
        drops: DropCounter,
    ) -> None:
        """Take commands and hear opinions from now on.

        `identity`: returns the present identity, None in a swarm without keys. `robots`: returns
        the names of the robots of the swarm. `step` takes the heard opinions, `on_event` a line for
        the events. `drops` counts dropped opinions.
        """
        self._commands: DriverCommands | None = None
        self._opinions: ForeignOpinions | None = None
        if (source := command_source(driver)) is not None:
            self._commands = DriverCommands(robot, requests, identity)
            source.serve(self._commands.take)
        if (link := opinion_link(driver)) is not None:
            self._opinions = ForeignOpinions(
                link,
                lambda: robot.channel_named(OPINION),
                robots,
                step,
                on_event,
                is_secured=identity() is not None,
                drops=drops,
            )

    def on_tick(self) -> None:
        """Note the robot's present epoch, by which the age of a command is judged."""
        if self._commands is not None:
            self._commands.note_epoch(boottime())

    def on_sent(self, channel: str, value: Value) -> None:
        """Hand a message of the own pattern on, if it is an opinion."""
        if self._opinions is not None:
            self._opinions.on_sent(channel, value)
