"""Swarms on a radio that fails: real daemons in namespaces, skipped where these need more rights.

Each test leaves the robots of its module as it likes: the next one finds them idle, on a clean
radio, and every daemon alive.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest

from tests.support.field import Field, lacks
from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR, prepare


@pytest.fixture(scope="session")
def namespaces_permitted() -> None:
    """Skip where network namespaces are not permitted."""
    if why := lacks():
        pytest.skip(why)


@pytest.fixture(
    scope="session",
    params=[
        pytest.param(False, id="insecure"),
        pytest.param(True, id="keys", marks=pytest.mark.evidence),
    ],
)
def is_secured(request: pytest.FixtureRequest) -> bool:
    """True: with keys; all tests do so in `make network`, and those of test_keys.py always."""
    return bool(request.param)


@pytest.fixture(scope="module")
def started_swarm(
    request: pytest.FixtureRequest,
    namespaces_permitted: None,
    is_secured: bool,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[FieldSwarm]:
    """The robots of a test module with their daemons, and the two laptops of the matrix.

    They are the parameter of this fixture if it has one, else `ROBOTS` of the module.
    """
    robots: tuple[str, ...] = getattr(request, "param", None) or request.module.ROBOTS
    with contextlib.ExitStack() as left:
        field = left.enter_context(contextlib.closing(Field((*robots, FAR, NEAR))))
        folder = tmp_path_factory.mktemp("field")
        swarm = left.enter_context(FieldSwarm(folder, field, robots, is_secured=is_secured))
        swarm.start()
        yield swarm


@pytest.fixture
def swarm(started_swarm: FieldSwarm) -> FieldSwarm:
    """The swarm of the module: every robot is alive and idle, and the radio is clean."""
    started_swarm.revive()
    prepare(started_swarm, "idle")
    started_swarm.moved()
    return started_swarm
