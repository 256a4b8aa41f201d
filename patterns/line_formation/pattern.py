"""Line formation: the robots form a straight line with equal spacing from any start.

Source: Yun, Alptekin and Albayrak, "Line and circle formation of distributed physical mobile
robots", J. Robotic Systems 14(2), 1997: each robot drives to the line that fits best, by least
squares, to all robots in sight. Sugihara and Suzuki (J. Robotic Systems 13(3), 1996) pose the task,
with local sensing and without positions or a leader. Ours: along the line each robot drives to its
place in the evenly spaced row that fits best, and comes to rest.

Limits: groups that do not see each other form separate lines. By lidar robots in a line hide each
other, a pillar counts as a robot, and so does a robot that is switched off.
"""

from __future__ import annotations

from swarmd.api import Array, FormationParams, FormationPattern, place_on_line


class LineFormationParams(FormationParams, frozen=True, kw_only=True):
    """Those of every formation; `spacing` is along the line."""


class LineFormation(FormationPattern[LineFormationParams]):
    """Forms a straight line with equal spacing from the sensed positions of the others."""

    group = "formation"
    params_type = LineFormationParams

    def place(self, others: Array) -> Array:
        """Its place (2,) in a line with `others` (k, 2)."""
        return place_on_line(others, self.params.spacing)
