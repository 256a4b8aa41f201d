"""Swarms on a radio that fails: namespaces that are gone after each test, skipped without root."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.field import Field, lacks
from tests.support.field_swarm import FieldSwarm

MakeSwarm = Callable[..., FieldSwarm]


@pytest.fixture(scope="session")
def namespaces_permitted() -> None:
    """Skip where network namespaces are not permitted."""
    if why := lacks():
        pytest.skip(why)


@pytest.fixture
def make_swarm(namespaces_permitted: None, tmp_path: Path) -> Iterator[MakeSwarm]:
    """`make_swarm(robots, laptops)`: a field of these hosts and a swarm without daemons yet."""
    with contextlib.ExitStack() as left:

        def make(robots: tuple[str, ...], laptops: tuple[str, ...]) -> FieldSwarm:
            field = Field((*robots, *laptops))
            left.callback(field.close)
            return left.enter_context(FieldSwarm(tmp_path, field, robots))

        yield make
