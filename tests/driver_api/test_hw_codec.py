"""The wire between a driver and its base: what is refused."""

from __future__ import annotations

import math

import pytest

from swarmd.core.errors import CodecError
from swarmd.core.values import MAX_TOLD_DISTANCE, Detection, Neighbor
from swarmd.driver_api.hw_codec import (
    decode_detections,
    decode_neighbors,
    encode_detections,
    encode_neighbors,
)


@pytest.mark.parametrize("distance", [0.0, MAX_TOLD_DISTANCE, None])
def test_distances_of_a_swarm_are_taken(distance: float | None) -> None:
    neighbor = Neighbor("b", 0.0, distance, 0.0)
    assert decode_neighbors(encode_neighbors((neighbor,))) == (neighbor,)


@pytest.mark.parametrize("distance", [-0.1, 1.001 * MAX_TOLD_DISTANCE, 1e9, math.inf, math.nan])
def test_distances_that_no_robot_has_are_refused(distance: float) -> None:
    with pytest.raises(CodecError):
        decode_neighbors(encode_neighbors((Neighbor("b", 0.0, distance, 0.0),)))


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
    with pytest.raises(CodecError):
        decode_detections(encode_detections((Detection("box", 0.0), wrong)))
