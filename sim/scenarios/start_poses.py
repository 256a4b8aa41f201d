"""Start poses of all groups for a seed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array
from swarmd.settings.layered import Keys, Layered, dotted
from swarmd.settings.yamlfile import Data
from swarmd.sim.scenarios.schema import StartSection
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.layouts import REGULAR, Placement, chain, moved, scatter
from swarmd.sim.world.seeding import generator

_TURNABLE = ("center", "heading_deg")
KEYS: Mapping[str, tuple[str, ...]] = {
    "row": ("spacing", *_TURNABLE),
    "paper": ("spacing", *_TURNABLE),
    "grid": ("spacing", *_TURNABLE),
    "ring": ("radius", *_TURNABLE),
    "random": ("clearance", "size", *_TURNABLE),
    "chain": ("near", "far", *_TURNABLE),
    "list": ("poses",),
}
"""The keys of each layout."""

_SEEDED = ("random", "chain")
_SPACING = 1.0  # m, the default, as the next two
_RADIUS = 1.5
_CLEARANCE = 0.2


@dataclass(frozen=True, slots=True)
class StartGroup:
    """Robots (rows) with a common layout. `where` names file and key, `key` the key alone."""

    where: str
    key: str
    rows: Sequence[int]
    start: StartSection


@dataclass(frozen=True, slots=True, eq=False)
class StartPoses:
    """The start poses of a scenario as a function of the seed."""

    names: Sequence[str]
    footprints: Sequence[Array]
    arena: Arena
    parts: Sequence[StartGroup]

    def __call__(self, seed: int) -> Array:
        """Poses (n, 3) x, y in m and yaw in rad.

        Random layouts are placed last, in a random order of groups and robots, so that the order in
        the file has no effect.
        """
        placement = self.check()
        seeded = [part for part in self.parts if layout_of(part.start) in _SEEDED]
        seeded.sort(key=lambda part: part.key)
        for index in generator(seed, "starts", "").permutation(len(seeded)).tolist():
            _place(placement, seeded[index], seed)
        return placement.poses

    def check(self) -> Placement:
        """The robots of layouts without randomness; ConfigError if they do not fit."""
        placement = Placement(self.names, self.footprints, self.arena)
        for part in self.parts:
            if layout_of(part.start) not in _SEEDED:
                _place(placement, part, 0)
        return placement


def layout_of(start: StartSection) -> str:
    """The layout, or the default one."""
    return start.layout or ("grid" if start.poses is None else "list")


def without_stale(sources: Iterable[tuple[str, Data]]) -> list[tuple[str, Data]]:
    """Drop the keys of `start` that do not fit the layout of a stronger source; returns the rest.

    `sources`: strongest first. So a file may change the layout of the file that it extends, and
    need not remove the keys of the old layout.
    """
    kept: list[tuple[str, Data]] = []
    layouts: dict[str, str] = {}
    for source, data in sources:
        data = deepcopy(data)
        for key, start in _sections(data):
            if key in layouts:
                wanted = KEYS.get(layouts[key], tuple(start))
                for name in [name for name in start if name not in wanted]:
                    del start[name]
            elif start.get("layout") is not None or start.get("poses") is not None:
                layouts[key] = str(start.get("layout") or "list")
        kept.append((source, data))
    return kept


def _sections(data: Data) -> Iterator[tuple[str, Data]]:
    """The `start` sections by group; that of the whole swarm under an empty name."""
    groups = data.get("groups")
    holders = [("", data), *(groups.items() if isinstance(groups, dict) else ())]
    for name, holder in holders:
        if isinstance(holder, dict) and isinstance(holder.get("start"), dict):
            yield name, holder["start"]


def start_group_of(
    layers: Layered, keys: Keys, start: StartSection, rows: Sequence[int]
) -> StartGroup:
    """A checked group; ConfigError for unknown layouts and for keys of another layout."""
    layout = layout_of(start)
    key = dotted(keys)
    if layout not in KEYS:
        text = f"{key}.layout: {unknown('layout', layout, KEYS)}"
        raise layers.error((*keys, "layout"), text)
    for name in StartSection.__struct_fields__[1:]:
        if getattr(start, name) is not None and name not in KEYS[layout]:
            wanted = ", ".join(KEYS[layout])
            text = f"{key}.{name} means nothing with layout {layout}; expected there: {wanted}"
            raise layers.error((*keys, name), text)
    fault = _misfit(layout, start, len(rows))
    if fault:
        raise layers.error(keys, f"{key} {fault}")
    return StartGroup(str(layers.error(keys, key)), key, tuple(rows), start)


def _misfit(layout: str, start: StartSection, n: int) -> str:
    if layout == "chain":
        if start.near is None or start.far is None:
            return "needs near and far: how far in m each robot is from the nearest before it"
        if start.near > start.far:
            return f"has near {start.near:g} above far {start.far:g}; expected near up to far"
    if layout == "list" and len(start.poses or ()) != n:
        return f"has {len(start.poses or ())} poses; expected {n}, one a robot"
    if layout == "random" and start.center is not None and start.size is None:
        return "has a center and no size; give size, such as [2, 2], or leave center out"
    return ""


def _place(placement: Placement, part: StartGroup, seed: int) -> None:
    """Place the robots of a group by its layout; `seed`: of random layouts.

    ConfigError with the file and key of the group if a robot does not fit.
    """
    start = part.start
    layout = layout_of(part.start)
    # A random layout must not depend on the order of the ids in the file.
    rows = sorted(part.rows) if layout in _SEEDED else part.rows
    center = start.center or (0.0, 0.0)
    # rad. Without a heading, robots of random layouts have random headings.
    heading = None if start.heading_deg is None else math.radians(start.heading_deg)
    rng = generator(seed, "starts", part.key)
    try:
        if layout == "chain":
            near = start.near or 0.0
            far = start.far or 0.0
            chain(placement, rows, rng, near=near, far=far, center=center, heading=heading)
        elif layout == "random":
            scatter(
                placement,
                rows,
                rng,
                clearance=_CLEARANCE if start.clearance is None else start.clearance,
                center=center,
                size=start.size,
                heading=heading,
            )
        elif layout == "list":
            poses = np.array(start.poses, dtype=np.float64)
            poses[:, 2] = np.radians(poses[:, 2])
            placement.place_all(rows, poses)
        else:  # row, paper or grid by the spacing, ring by the radius
            radius = start.radius or _RADIUS
            spacing = start.spacing or _SPACING
            size = radius if layout == "ring" else spacing
            poses = moved(REGULAR[layout](len(rows), size), center, heading or 0.0)
            placement.place_all(rows, poses)
    except ConfigError as error:
        raise ConfigError(f"{part.where}: {error}") from error
