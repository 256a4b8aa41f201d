"""Figures of the voting patterns: `python -m studies.voting`, about half an hour.

Measures the time until agreement and the winning opinion: for majority_rule and voter_model by the
number of robots, for collective_perception by the share of black tiles. Prints the tables of their
pages. With all seeds it also draws their figures. The same command resumes.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from benchmarks.table import markdown
from studies import keeper, kept
from studies.debates import IN_STEP, Motion, Result
from studies.debates import hold as hold_debate
from studies.outcomes.outcome import PATTERNS
from studies.outcomes.patterns import collective_perception as perception
from studies.outcomes.patterns import voter_model
from studies.outcomes.patterns.majority_rule import LOSSY
from swarmd.core.pin import restart_pinned
from swarmd.core.values import Value
from swarmd.sim.experiments.statistics import wilson
from swarmd.sim.plots.theme import GUIDE_COLOUR, VARIANT_COLOURS, new_figure, save, tidy

KINDS = ("tumbling", "sliding", "rounds")
SIZES = (3, 5, 7, 11, 15, 21)
VOTERS = (3, 5, 7, 10, 15)
RUNS = 30
FIRST = 10_000
"""The first seed; the outcomes use others."""


K = TypeVar("K")


Group = tuple[str, int, Mapping[str, Value], Sequence[int] | None]
"""Debates: the pattern, the number of robots, the parameters, and the first opinions.

The first opinions are dealt to the robots in a random order; None: the pattern's own.
"""


def hold(groups: Mapping[K, Group], options: Namespace) -> dict[K, list[Result]]:
    """The results of `options.runs` debates of each group, with different seeds."""
    motions = []
    for pattern, count, params, held in groups.values():
        settled = 2.0 * float(str(params.get("window", 5.0)))
        for seed in range(FIRST, FIRST + options.runs):
            order = tuple(np.random.default_rng(seed).permutation(held).tolist()) if held else None
            motions.append(Motion(pattern, count, seed, 600.0, params, order, LOSSY, settled))
    records = keeper.records(hold_debate, motions, jobs=options.jobs)
    results = (record.found for record in records)
    return {key: [next(results) for _ in range(options.runs)] for key in groups}


def majority_rule(options: Namespace, figures: dict[str, Any]) -> str:
    """Time to agree by the number of robots, and its distribution for seven."""
    figure = figures["majority_rule"] = new_figure(8.0, 3.2)
    left, right = figure.subplots(1, 2)
    rows = [["windows", *(f"{n} robots" for n in SIZES)]]
    groups = {(k, n): ("majority_rule", n, {"windows": k}, None) for k in KINDS for n in SIZES}
    every = hold(groups, options)
    for kind, colour in zip(KINDS, VARIANT_COLOURS, strict=False):
        results = {n: every[kind, n] for n in SIZES}
        # Debates without agreement are the longest.
        times = [[min(result.agreed_at, 600.0) for result in some] for some in results.values()]
        low, middle, high = np.quantile(times, (0.05, 0.5, 0.95), axis=1)
        bars = (middle - low, high - middle)
        left.errorbar(SIZES, middle, bars, color=colour, marker="o", ms=4, capsize=2, label=kind)
        seven = np.sort([result.agreed_at for result in results[7]])
        right.step(seven, np.arange(1, len(seven) + 1) / len(seven), color=colour, where="post")
        rows.append(
            [
                f"`{kind}`",
                *(
                    f"{a:.1f} / {b:.1f} / {c:.1f} s"
                    for a, b, c in zip(low, middle, high, strict=True)
                ),
            ]
        )
    left.set(xlabel="robots", ylabel="time until all agree, s", ylim=(0.0, None))
    left.legend(frameon=False, fontsize=9)
    right.axvline(20.0, color=GUIDE_COLOUR, linestyle=":", linewidth=1.0)
    right.set(xlabel="time, s (dotted: 20 s)", ylabel="share of swarms of 7 that agree")
    right.set(xlim=(0.0, 21.0), ylim=(0.0, 1.02))
    return markdown(rows)


def voters(options: Namespace, figures: dict[str, Any]) -> str:
    """The winner by the share at the start, and windows or rounds until all agree."""
    figure = figures["voter_model"] = new_figure(8.0, 3.2)
    left, right = figure.subplots(1, 2)
    rows = [["at first of ten robots", "opinion 1 wins", "95 %"]]
    groups = {
        first: ("voter_model", 10, voter_model.SHORT, [1] * first + [0] * (10 - first))
        for first in range(1, 10)
    }
    for first, results in hold(groups, options).items():
        wins = sum(result.winner == 1 for result in results)
        within = wilson(wins, len(results))
        share = wins / len(results)
        bars = ([share - within.low], [within.high - share])
        left.errorbar(
            first / 10, share, bars, color=VARIANT_COLOURS[0], marker="o", ms=4, capsize=2
        )
        rows.append(
            [
                str(first),
                f"{wins} of {len(results)}",
                f"{within.low:.0%} to {within.high:.0%}",
            ]
        )
    left.plot((0.0, 1.0), (0.0, 1.0), color=GUIDE_COLOUR, linestyle=":")
    left.set(xlabel="share of opinion 1 at first", ylabel="share of debates it wins")
    return f"{markdown(rows)}\n\n{_voting_times(options, right)}"


def _voting_times(options: Namespace, axes: Any) -> str:
    """Means over runs that begin with two halves, and the theory."""
    length = float(str(voter_model.SHORT["window"]))
    settings = {"tumbling": voter_model.SHORT, "rounds": {**IN_STEP, "opinions": 2}}
    groups = {
        (kind, n): ("voter_model", n, params, [1] * (n // 2) + [0] * (n - n // 2))
        for kind, params in settings.items()
        for n in VOTERS
    }
    every = hold(groups, options)
    theory = [voter_model.expected_rounds(n, n // 2)[0] for n in VOTERS]
    rows = [["windows or rounds until all agree", *(f"{n} robots" for n in VOTERS)]]
    for kind, colour in zip(settings, VARIANT_COLOURS, strict=False):
        means, errors = [], []
        for n in VOTERS:
            results = every[kind, n]
            taken = [r.agreed_at / length if kind == "tumbling" else r.rounds for r in results]
            means.append(float(np.mean(taken)))
            errors.append(1.96 * float(np.std(taken, ddof=1)) / len(taken) ** 0.5)
        axes.errorbar(
            VOTERS, means, errors, color=colour, marker="o", ms=4, capsize=2, ls="", label=kind
        )
        rows.append(
            [
                f"`{kind}`",
                *(f"{a:.1f} +- {b:.1f}" for a, b in zip(means, errors, strict=True)),
            ]
        )
    rows.append(["theory of rounds", *(f"{rounds:.1f}" for rounds in theory)])
    axes.plot(VOTERS, theory, color=GUIDE_COLOUR, linestyle=":", label="theory of rounds")
    axes.set(xlabel="robots", ylabel="windows or rounds until all agree", ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=9)
    return markdown(rows)


def floors(options: Namespace, figures: dict[str, Any]) -> str:
    """Who wins, and the time to agree, by the share of black tiles."""
    figure = figures["collective_perception"] = new_figure(8.0, 3.2)
    left, right = figure.subplots(1, 2)
    percent, n = 100.0 * np.array(perception.SHARES), options.seeds
    settings = perception.settings_of(range(n))
    records = keeper.records(perception.run, settings, jobs=options.jobs)
    every = [record.found for record in records]
    rows = [
        [
            "rule",
            "black",
            "agree on black (95 %)",
            "on white",
            "on none",
            "mean time",
            "5 % / median / 95 %",
        ]
    ]
    for index, (rule, colour) in enumerate(zip(perception.RULES, VARIANT_COLOURS, strict=False)):
        firsts = [n * (k * len(perception.RULES) + index) for k in range(len(percent))]
        runs = [every[first : first + n] for first in firsts]
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
        for k, share in enumerate(perception.SHARES):
            none = sum(run.opinion is None for run in runs[k])
            wrong = len(runs[k]) - wins[k] - none
            mean = f"{kept.mean_of(np.array(perception.taken(runs[k])))} s"
            text = f"{few[k]:.0f} / {middle[k]:.0f} / {most[k]:.0f} s"
            won = f"{wins[k]} of {len(runs[k])} ({low[k]:.0%} to {high[k]:.0%})"
            rows.append([rule, f"{share:.0%}", won, str(wrong), str(none), mean, text])
    for axes in (left, right):
        axes.set_xticks(percent)
    left.set(xlabel="black tiles, %", ylabel="share of runs that agree on black", ylim=(0.0, 1.03))
    left.legend(frameon=False, fontsize=9)
    right.set(xlabel="black tiles, %", ylabel="time until all agree, s", ylim=(0.0, None))
    return markdown(rows)


def main() -> None:
    """Hold all debates, print the tables and draw the figures."""
    options, figures = kept.chosen("voting", __doc__), dict[str, Any]()
    options.runs = RUNS * options.seeds // kept.SEEDS
    parts = {
        "voting_majority_rule": majority_rule(options, figures),
        "voting_voter_model": voters(options, figures),
        "voting_collective_perception": floors(options, figures),
    }
    for pattern, figure in figures.items():
        for axes in figure.axes:
            tidy(axes)
        if options.seeds == kept.SEEDS:
            save(figure, PATTERNS / pattern / "figure.png")
    kept.print_parts(parts)


if __name__ == "__main__":
    restart_pinned()  # as in a night, so that runs have its bits
    main()
