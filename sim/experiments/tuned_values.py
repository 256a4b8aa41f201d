"""The result of a tuning as a scenario's file, with its evidence in comments."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarmd.settings.yamlfile import text_of
from swarmd.sim.experiments.compare import Difference
from swarmd.sim.experiments.manifest import Manifest
from swarmd.sim.experiments.search_space import ParameterSpace
from swarmd.sim.experiments.statistics import interval, number
from swarmd.sim.scenarios.overrides import nested

if TYPE_CHECKING:
    from swarmd.sim.experiments.tune import Space, Tuning

_SOFTWARE = ("swarmd", "python", "numpy", "mujoco", "kernels")


def tuned_document(
    found: Tuning, scenario: str, sets: Mapping[str, Any], manifest: Manifest
) -> str:
    """A scenario that extends the tuned one, with the best values, and what is known of them.

    Values of patterns stand in a comment as a platform's file has them, too.
    """
    comments = [line for text in _evidence(found, manifest) for line in _wrapped(text)]
    base = str(Path(scenario).absolute()) if scenario.endswith(".yaml") else scenario
    overrides = {**sets, **found.best.overrides}
    body = {"extends": base, **nested(overrides, found.candidates[-1].effective)}
    platform = platform_values(found.space, found.best.values) if found.best.number else {}
    if platform:
        comments += ["", "In a platform's file, for all its robots and scenarios:"]
        comments += [f"  {line}" for line in _yaml({"patterns": platform}).splitlines()]
    head = [f"# {line}".rstrip() for line in comments]
    return "\n".join([*head, "", _yaml(body)])


def platform_values(space: Space, values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The values of patterns' parameters, as `patterns` of a platform's file holds them."""
    found: dict[str, dict[str, Any]] = {}
    for one in space.parameters if isinstance(space, ParameterSpace) else ():
        if one.pattern:
            found.setdefault(one.pattern, {})[one.param] = values[one.name]
    return found


def _evidence(found: Tuning, manifest: Manifest) -> Iterator[str]:
    unit = f" [{found.metric.unit}]" if found.metric.unit else ""
    best = "less" if found.goal == "min" else "more"
    yield f"Tuned for {found.metric.name}{unit}; {best} is better."
    tried = f"{found.runs} runs, {len(found.candidates)} candidates"
    present = next((one for one in found.candidates if one.number == 0), found.best)
    if found.best.number == 0:
        yield f"No values are better than the present ones ({tried})."
    else:
        has_ended = f" (by {len(present.losses)} seeds)" if present.is_out else ""
        yield (
            f"Races: seeds {_seeds(found.seeds)}, {tried}. Mean: {number(found.value(found.best))}"
            f" tuned, {number(found.value(present))} present{has_ended}. These seeds chose the"
            " values, so this difference is too good."
        )
    if found.gain is not None:
        text = _shown(found.gain, "present", "tuned", found)
        yield f"Held-out seeds {_seeds(found.held_out)}: {text}"
    elif found.best.number and not found.held_out:
        yield "No seeds were held out: nothing is claimed."
    for name, drop in found.drops.items():
        text = _shown(drop, "nominal", "pseudo-reality", found)
        yield f"In pseudo-reality, {name} values: {text}"
    software = [f"{name} {manifest.made_with[name]}" for name in _SOFTWARE]
    git = manifest.git.get("swarmd")
    commit = [] if git is None else [f"commit {git.commit[:12]}{', changed' * git.is_dirty}"]
    yield f"Made with {', '.join((*software, *commit))}; code {manifest.made_with['code'][:12]}."


def _shown(one: Difference, a: str, b: str, found: Tuning) -> str:
    """Both means, their difference and its interval, and the conclusion."""
    text = f"mean {number(one.mean_b)} {b}, {number(one.mean_a)} {a}, of {one.n_a} seeds"
    text += f"; difference {number(one.difference)}, 95 % interval {interval(one.interval)}"
    if one.p is not None:
        text += f", p {number(one.p)}"
    if one.never_a or one.never_b:
        text += f"; never: {one.never_b} {b}, {one.never_a} {a}"
    if lost := len(found.held_out) - min(one.n_a, one.n_b):
        text += f"; {lost} seeds more have no value on both sides"
    if not one.holds:
        return f"{text}. No difference is shown."
    is_less = one.difference is not None and one.difference < 0.0
    return f"{text}. Better: {b if is_less == (found.goal == 'min') else a}."


def _seeds(seeds: Sequence[int]) -> str:
    is_range = list(seeds) == list(range(seeds[0], seeds[0] + len(seeds)))
    return f"{seeds[0]}-{seeds[-1]}" if is_range and len(seeds) > 1 else ",".join(map(str, seeds))


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 96, subsequent_indent="  ", break_long_words=False)


def _yaml(data: Mapping[str, Any]) -> str:
    return text_of(dict(data), flow=None, width=100)
