"""Which instants and robots count."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from swarmd.sim.metrics import window
from tests.sim.metrics.runs import full_run, run


@pytest.mark.parametrize(("instants", "since"), [(1801, 120.0), (1201, 60.0), (401, 20.0)])
def test_late_is_the_last_minute_or_half(instants: int, since: float) -> None:
    late = window.late(run(np.zeros((instants, 1, 3))))
    assert late.t[0] == pytest.approx(since)
    assert late.t[-1] == pytest.approx((instants - 1) / 10)
    assert window.late(late, 2.0).t[0] == pytest.approx(late.t[-1] - 2.0)


def test_a_cut_takes_all_that_has_instants() -> None:
    trace = replace(
        full_run(3),
        movable_boxes=("crate",),
        box_pose=np.zeros((12, 1, 3)),
        words={"mood": np.full((12, 6), "calm")},
    )
    part = window.cut(trace, 4, 7)
    for field in fields(part):
        value = getattr(part, field.name)
        if isinstance(value, np.ndarray) and not field.name.startswith("contact"):
            assert len(value) == 3, field.name
    assert part.report["opinion"].shape == part.words["mood"].shape == (3, 6)
    np.testing.assert_array_equal(part.pose, trace.pose[4:7])


def test_a_cut_keeps_the_touches_of_its_time() -> None:
    contacts = [(time, 0, 1) for time in (0.35, 0.4, 0.5, 0.55, 0.6, 0.61)]
    part = window.cut(run(np.zeros((11, 2, 3)), contacts), 4, 7)
    assert part.contact_t.tolist() == [0.4, 0.5, 0.55, 0.6]
    assert len(part.contact_pair) == len(part.contact_speed) == 4


def test_first_and_last_are_one_instant() -> None:
    trace = run(np.zeros((5, 2, 3)))
    assert window.first(trace).t.tolist() == [0.0]
    assert window.last(trace).t.tolist() == [0.4]


def test_means_leave_out_what_is_not_known() -> None:
    assert window.mean(np.array([1.0, np.nan, 3.0])) == 2.0
    assert window.mean(np.array([1.0, 5.0]), np.array([False, True])) == 5.0
    assert window.mean(np.array([np.nan])) is None
    assert window.mean(np.zeros(0)) is None
    is_counted = np.array([[True, True], [False, True], [False, False]])
    rows = window.row_means(np.array([[1.0, 3.0], [np.nan, 4.0], [1.0, 1.0]]), is_counted)
    np.testing.assert_array_equal(rows, [2.0, 4.0, np.nan])


def test_numbers_by_platform() -> None:
    trace = replace(run(np.zeros((1, 2, 3))), platforms=("burger", "jackal"))
    speeds = window.by_platform(trace, "v_max")
    assert speeds is not None
    assert speeds.tolist() == [0.22, 0.5]
    assert window.by_platform(trace, "weights") is None
    assert window.by_platform(replace(trace, meta={"v_max": {"burger": 1.0}}), "v_max") is None
