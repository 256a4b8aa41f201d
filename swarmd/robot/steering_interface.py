"""What a robot needs of steering; the shells give it one (`swarmd/robot/steering/steering.py`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Set
from typing import TYPE_CHECKING, Protocol, TypeAlias

from swarmd.core.kin_message import KinMessage, KinOpinions
from swarmd.core.messages import Reason
from swarmd.core.values import Neighbor, Odometry, Platform, Scan, Twist
from swarmd.robot.protection.decision import (
    NO_PERMIT,
    DecisionContext,
    Permit,
    Steered,
)

if TYPE_CHECKING:
    from swarmd.robot.protection.protection import ProtectionView


class MovingObject(Protocol):
    """A tracked object: place (m), velocity (m/s) and radius (m) in the frame of the robot."""

    id: int
    x: float
    y: float
    vx: float
    vy: float
    radius: float


class Steers(Protocol):
    """Asks protection for another command where the request leads nowhere.

    The robot hands what is asked to protection, which judges it like any request. So steering
    cannot weaken protection. The robot stands while `steer` raises an error, or gives anything else
    than a `Steered` with a finite command.
    """

    must_track: bool
    """objects are tracked also without avoidance"""

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """Take in a conditioned scan."""

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading."""

    def steer(
        self,
        requested: Twist | None,
        context: DecisionContext,
        is_running: bool,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
    ) -> Steered | None:
        """What is asked of protection in place of the request; None: the request itself."""

    def tracks(self, context: DecisionContext) -> Iterable[MovingObject] | None:
        """The tracked objects; None while nothing is tracked."""


class NamesPeers(Protocol):
    """Names tracked objects, and gives the places of peers (`swarmd/robot/kin/kin.py`)."""

    def on_odometry(self, odometry: Odometry, now: float) -> None:
        """Take in a new reading."""

    def observe(self, tracks: Iterable[MovingObject], scan: Scan, now: float) -> None:
        """Take in a scan and the tracks after it."""

    def next_message(self, now: float, asks: bool, stands: bool) -> KinMessage | None:
        """The message to peers that is due."""

    def opinions(self, missed_by: Set[str], now: float) -> KinOpinions | None:
        """What this robot and its peers tell of faults of peers; None: nothing is told.

        `missed_by`: the peers whose lidar may miss this robot.
        """

    def on_message(self, id: str, message: KinMessage, now: float) -> None:
        """Take in the message of a peer."""

    def names(self, now: float) -> Mapping[int, str | None]:
        """The name of each track: that of a peer, "" for what is no robot, None: not known."""

    def complete(self, neighbors: tuple[Neighbor, ...], now: float) -> tuple[Neighbor, ...]:
        """The neighbors with what is not known of them otherwise."""


MakeKin: TypeAlias = "Callable[[float, int, bool, float], NamesPeers]"
"""Makes what names peers; see `Kin`."""
MakeSteering: TypeAlias = "Callable[[Platform, ProtectionView, str], Steers]"
"""Makes steering for a robot: its platform, a view of its protection, and a seed."""
