"""Figures of the voting patterns: `python -m studies.voting [OUT]`, about half an hour.

Draws the time until agreement and the winning opinion: for majority_rule and voter_model by the
number of robots, for collective_perception by the share of black tiles. Writes
`OUT/PATTERN/figure.png`, with OUT by default `patterns`, and prints the numbers.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from studies.debates import IN_STEP, Motion, Result, hold_all
from studies.outcomes.outcome import PATTERNS
from studies.outcomes.patterns import collective_perception as perception
from studies.outcomes.patterns import voter_model
from studies.outcomes.patterns.majority_rule import LOSSY
from swarmd.core.values import Value
from swarmd.sim.experiments.statistics import wilson
from swarmd.sim.plots.theme import GUIDE_COLOUR, VARIANT_COLOURS, new_figure, save, tidy

K = TypeVar("K")

KINDS = ("tumbling", "sliding", "rounds")
SIZES = (3, 5, 7, 11, 15, 21)
VOTERS = (3, 5, 7, 10, 15)
RUNS = 30
FIRST = 10_000
"""The first seed; the outcomes use others."""


def motions(
    pattern: str, count: int, params: Mapping[str, Value], held: Sequence[int] | None = None
) -> list[Motion]:
    """The settings of `RUNS` debates with different seeds.

    `held`: the first opinions, dealt to the robots in a random order; None: the pattern's own.
    """
    settled = 2.0 * float(str(params.get("window", 5.0)))
    made = []
    for seed in range(FIRST, FIRST + RUNS):
        order = np.random.default_rng(seed).permutation(held).tolist() if held else ()
        made.append(
            Motion(pattern, count, seed, 600.0, params, tuple(order) or None, LOSSY, settled)
        )
    return made


def hold(groups: Mapping[K, list[Motion]]) -> dict[K, list[Result]]:
    """The results of the debates of all groups, by group, on all processors."""
    motions = [motion for group in groups.values() for motion in group]
    results = iter(hold_all(motions, os.cpu_count() or 1))
    return {key: [next(results) for _ in group] for key, group in groups.items()}


def majority_rule(out: Path) -> None:
    """Time to agree by the number of robots, and its distribution for seven."""
    figure = new_figure(8.0, 3.2)
    left, right = figure.subplots(1, 2)
    groups = {
        (kind, n): motions("majority_rule", n, {"windows": kind}) for kind in KINDS for n in SIZES
    }
    every = hold(groups)
    for kind, colour in zip(KINDS, VARIANT_COLOURS, strict=False):
        results = {n: every[kind, n] for n in SIZES}
        # Debates without agreement are the longest.
        times = [[min(result.agreed_at, 600.0) for result in some] for some in results.values()]
        low, middle, high = np.quantile(times, (0.05, 0.5, 0.95), axis=1)
        bars = (middle - low, high - middle)
        left.errorbar(SIZES, middle, bars, color=colour, marker="o", ms=4, capsize=2, label=kind)
        seven = np.sort([result.agreed_at for result in results[7]])
        right.step(seven, np.arange(1, len(seven) + 1) / len(seven), color=colour, where="post")
        for n, a, b, c in zip(SIZES, low, middle, high, strict=True):
            print(f"majority_rule {kind} {n} robots: {a:.1f} / {b:.1f} / {c:.1f} s", flush=True)
    left.set(xlabel="robots", ylabel="time until all agree, s", ylim=(0.0, None))
    left.legend(frameon=False, fontsize=9)
    right.axvline(20.0, color=GUIDE_COLOUR, linestyle=":", linewidth=1.0)
    right.set(xlabel="time, s (dotted: 20 s)", ylabel="share of swarms of 7 that agree")
    right.set(xlim=(0.0, 21.0), ylim=(0.0, 1.02))
    _keep(figure, (left, right), _file(out, "majority_rule"))


def voters(out: Path) -> None:
    """The winner by the share at the start, and windows or rounds until all agree."""
    figure = new_figure(8.0, 3.2)
    left, right = figure.subplots(1, 2)
    firsts = range(1, 10)
    groups = {
        first: motions("voter_model", 10, voter_model.SHORT, [1] * first + [0] * (10 - first))
        for first in firsts
    }
    for first, results in hold(groups).items():
        wins = sum(result.winner == 1 for result in results)
        within = wilson(wins, len(results))
        share = wins / len(results)
        bars = ([share - within.low], [within.high - share])
        left.errorbar(
            first / 10, share, bars, color=VARIANT_COLOURS[0], marker="o", ms=4, capsize=2
        )
        print(f"voter_model {first} of 10: won {wins} of {len(results)}", flush=True)
    left.plot((0.0, 1.0), (0.0, 1.0), color=GUIDE_COLOUR, linestyle=":")
    left.set(xlabel="share of opinion 1 at first", ylabel="share of debates it wins")
    _voting_times(right)
    _keep(figure, (left, right), _file(out, "voter_model"))


def _voting_times(axes: Any) -> None:
    """Means over runs that begin with two halves, and the theory."""
    length = float(str(voter_model.SHORT["window"]))
    settings = {"tumbling": voter_model.SHORT, "rounds": {**IN_STEP, "opinions": 2}}
    groups = {
        (kind, n): motions("voter_model", n, params, [1] * (n // 2) + [0] * (n - n // 2))
        for kind, params in settings.items()
        for n in VOTERS
    }
    every = hold(groups)
    for kind, colour in zip(settings, VARIANT_COLOURS, strict=False):
        means, errors = [], []
        for n in VOTERS:
            results = every[kind, n]
            taken = [r.agreed_at / length if kind == "tumbling" else r.rounds for r in results]
            means.append(float(np.mean(taken)))
            errors.append(1.96 * float(np.std(taken, ddof=1)) / len(taken) ** 0.5)
            print(f"voter_model {kind} {n} robots: {means[-1]:.1f} +- {errors[-1]:.1f}", flush=True)
        axes.errorbar(
            VOTERS, means, errors, color=colour, marker="o", ms=4, capsize=2, ls="", label=kind
        )
    theory = [voter_model.expected_rounds(n, n // 2)[0] for n in VOTERS]
    axes.plot(VOTERS, theory, color=GUIDE_COLOUR, linestyle=":", label="theory of rounds")
    axes.set(xlabel="robots", ylabel="windows or rounds until all agree", ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=9)


def floors(out: Path) -> None:
    """Who wins, and the time to agree, by the share of black tiles."""
    figure = new_figure(8.0, 3.2)
    left, right = figure.subplots(1, 2)
    agreements = perception.agreements(range(20), os.cpu_count() or 1)
    percent = 100.0 * np.array(perception.SHARES)
    for index, (rule, colour) in enumerate(zip(perception.RULES, VARIANT_COLOURS, strict=False)):
        runs = [agreements[rule, share] for share in perception.SHARES]
        wins = [sum(run.opinion == perception.BLACK for run in some) for some in runs]
        within = [wilson(won, len(some)) for won, some in zip(wins, runs, strict=True)]
        shares = [won / len(some) for won, some in zip(wins, runs, strict=True)]
        low, high = ([getattr(interval, end) for interval in within] for end in ("low", "high"))
        bars = np.abs(np.array((low, high)) - shares)
        # Runs without agreement are the longest.
        times = [[min(run.at, perception.SECONDS) for run in some] for some in runs]
        few, middle, most = np.quantile(times, (0.05, 0.5, 0.95), axis=1)
        look = {"color": colour, "marker": "o", "ms": 4, "capsize": 2, "label": rule}
        at = percent + 0.3 * (index - 1)
        left.errorbar(at, shares, bars, **look)
        right.errorbar(at, middle, (middle - few, most - middle), **look)
        for n, share in enumerate(perception.SHARES):
            none = sum(run.opinion is None for run in runs[n])
            wrong = len(runs[n]) - wins[n] - none
            mean = f"{np.mean(perception.taken(runs[n])):.0f} s"
            text = f"{few[n]:.0f} / {middle[n]:.0f} / {most[n]:.0f} s"
            won = f"{wins[n]} of {len(runs[n])}"
            print(f"| {rule} | {share:.0%} | {won} | {wrong} | {none} | {mean} | {text} |")
    for axes in (left, right):
        axes.set_xticks(percent)
    left.set(xlabel="black tiles, %", ylabel="share of runs that agree on black", ylim=(0.0, 1.03))
    left.legend(frameon=False, fontsize=9)
    right.set(xlabel="black tiles, %", ylabel="time until all agree, s", ylim=(0.0, None))
    _keep(figure, (left, right), _file(out, "collective_perception"))


def _keep(figure: Any, axes: Sequence[Any], path: Path) -> None:
    for axis in axes:
        tidy(axis)
    print(save(figure, path))


def _file(folder: Path, pattern: str) -> Path:
    (folder / pattern).mkdir(parents=True, exist_ok=True)
    return folder / pattern / "figure.png"


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else PATTERNS
    majority_rule(folder)
    voters(folder)
    floors(folder)
