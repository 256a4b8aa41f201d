"""The evidence of a step: what a robot recorded meanwhile, its status, and findings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

from msgspec import Struct

from swarmd.core.events import (
    DriverInput,
    Input,
    LeaseInput,
    OdometryInput,
    ReadingsInput,
    RequestInput,
    ScanInput,
)
from swarmd.core.finding import Finding
from swarmd.core.messages import Status
from swarmd.core.values import Odometry, Platform, Scan, Twist
from swarmd.core.verbs import EstopRequest, StopRequest
from swarmd.operator.acceptance.verdict import Verdict

K = TypeVar("K", bound=Struct)
_HEIGHT = "height"  # the reading, in m above the floor


class TimedDecision(NamedTuple):
    """A decision of protection at `at` s on the robot's clock.

    `gap`: m from the outline to the nearest obstacle, NaN without one. `speed_share`: below 1 after
    a violated assumption.
    """

    at: float
    safe: Twist
    gap: float
    speed_share: float


@dataclass(frozen=True, slots=True)
class Samples:
    """The inputs and the decisions of a robot, in order. Times in s on the robot's clock.

    `wall`: the wall clock in s since 1970 at 0 s of the robot's clock.
    """

    inputs: Sequence[tuple[Input, float]] = ()
    decisions: Sequence[TimedDecision] = ()
    wall: float = 0.0

    @property
    def scans(self) -> list[tuple[float, Scan]]:
        """The arrival of each scan, with the scan."""
        return [(at, input.scan) for at, input in self.of(ScanInput)]

    @property
    def odometry(self) -> list[tuple[float, Odometry]]:
        """The arrival of each reading of odometry, with the reading; of valid readings."""
        readings = ((at, input.odometry) for at, input in self.of(OdometryInput))
        return [(at, odometry) for at, odometry in readings if odometry.is_valid]

    @property
    def heights(self) -> list[tuple[float, float]]:
        """The arrival of each reading of the height of a drone, with the height in m."""
        readings = ((at, input.readings) for at, input in self.of(ReadingsInput))
        return [(at, one[_HEIGHT]) for at, one in readings if _HEIGHT in one]

    @property
    def driver_states(self) -> list[DriverInput]:
        """The states of the base; the first is that at the begin of the recording."""
        return [input for _, input in self.of(DriverInput)]

    @property
    def stops(self) -> list[float]:
        """When a stop or an emergency stop of an operator arrived."""
        requests = self.of(RequestInput)
        return [at for at, one in requests if isinstance(one.request, StopRequest | EstopRequest)]

    @property
    def leases(self) -> list[float]:
        """When the operator of the run was heard."""
        return [at for at, lease in self.of(LeaseInput) if lease.age is not None]

    def of(self, kind: type[K]) -> Iterator[tuple[float, K]]:
        """The inputs of a kind, with their times."""
        return ((at, input) for input, at in self.inputs if isinstance(input, kind))


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the judge of a step gets.

    `status`: after the step; None if the robot did not answer. `earlier`: verdicts by step.
    `charges`: the batteries of other robots then, from 0 to 1 by name.
    """

    platform: Platform
    samples: Samples = Samples()
    status: Status | None = None
    findings: Sequence[Finding] = ()
    earlier: Mapping[str, Verdict] = field(default_factory=dict)
    charges: Mapping[str, float] = field(default_factory=dict)
