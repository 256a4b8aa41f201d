"""Races: what is worse ends early, what is equal does not, and how often that is wrong."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from swarmd.core.values import Array
from swarmd.sim.experiments.racing import ALPHA, looks, losers, mean_loss

SEEDS = 20
Draw = Callable[[np.random.Generator, tuple[int, int]], Array]


def ended(losses: Array) -> dict[int, int]:
    """After how many seeds each candidate of a race (seeds, candidates) ends that ends early."""
    alive, found = list(range(losses.shape[1])), dict[int, int]()
    stages = looks(len(losses))
    for count in stages:
        out = [alive[k] for k in losers(losses[:count, alive], ALPHA / len(stages))]
        found |= dict.fromkeys(out, count)
        alive = [one for one in alive if one not in found]
    return found


def normal(generator: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Losses with a common effect of the seed, which is larger than their own scatter."""
    return generator.normal(size=shape) + 3.0 * generator.normal(size=(shape[0], 1))


def skewed(generator: np.random.Generator, shape: tuple[int, int]) -> Array:
    return generator.exponential(size=shape) ** 2


def yes_or_no(generator: np.random.Generator, shape: tuple[int, int]) -> Array:
    return (generator.random(shape) < 0.3).astype(np.float64)


def test_looks_come_before_the_last_seed() -> None:
    assert looks(20) == (5, 8, 12, 17)
    assert looks(6) == (5,)
    assert looks(5) == looks(2) == ()


@pytest.mark.parametrize(("candidates", "seeds"), [(3, 5), (8, 8)])
def test_a_clearly_worse_candidate_ends_early(candidates: int, seeds: int) -> None:
    losses = normal(np.random.default_rng(1), (SEEDS, candidates))
    losses[:, 1] += 10.0
    assert ended(losses) == {1: seeds}


def test_all_but_the_best_end() -> None:
    losses = normal(np.random.default_rng(2), (SEEDS, 6))
    losses[:, 4] -= 6.0
    assert set(ended(losses)) == {0, 1, 2, 3, 5}


def test_the_worse_of_two_ends_later_as_signs_alone_count() -> None:
    """Below level p = 0.0125 needs 8 pairs: 2 of 256 signs."""
    losses = normal(np.random.default_rng(3), (SEEDS, 2))
    losses[:, 0] += 10.0
    assert ended(losses) == {0: 8}


def test_common_effects_of_seeds_do_not_matter() -> None:
    generator = np.random.default_rng(4)
    losses = normal(generator, (SEEDS, 5))
    assert ended(losses + 100.0 * generator.normal(size=(SEEDS, 1))) == ended(losses)


@pytest.mark.parametrize(("draw", "candidates"), [(normal, 3), (skewed, 8), (yes_or_no, 8)])
def test_equal_candidates_end_in_no_more_than_5_percent_of_races(
    draw: Draw, candidates: int
) -> None:
    generator = np.random.default_rng(5)
    races = 200
    wrong = sum(bool(ended(draw(generator, (SEEDS, candidates)))) for _ in range(races))
    assert wrong <= races * (ALPHA + 3.0 * np.sqrt(ALPHA * (1.0 - ALPHA) / races))


def test_the_best_ends_in_no_more_than_5_percent_of_races_with_much_worse_ones() -> None:
    """Friedman's test, which comes first, protects equal candidates alone."""
    generator = np.random.default_rng(6)
    races, lost = 150, 0
    for _ in range(races):
        losses = normal(generator, (SEEDS, 8))
        losses[:, 3:] += 4.0  # 0, 1 and 2 are equal
        lost += 0 in ended(losses)
    assert lost <= races * (ALPHA + 3.0 * np.sqrt(ALPHA * (1.0 - ALPHA) / races))


def test_equal_losses_end_nothing() -> None:
    assert ended(np.ones((SEEDS, 4))) == {}
    assert ended(np.ones((SEEDS, 2))) == {}
    assert losers(np.ones((5, 1)), ALPHA) == losers(np.ones((1, 4)), ALPHA) == []


@pytest.mark.parametrize("candidates", [2, 4])
def test_failed_runs_are_the_worst_of_all(candidates: int) -> None:
    losses = normal(np.random.default_rng(7), (SEEDS, candidates))
    losses[:, 0] = np.inf
    assert set(ended(losses)) == {0}
    assert ended(np.full((SEEDS, candidates), np.inf)) == {}


def test_a_mean_with_a_failed_run_is_worse_than_any_without() -> None:
    means = [mean_loss(one) for one in ([1.0, 9.0], [0.0, np.inf], [np.inf, np.inf])]
    assert means == [(0, 5.0), (1, 0.0), (2, np.inf)]
    assert means == sorted(means)
