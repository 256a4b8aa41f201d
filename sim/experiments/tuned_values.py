"""The text of tuned.yaml: the best values as a scenario's file, with the evidence in comments."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarmd.settings.yamlfile import text_of
from swarmd.sim.experiments.compare import Difference
from swarmd.sim.experiments.manifest import Manifest
from swarmd.sim.experiments.statistics import interval, number
from swarmd.sim.scenarios import pattern_paths
from swarmd.sim.scenarios.overrides import nested

if TYPE_CHECKING:
    from swarmd.sim.experiments.search_space import ParameterSpace
    from swarmd.sim.experiments.tune import Tuning

_SOFTWARE = ("swarmd", "python", "numpy", "mujoco", "kernels")


def tuned_document(
    tuning: Tuning, scenario: str, sets: Mapping[str, Any], manifest: Manifest
) -> str:
    """The text of a scenario that extends the tuned scenario by the best values.

    Comments hold the evidence, and the values of patterns in the form of a platform's file.
    """
    comments = [line for text in _evidence(tuning, manifest) for line in _wrapped(text)]
    base = str(Path(scenario).absolute()) if scenario.endswith(".yaml") else scenario
    overrides = pattern_paths.absolute({**sets, **tuning.best.overrides})
    # A list with an overridden item is copied in full, from the scenario with the best values.
    body = {"extends": base, **nested(overrides, tuning.best.effective)}
    platform = platform_values(tuning.space, tuning.best.values) if tuning.best.number else {}
    if platform:
        comments += ["", "In a platform's file, for all its robots and scenarios:"]
        comments += [f"  {line}" for line in _yaml({"patterns": platform}).splitlines()]
    head = [f"# {line}".rstrip() for line in comments]
    return "\n".join([*head, "", _yaml(body)])


def platform_values(space: ParameterSpace, values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The values of patterns' parameters, as `patterns` of a platform's file holds them."""
    by_pattern: dict[str, dict[str, Any]] = {}
    for parameter in space.parameters:
        if parameter.pattern:
            by_pattern.setdefault(parameter.pattern, {})[parameter.param] = values[parameter.name]
    return by_pattern


def _evidence(tuning: Tuning, manifest: Manifest) -> Iterator[str]:
    """The sentences about the evidence for tuned values, which stand above the values in the file.

    Goal, means in the search, held-out difference, difference to pseudo-reality, software.
    """
    unit = f" [{tuning.metric.unit}]" if tuning.metric.unit else ""
    direction = "less" if tuning.goal == "min" else "more"
    yield f"Tuned for {tuning.metric.name}{unit}; {direction} is better."

    yield _search(tuning)
    if tuning.gain is not None:
        text = _shown(tuning.gain, "present", "tuned", tuning)
        yield f"Held-out seeds {_seeds(tuning.held_out)}: {text}"
    elif tuning.best.number and not tuning.held_out:
        yield "No seeds were held out: nothing is claimed."
    for name, drop in tuning.drops.items():
        text = _shown(drop, "nominal", "pseudo-reality", tuning)
        yield f"In pseudo-reality, {name} values: {text}"
    software = [f"{name} {manifest.made_with[name]}" for name in _SOFTWARE]
    git = manifest.git.get("swarmd")
    changed = ", changed" if git is not None and git.is_dirty else ""
    commit = [] if git is None else [f"commit {git.commit[:12]}{changed}"]
    yield f"Made with {', '.join((*software, *commit))}; code {manifest.made_with['code'][:12]}."


def _search(tuning: Tuning) -> str:
    """The sentences about the search; candidate 0 has the present values of the scenario."""
    effort = f"{tuning.runs} runs, {len(tuning.candidates)} candidates"
    if tuning.best.number == 0:
        return f"No values are better than the present ones ({effort})."
    present = next(candidate for candidate in tuning.candidates if candidate.number == 0)
    mean, present_mean = (number(tuning.value(one)) for one in (tuning.best, present))
    return (
        f"Search: seeds {_seeds(tuning.seeds)}, {effort}. Mean: {mean} tuned, {present_mean}"
        " present. These seeds chose the values, so this difference is too good."
    )


def _shown(difference: Difference, a: str, b: str, tuning: Tuning) -> str:
    """A line about a difference b - a: both means, difference, interval, p, and the conclusion."""
    mean_a, mean_b, mean_difference = map(
        number, (difference.mean_a, difference.mean_b, difference.difference)
    )
    text = f"mean {mean_b} {b}, {mean_a} {a}, of {difference.n_a} seeds"
    text += f"; difference {mean_difference}, 95 % interval {interval(difference.interval)}"
    if difference.p is not None:
        text += f", p {number(difference.p)}"
    if difference.never_a or difference.never_b:
        text += f"; never: {difference.never_b} {b}, {difference.never_a} {a}"
    if lost := len(tuning.held_out) - min(difference.n_a, difference.n_b):
        text += f"; {lost} further seeds lack a value on a side"
    if not difference.holds:
        return f"{text}. No difference is shown."
    is_b_less = difference.difference is not None and difference.difference < 0.0
    is_less_better = tuning.goal == "min"
    return f"{text}. Better: {b if is_b_less == is_less_better else a}."


def _seeds(seeds: Sequence[int]) -> str:
    is_range = list(seeds) == list(range(seeds[0], seeds[0] + len(seeds)))
    return f"{seeds[0]}-{seeds[-1]}" if is_range and len(seeds) > 1 else ",".join(map(str, seeds))


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 96, subsequent_indent="  ", break_long_words=False)


def _yaml(data: Mapping[str, Any]) -> str:
    return text_of(dict(data), flow=None, width=100)
