"""The table of the wall time of runs on one and on two processes."""

from __future__ import annotations

from benchmarks.executors import table


def test_the_speed_of_two_processes_is_a_ratio_within_each_round() -> None:
    times = {("Dask", 1): [40.0, 60.0, 90.0], ("Dask", 2): [20.0, 40.0, 60.0]}

    row = table(times).splitlines()[-1]

    assert [cell.strip() for cell in row.strip("|").split("|")] == [
        "Dask",
        "60 s",
        "40 s",
        "1.50 (1.50 to 2.00)",
    ]
