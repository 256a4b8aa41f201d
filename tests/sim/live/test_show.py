"""A demo's course: what it makes of the world's states and the robots' answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import pytest

from swarmd.core.errors import NetworkError
from swarmd.sim.live import show
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.show import Watch
from swarmd.sim.live.state import WorldState


class Sky:
    """A world's view whose states a test makes."""

    def __init__(self) -> None:
        self.tell: Callable[[WorldState], None] = lambda state: None

    def watch(self, handler: Callable[[WorldState], None]) -> None:
        self.tell = handler


def state(time: float, *xs: float) -> WorldState:
    n = len(xs)
    return WorldState(
        time=time,
        real_time_factor=1.0,
        arena=(4.0, 4.0),
        ids=tuple("abc"[:n]),
        poses=tuple((x, 0.0, 0.0) for x in xs),
        twists=((0.0, 0.0, 0.0),) * n,
        commanded=(True,) * n,
        contacts=0,
        arena_contacts=0,
        is_recording=True,
        recorded=time,
        overruns=0,
        dropped=0,
    )


@pytest.fixture
def sky() -> Sky:
    return Sky()


@pytest.fixture
def watch(sky: Sky) -> Watch:
    return Watch(cast(WorldView, sky))


def test_the_newest_state_is_given(sky: Sky, watch: Watch) -> None:
    sky.tell(state(1.0, 0.0))
    sky.tell(state(2.0, 0.0))
    assert watch.wait().time == 2.0
    assert watch.wait(since=1.5).time == 2.0


def test_a_world_that_falls_silent_is_an_error(
    sky: Sky, watch: Watch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(show, "SILENT", 0.0)
    sky.tell(state(1.0, 0.0))
    with pytest.raises(NetworkError, match="the world has said nothing"):
        watch.wait(since=1.0)


def test_all_have_moved_once_each_has(sky: Sky, watch: Watch) -> None:
    watch.begin(state(0.0, 0.0, 1.0))
    sky.tell(state(0.1, 0.01, 1.0))
    assert watch.all_moved_at is None
    sky.tell(state(0.2, 0.0, 1.0))  # the first is back where it was: it has moved all the same
    assert watch.all_moved_at is None
    sky.tell(state(0.3, 0.0, 1.002))
    assert watch.all_moved_at is not None


def test_standing_is_not_moving(sky: Sky, watch: Watch) -> None:
    watch.begin(state(0.0, 0.0))
    sky.tell(state(0.1, 0.0005))
    assert watch.all_moved_at is None
