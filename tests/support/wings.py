"""The wings of the project, the rooms of the network, and the tests of the robot wing.

`python -m tests.support.wings` prints those tests as arguments of pytest, for `make test-robot`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WINGS: Mapping[str, tuple[str, ...]] = {
    "robot": (
        *("config", "drivers", "patterns", "swarmd/api", "swarmd/core", "swarmd/daemon"),
        *("swarmd/driver_api", "swarmd/kit", "swarmd/mission", "swarmd/link"),
        "swarmd/make_robot",
        *(
            "swarmd/pattern_host",
            "swarmd/plugins",
        ),
        *(
            "swarmd/robot",
            "swarmd/ros2_nodes",
            "swarmd/settings",
        ),
        "swarmd/testing",
    ),
    "operator": (*("drivers/ros2swarm", "swarmd/operator"),),
    "laboratory": ("benchmarks", "sim", "studies"),
}
"""Folders and files of each wing; none imports from a later wing."""
ROOMS: tuple[tuple[str, ...], ...] = (
    ("keys",),
    ("access", "datagram", "settings"),
    ("signature",),
    ("stops",),
    ("members",),
    ("carriers",),
    ("spread",),
    ("peer",),
)
"""Folders and files of `swarmd/link`, from the ground up: each imports lower rooms only."""


def wing_of(place: str) -> str | None:
    """The wing of a file or folder: that of its longest prefix in WINGS; None for no wing.

    The metrics beside a pattern are imported by experiments alone: they are of the laboratory.
    """
    if place.startswith("patterns/") and place.removesuffix(".py").endswith("/metrics"):
        return "laboratory"
    wings = {name: wing for wing, names in WINGS.items() for name in names}
    parts = place.removesuffix(".py").split("/")
    prefixes = ("/".join(parts[:n]) for n in range(len(parts), 0, -1))
    return next((wings[prefix] for prefix in prefixes if prefix in wings), None)


def tests_of(wing: str) -> list[str]:
    """Arguments of pytest for the tests of a wing: its folders, and those of other wings in it."""
    folders = [f"tests/{name.removeprefix('swarmd/')}" for name in WINGS[wing]]
    inner = [
        f"--ignore=tests/{name.removeprefix('swarmd/')}"
        for names in WINGS.values()
        for name in names
        if wing_of(name) != wing and wing_of(name.rpartition("/")[0]) == wing
    ]
    return [name for name in folders if (ROOT / name).is_dir()] + inner


if __name__ == "__main__":
    print(*tests_of("robot"))
