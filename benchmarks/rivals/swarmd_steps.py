"""Speed of swarmd: `python -m benchmarks.rivals.swarmd_steps ROBOTS RAYS RANGE NEAR SECONDS MODE`.

Prints the simulated robot-seconds and their CPU seconds, as each program of this folder does.
Waffle Pis run the pattern of examples/shy.py in lockstep, with all parts of an experiment: physics,
noisy lidars, delays, odometry, radio, protection in mode MODE, and the trace.
"""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.lockstep import one_per_square_metre
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import load_scenario

PATTERN = Path(__file__).resolve().parents[2] / "examples" / "shy.py"
STEP = 0.1  # s
DURATION = 3600.0  # s, which no measurement reaches
WIDEST_GAP = 100.0  # deg between two neighbouring rays, for eight of them


def overrides(
    robots: int, rays: int, range_max: float, near: float, mode: str
) -> Mapping[str, Any]:
    """Overrides of scenario `thousand`; `near`: m at which a robot turns."""
    scan: dict[str, Any] = {"rays": rays, "rate": 1.0 / STEP, "range_max": range_max}
    if rays < 360:
        scan["max_gap_deg"] = WIDEST_GAP
    return {
        **one_per_square_metre(robots, str(PATTERN)),
        "groups.all.parameters": {"speed": 0.2, "distance": near},
        "groups.all.platform": "measured",
        "platforms.measured": {"extends": "waffle_pi", "scan": scan, "protection": {"mode": mode}},
        "duration": DURATION,
    }


def measure(robots: int, seconds: float, words: Mapping[str, Any]) -> tuple[float, float]:
    """Robot-seconds that were simulated, and their CPU seconds, at least `seconds`."""
    run = Lockstep(load_scenario("thousand", words), seed=0)
    gc.disable()  # as within one long `advance`: a pass over 1,000 robots takes 1 s, a step 0.1 s

    def advance(least: float) -> tuple[int, float]:
        start = time.process_time()
        steps = 0
        while (taken := time.process_time() - start) < least:
            run.advance(STEP)
            steps += 1
        return steps, taken

    advance(seconds / 2.0)
    steps, taken = advance(seconds)
    return robots * steps * STEP, taken


if __name__ == "__main__":
    count = int(sys.argv[1])
    of_rays = int(sys.argv[2])
    farthest, turns_at, cpu = map(float, sys.argv[3:6])
    print(*measure(count, cpu, overrides(count, of_rays, farthest, turns_at, sys.argv[6])))
