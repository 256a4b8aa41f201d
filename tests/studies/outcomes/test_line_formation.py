"""A line in a swarm, short: two swarms of Burgers, of which one robot each is removed."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from studies.outcomes.line_formation import SHORT, outcomes
from studies.outcomes.outcome import Outcome

SEEDS = (1, 2)


@pytest.fixture(scope="module")
def found() -> Sequence[Outcome]:
    return outcomes(SEEDS, settings=(SHORT,))


def test_they_form_a_line(found: Sequence[Outcome]) -> None:
    assert found[0].is_reached, found[0]


def test_a_removal_breaks_it(found: Sequence[Outcome]) -> None:
    assert found[1].is_reached, found[1]


def test_after_a_removal_they_form_it_again(found: Sequence[Outcome]) -> None:
    assert found[2].is_reached, found[2]


def test_they_rest_in_it(found: Sequence[Outcome]) -> None:
    assert found[3].is_reached, found[3]
