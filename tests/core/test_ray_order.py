"""Rays by rising angle, as Python sorts them."""

from __future__ import annotations

import math

from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.kernel_forms import interpreted

kernel = interpreted("swarmd.core.ray_order", because="a function of C")
TURNED = [*range(20, 40), *range(20)]
MIXED = [7 * n % 101 for n in range(101)]  # more moves than an insertion sort is given


@given(st.lists(st.floats(-4.0, 4.0) | st.sampled_from([0.0, 1.0]), max_size=40))
@example(TURNED)
@example(TURNED[::-1])
@example(MIXED)
@example([1.0] * 5)
def test_rays_are_sorted_and_those_of_one_angle_keep_their_order(angles: list[float]) -> None:
    rising, order = [math.nan] * (len(angles) + 1), [-1] * (len(angles) + 1)
    kernel.sort_rays([*angles, -9.0], len(angles), rising, order)
    wanted = sorted(range(len(angles)), key=lambda ray: (angles[ray], ray))
    assert order == [*wanted, -1]
    assert rising[:-1] == [angles[ray] for ray in wanted]


def test_an_angle_that_is_not_a_number_is_last() -> None:
    rising, order = [0.0] * 3, [0] * 3
    kernel.sort_rays([math.nan, 2.0, 1.0], 3, rising, order)
    assert order == [2, 1, 0]
