"""Survival curves: the share of runs in which an event has not happened yet, over time."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.statistics import LEVEL
from swarmd.sim.plots.bands import Legend, finish_series, new_series_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MAX_BANDS = 3  # variants up to which intervals are drawn


@dataclass(frozen=True, slots=True, eq=False)
class Times:
    """Times to an event in s."""

    times: Array  # (runs,) NaN: the event never happened
    ends: Array  # (runs,) the end of each run


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A survival curve as a step function with its interval."""

    t: Array  # (k,) s of the steps
    share: Array  # (k,) from each step on
    low: Array  # (k,) lower bound of the interval, NaN without one
    high: Array  # (k,)
    censored: Array  # (c,) s, the ends of runs without the event


def survival_curve(times: Times) -> Curve:
    """The Kaplan-Meier estimate of the share of runs without the event so far.

    Kaplan and Meier, "Nonparametric Estimation from Incomplete Observations", JASA 53, 1958. A run
    without the event is censored at its end. The 95 % interval is Greenwood's on the log-log scale,
    by scipy; NaN where it does not exist. The curve begins at 0 s with the share 1. It ends with
    the last event or the last censored run.
    """
    from scipy.stats import CensoredData, ecdf

    is_known = np.isfinite(times.times)
    censored = times.ends[~is_known]
    estimate = ecdf(CensoredData(uncensored=times.times[is_known], right=censored)).sf
    with np.errstate(all="ignore"), warnings.catch_warnings():
        # A share of 1 or 0 (no run has had the event, or each run) gives the logarithm of 0.
        warnings.simplefilter("ignore", RuntimeWarning)
        interval = estimate.confidence_interval(LEVEL, method="log-log")
    t = np.concatenate(([0.0], estimate.quantiles))
    share, low, high = (
        np.concatenate(([1.0], values))
        for values in (
            estimate.probabilities,
            interval.low.probabilities,
            interval.high.probabilities,
        )
    )
    if len(censored) and censored.max() > t[-1]:
        t = np.append(t, censored.max())
        share, low, high = (np.append(values, values[-1]) for values in (share, low, high))
    return Curve(t, share, low, high, np.sort(censored))


def survival_figure(
    facets: Mapping[str, Mapping[str, Times]],
    *,
    event: str,
    title: str = "",
    width: float | None = None,
    legend_title: str = "",
) -> Figure:
    """A figure of survival curves, with a panel for each facet and a line for each variant.

    A small stroke marks the end of a run without the event. With up to three variants, bands show
    the 95 % interval. The axis of time ends with the last event or the last run without the event.
    `facets`: by panel, the times of each variant. `event`: a noun, such as `gathering`. `width`: in
    inches, for a paper. SwarmError without a run.
    """
    # 1. The variants of each panel that have runs.
    with_runs = {
        panel: {name: times for name, times in variants.items() if times.times.size}
        for panel, variants in facets.items()
    }
    drawn = {panel: variants for panel, variants in with_runs.items() if variants}
    if not drawn:
        raise SwarmError(f"{event}: no run: nothing to draw")
    legend = Legend.of(
        {name: times.times.size for name, times in variants.items()} for variants in drawn.values()
    )

    # 2. The curves.
    has_band = len(legend.counts) <= _MAX_BANDS
    figure, panels = new_series_figure(list(drawn), legend, width)
    last_time = 0.0
    for axes, variants in zip(panels, drawn.values(), strict=True):
        for name, times in variants.items():
            curve = survival_curve(times)
            _paint(axes, curve, legend.style(name), legend.text(name), has_band=has_band)
            last_time = max(last_time, float(curve.t[-1]))
    panels[0].set_ylim(-0.03, 1.03)
    panels[0].set_xlim(0.0, last_time)

    band = ", band: its 95 % interval" if has_band else ""
    explanation = f"Kaplan-Meier{band}; stroke: a run ended without it"
    text = f"share of runs without {event}"
    return finish_series(figure, panels, text, title, explanation, legend, width, legend_title)


def _paint(axes: Axes, curve: Curve, look: tuple[str, str], label: str, *, has_band: bool) -> None:
    colour, style = look
    if has_band:
        # By corners: `step="post"` leaves out the segment before a bound that does not exist, such
        # as the last before the share is 0.
        corners = np.repeat(curve.t, 2)[1:-1]
        low, high = (np.repeat(bound, 2)[:-2] for bound in (curve.low, curve.high))
        axes.fill_between(corners, low, high, color=colour, alpha=0.16, linewidth=0.0)
    axes.step(curve.t, curve.share, where="post", color=colour, linestyle=style, linewidth=1.8,
              zorder=3.0, label=label, clip_on=False)  # fmt: skip
    if not len(curve.censored):  # an empty line outside of the axes has no extent for the layout
        return
    at = np.searchsorted(curve.t, curve.censored, side="right") - 1
    axes.plot(curve.censored, curve.share[at], linestyle="none", marker="|", color=colour,
              markersize=7.0, zorder=3.5, clip_on=False)  # fmt: skip
