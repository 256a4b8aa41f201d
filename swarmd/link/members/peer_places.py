"""The datagrams that carry robots' positions in a shared frame. Pure."""

from __future__ import annotations

import math

from swarmd.core.arrival_delay import ArrivalDelay
from swarmd.core.values import PeerPlace, SharedPose
from swarmd.link.datagram import Place

PLACE_PERIOD = 0.1  # s between datagrams of the own place, at least
FASTEST_DATAGRAM = 0.02  # s: bound of the delay of the fastest datagram, which no clock can show
MAX_SENDERS = 1024
_JITTER = 0.01  # s by which a tick may be early


class PeerPlaces:
    """The places that `robot`, in the life `instance` of its daemon, sends and receives."""

    def __init__(self, robot: str, instance: bytes) -> None:
        self._robot = robot
        self._instance = instance
        self._due_at = -math.inf
        self._delays: dict[str, tuple[bytes, ArrivalDelay]] = {}

    def place(self, pose: SharedPose, age: float, now: float) -> Place | None:
        """The datagram of the own pose, measured `age` s ago; None if it is not due yet."""
        if now < self._due_at:
            return None
        self._due_at = now + PLACE_PERIOD - _JITTER
        return Place(
            robot=self._robot,
            instance=self._instance,
            sent=max(round(1000.0 * now), 0),
            age=math.ceil(1000.0 * max(age, 0.0)),
            frame=pose.frame,
            x=round(1000.0 * pose.pose.x),
            y=round(1000.0 * pose.pose.y),
            error=math.ceil(1000.0 * pose.error) + 1,  # mm; 1 mm covers the rounding of x and y
            heading=round(1000.0 * math.remainder(pose.pose.yaw, math.tau)),
        )

    def take(self, place: Place, now: float) -> PeerPlace | None:
        """The place of a peer with its age at `now`; None while its delay is not known."""
        instance, delay = self._delays.get(place.robot, (b"", ArrivalDelay()))
        if instance != place.instance:
            delay = ArrivalDelay()
            self._delays.pop(place.robot, None)
            while len(self._delays) >= MAX_SENDERS:
                del self._delays[next(iter(self._delays))]
            self._delays[place.robot] = place.instance, delay
        delay_s = delay.take(place.sent / 1000.0, now)  # beyond the fastest datagram
        if delay_s is None:
            return None
        x = place.x / 1000.0
        y = place.y / 1000.0
        error = place.error / 1000.0
        age = place.age / 1000.0 + delay_s + FASTEST_DATAGRAM
        heading = None if place.heading is None else place.heading / 1000.0
        return PeerPlace(place.robot, place.frame, x, y, error, age, heading)
