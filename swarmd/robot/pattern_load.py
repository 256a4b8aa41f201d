"""A load and a trial of a pattern, with the request behind them; `pattern_run.py` has the run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from msgspec import Struct

from swarmd.core.goal import Goal
from swarmd.core.host_messages import REQUEST_LAYER, Load, Loaded
from swarmd.core.values import Scalar
from swarmd.core.verbs import ParamRequest, ReloadRequest, ResumeRequest, RunRequest
from swarmd.robot.issue_time import IssueTime
from swarmd.robot.setup import RobotIdentity


class Wish(Struct, frozen=True):
    """When and by whom a run was requested. An earlier stop does not end the run.

    - A joined goal (run without a request) counts from the time at which the goal was set.
    - The run after a reload counts from the reload request.
    - A restart after a fault keeps the wish of the failed run.
    - The run of the setting `on_low_battery`, which replaces another run, keeps the time of that
      run: a stop that would have ended the replaced run ends this run, too.
    """

    issued: IssueTime
    by: str
    """the operator, the goal as text, or the low battery"""
    is_own: bool = False
    """the robot itself wants the run: its battery is low"""

    @property
    def at(self) -> float:
        """The earliest time at which the run may have been requested, in s on the own clock."""
        return self.issued.at


@dataclass(frozen=True, slots=True, eq=False)
class Loading:
    """A pattern that the host is loading; meanwhile the running pattern gets no steps.

    Times are in s on the own clock.
    """

    generation: int  # the number of the load
    pattern: str
    params: Mapping[str, Scalar | None]
    seconds: float | None  # the longest time of the run; None: no limit
    since: float  # the start of the load
    request: RunRequest | ReloadRequest | ResumeRequest | None  # answered once the pattern runs
    wish: Wish
    until: tuple[str, ...] = ()  # conditions; the first that holds ends the run
    goal: Goal | None = None  # the goal of the run
    start_at: float | None = None  # the run does not begin before this time
    loaded: Loaded | None = None  # the host's answer, kept until `start_at`
    is_restart: bool = False  # a failed pattern is loaded again
    speed: float | None = None  # the greatest speed of the run in m/s; None: that of the robot


class PendingParams(NamedTuple):
    """A parameter request without an answer of the pattern; `since`: s on the own clock."""

    request: ParamRequest
    since: float


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A present trial of new code for a reload request; `wish`: of the run that may follow."""

    generation: int
    since: float
    request: ReloadRequest
    wish: Wish


def load_command(
    identity: RobotIdentity,
    labels: Iterable[str],
    generation: int,
    pattern: str,
    params: Mapping[str, Scalar | None],
) -> Load:
    """The command that loads a pattern for a robot with `labels`; `params`: the strongest layer."""
    configured = identity.setup.parameters.layers(pattern, labels)
    layers = (*configured, (REQUEST_LAYER, dict(params)))
    seed = (identity.seed * 1_000_003 + generation) % 2**63
    return Load(generation, pattern, layers, identity.robot, identity.platform, seed)
