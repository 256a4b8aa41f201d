"""A thin pole that homes in on a robot at `others_speed`, and a robot that turns; seeded."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from swarmd.core.values import ZERO, Array, Pose, Twist
from swarmd.settings.platforms import load_platform
from tests.support.filter_sim import DT, FilterSim, Shape, placed, pole, under_barrier


@dataclass(frozen=True, slots=True, eq=False)
class Homing(Shape):
    """A pole of 2 cm that heads for a place of an outline, which moves along the outline.

    It is at `places[-1]`. The place begins at the share `first` of the outline and moves `rate`
    rounds a second.
    """

    speed: float = 0.0
    first: float = 0.0
    rate: float = 0.0
    places: list[Array] = field(default_factory=list)

    def at(self, time: float) -> Pose:
        x, y = self.places[-1].tolist()
        return Pose(x, y)

    def after(self, outline: Array, time: float) -> Array:
        """Where it is `DT` later."""
        edge, share = divmod((self.first + self.rate * time) % 1.0 * len(outline), 1.0)
        one, other = outline[int(edge)], outline[(int(edge) + 1) % len(outline)]
        here = self.places[-1]
        way = one + share * (other - one) - here
        there: Array = here + self.speed * DT / max(float(np.hypot(*way)), 1e-9) * way
        return there


class HomingSim(FilterSim):
    """A robot of a platform that turns and drives from `begin` s on, while a pole homes in on it.

    Bodies are seen whole. `seed` draws the pole's place, its aim and the rate at which that sweeps
    along the outline, and the twists of each second. `late` s: by which scans come later than
    declared.
    """

    def __init__(
        self,
        name: str,
        seed: int,
        *,
        begin: float,
        phase: float,
        late: float = 0.0,
        rolling: bool = False,
    ) -> None:
        rng = np.random.default_rng(seed)
        platform = under_barrier(load_platform(name), unseen_extent=0.0)
        bearing, distance = rng.uniform(-math.pi, math.pi), rng.uniform(0.5, 0.9)
        self.pole = Homing(
            pole(0.02).corners,
            speed=platform.protection["barrier"]["others_speed"],
            first=rng.random(),
            rate=rng.uniform(-0.5, 0.5),
            places=[distance * np.array([math.cos(bearing), math.sin(bearing)])],
        )
        self.begin, limits = begin, platform.limits
        turns = rng.choice((-1.0, 1.0)) * rng.uniform(0.4, 1.0, 8) * limits.angular
        drives = rng.uniform(-1.0, 1.0, 8) * limits.linear
        self._twists = list(map(Twist, drives.tolist(), turns.tolist()))
        super().__init__(
            platform,
            [self.pole],
            phase=phase,
            noise=0.005,
            seed=seed,
            late=lambda seq: late,
            rolling=rolling,
        )

    def requested(self, time: float) -> Twist:
        """The twist that the robot is asked for."""
        since = time - self.begin
        return ZERO if since < 0.0 else self._twists[int(since) % len(self._twists)]

    def fault(self, seconds: float) -> float | None:
        """m/s at which the outline closes at the touch, if there is one in so many s; else None."""
        touch = self.run(self.requested, self.begin + seconds).touch
        return None if touch is None else touch.speed

    def _move(self) -> None:
        super()._move()
        if self.time > self.begin:
            outline = placed(self.platform.footprint, self.pose)
            self.pole.places.append(self.pole.after(outline, self.time - self.begin))
