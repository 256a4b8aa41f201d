"""How often robots stand after `stop; run` of one operator.

Run it as `python -m tests.histories.price_of_doubt [SEEDS]`.

In doubt a robot stands. Three robots run; then the operator types a stop and a run, on a network
with 20 % of loss and a delay of 0.5 s. The run is typed once the stop has its answers, or `gap` s
after the stop. A robot that stands 20 s after the run has ended stands falsely. `late`: s by which
the datagrams of the operator, and so its stops, come later than its requests.
"""

from __future__ import annotations

import sys

from tests.histories.history import History, step

LOSS, DELAY = 0.2, 0.5
ROBOTS = 3
CASES: tuple[tuple[float | None, float], ...] = (
    (None, 0.0),
    (0.0, 0.0),
    (0.3, 0.0),
    (1.0, 0.0),
    (0.3, 1.5),
    (1.0, 1.5),
)
"""Each a gap, None: once the stop is answered, and the lateness of datagrams."""


def standing(seed: int, gap: float | None, late: float) -> int:
    """The number of robots that stand after a run that was typed after a stop."""
    history = History(ROBOTS, seed)
    history.carry_out(step(0.0, "run", by="anna"))
    history.carry_out(step(4.0, "disturb", loss=LOSS, delay=DELAY))
    history.swarm.slow = {"anna": late}
    history.carry_out(step(1.0, "stop", by="anna"))
    if gap is None:
        history.await_commands()
    history.carry_out(step(gap or 0.0, "run", by="anna"))
    history.await_commands()
    history.swarm.advance(20.0)
    return sum(not one.robot.is_running for one in history.swarm.robots.values())


def main(seeds: int) -> None:
    """Print the share of each case."""
    for gap, late in CASES:
        count = sum(standing(seed, gap, late) for seed in range(seeds))
        when = "after the answers" if gap is None else f"{gap} s after the stop"
        print(f"run {when}, datagrams {late} s late: {count} of {ROBOTS * seeds} stand", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
