"""Touches of bodies as the physics sees them: who, and how fast each surface came."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco

from swarmd.values import Array


@dataclass(frozen=True, slots=True)
class Contact:
    """Two things that touch: robot ids, or `wall/east`, `box/0`, `pole/0` for `b`.

    `speed_a` and `speed_b` in m/s: how fast each one's surface moves towards the other.
    """

    a: str
    b: str
    speed_a: float
    speed_b: float

    @property
    def closing_speed(self) -> float:
        """The speed of approach in m/s, negative while they separate."""
        return self.speed_a + self.speed_b


class Touches:
    """Reads the touching pairs of planar robots out of a model's contacts."""

    def __init__(self, model: mujoco.MjModel) -> None:
        # Body 0 is the arena; robot i is body i + 1.
        self._robots = [int(body) - 1 for body in model.geom_bodyid]
        self._names = [model.geom(geom).name for geom in range(model.ngeom)]

    def after_step(self, data: mujoco.MjData, qpos: Array, qvel: Array) -> list[Contact]:
        """The pairs in touch, each with its fastest approach, robots in order.

        `qpos` and `qvel` are those before the step: MuJoCo finds contacts there, and the solver
        has not yet stopped what was about to collide.
        """
        found = data.contact
        touching: dict[tuple[int, int], Contact] = {}
        for geoms, depth, place, frame in zip(
            found.geom, found.dist, found.pos, found.frame, strict=True
        ):
            if depth <= 0.0:
                a, b = (int(geom) for geom in geoms)
                speed_a = self._speed(a, place, frame[:3], qpos, qvel)
                speed_b = -self._speed(b, place, frame[:3], qpos, qvel)
                if self._order(b) < self._order(a):
                    a, b, speed_a, speed_b = b, a, speed_b, speed_a
                contact = Contact(self._names[a], self._names[b], speed_a, speed_b)
                touching[a, b] = _faster(touching.get((a, b)), contact)
        return [touching[pair] for pair in sorted(touching)]

    def _order(self, geom: int) -> tuple[bool, int]:
        """Robots in order, then the arena."""
        return self._robots[geom] < 0, geom

    def _speed(self, geom: int, place: Array, normal: Array, qpos: Array, qvel: Array) -> float:
        """The speed along `normal` of a geom's surface at `place`; 0 for the arena."""
        robot = self._robots[geom]
        if robot < 0:
            return 0.0
        x, y, _ = qpos[3 * robot : 3 * robot + 3]
        vx, vy, angular = qvel[3 * robot : 3 * robot + 3]
        vx, vy = vx - angular * (place[1] - y), vy + angular * (place[0] - x)
        return float(vx * normal[0] + vy * normal[1])


def fastest(contacts: Iterable[Contact]) -> list[Contact]:
    """One contact for each pair: its fastest approach."""
    found: dict[tuple[str, str], Contact] = {}
    for contact in contacts:
        found[contact.a, contact.b] = _faster(found.get((contact.a, contact.b)), contact)
    return list(found.values())


def _faster(known: Contact | None, contact: Contact) -> Contact:
    if known is None or contact.closing_speed > known.closing_speed:
        return contact
    return known
