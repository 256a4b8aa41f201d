"""The modules that are mutated, the tests that must fail, and the share that is drawn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from msgspec import Struct

ROOT = Path(__file__).resolve().parents[2]


class Subject(Struct, frozen=True, kw_only=True):
    """Modules with the tests of the short lane that must fail for each mutant of them."""

    name: str
    paths: tuple[str, ...]
    """Files, relative to the root."""
    tests: tuple[str, ...]
    """Files of tests that run first."""
    more: tuple[str, ...] = ()
    """Files of tests that run if all of `tests` pass."""
    one_of: int = 1
    """One mutant of so many is drawn."""


_FIRST: Mapping[str, tuple[str, ...]] = {
    "assumption_monitor": ("test_assumption_monitor",),
    "barrier": ("test_barrier", "test_barrier_lost_sector"),
    "barrier_assumptions": ("test_binding_range", "test_constraints"),
    "binding_range": ("test_binding_range", "test_constraints", "test_dead_reckoning"),
    "blind_zone": ("test_blind_zone",),
    "compatibility": ("test_compatibility",),
    "constraints": ("test_constraints", "test_barrier_told"),
    "dead_reckoning": ("test_dead_reckoning", "test_late_scans"),
    "envelope": ("test_following", "test_modes"),
    "feasible_set": ("test_constraints", "test_barrier_told"),
    "fence": ("fence/test_fence",),
    "fence_pose": ("fence/test_fence",),
    "fence_settings": ("fence/test_fence",),
    "fence_stops": ("fence/test_fence",),
    "following": ("test_following",),
    "footprint": ("test_footprint",),
    "limiting_obstacles": ("test_constraints", "test_barrier"),
    "modes": ("test_modes", "test_set_down"),
    "obstacles": ("test_footprint", "test_constraints"),
    "outline": ("test_footprint", "test_constraints"),
    "passage": ("test_binding_range",),
    "projection": ("test_projection",),
    "protection": ("test_protection", "walls/test_standing_walls"),
    "set_down": ("test_set_down",),
    "settings": ("test_protection",),
    "stopping": ("test_stopping",),
    "bare_returns": ("walls/test_bare_returns",),
    "standing_walls": ("walls/test_standing_walls", "walls/test_bare_returns"),
    "straight_runs": ("walls/test_standing_walls",),
    "walls_settings": ("walls/test_standing_walls",),
}
"""By module of protection, the files of tests/robot/protection that run first."""
_REST = ("test_constraints", "test_barrier", "test_protection", "test_modes", "test_barrier_flank")
"""Those that run for all modules."""


def _protection() -> Iterator[Subject]:
    """A subject for each module of protection, all with one name."""
    folder = ROOT / "swarmd" / "robot/protection"
    for path in sorted(folder.rglob("*.py")):
        if path.name == "__init__.py":
            continue
        first = _FIRST.get(path.stem, ("test_constraints",))
        rest = [name for name in _REST if name not in first]
        yield Subject(
            name="protection",
            paths=(path.relative_to(ROOT).as_posix(),),
            tests=tuple(f"tests/robot/protection/{name}.py" for name in first),
            more=tuple(f"tests/robot/protection/{name}.py" for name in rest),
            one_of=50,
        )


def subjects() -> Sequence[Subject]:
    """What a night mutates; small modules come first."""
    return (
        Subject(
            name="issue_time",
            paths=("swarmd/robot/issue_time.py",),
            tests=("tests/robot/test_issue_time.py",),
            more=("tests/robot/test_requests.py", "tests/robot/test_pattern_run.py"),
        ),
        Subject(
            name="command_gate",
            paths=("swarmd/driver_api/command_gate.py",),
            tests=("tests/driver_api/test_command_gate.py",),
        ),
        Subject(
            name="command_credit",
            paths=("drivers/ros2/command_credit.py",),
            tests=("tests/drivers/ros2/test_command_credit.py",),
        ),
        Subject(
            name="requests",
            paths=("swarmd/robot/requests.py",),
            tests=("tests/robot/test_requests.py", "tests/robot/test_requests_reload.py"),
            more=(
                "tests/robot/test_robot.py",
                "tests/robot/test_goals.py",
                "tests/robot/test_lifecycle.py",
                "tests/robot/test_latches.py",
                "tests/robot/test_provisional.py",
                "tests/robot/test_pattern_run.py",
                "tests/robot/test_hand.py",
                "tests/robot/test_hand_histories.py",
                "tests/robot/test_permit.py",
            ),
        ),
        Subject(
            name="ticker",
            paths=("swarmd/robot/ticker.py",),
            tests=("tests/robot/test_ticker.py", "tests/robot/test_robot.py"),
            more=(
                "tests/robot/test_lying_steering.py",
                "tests/robot/test_permit.py",
                "tests/robot/test_kin.py",
                "tests/robot/test_sensors.py",
                "tests/robot/test_quiet_ticks.py",
                "tests/robot/test_memory.py",
                "tests/robot/test_hand.py",
                "tests/robot/protection/test_following.py",
            ),
            one_of=3,
        ),
        *_protection(),
    )
