"""A short film of each pattern: film_PATTERN.gif for docs/patterns, and demo.gif for README.md.

`make films` runs it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from swarmd.core.errors import unknown
from swarmd.sim.film.film import FilmSettings, make_film
from swarmd.sim.film.renderer import Camera
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.view.trace_source import RecordedRun
from swarmd.texts.values import megabytes

SECONDS = 6.0
"""How long a film is, without its last frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """The first `stop` s of a scenario, with values by dotted key, and how they are filmed."""

    scenario: str
    title: str
    stop: float
    sets: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    colour: str = "robot"
    camera: Camera = "perspective"
    size: tuple[int, int] = (480, 340)


def _even(name: str, value: float) -> Mapping[str, Any]:
    """A field of one value."""
    return {"kind": "gaussian", "name": name, "center": [0, 0], "sigma": 1000, "peak": value}


_ROOM = {"arena.size": [6, 6]}
_VOTE = {"groups.tb3.parameters": {"opinions": 3}, "duration": 40}
_OPTIONS = {"fields": [_even("quality_0", 0.6), _even("quality_1", 0.9)]}


def _shot(pattern: str, title: str, stop: float, colour: str, **more: Any) -> Shot:
    """A pattern that needs no scenario of its own: 25 robots that stand, and what they report."""
    sets = {
        "groups.tb3.pattern": pattern,
        "groups.tb3.count": 25,
        "start": {"layout": "grid", "spacing": 1.0},
        "radio": {"neighborhood": "range", "range": 1.5},
        **_ROOM,
        **more,
    }
    text = f"{pattern}; {title}"
    return Shot(scenario="flocking", title=text, stop=stop, sets=sets, colour=colour)


SHOTS = MappingProxyType(
    {
        "demo": Shot(
            scenario="paper_exp2",
            title="Seven robots agree on a distance, and keep it",
            stop=40.0,
            colour="opinion",
            size=(640, 420),
        ),
        "film_attraction": Shot(scenario="aggregation", title="attraction", stop=90.0),
        "film_best_of_n": _shot(
            "best_of_n", "quality 0.6 and 0.9", 120.0, "report:opinion", **_OPTIONS
        ),
        "film_chain_formation": Shot(
            scenario="chain_formation",
            title="chain_formation, from the nest in the middle to the goal on the right",
            stop=150.0,
            camera="top",
        ),
        "film_circle_formation": Shot(
            scenario="circle_formation",
            title="circle_formation; one robot is removed",
            stop=60.0,
            sets=_ROOM,
        ),
        "film_collective_perception": Shot(
            scenario="collective_perception",
            title="collective_perception; 62 % is black",
            stop=160.0,
            colour="opinion",
            camera="top",
        ),
        "film_cooperative_transport": Shot(
            scenario="cooperative_transport",
            title="cooperative_transport, to a lamp on the right",
            stop=75.0,
            camera="top",
        ),
        "film_cross_inhibition": _shot(
            "cross_inhibition", "quality 0.6 and 0.9", 120.0, "report:opinion", **_OPTIONS
        ),
        "film_cue_aggregation": Shot(
            scenario="cue_aggregation",
            title="cue_aggregation; the right is warmer",
            stop=240.0,
            camera="top",
        ),
        "film_discussed_dispersion": Shot(
            scenario="paper_exp2", title="discussed_dispersion", stop=40.0, colour="opinion"
        ),
        "film_dispersion": Shot(scenario="dispersion", title="dispersion", stop=40.0, sets=_ROOM),
        "film_drive": Shot(scenario="drive", title="drive, towards a wall", stop=25.0),
        "film_firefly_synchronization": _shot(
            "firefly_synchronization", "phase", 20.0, "report:phase"
        ),
        "film_flocking": Shot(scenario="flocking", title="flocking", stop=40.0, seed=1),
        "film_foraging": Shot(
            scenario="foraging",
            title="foraging, from the source on the right to the nest",
            stop=120.0,
            camera="top",
        ),
        "film_hexagonal_lattice": Shot(
            scenario="hexagonal_lattice", title="hexagonal_lattice", stop=90.0, camera="top"
        ),
        "film_hop_gradient": _shot("hop_gradient", "hops to the leader", 20.0, "report:hops"),
        "film_leader_following": Shot(
            scenario="leader_following",
            title="leader_following; the leader is removed after 60 s",
            stop=90.0,
        ),
        "film_levy_walk": Shot(
            scenario="random_walk",
            title="levy_walk",
            stop=120.0,
            sets={"groups.tb3.pattern": "levy_walk"},
        ),
        "film_line_formation": Shot(
            scenario="line_formation",
            title="line_formation; one robot is removed",
            stop=60.0,
            sets=_ROOM,
        ),
        "film_lloyd_coverage": Shot(
            scenario="lloyd_coverage", title="lloyd_coverage, from a corner", stop=90.0
        ),
        "film_majority_rule": Shot(
            scenario="voting_range", title="majority_rule", stop=30.0, colour="opinion", sets=_VOTE
        ),
        "film_one_bit_aggregation": Shot(
            scenario="one_bit_aggregation", title="one_bit_aggregation", stop=240.0
        ),
        "film_patrol": Shot(
            scenario="patrol", title="patrol, nine places", stop=150.0, camera="top"
        ),
        "film_phototaxis": Shot(
            scenario="phototaxis", title="phototaxis, to a lamp on the right", stop=60.0
        ),
        "film_policy": Shot(
            scenario="aggregation",
            title="policy, a learned network",
            stop=30.0,
            sets={
                "groups.tb3.pattern": "policy",
                "groups.tb3.count": 4,
                "arena": {"size": [4, 4], "boxes": [], "poles": []},
            },
        ),
        "film_random_walk": Shot(scenario="random_walk", title="random_walk", stop=60.0),
        "film_response_threshold": _shot(
            "response_threshold",
            "a stimulus is strongest in the middle",
            60.0,
            "report:works",
            fields=[{**_even("stimulus", 12.0), "sigma": 1.5}],
        ),
        "film_shelter_choice": Shot(
            scenario="flocking",
            title="shelter_choice, two equal shelters",
            stop=400.0,
            colour="report:state",
            camera="top",
            sets={
                "groups.tb3.pattern": "shelter_choice",
                "groups.tb3.count": 10,
                "groups.tb3.parameters": {"capacity": 10, "near": 1.8},
                "arena.size": [8, 4],
                "start.size": [7, 3],
                "radio": {"range_and_bearing": True},
                "fields": [
                    {
                        "kind": "floor",
                        "name": "ground",
                        "patches": [
                            {"disc": [-2, 0, 0.9], "colour": 0.2},
                            {"disc": [2, 0, 0.9], "colour": 0.2},
                        ],
                    }
                ],
            },
        ),
        "film_shepherding": Shot(
            scenario="shepherding",
            title="shepherding, to the goal on the left",
            stop=240.0,
            colour="report:role",
            camera="top",
        ),
        "film_source_seeking": Shot(
            scenario="source_seeking", title="source_seeking, up to the right", stop=120.0
        ),
        "film_trimmed_consensus": _shot("trimmed_consensus", "value", 60.0, "report:value"),
        "film_vicsek_alignment": Shot(
            scenario="flocking",
            title="vicsek_alignment, noise 0.5",
            stop=30.0,
            sets={
                "groups.tb3.pattern": "vicsek_alignment",
                "groups.tb3.count": 12,
                "groups.tb3.parameters": {"noise": 0.5},
                "start.size": [4, 4],
                "radio": {"range_and_bearing": True},
            },
        ),
        "film_voter_model": Shot(
            scenario="voting_range",
            title="voter_model",
            stop=40.0,
            colour="opinion",
            sets={**_VOTE, "groups.tb3.pattern": "voter_model"},
        ),
    }
)


def shoot(name: str, out: Path) -> Path:
    """Simulate and film one shot; the file."""
    shot = SHOTS[name]
    scenario = load_scenario(shot.scenario, {"duration": shot.stop, **shot.sets})
    settings = FilmSettings(
        camera=shot.camera,
        colour=shot.colour,
        speed=shot.stop / SECONDS,
        size=shot.size,
        stop=shot.stop,
    )
    path = out / f"{name}.gif"
    run = RecordedRun(simulate_run(scenario, shot.seed), scenario.fields)
    make_film(run, path, shot.title, settings)
    return path


def main(arguments: Sequence[str] | None = None) -> int:
    """Film what the command line names."""
    parser = argparse.ArgumentParser(prog="python -m studies.films", description=__doc__)
    parser.add_argument("out", nargs="?", type=Path, default=Path("build/films"), help="folder")
    parser.add_argument("films", nargs="*", metavar="FILM", help="default: all")
    options = parser.parse_args(arguments)
    for name in options.films:
        if name not in SHOTS:
            parser.error(unknown("film", name, SHOTS))
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.films or SHOTS:
        made = shoot(name, options.out)
        print(f"{made}: {megabytes(made.stat().st_size, 2)}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
