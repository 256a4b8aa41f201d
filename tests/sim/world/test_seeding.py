"""Random generators depend on seed, purpose and robot alone."""

from __future__ import annotations

import subprocess
import sys

import pytest

from swarmd.sim.world.seeding import generator


def drawn(seed: int, purpose: str, robot: str) -> float:
    return float(generator(seed, purpose, robot).random())


def test_each_of_the_three_makes_them_others() -> None:
    found = [
        drawn(3, "lidar", "tb3-01"),
        drawn(4, "lidar", "tb3-01"),
        drawn(3, "radio", "tb3-01"),
        drawn(3, "lidar", "tb3-02"),
        drawn(3, "lidart", "b3-01"),
        drawn(3, "lida", "rtb3-01"),
    ]
    assert len(set(found)) == len(found)


@pytest.mark.integration
def test_another_process_with_another_hash_seed_gives_the_same() -> None:
    code = (
        "from swarmd.sim.world.seeding import generator;"
        "print(repr(float(generator(3, 'lidar', 'tb3-01').random())))"
    )
    for hash_seed in ("0", "1"):
        out = subprocess.run(
            [sys.executable, "-c", code],
            env={"PYTHONHASHSEED": hash_seed},
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        ).stdout
        assert float(out) == drawn(3, "lidar", "tb3-01")
