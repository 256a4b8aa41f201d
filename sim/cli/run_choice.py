"""Which run a verb is about: of an experiment, of a demo, or a trace by its file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from swarmd.core.errors import ConfigError, unknown
from swarmd.sim.trace import Trace, load_trace

if TYPE_CHECKING:
    from swarmd.sim.experiments.results import Results

_DEMO = "trace.npz"


def chosen_run(
    place: Path, seed: int | None = None, variant: str | None = None
) -> tuple[Trace, str]:
    """The trace at `place` and its title.

    `place` is the folder of an experiment, that of a demo, or an .npz file. Of an experiment
    without `seed` and `variant`, the first finished run. ConfigError if there is no such run.
    """
    if place.is_file() or (place / _DEMO).is_file():
        if seed is not None or variant is not None:
            raise ConfigError(f"{place} is one run; leave out --seed and --variant")
        trace = load_trace(place if place.is_file() else place / _DEMO)
        return trace, title_of(trace)
    from swarmd.sim.experiments.results import load_results

    trace = _of_experiment(load_results(place), seed, variant)
    name = f", {variant}" if variant else ""
    return trace, f"{title_of(trace)}{name}"


def title_of(trace: Trace) -> str:
    """What a run was, in a few words."""
    meta = trace.meta
    name = meta.get("scenario") or meta.get("pattern")
    if not name:
        kinds = ", ".join(dict.fromkeys(trace.platforms))
        name = f"{len(trace.ids)} {kinds}"
    return f"{name}, seed {meta['seed']}" if "scenario" in meta and "seed" in meta else str(name)


def _of_experiment(results: Results, seed: int | None, variant: str | None) -> Trace:
    if variant is not None and variant not in results.variants:
        raise ConfigError(f"{results.folder}: {unknown('variant', variant, results.variants)}")
    runs = [run for run in results.runs if variant is None or run.variant.name == variant]
    if not runs:
        raise ConfigError(f"{results.folder}: no run of it has finished; run it first")
    found = [run for run in runs if seed is None or run.seed == seed]
    if not found:
        known = ", ".join(map(str, sorted({run.seed for run in runs})))
        raise ConfigError(f"{results.folder}: no finished run has seed {seed}; there are {known}")
    return results.traces[found[0].id]
