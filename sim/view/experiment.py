"""The recorded runs of an experiment, of a demo or in a file, for the page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Platform
from swarmd.settings.layered import Layered
from swarmd.settings.platforms import platform_of
from swarmd.sim.experiments.manifest import NAME as MANIFEST
from swarmd.sim.experiments.results import load_results
from swarmd.sim.experiments.store import trace_path
from swarmd.sim.scenarios.environment import fields_of
from swarmd.sim.trace import load_trace
from swarmd.sim.view.trace_source import RecordedRun, TraceSource

DEMO_TRACE = "trace.npz"


class Runs(NamedTuple):
    """Recorded runs: their names, and `load`, which gives the run of a name."""

    title: str
    names: Sequence[str]
    load: Callable[[str], RecordedRun]
    first: str


def source_of(place: Path, seed: int | None = None, variant: str | None = None) -> TraceSource:
    """The runs of `runs_of` for the page; the first is shown first. Errors as of `runs_of`."""
    return TraceSource(*runs_of(place, seed, variant))


def runs_of(place: Path, seed: int | None = None, variant: str | None = None) -> Runs:
    """The runs of an experiment's folder, or the trace of a demo's folder or in a file.

    `first` is the first run of `seed` and `variant`. ConfigError in one line if there is no trace,
    or such a run is not among them; `load` raises it for a damaged trace.
    """
    if place.is_dir() and (place / MANIFEST).exists():
        return _experiment(place, seed, variant)
    file = place / DEMO_TRACE if place.is_dir() else place
    if not file.exists() or file.suffix == ".mcap":
        raise ConfigError(
            f"{place}: there are no recorded runs; expected the folder of an experiment"
            " or a demo, or a trace (.npz); recordings of robots: swarmctl view --web FILE"
        )
    if seed is not None or variant is not None:
        raise ConfigError(f"{place}: one trace; --seed and --variant are for experiments")
    return Runs(str(place), [file.name], lambda _: RecordedRun(load_trace(file)), file.name)


def _experiment(folder: Path, seed: int | None, variant: str | None) -> Runs:
    results = load_results(folder)
    kept = [run for run in results.runs if trace_path(folder, run).exists()]
    if not kept:
        why = "no run has finished" if not results.runs else "they were run with --no-traces"
        raise ConfigError(f"{folder}: there are no traces ({why}); run the experiment with them")
    chosen = kept
    if variant is not None:
        chosen = [run for run in chosen if run.variant.name == variant]
        if not chosen:
            names = [name for name in results.variants if name]
            raise ConfigError(f"--variant: {unknown('variant', variant, names)}")
    if seed is not None:
        seeds = [str(run.seed) for run in chosen]
        chosen = [run for run in chosen if run.seed == seed]
        if not chosen:
            raise ConfigError(f"--seed: {unknown('seed', str(seed), seeds)}")
    runs = {run.title: run for run in kept}

    def load(name: str) -> RecordedRun:
        run = runs[name]
        effective = run.variant.effective
        fields = fields_of(Layered((str(folder), effective)), effective.get("fields", ()))
        return RecordedRun(load_trace(trace_path(folder, run)), fields, _platforms(effective))

    title = f"{results.plan.scenario}, {len(kept)} run{'s' * (len(kept) > 1)}"
    return Runs(title, list(runs), load, chosen[0].title)


def _platforms(effective: Mapping[str, Any]) -> dict[str, Platform]:
    """The platforms of a scenario by name."""
    files = effective.get("platforms", {})
    return {name: platform_of(name, Layered((name, data))) for name, data in files.items()}
