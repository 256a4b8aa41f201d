"""Stops on topics, as a node of each middleware sends them, and the daemon's side in a test."""

from __future__ import annotations

from typing import Any

from swarmd.core.messages import Code, Reply
from swarmd.driver_api.command_source import Answer, DriverCommand, command_source
from swarmd.testing.driver_contract import DriverHarness
from tests.support import ros2_types as dds

STOP, ESTOP, STATE = "swarmd/stop", "swarmd/estop", "swarmd/state"
Empty: Any = dds.empty("std_msgs::msg::dds_::Empty_")


def served(harness: DriverHarness) -> list[DriverCommand]:
    """The commands from now on; the answer to each names the verb."""
    commands: list[DriverCommand] = []

    def take(command: DriverCommand, answer: Answer) -> None:
        commands.append(command)
        answer(Reply(id="i", robot="r", code=Code.APPLIED, text=f"{command.verb} done"))

    source = command_source(harness.driver)
    assert source is not None
    source.serve(take)
    return commands
