"""A daemon with a fault: the end of a run lease does not end the run."""

from __future__ import annotations

from swarmd.operator.cli.daemon import main
from swarmd.robot.goals import Goals

if __name__ == "__main__":
    Goals.lease_ends = property(lambda goals: None)  # type: ignore[method-assign, assignment]
    main()
