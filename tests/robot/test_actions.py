"""The one command of an event for the pattern host."""

from __future__ import annotations

import pytest

from swarmd.core.host_messages import HostCommand, KillHost, Load, SetParams, Step
from swarmd.core.values import Inputs
from swarmd.robot.effects import Effects
from swarmd.settings.settings import load_platform

LOAD = Load(1, "drive", (), "tb3-01", load_platform("burger"), 1)
FRESH = Load(1, "drive", (), "tb3-01", LOAD.platform, 1, is_fresh=True)
KILL, SET_PARAMS = KillHost(), SetParams(1, "r1", {})
STEP = Step(1, Inputs(now=0.0, dt=0.0))


@pytest.mark.parametrize(
    ("commands", "chosen"),
    [
        ((LOAD, KILL), KILL),
        ((KILL, LOAD), FRESH),
        ((SET_PARAMS, KILL), KILL),
        ((KILL, SET_PARAMS), KILL),
        ((LOAD, STEP), LOAD),
        ((SET_PARAMS, STEP), SET_PARAMS),
        ((STEP,), STEP),
    ],
)
def test_host_gets_the_command_that_decides(
    commands: tuple[KillHost | Load | SetParams | Step, ...], chosen: HostCommand
) -> None:
    effects = Effects(0.0)
    for command in commands:
        effects.command_host(command)
    assert type(effects.host) is type(chosen)
    assert getattr(effects.host, "is_fresh", None) == getattr(chosen, "is_fresh", None)
