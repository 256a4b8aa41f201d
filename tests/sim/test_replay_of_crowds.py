"""Recorded robots of a crowd, with clocks of any uptime, are repeated to the bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.recording.reader import read_file
from swarmd.replay.replay import recordings_of, repeat
from tests.support.clocked_crowd import crowd
from tests.support.examples import part
from tests.support.recorded_crowd import recorded_crowd
from tests.support.recorded_stories import ORIGINS

DAY = 86_400.0


@pytest.mark.parametrize(
    ("seed", "uptime"),
    part([(1, 60.0)], [(seed, (60.0, 600.0, DAY)[seed % 3]) for seed in range(2, 12)]),
)
def test_each_robot_of_a_crowd_is_repeated(tmp_path: Path, seed: int, uptime: float) -> None:
    seconds = 8.0
    crowded = recorded_crowd(tmp_path, crowd(4, seconds), seed, seconds, uptime)
    assert crowded.lives["tb3-03"] == 2, "its daemon was killed and started again"
    assert min(crowded.active.values()) > 10
    for folder in sorted(tmp_path.iterdir()):
        recordings = recordings_of(map(read_file, sorted(folder.glob("*.mcap"))))
        assert len(recordings) == crowded.lives[folder.name]
        for files in recordings:
            _, parity = repeat(files, ORIGINS)
            assert parity.notes == ()
            assert parity.safe.is_equal
            assert parity.requested.is_equal
            assert parity.safe.count > 10
