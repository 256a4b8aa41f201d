"""Survival curves of times to an event."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.sim.plots.survival import Times, survival_curve

pytest.importorskip("matplotlib")
NAN = np.nan


def test_the_curve_is_that_of_kaplan_and_meier() -> None:
    """By hand: 5 runs; events at 2 and 6 s, ends without it at 4 s and 10 s."""
    times = Times(np.array([2.0, NAN, 6.0, NAN, 6.0]), np.array([10.0, 4.0, 10.0, 10.0, 10.0]))
    curve = survival_curve(times)
    at = {t: share for t, share in zip(curve.t, curve.share, strict=True)}
    assert at[0.0] == 1.0
    assert at[2.0] == pytest.approx(4 / 5)
    assert at[6.0] == pytest.approx(4 / 5 * 1 / 3)  # of three runs that are left
    assert curve.t[-1] == 10.0
    assert curve.share[-1] == at[6.0]
    assert curve.censored.tolist() == [4.0, 10.0]
    known = np.isfinite(curve.low)
    assert (curve.low[known] <= curve.share[known]).all()
    assert (curve.share[known] <= curve.high[known]).all()


def test_a_share_of_runs_that_end_together_is_the_plain_share() -> None:
    curve = survival_curve(Times(np.array([1.0, 2.0, 3.0, NAN]), np.full(4, 9.0)))
    assert curve.share.tolist() == pytest.approx([1.0, 0.75, 0.5, 0.25, 0.25])


@pytest.mark.parametrize("times", [[NAN, NAN], [1.0, 2.0], [1.0]])
def test_all_or_none_of_the_runs_give_a_curve(times: list[float]) -> None:
    curve = survival_curve(Times(np.array(times), np.full(len(times), 5.0)))
    assert curve.share[-1] == (1.0 if np.isnan(times[0]) else 0.0)
