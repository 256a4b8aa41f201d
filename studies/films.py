"""A short film of each pattern, PATTERN/film.gif for its page, and FIGURES for docs/figures.

`make films` runs it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from studies.outcomes.catalog import MODULES
from studies.safety import beside
from swarmd.core.errors import unknown
from swarmd.operator.texts.values import megabytes
from swarmd.sim.film.film import FilmSettings, make_film
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.view.trace_source import RecordedRun

FIGURES = ("demo", "beside_wall")
"""The films of pages of docs/, not of a pattern."""
SECONDS = 6.0
"""How long a film is, without its last frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """The first `stop` s of a scenario, with values by dotted key, and how they are filmed.

    `scenario`: its name, or the scenario itself, to which `sets` does not apply.
    """

    scenario: str | Scenario
    title: str
    stop: float
    sets: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    colour: str = "robot"
    size: int = 400


def _film_of(pattern: str) -> Shot:
    """The film of its scenario; FILM of its outcomes has what differs."""
    look = dict(getattr(MODULES[pattern], "FILM", {}))
    title = "; ".join(filter(None, (pattern, look.pop("title", ""))))
    stop = look.pop("stop", None) or load_scenario(pattern).duration
    return Shot(scenario=pattern, title=title, stop=stop, **look)


def shots() -> Mapping[str, Shot]:
    """The films by name: those of FIGURES, and that of each pattern."""
    demo = Shot(
        scenario="paper_exp2",
        title="Seven robots agree on a distance, and keep it",
        stop=40.0,
        colour="opinion",
        size=640,
    )
    cell = beside.Cell("turtlebot4", "wall", 0.3, 0.0)
    beside_wall = Shot(
        scenario=beside.scenario_for(cell, beside.place_of(cell)),
        title="A TurtleBot 4 set down 0.3 m from a wall",
        stop=60.0,
        seed=cell.seed,
        colour="state",
    )
    figures = dict(zip(FIGURES, (demo, beside_wall), strict=True))
    return {**figures, **{name: _film_of(name) for name in MODULES}}


def shoot(name: str, out: Path) -> Path:
    """Simulate and film one shot; the file."""
    shot = shots()[name]
    scenario = shot.scenario
    if isinstance(scenario, str):
        scenario = load_scenario(scenario, {"duration": shot.stop, **shot.sets})
    settings = FilmSettings(
        colour=shot.colour,
        speed=shot.stop / SECONDS,
        size=shot.size,
        stop=shot.stop,
    )
    path = out / f"{name}.gif" if name in FIGURES else out / name / "film.gif"
    path.parent.mkdir(parents=True, exist_ok=True)
    run = RecordedRun(simulate_run(scenario, shot.seed, seconds=shot.stop), scenario.fields)
    make_film(run, path, shot.title, settings)
    return path


def main(arguments: Sequence[str] | None = None) -> int:
    """Film what the command line names."""
    parser = argparse.ArgumentParser(prog="python -m studies.films", description=__doc__)
    parser.add_argument("out", nargs="?", type=Path, default=Path("build/films"), help="folder")
    parser.add_argument("films", nargs="*", metavar="FILM", help="default: all")
    options = parser.parse_args(arguments)
    known = shots()
    for name in options.films:
        if name not in known:
            parser.error(unknown("film", name, known))
    for name in options.films or known:
        made = shoot(name, options.out)
        print(f"{made}: {megabytes(made.stat().st_size, 2)}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
