"""All that the author of a pattern imports."""

from __future__ import annotations

from typing import Annotated

from swarmd.angles import difference, wrap
from swarmd.errors import ConfigError, PluginError
from swarmd.kit.behavior import Context, Make, MovementPattern, Pattern
from swarmd.kit.combined import CombinedPattern
from swarmd.kit.formation import place_on_circle, place_on_line, radius_of
from swarmd.kit.forming import FormationParams, FormationPattern
from swarmd.kit.params import P, Params, TopSpeed, TopTurn, Unstick, about
from swarmd.kit.steering import from_base, keep_clear, steer
from swarmd.kit.votes import Ties, VoteWindow, majority, tally
from swarmd.kit.voting import Initial, Opinions, TieRule, VotingParams, VotingPattern, WindowLength
from swarmd.scans.fields import FieldKind, FieldResult, field_twist, potential_field
from swarmd.scans.rays import (
    Gap,
    Ray,
    RayClusters,
    closest_points,
    clusters,
    gaps,
    nearest,
    sectors,
)
from swarmd.values import (
    ZERO,
    Array,
    Inputs,
    Message,
    Neighbor,
    Odometry,
    Outputs,
    Platform,
    Pose,
    Scalar,
    Scan,
    TouchZone,
    Twist,
    Value,
)

__all__ = [
    "ZERO",
    "Annotated",
    "Array",
    "CombinedPattern",
    "ConfigError",
    "Context",
    "FieldKind",
    "FieldResult",
    "FormationParams",
    "FormationPattern",
    "Gap",
    "Initial",
    "Inputs",
    "Make",
    "Message",
    "MovementPattern",
    "Neighbor",
    "Odometry",
    "Opinions",
    "Outputs",
    "P",
    "Params",
    "Pattern",
    "Platform",
    "PluginError",
    "Pose",
    "Ray",
    "RayClusters",
    "Scalar",
    "Scan",
    "TieRule",
    "Ties",
    "TopSpeed",
    "TopTurn",
    "TouchZone",
    "Twist",
    "Unstick",
    "Value",
    "VoteWindow",
    "VotingParams",
    "VotingPattern",
    "WindowLength",
    "about",
    "closest_points",
    "clusters",
    "difference",
    "field_twist",
    "from_base",
    "gaps",
    "keep_clear",
    "majority",
    "nearest",
    "place_on_circle",
    "place_on_line",
    "potential_field",
    "radius_of",
    "sectors",
    "steer",
    "tally",
    "wrap",
]
