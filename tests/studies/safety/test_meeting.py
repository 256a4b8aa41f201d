from __future__ import annotations

import numpy as np
import pytest

from studies.safety.meeting import meeting

SQUARE = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])
DIAMOND = np.array([[0.0, -0.1], [0.1, 0.0], [0.0, 0.1], [-0.1, 0.0]])


@pytest.mark.parametrize("overlap", [-0.005, 0.0, 0.004])
def test_a_corner_that_meets_a_face(overlap: float) -> None:
    at, way = meeting(SQUARE, np.add(DIAMOND, (0.2 - overlap, 0.05)))
    assert way == pytest.approx((1.0, 0.0))
    assert at == pytest.approx(np.array([[0.1 - overlap, 0.05]]))
    at, way = meeting(np.add(DIAMOND, (0.2 - overlap, 0.05)), SQUARE)
    assert way == pytest.approx((-1.0, 0.0))
    assert at == pytest.approx(np.array([[0.1 - overlap, 0.05]]))


def test_two_faces_meet_where_they_are_beside_each_other() -> None:
    at, way = meeting(SQUARE, np.add(SQUARE, (0.2, 0.15)))
    assert way == pytest.approx((1.0, 0.0))
    assert sorted(at[:, 1].tolist()) == pytest.approx([0.05, 0.1])
