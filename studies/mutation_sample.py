"""A seeded sample of the mutants: `python -m studies.mutation_sample START END`, after a run.

Prints the names of the drawn mutants START to END, for `make mutants`. About half of the drawn
mutants are of protection, a third of robot, and the rest of the ROS conversion. The order is
random, too, so that the first mutants are a fair sample.
"""

from __future__ import annotations

import json
import random
import sys
from pathlib import Path

SEED = 1
SHARES = {"swarmd/protection": 126, "swarmd/robot": 84, "swarmd/drivers/ros": 42}


def drawn(mutants: Path) -> list[str]:
    """The names of all drawn mutants, of those that mutmut has written to the folder `mutants`."""
    draw, names = random.Random(SEED), []
    for folder, count in SHARES.items():
        made = [
            name
            for file in sorted((mutants / folder).glob("*.py.meta"))
            for name in json.loads(file.read_text())["exit_code_by_key"]
        ]
        names += draw.sample(sorted(made), count)
    draw.shuffle(names)
    return names


if __name__ == "__main__":
    start, end = (int(argument) for argument in sys.argv[1:])
    print(*drawn(Path("mutants"))[start:end])
