"""Who can hear whom: the radio graph, from the radio's range at the robots' true places.

Only present robots have a radio. Where `meta["radio"]` gives no range everyone hears everyone.
Loss and delay do not count: a link is there if it ever lets something through.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from swarmd.sim.metrics.aggregation import cluster_counts
from swarmd.sim.metrics.window import last, mean, presence
from swarmd.sim.trace import Trace
from swarmd.values import Array


def radio_range(trace: Trace) -> float:
    """How far in m a robot is heard; inf if the trace gives no range."""
    radio = trace.meta.get("radio")
    if not isinstance(radio, Mapping) or radio.get("neighborhood") != "range":
        return float("inf")
    return float(radio.get("range") or np.inf)


def radio_components(trace: Trace) -> Array:
    """(T,) the number of parts that cannot hear one another; NaN while no robot is present.

    Components of the disk graph, one of the models of Zavlanos, Egerstedt and Pappas 2011 (Proc.
    IEEE 99, Graph-Theoretic Connectivity Control of Mobile Robot Networks).
    """
    is_here = presence(trace)
    reach = radio_range(trace)
    if np.isinf(reach):
        return np.where(is_here.any(axis=1), 1.0, np.nan)
    counts = cluster_counts(trace, reach).astype(np.float64)
    return np.where(is_here.any(axis=1), counts, np.nan)


def is_radio_connected(trace: Trace) -> Array:
    """(T,) 1 where links join all present robots, over others or not, else 0; NaN if none is."""
    counts = radio_components(trace)
    return np.where(np.isnan(counts), np.nan, counts == 1.0)


def radio_connected(trace: Trace) -> float | None:
    """The share of time in which links join all present robots."""
    return mean(is_radio_connected(trace))


def algebraic_connectivities(trace: Trace) -> Array:
    """(T,) the second smallest eigenvalue of the graph's Laplacian: 0 if it is in parts.

    Fiedler 1973 (Algebraic connectivity of graphs, Czechoslovak Math. J. 23). n if all n hear all,
    and by our own convention 0 for a robot alone. NaN while none is present.
    """
    is_here = presence(trace)
    reach = radio_range(trace)
    values = np.empty(len(trace.t))
    for at, place in enumerate(trace.pose[..., :2]):
        values[at] = _fiedler(place[is_here[at]], reach)
    return values


def algebraic_connectivity(trace: Trace) -> float | None:
    """That eigenvalue at the last instant."""
    values = algebraic_connectivities(last(trace))
    return float(values[0]) if len(values) and not np.isnan(values[0]) else None


def _fiedler(place: Array, reach: float) -> float:
    n = len(place)
    if n < 2 or np.isinf(reach):
        return float("nan") if n == 0 else float(n if n > 1 else 0)
    away = place[:, None] - place[None]
    links = (np.hypot(away[..., 0], away[..., 1]) <= reach).astype(np.float64)
    laplacian = np.diag(links.sum(axis=1)) - links
    return max(float(np.linalg.eigvalsh(laplacian)[1]), 0.0)
