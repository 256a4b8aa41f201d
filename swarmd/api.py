"""Everything that the author of a pattern imports."""

from __future__ import annotations

from typing import Annotated

from swarmd.core.angles import difference, wrap
from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.values import (
    ZERO,
    Array,
    Detection,
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
from swarmd.kit.behavior import Context, Make, MovementPattern, Pattern
from swarmd.kit.combined import CombinedPattern
from swarmd.kit.field_pattern import Bias, FieldParams, FieldPattern, TurnIfAlone
from swarmd.kit.formation_geometry import place_on_circle, place_on_line, radius_of
from swarmd.kit.formation_pattern import FormationParams, FormationPattern
from swarmd.kit.params import (
    Avoidance,
    ObjectWidth,
    P,
    Params,
    Recovery,
    TopSpeed,
    TopTurn,
    about,
    clear_distance,
    of_threshold,
    threshold,
)
from swarmd.kit.policy_pattern import PolicyParams, PolicyPattern
from swarmd.kit.robot_detection import robots_near
from swarmd.kit.steering import NearPoints, from_base, keep_clear, polar_from_base, steer
from swarmd.kit.timed_pattern import TimedPattern
from swarmd.kit.vote_windows import Ties, VoteWindow, majority, tally
from swarmd.kit.voting_pattern import (
    Initial,
    Opinions,
    TieRule,
    VotingParams,
    VotingPattern,
    WindowLength,
)
from swarmd.sensing.potential_field import FieldKind, FieldResult, field_twist, potential_field
from swarmd.sensing.rays import (
    Gap,
    Ray,
    RayClusters,
    closest_points,
    clusters,
    gaps,
    nearest,
    sectors,
)

__all__ = [
    "ZERO",
    "Annotated",
    "Array",
    "Avoidance",
    "Bias",
    "CombinedPattern",
    "ConfigError",
    "Context",
    "Detection",
    "FieldKind",
    "FieldParams",
    "FieldPattern",
    "FieldResult",
    "FormationParams",
    "FormationPattern",
    "Gap",
    "Initial",
    "Inputs",
    "Make",
    "Message",
    "MovementPattern",
    "NearPoints",
    "Neighbor",
    "ObjectWidth",
    "Odometry",
    "Opinions",
    "Outputs",
    "P",
    "Params",
    "Pattern",
    "Platform",
    "PluginError",
    "PolicyParams",
    "PolicyPattern",
    "Pose",
    "Ray",
    "RayClusters",
    "Recovery",
    "Scalar",
    "Scan",
    "TieRule",
    "Ties",
    "TimedPattern",
    "TopSpeed",
    "TopTurn",
    "TouchZone",
    "TurnIfAlone",
    "Twist",
    "Value",
    "VoteWindow",
    "VotingParams",
    "VotingPattern",
    "WindowLength",
    "about",
    "clear_distance",
    "closest_points",
    "clusters",
    "difference",
    "field_twist",
    "from_base",
    "gaps",
    "keep_clear",
    "majority",
    "nearest",
    "of_threshold",
    "place_on_circle",
    "place_on_line",
    "polar_from_base",
    "potential_field",
    "radius_of",
    "robots_near",
    "sectors",
    "steer",
    "tally",
    "threshold",
    "wrap",
]
