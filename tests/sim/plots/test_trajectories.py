"""Pictures are pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from swarmd.errors import SwarmError
from swarmd.platforms import load_platform
from swarmd.sim.plots.trajectories import draw_trajectories
from swarmd.sim.trace import Recorder

pytest.importorskip("matplotlib")


def recorder(arena: str) -> Recorder:
    return Recorder(("a", "b"), [load_platform("burger")] * 2, {"arena": arena})


@pytest.mark.parametrize("arena", ["6x6,box:1:1:0.5:0.5:20,pole:-1:0:0.2", "nowhere"])
def test_draws_a_run(tmp_path: Path, arena: str) -> None:
    record = recorder(arena)
    for k in range(20):
        record.add(0.1 * k, np.array([[0.1 * k, 0.0, 0.0], [0.0, 0.1 * k, 1.0]]), np.zeros((2, 3)))
    record.touch(1.0, "a", "b", 0.1, 0.1)
    path = tmp_path / "new" / "run.png"
    draw_trajectories(record.trace(), path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 10_000


def test_an_empty_run_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(SwarmError, match="nothing to draw"):
        draw_trajectories(recorder("6x6").trace(), tmp_path / "run.png")
