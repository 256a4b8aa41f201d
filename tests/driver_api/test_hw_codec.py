"""The wire between a simulated robot and its daemon: what is refused."""

from __future__ import annotations

import math
from typing import get_args

import pytest

from swarmd.core.codec import MAX_CONTROL
from swarmd.core.errors import CodecError
from swarmd.core.events import (
    TICK_INPUT,
    DetectionsInput,
    HazardsInput,
    NeighborsInput,
    PoseInput,
    ReadingsInput,
    SensorInput,
    tag_of,
)
from swarmd.core.events import (
    encode_input as any_bytes,
)
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.values import MAX_TOLD_DISTANCE, Detection, Neighbor, Pose, SharedPose
from swarmd.driver_api.hw_codec import KINDS, decode_input, encode_input
from swarmd.settings.platforms import load_platform

PLATFORM = load_platform("burger")
BOX = Detection("box", 0.0)
POSE = SharedPose(1.0, Pose(1.0, 2.0, 0.5), 0.1, 0.1, "map")


@pytest.mark.parametrize(
    "input",
    [
        *(
            NeighborsInput((Neighbor("b", 0.0, far, 0.0),))
            for far in (0.0, MAX_TOLD_DISTANCE, None)
        ),
        DetectionsInput((BOX,)),
        DetectionsInput(None),
        HazardsInput((Hazard(HazardKind.BUMP, "left"),)),
        PoseInput(POSE),
        ReadingsInput({"light": 0.25}),
    ],
)
def test_what_a_sensor_measures_is_taken(input: SensorInput) -> None:
    assert decode_input(tag_of(input), encode_input(input), PLATFORM) == input


@pytest.mark.parametrize(
    "wrong",
    [
        *(
            NeighborsInput((Neighbor("b", 0.0, far, 0.0),))
            for far in (-0.1, 1.001 * MAX_TOLD_DISTANCE, 1e9, math.inf, math.nan)
        ),
        NeighborsInput((Neighbor("x" * 64, 0.0),)),
        NeighborsInput((Neighbor("b", math.nan),)),
        *(
            DetectionsInput((BOX, wrong))
            for wrong in (
                Detection("", 0.0),
                Detection("box", math.nan),
                Detection("box", 0.0, -1.0),
                Detection("box", 0.0, math.inf),
                Detection("x" * 64, 0.0),
            )
        ),
        PoseInput(SharedPose(1.0, Pose(math.nan, 0.0, 0.0), 0.1, 0.1, "map")),
        ReadingsInput({"x" * MAX_CONTROL: 1.0}),
    ],
)
def test_an_input_beyond_its_bounds_is_refused(wrong: SensorInput) -> None:
    with pytest.raises(CodecError):
        decode_input(tag_of(wrong), encode_input(wrong), PLATFORM)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_no_frame_carries_another_kind_of_input(kind: str) -> None:
    assert len(KINDS) == len(get_args(SensorInput))
    with pytest.raises(CodecError):
        decode_input(kind, any_bytes(TICK_INPUT), PLATFORM)
    if kind != "hazards":
        with pytest.raises(CodecError):
            decode_input(kind, any_bytes(HazardsInput(())), PLATFORM)
