"""Tables of statistics."""

from __future__ import annotations

import numpy as np

from swarmd.sim.experiments.statistics import HEADER, summarize, summary_rows
from swarmd.sim.metrics.catalog import METRICS


def test_a_time_that_some_runs_never_reached_shows_how_many() -> None:
    values = np.array([10.0] * 5 + [20.0] * 4 + [np.nan])
    (row,) = summary_rows([(METRICS["gather_time"], summarize(values, is_time_to_event=True))])
    cells = dict(zip(HEADER, row, strict=True))
    assert (cells["MEAN"], cells["MEDIAN"], cells["RUNS"]) == ("1 of 10 never", "15", "10")
