"""Circle formation: the robots form a circle with equal spacing from any start.

Source: Sugihara and Suzuki (J. Robotic Systems 13(3), 1996) pose the task, with local sensing and
without positions or a leader. In Defago and Souissi (Theor. Comput. Sci. 396, 2008) a robot moves
between its two neighbours on the circle. Ours: each robot fits a regular polygon to all robots in
sight and itself, around their mean position. So the robots agree on circle and places at once, and
come to rest.

Limits: every robot must sense all others, so the circle must be narrower than the sensing range. By
lidar a pillar counts as a robot, and so does a robot that is switched off.
"""

from __future__ import annotations

from typing import Annotated

from swarmd.api import Array, FormationParams, FormationPattern, about, place_on_circle, radius_of


class CircleFormationParams(FormationParams, frozen=True, kw_only=True):
    """Those of every formation; `spacing` is the straight distance to the next robot."""

    radius: Annotated[
        float,
        about(
            "radius of the circle; 0: the radius that gives the robots in sight their spacing",
            ge=0.0,
            le=100.0,
            unit="m",
            source="ours",
        ),
    ] = 0.0


class CircleFormation(FormationPattern[CircleFormationParams]):
    """Forms a circle with equal spacing from the sensed positions of the others."""

    group = "formation"
    params_type = CircleFormationParams

    def place(self, others: Array) -> Array:
        """Its place (2,) on a circle with `others` (k, 2)."""
        radius = self.params.radius or radius_of(self.params.spacing, len(others) + 1)
        return place_on_circle(others, radius)
