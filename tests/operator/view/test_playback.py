"""The time of recorded runs."""

from __future__ import annotations

import pytest

from swarmd.operator.view.playback import MAX_SPEED, Playback


class Clock:
    """A clock that the test sets."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def playback(clock: Clock) -> Playback:
    """A run of ten seconds, which plays."""
    one = Playback(["a", "b"], lambda run: None, clock)
    one.load("a", 10.0)
    return one


def test_plays_at_its_speed_and_stays_at_the_end(playback: Playback, clock: Clock) -> None:
    clock.now += 2.0
    assert playback.time == pytest.approx(2.0)
    playback.play(is_playing=True, speed=2.0)
    clock.now += 3.0
    assert playback.time == pytest.approx(8.0)
    clock.now += 30.0
    assert playback.time == 10.0
    assert not playback.plain()["is_playing"]


def test_plays_again_from_the_start(playback: Playback, clock: Clock) -> None:
    clock.now += 30.0
    playback.play(is_playing=True, speed=1.0)
    clock.now += 1.0
    assert playback.time == pytest.approx(1.0)


def test_pauses_and_seeks_within_the_run(playback: Playback, clock: Clock) -> None:
    clock.now += 2.0
    playback.play(is_playing=False, speed=1.0)
    clock.now += 5.0
    assert playback.time == pytest.approx(2.0)
    playback.seek(99.0)
    assert playback.time == 10.0
    playback.seek(-1.0)
    assert playback.time == 0.0
    playback.play(is_playing=True, speed=1e9)
    assert playback.speed == MAX_SPEED
    with pytest.raises(ValueError, match="finite"):
        playback.seek(float("nan"))
    with pytest.raises(ValueError, match="finite"):
        playback.play(is_playing=True, speed=float("inf"))
    assert (playback.time, playback.speed) == (0.0, MAX_SPEED)


def test_another_run_begins_at_its_start(playback: Playback, clock: Clock) -> None:
    clock.now += 5.0
    playback.load("b", 3.0)
    clock.now += 1.0
    assert playback.time == pytest.approx(1.0)
    assert playback.plain()["run"] == "b"
