"""Lloyd coverage: the cost never rises, and ends near the best that Lloyd's algorithm finds."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count

import numpy as np

from studies.keeper import each
from studies.outcomes.outcome import Outcome, at_least, at_most, metric, no_contacts
from studies.point_swarm import PointSwarm, at_places
from swarmd.core.values import Array, Pose, Scan
from swarmd.settings.settings import load_platform
from swarmd.sim.experiments.simulate import simulate
from swarmd.testing.scans import scan_of

NAME = "lloyd_coverage"
SHORT_FORM = {"duration": 80.0}
IS_LONG = True
FILM = {"title": "from a corner", "stop": 90.0}
ROBOTS, SIDE, SECONDS = 8, 4.0, 120.0
REACH = 3.5
"""The lidar's range in m."""
RESTARTS, ITERATIONS = 50, 100
DURATION = 120.0
RISE = 1e-3
"""Of the cost in one step of 0.5 s; scans of 360 rays see the room's corners roughly."""
_CORTES = "Cortes et al. 2004: the cost never rises"
_CENTROID = "Cortes et al. 2004: each robot ends at its centroid; the tolerance is 0.025 m"
_LLOYD = "the least of 50 random starts of Lloyd's algorithm on a grid"


def outcomes(seeds: Sequence[int], jobs: int = 1, duration: float = DURATION) -> list[Outcome]:
    """Measure the cost of the places at which the robots settle, and how it falls.

    The cost is the mean square distance of the room's places to the nearest robot. For each seed
    there is a run of point robots (no bodies), and a run of Burgers of `duration` s. Each outcome
    has the measured values, their bound and the source of the bound.
    """
    # Of each run the cost at each sample, and the largest way of a robot to its centroid in m.
    runs = each(costs, seeds, jobs)
    rises = [float((np.diff(cost_at) / cost_at[:-1]).max()) for cost_at, _ in runs]
    least_cost = least()  # of the best places of this number of robots
    end_ratios = [float(cost_at[-1]) / least_cost for cost_at, _ in runs]
    to_centroid_m = [to_centroid for _, to_centroid in runs]
    burgers = simulate(NAME, seeds, jobs=jobs, set={"duration": duration})
    starts = [cost(trace.pose[0, :, :2]) for trace in burgers.traces]
    ends = [cost(trace.pose[-1, :, :2]) for trace in burgers.traces]
    body_ratios = [end / least_cost for end in ends]
    gains = [start / end for start, end in zip(starts, ends, strict=True)]
    speed = metric(burgers, "mean_speed_late_share")
    return [
        at_most(
            NAME, "points: way to the own centroid at the end [m]", 0.05, to_centroid_m, _CENTROID
        ),
        at_most(NAME, "points: largest rise of the cost in a step, share", RISE, rises, _CORTES),
        at_most(NAME, "points: cost at the end / least", 1.15, end_ratios, _LLOYD),
        at_most(NAME, "Burgers: cost at the end / least", 1.3, body_ratios, _LLOYD),
        at_least(NAME, "Burgers: cost at the start / at the end", 2.0, gains, "ours"),
        at_most(NAME, "Burgers: late speed / limit", 0.1, speed, "ours"),
        no_contacts(NAME, burgers),
    ]


def costs(seed: int) -> tuple[Array, float]:
    """The cost (T,) every 0.5 s, and the greatest way to a centroid in m at the end."""
    rng = np.random.default_rng(seed)
    poses = at_places(rng.uniform(-1.8, -0.8, (ROBOTS, 2)))
    poses[:, 2] = rng.uniform(-np.pi, np.pi, ROBOTS)
    platform, number = load_platform("burger"), count()

    def see(row: int, now: Array) -> Scan:
        return scan_of(platform, room=SIDE, pose=Pose(*now[row].tolist()), seq=next(number))

    track = PointSwarm(NAME, poses, seed=seed, see=see).run(SECONDS, every=0.5)
    return np.array([cost(p[:, :2]) for p in track.pose]), float(track.reported("off")[-1].max())


def cost(places: Array) -> float:
    """The mean square distance in m2 of the room's places to the nearest of these (n, 2).

    A distance beyond the reach counts as the reach, as the cells are bounded by it.
    """
    return float(np.minimum(_squares(places).min(axis=1), REACH**2).mean())


def least() -> float:
    """The least cost that Lloyd's algorithm finds on the grid."""
    rng, found = np.random.default_rng(0), []
    for _ in range(RESTARTS):
        places = rng.uniform(-0.5 * SIDE, 0.5 * SIDE, (ROBOTS, 2))
        for _ in range(ITERATIONS):
            owner = _squares(places).argmin(axis=1)
            size = np.maximum(np.bincount(owner, minlength=ROBOTS), 1)
            sums = [np.bincount(owner, axis, minlength=ROBOTS) for axis in _grid().T]
            places = np.column_stack(sums) / size[:, None]
        found.append(cost(places))
    return min(found)


def _squares(places: Array) -> Array:
    """(m, n) the square distances of the grid's places to these."""
    off = _grid()[:, None, :] - places[None]
    return np.asarray((off**2).sum(axis=2))


def _grid() -> Array:
    """(m, 2) the middles of squares of 0.1 m."""
    line = np.arange(-0.5 * SIDE + 0.05, 0.5 * SIDE, 0.1)
    x, y = np.meshgrid(line, line)
    return np.column_stack([x.ravel(), y.ravel()])
