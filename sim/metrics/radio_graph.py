"""Metrics of the radio graph, whose edges (links) connect robots that can hear each other.

Links are computed from true positions, by the range and line of sight of `meta["radio"]`. Without
range and line of sight all robots are linked. Loss and delay of messages do not matter. Only
present robots are nodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics import pairs
from swarmd.sim.metrics.metric import SHARE, Metric, at_end
from swarmd.sim.metrics.pairs import Pairs
from swarmd.sim.metrics.window import arena_of, mean, presence, tall_boxes
from swarmd.sim.trace import Trace
from swarmd.sim.world.geometry import transform
from swarmd.sim.world.line_of_sight import LineOfSight


def radio_range(trace: Trace) -> float:
    """The range in m of the radio; inf if the trace gives none."""
    radio = trace.meta.get("radio")
    if not isinstance(radio, Mapping) or radio.get("neighborhood") != "range":
        return float("inf")
    return float(radio.get("range") or np.inf)


def radio_links(trace: Trace) -> Iterator[Pairs]:
    """Yield all links of a trace, those of some consecutive instants at a time.

    The links are those of the disk graph of Zavlanos, Egerstedt and Pappas 2011 (Graph-Theoretic
    Connectivity Control of Mobile Robot Networks, Proc. IEEE 99). With `radio.line_of_sight`, links
    that obstacles block are left out. `instant` of a link is the index of its instant in the trace.
    """
    sight = _sight(trace)
    is_present = presence(trace)
    reach = radio_range(trace)
    for span in pairs.spans(*is_present.shape):
        links = pairs.near(trace.pose[span, :, :2], is_present[span], reach)
        instant = links.instant + span.start
        links = Pairs(instant, links.a, links.b, links.distance)
        yield links if sight is None else _seen(trace, sight, links)


def radio_components(trace: Trace) -> Array:
    """(T,) the number of connected components; NaN while no robot is present."""
    is_present = presence(trace)
    n = is_present.shape[1]
    counts = is_present.sum(axis=1).astype(np.float64)
    if _is_complete(trace):
        return np.where(counts > 0.0, 1.0, np.nan)
    for links in radio_links(trace):
        if len(links.instant):
            low = int(links.instant.min())
            high = int(links.instant.max()) + 1
            node = (links.instant - low) * n
            root = pairs.components((high - low) * n, node + links.a, node + links.b)
            # `counts` begins with a component for each robot. Each node that is not the lowest of
            # its component makes one component less.
            is_joined = root != np.arange(len(root))
            counts[low:high] -= is_joined.reshape(-1, n).sum(axis=1)
    return np.where(counts > 0.0, counts, np.nan)


def is_radio_connected(trace: Trace) -> Array:
    """(T,) 1 where the graph of present robots is connected, else 0; NaN without one."""
    counts = radio_components(trace)
    return np.where(np.isnan(counts), np.nan, counts == 1.0)


def radio_connected(trace: Trace) -> float | None:
    """The share of time in which the graph is connected."""
    return mean(is_radio_connected(trace))


def _is_complete(trace: Trace) -> bool:
    return bool(np.isinf(radio_range(trace))) and _sight(trace) is None


def _sight(trace: Trace) -> LineOfSight | None:
    """The obstacles that block the radio; None without line of sight or without a known arena."""
    radio = trace.meta.get("radio")
    if not isinstance(radio, Mapping) or not radio.get("line_of_sight"):
        return None
    arena = arena_of(trace)
    return None if arena is None else LineOfSight(arena)


def _seen(trace: Trace, sight: LineOfSight, links: Pairs) -> Pairs:
    """The links with line of sight."""
    here = trace.pose[links.instant, links.a, :2]
    there = trace.pose[links.instant, links.b, :2]
    movable = tall_boxes(trace)
    if movable is None:
        is_clear = sight.is_clear(here, there)
    else:
        is_clear = np.ones(len(here), dtype=bool)
        for instant in np.unique(links.instant):
            of = links.instant == instant
            movable_boxes = transform(movable[0], movable[1][instant])
            is_clear[of] = sight.is_clear(here[of], there[of], movable_boxes)
    return pairs.chosen(links, is_clear)


_ZAVLANOS = "Zavlanos et al. 2011, Proc. IEEE 99"

METRICS = (
    Metric("radio_connected", "share", "share of time in which the radio graph is connected",
           _ZAVLANOS, radio_connected, is_radio_connected, "more", bounds=SHARE),
    Metric("radio_components_end", "", "connected components of the radio graph at the end",
           _ZAVLANOS, at_end(radio_components), radio_components, "less"),
)  # fmt: skip
