"""Where a peer is, seen from the own robot, by the poses of both in one shared frame. Pure."""

from __future__ import annotations

import math

from msgspec import structs

from swarmd.core.angles import wrap
from swarmd.core.values import Neighbor, PeerPlace, SharedPose

PLACE_TIMEOUT = 1.0  # s after which the place of a peer, or the own pose, is too old


def located(
    neighbor: Neighbor, own: SharedPose, own_age: float, place: PeerPlace, place_age: float
) -> Neighbor:
    """The neighbor with each field that is not measured taken from `place`.

    A field that the base measures stays. Ages in s; the older of both poses gives the age of the
    result. The neighbor is returned unchanged if a pose is older than PLACE_TIMEOUT, or if the
    frames differ. `error` in m bounds the error of the place, apart from motion within its age.
    """
    age = max(own_age, place_age, 0.0)
    if age > PLACE_TIMEOUT or place.frame != own.frame:
        return neighbor
    dx, dy = place.x - own.pose.x, place.y - own.pose.y  # m in the shared frame, from own to peer
    distance = math.hypot(dx, dy)
    heading = neighbor.heading
    if heading is None and place.heading is not None:
        heading = wrap(place.heading - own.pose.yaw)
    bearing = neighbor.bearing
    if bearing is None:
        bearing = wrap(math.atan2(dy, dx) - own.pose.yaw)
    if neighbor.distance is not None:
        return structs.replace(neighbor, bearing=bearing, heading=heading)
    error = own.error + place.error + own.yaw_error * distance
    return Neighbor(neighbor.id, age, distance, bearing, heading, neighbor.in_reach, error)
