"""The number of processor cores that a program may use on this machine."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path

MAX_PROCESSES = 256
_LEAST_SHARE = 0.05  # so that what does not return ends at any load, after 20 times its limit
LARGE_RUN = 100
"""From this number of robots on, several cores share a run if other runs leave cores free."""


def usable_cores(root: Path = Path("/")) -> int:
    """The number of cores that this process may use, 1 to MAX_PROCESSES.

    It is the number of cores in the affinity mask of the process, limited by the quotas of its
    control groups (cgroup v1 and v2). A quota is rounded up to whole cores. `root`: the folder that
    holds /proc and /sys.
    """
    quotas = [_quota(folder) for folder in _groups(root)]
    limits = [math.ceil(quota) for quota in quotas if quota < math.inf]
    has_mask = hasattr(os, "sched_getaffinity")  # not on macOS
    cores = len(os.sched_getaffinity(0)) if has_mask else os.cpu_count() or 1
    return max(1, min(cores, *limits, MAX_PROCESSES))


def core_share() -> float:
    """The share of a core that one process gets at the present load, 1 on a machine that is free.

    At least _LEAST_SHARE. Time limits of runs count seconds by this share, so that an overloaded
    machine does not look like a slow program.
    """
    return min(1.0, max(usable_cores() / max(os.getloadavg()[0], 1.0), _LEAST_SHARE))


def cores_of_a_run(cores: int, runs: int, robots: int) -> int:
    """The number of cores that share each of `runs` runs of `robots` robots, at least 1.

    1 for fewer than LARGE_RUN robots. Each run has its first core before a run gets a second one,
    since a run on one core costs less processor time than a shared run.
    """
    return max(1, cores // max(runs, 1)) if robots >= LARGE_RUN else 1


def _groups(root: Path) -> list[Path]:
    """The folders of the control groups of this process, and of all groups around them."""
    base = root / "sys/fs/cgroup"
    folders = []
    with suppress(OSError):
        for line in (root / "proc/self/cgroup").read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if controllers and "cpu" not in controllers.split(","):
                continue
            folder = (base / controllers if controllers else base) / path.strip("/")
            # A container sees its own group as the root, whatever its path outside is.
            folders += [folder, *folder.parents[: len(folder.relative_to(base).parts)]]
    return folders


def _quota(folder: Path) -> float:
    """The cores that a control group may use; infinite without a quota."""
    with suppress(OSError, ValueError, IndexError, ZeroDivisionError):
        limit, period = (folder / "cpu.max").read_text().split()  # v2: "max 100000"
        return float(limit) / float(period)
    with suppress(OSError, ValueError, ZeroDivisionError):
        limit, period = (
            (folder / f"cpu.cfs_{name}_us").read_text() for name in ("quota", "period")
        )
        return float(limit) / float(period) if float(limit) > 0 else math.inf
    return math.inf
