"""What a robot needs of steering; the shells give it one (`swarmd/steering/steering.py`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Protocol, TypeAlias

from swarmd.core.messages import Reason
from swarmd.core.told import Told
from swarmd.core.values import Neighbor, Odometry, Platform, Scan, Twist
from swarmd.protection.decision import NO_PERMIT, Decision, DecisionContext, Permit

if TYPE_CHECKING:
    from swarmd.protection.protection import Protection


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

    It cannot weaken protection, which judges what is asked like any request.
    """

    must_track: bool
    """objects are tracked also without avoidance"""

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """Take in a conditioned scan."""

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading."""

    def decide(
        self,
        requested: Twist | None,
        context: DecisionContext,
        is_running: bool,
        hold: Reason | None,
        permit: Permit = NO_PERMIT,
    ) -> Decision:
        """The decision of protection on the request, or on what is asked in its place."""

    def tracks(self, context: DecisionContext) -> Iterable[MovingObject] | None:
        """The tracked objects; None while nothing is tracked."""


class NamesPeers(Protocol):
    """Names tracked objects, and gives the places of peers (`swarmd/kin/kin.py`)."""

    def on_odometry(self, odometry: Odometry, now: float) -> None:
        """Take in a new reading."""

    def observe(self, tracks: Iterable[MovingObject], scan: Scan, now: float) -> None:
        """Take in a scan and the tracks after it."""

    def tell(self, now: float, asks: bool) -> Told | None:
        """The message to peers that is due."""

    def hear(self, id: str, told: Told, now: float) -> None:
        """Take in the message of a peer."""

    def names(self, now: float) -> Mapping[int, str | None]:
        """The name of each track: that of a peer, "" for what is no robot, None: not known."""

    def complete(self, neighbors: tuple[Neighbor, ...], now: float) -> tuple[Neighbor, ...]:
        """The neighbors with what is not known of them otherwise."""


MakeKin: TypeAlias = "Callable[[float, int], NamesPeers]"
"""Makes what names peers; see `Kin`."""
MakeSteering: TypeAlias = "Callable[[Platform, Protection, str], Steers]"
"""Makes steering for a robot: its platform, its protection, and a seed for random choices."""
