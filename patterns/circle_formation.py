"""Circle formation: the robots stand on a circle with equal spacing, wherever they are.

Source: the task, from local sensing and without positions or leader, is Sugihara and Suzuki's
(J. Robotic Systems 13(3), 1996); that a robot goes between its two neighbours on the circle is
Defago and Souissi's (Theor. Comput. Sci. 396, 2008). Ours: the regular polygon that fits best to
all that a robot sees and itself, around their mean position, so that the robots agree on circle
and places at once, and that they come to rest.

Limits: every robot must see all others, so the circle must be less wide than they sense. By lidar
a pillar counts as a robot, and so does a robot that stands there switched off.
"""

from __future__ import annotations

from typing import Annotated

from swarmd.api import (
    Array,
    FormationParams,
    FormationPattern,
    about,
    place_on_circle,
    radius_of,
)


class CircleFormationParams(FormationParams, frozen=True, kw_only=True):
    """Those of every formation; `spacing` is straight from one robot to the next."""

    radius: Annotated[
        float,
        about(
            "radius of the circle; 0: what gives the robots in sight their spacing",
            ge=0.0,
            le=100.0,
            unit="m",
            source="ours",
        ),
    ] = 0.0


class CircleFormation(FormationPattern[CircleFormationParams]):
    """Forms a circle with equal spacing, from what is sensed of the others."""

    params_type = CircleFormationParams

    def place(self, others: Array) -> Array:
        """Where (2,) it belongs on a circle with `others` (k, 2)."""
        radius = self.params.radius or radius_of(self.params.spacing, len(others) + 1)
        return place_on_circle(others, radius)
