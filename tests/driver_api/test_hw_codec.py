"""The wire between a driver and its base: what is refused."""

from __future__ import annotations

import math

import pytest

from swarmd.core.errors import CodecError
from swarmd.core.values import MAX_TOLD_DISTANCE, Neighbor
from swarmd.driver_api.hw_codec import decode_neighbors, encode_neighbors


@pytest.mark.parametrize("distance", [0.0, MAX_TOLD_DISTANCE, None])
def test_distances_of_a_swarm_are_taken(distance: float | None) -> None:
    neighbor = Neighbor("b", 0.0, distance, 0.0)
    assert decode_neighbors(encode_neighbors((neighbor,))) == (neighbor,)


@pytest.mark.parametrize("distance", [-0.1, 1.001 * MAX_TOLD_DISTANCE, 1e9, math.inf, math.nan])
def test_distances_that_no_robot_has_are_refused(distance: float) -> None:
    with pytest.raises(CodecError):
        decode_neighbors(encode_neighbors((Neighbor("b", 0.0, distance, 0.0),)))
