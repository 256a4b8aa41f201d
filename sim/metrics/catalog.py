"""All metrics by name: what they are, in which unit, from where, and their numbers of a run.

Names are stable: they are columns of tables and keys of files. `late` is the last 60 s of a run,
or its last half if that is shorter. A metric is None where the trace does not hold what it needs,
and where it has no value: the time to what never came.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from swarmd.errors import ConfigError, unknown
from swarmd.sim.metrics import (
    aggregation,
    area,
    effort,
    flock,
    gap,
    graph,
    protection,
    touches,
    voting,
)
from swarmd.sim.metrics.metric import (
    Metric,
    at_end,
    at_start,
    late,
    linked,
    linked_value,
    peak,
)
from swarmd.sim.metrics.window import late as late_part
from swarmd.sim.trace import Trace
from swarmd.values import Array

KAISER = "Kaiser et al. 2022, ICRA"
SNEATH = "single linkage: Sneath 1957; the link, 2 x protection threshold: ours"
GAGE = "Gage 1992, AUVS (sweep coverage)"
ZAVLANOS = "Zavlanos et al. 2011, Proc. IEEE 99"
VALENTINI = "Valentini et al. 2017, Front. Robot. AI 4:9"
WANG = "|u - u_wish| of Wang et al. 2017, IEEE T-RO 33; the scale: ours"
OURS = "ours"
KINEMATICS = "kinematics"

_one_cluster = linked(aggregation.is_one_cluster)

_ALL = (
    Metric(
        "mean_distance_to_centroid_start",
        "m",
        "robots' mean distance to their centroid at the start",
        KAISER,
        at_start(aggregation.distance_to_centroid),
        aggregation.distance_to_centroid,
    ),
    Metric(
        "mean_distance_to_centroid_30s",
        "m",
        "the same after 30 s",
        KAISER,
        lambda trace: aggregation.distance_at(trace, 30.0),
        aggregation.distance_to_centroid,
    ),
    Metric(
        "mean_distance_to_centroid_late",
        "m",
        "the same, mean of the last 60 s",
        KAISER,
        late(aggregation.distance_to_centroid),
        aggregation.distance_to_centroid,
    ),
    Metric(
        "mean_distance_to_centroid_end",
        "m",
        "the same at the end",
        KAISER,
        at_end(aggregation.distance_to_centroid),
        aggregation.distance_to_centroid,
    ),
    Metric(
        "clusters_end",
        "",
        "number of clusters at the end, lone robots included",
        SNEATH,
        at_end(linked(aggregation.cluster_counts)),
        linked(aggregation.cluster_counts),
    ),
    Metric(
        "largest_cluster",
        "robots",
        "robots in the largest cluster at the end",
        SNEATH,
        at_end(linked(aggregation.largest_cluster)),
        linked(aggregation.largest_cluster),
    ),
    Metric(
        "largest_cluster_share",
        "share",
        "the same as a share of the robots present",
        SNEATH,
        at_end(linked(aggregation.largest_cluster_share)),
        linked(aggregation.largest_cluster_share),
    ),
    Metric(
        "largest_cluster_peak",
        "robots",
        "robots in the largest cluster there ever was",
        SNEATH,
        peak(linked(aggregation.largest_cluster)),
        linked(aggregation.largest_cluster),
    ),
    Metric(
        "one_cluster_at_end",
        "0 or 1",
        "whether all robots are in one cluster at the end",
        SNEATH,
        at_end(_one_cluster),
        _one_cluster,
    ),
    Metric(
        "time_in_one_cluster_late",
        "share",
        "share of the last 60 s in which all are in one cluster",
        SNEATH,
        late(_one_cluster),
        _one_cluster,
    ),
    Metric(
        "gather_time",
        "s",
        "until first all are in one cluster and half as far from the centroid as at the start",
        OURS,
        linked_value(aggregation.gather_time),
    ),
    Metric(
        "nearest_neighbor_median_late",
        "m",
        "median distance to the nearest other robot in the last 60 s",
        "Clark and Evans 1954, Ecology 35",
        aggregation.nearest_neighbor_median,
        aggregation.nearest_neighbor_medians,
    ),
    Metric(
        "covered_area",
        "m2",
        "floor that has been within 0.5 m of a robot",
        GAGE,
        area.covered_area,
        area.covered_areas,
    ),
    Metric(
        "hull_area_end",
        "m2",
        "convex hull of the robots at the end",
        "Andrew 1979, Inf. Process. Lett. 9 (hull)",
        area.hull_area,
        area.hull_areas,
    ),
    Metric(
        "radio_connected",
        "share",
        "share of time in which the radio joins all robots, over others or not",
        ZAVLANOS,
        graph.radio_connected,
        graph.is_radio_connected,
        "more",
    ),
    Metric(
        "radio_components_end",
        "",
        "parts of the swarm at the end that cannot hear one another",
        ZAVLANOS,
        at_end(graph.radio_components),
        graph.radio_components,
        "less",
    ),
    Metric(
        "algebraic_connectivity_end",
        "",
        "second smallest eigenvalue of the radio graph's Laplacian at the end",
        "Fiedler 1973, Czechoslovak Math. J. 23",
        graph.algebraic_connectivity,
        graph.algebraic_connectivities,
        "more",
    ),
    Metric(
        "polarisation",
        "0 to 1",
        "how far the robots move one way, mean of the last 60 s; 0 for those that stand",
        "Vicsek et al. 1995, Phys. Rev. Lett. 75",
        late(flock.polarisations),
        flock.polarisations,
    ),
    Metric(
        "milling",
        "0 to 1",
        "how far they turn about their centroid, mean of the last 60 s",
        "Couzin et al. 2002, J. Theor. Biol. 218",
        late(flock.millings),
        flock.millings,
    ),
    Metric(
        "mean_speed",
        "m/s",
        "the robots' mean speed over the whole run",
        KINEMATICS,
        effort.mean_speed,
        effort.mean_speeds,
    ),
    Metric(
        "mean_speed_late_share",
        "share",
        "mean speed in the last 60 s as a share of the platform's highest",
        KINEMATICS,
        effort.speed_share,
        effort.speed_shares,
    ),
    Metric(
        "path_length",
        "m",
        "a robot's way over the whole run, mean of the robots",
        KINEMATICS,
        effort.path_length,
        effort.path_so_far,
    ),
    Metric(
        "consensus_time",
        "s",
        "until all robots hold one opinion, and keep it to the end",
        VALENTINI,
        voting.consensus_time,
        None,
        "less",
    ),
    Metric(
        "consensus_share",
        "share",
        "robots that hold the most common opinion at the end",
        VALENTINI,
        voting.consensus_share,
        voting.consensus_shares,
        "more",
    ),
    Metric(
        "consensus_opinion",
        "",
        "the opinion that all robots hold at the end",
        VALENTINI,
        voting.consensus_opinion,
    ),
    Metric(
        "robot_contacts",
        "",
        "touches of two robots, each once however long",
        OURS,
        touches.contacts_between_robots,
        None,
        "less",
    ),
    Metric(
        "arena_contacts",
        "",
        "touches of a robot with a wall, fixed box or pole",
        OURS,
        touches.contacts_with_arena,
        None,
        "less",
    ),
    Metric(
        "box_contacts",
        "",
        "touches of a robot with a movable box",
        OURS,
        touches.contacts_with_boxes,
    ),
    Metric(
        "hardest_contact",
        "m/s",
        "fastest approach in any touch of two robots",
        OURS,
        touches.hardest_contact,
        None,
        "less",
    ),
    Metric(
        "minimum_gap",
        "m",
        "smallest distance between two robots' footprints",
        "Ericson 2005, Real-Time Collision Detection",
        gap.minimum_gap,
        gap.minimum_gaps,
        "more",
    ),
    Metric(
        "protection_duty",
        "share",
        "sweeps in which protection replaced or cut the wish",
        KAISER,
        protection.protection_duty,
        protection.protection_duties,
        "less",
    ),
    Metric(
        "protection_duty_late",
        "share",
        "the same in the last 60 s",
        KAISER,
        lambda trace: protection.protection_duty(late_part(trace)),
        protection.protection_duties,
        "less",
    ),
    Metric(
        "command_alteration",
        "share",
        "mean change of the wished command, 1 being full speed",
        WANG,
        protection.command_alteration,
        protection.mean_alterations,
        "less",
    ),
    Metric(
        "hold_share",
        "share",
        "running time in which a hold kept a robot standing",
        OURS,
        protection.hold_share,
        None,
        "less",
    ),
)

METRICS: Mapping[str, Metric] = MappingProxyType({metric.name: metric for metric in _ALL})


def measure(trace: Trace, names: Iterable[str] | None = None) -> dict[str, float | None]:
    """The value of each named metric, all if None; true is 1. ConfigError for an unknown name."""
    wanted = [metric_of(name) for name in (METRICS if names is None else names)]
    return {metric.name: _plain(metric.value(trace)) for metric in wanted}


def series(trace: Trace, name: str) -> Array | None:
    """(T,) a metric over time, NaN where unknown; None if the trace lacks what it needs.

    ConfigError if there is no such metric, or if it is but one number of a whole run.
    """
    metric = metric_of(name)
    if metric.series is None:
        known = ", ".join(one.name for one in METRICS.values() if one.series is not None)
        raise ConfigError(
            f"metric {name} is one number of a whole run; over time there are {known}"
        )
    return metric.series(trace)


def metric_of(name: str) -> Metric:
    """The metric of that name; ConfigError with the nearest name if there is none."""
    if name not in METRICS:
        raise ConfigError(unknown("metric", name, METRICS))
    return METRICS[name]


def table() -> list[tuple[str, str, str, str]]:
    """(name, unit, meaning, source) of all metrics, for a reader."""
    return [(one.name, one.unit or "-", one.meaning, one.source) for one in METRICS.values()]


def _plain(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
