"""The wire between a simulated robot and its daemon: what is refused."""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
import pytest

from swarmd.core import events
from swarmd.core.codec import MAX_CONTROL
from swarmd.core.errors import CodecError
from swarmd.core.events import DetectionsInput, HazardsInput, NeighborsInput, PoseInput
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.values import MAX_TOLD_DISTANCE, Detection, Neighbor, Pose, Scan, SharedPose
from swarmd.driver_api.hw_codec import KINDS, decode_input, encode_input
from swarmd.settings.platforms import load_platform

PLATFORM = load_platform("burger")
BOX = Detection("box", 0.0)


@pytest.mark.parametrize(
    "input",
    [
        *(NeighborsInput((Neighbor("b", 0.0, far),)) for far in (0.0, MAX_TOLD_DISTANCE, None)),
        DetectionsInput((BOX,)),
        DetectionsInput(None),
        HazardsInput((Hazard(HazardKind.BUMP, "left"),)),
        PoseInput(SharedPose(1.0, Pose(1.0, 2.0, 0.5), 0.1, 0.1, "map")),
        events.ReadingsInput({"light": 0.25}),
    ],
)
def test_what_a_sensor_measures_is_taken(input: events.SensorInput) -> None:
    assert decode_input(events.tag_of(input), encode_input(input), PLATFORM) == input


def test_rays_are_taken_as_they_are() -> None:
    scan = Scan(7, 1.5, np.array([0.5, math.inf]), np.array([0.25, 0.5]), 0.12, 3.5)
    taken = decode_input("scan", encode_input(events.ScanInput(scan)), PLATFORM)
    assert isinstance(taken, events.ScanInput)
    assert (taken.scan.seq, taken.scan.stamp, taken.scan.ages) == (7, 1.5, None)
    for name in ("ranges", "bearings"):
        assert getattr(taken.scan, name).tolist() == getattr(scan, name).tolist()


@pytest.mark.parametrize("far", [-0.1, 1.001 * MAX_TOLD_DISTANCE, 1e9, math.inf, math.nan])
def test_distances_that_no_robot_has_are_refused(far: float) -> None:
    refuse(NeighborsInput((Neighbor("b", 0.0, far, 0.0),)))


@pytest.mark.parametrize(
    "wrong",
    [
        Detection("", 0.0),
        Detection("box", math.nan),
        Detection("box", 0.0, -1.0),
        Detection("box", 0.0, math.inf),
        Detection("x" * 64, 0.0),
    ],
)
def test_a_detection_beyond_its_bounds_is_refused(wrong: Detection) -> None:
    refuse(DetectionsInput((BOX, wrong)))


@pytest.mark.parametrize(
    "wrong",
    [
        NeighborsInput((Neighbor("x" * 64, 0.0),)),
        NeighborsInput((Neighbor("b", math.nan),)),
        NeighborsInput((Neighbor("b", 0.0, None, math.inf),)),
        PoseInput(SharedPose(1.0, Pose(math.nan, 0.0, 0.0), 0.1, 0.1, "map")),
        events.ReadingsInput({"x" * MAX_CONTROL: 1.0}),
    ],
)
def test_any_other_input_beyond_its_bounds_is_refused(wrong: events.SensorInput) -> None:
    refuse(wrong)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_no_frame_carries_another_kind_of_input(kind: str) -> None:
    assert len(KINDS) == len(get_args(events.SensorInput))
    for other in (events.TICK_INPUT, HazardsInput(()), DetectionsInput(())):
        if events.tag_of(other) != kind:
            with pytest.raises(CodecError):
                decode_input(kind, events.encode_input(other), PLATFORM)


def refuse(wrong: events.SensorInput) -> None:
    with pytest.raises(CodecError):
        decode_input(events.tag_of(wrong), encode_input(wrong), PLATFORM)
