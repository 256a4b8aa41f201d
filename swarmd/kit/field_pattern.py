"""The base of patterns with a parameter `law`: a pattern's own law, or that of a paper.

With law "paper" the robot follows a potential field over all returns of the lidar (Kaiser et al.,
ICRA 2022, and its code ROS2swarm). The robot then always drives at full speed, so it never rests.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, TypeVar

from swarmd.core.values import ZERO, Inputs, Scalar, Scan, Twist
from swarmd.kit.behavior import MovementPattern
from swarmd.kit.params import Params, Recovery, TopSpeed, TopTurn, about
from swarmd.robot.sensing.potential_field import FieldKind, field_twist, potential_field

Bias = Annotated[float, about("law paper: forward bias", ge=-100.0, le=100.0, source="ROS2swarm")]
TurnIfAlone = Annotated[
    float,
    about("law paper: turn rate if alone", ge=-4.0, le=4.0, unit="rad/s", source="ROS2swarm 1.0"),
]


class FieldParams(Params, frozen=True, kw_only=True):
    """The law, the speeds, and the parameters of law "paper"."""

    law: Annotated[
        Literal["settling", "paper"],
        about(
            "settling: comes to rest; paper: the original equations",
            source="ours: the original drives at full speed forever",
        ),
    ] = "settling"
    speed: TopSpeed
    turn: TopTurn
    paper_range: Annotated[
        float,
        about(
            "law paper: reach of the field",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ROS2swarm: the range of the lidar",
            derived=lambda platform: platform.scan.range_max,
        ),
    ]
    bias: Bias = 1.0
    rays: Annotated[
        int,
        about(
            "law paper: alone if at most so many rays return", ge=0, le=10000, source="ROS2swarm"
        ),
    ] = 1
    linear_if_alone: Annotated[
        float,
        about("law paper: speed if alone", ge=-2.0, le=2.0, unit="m/s", source="ROS2swarm 1.0"),
    ] = 0.0
    angular_if_alone: TurnIfAlone = 0.0
    recovery: Recovery = False


F = TypeVar("F", bound=FieldParams)


class FieldPattern(MovementPattern[F]):
    """Follows a potential field with law "paper"; with law "settling", `settle` gives the command.

    The report is "paper", or with law "settling" the attribute `state`, which the subclass sets.
    """

    field_kind: ClassVar[FieldKind]
    state: str
    _followed: tuple[Scan, F, Twist] | None = None  # the command of law "paper" for a scan

    @abstractmethod
    def settle(self, inputs: Inputs, scan: Scan) -> Twist:
        """The command of law "settling"."""

    def report(self) -> Mapping[str, Scalar]:
        """Its state."""
        return {"state": "paper" if self.params.law == "paper" else self.state}

    def drive(self, inputs: Inputs) -> Twist:
        """The command from the latest scan."""
        scan = inputs.scan
        params = self.params
        if scan is None:
            return ZERO
        if params.law != "paper":
            return self.settle(inputs, scan)
        followed = self._followed
        if followed is None or followed[0] is not scan or followed[1] is not params:
            followed = self._followed = scan, params, self._follow_field(scan)
        return followed[2]

    def _follow_field(self, scan: Scan) -> Twist:
        params = self.params
        field = potential_field(
            scan.ranges,
            scan.bearings,
            range_max=params.paper_range,
            range_min=scan.range_min,
            bias=params.bias,
            ray_threshold=params.rays,
            kind=self.field_kind,
            ignore_near=True,
        )
        if field.is_alone:
            return Twist(linear=params.linear_if_alone, angular=params.angular_if_alone)
        return field_twist(field.vector, params.speed, params.turn)
