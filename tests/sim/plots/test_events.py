"""Events in few words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from swarmd.sim.plots.events import MOST_EVENTS, events_of

if TYPE_CHECKING:
    from tests.sim.plots.conftest import Walk


def event(at: float, action: str, *robots: str, pattern: str = "") -> dict[str, Any]:
    return {"at": at, "action": action, "robots": list(robots), "pattern": pattern}


def test_says_what_happened_to_whom(walk: Walk) -> None:
    events = [
        event(0.0, "run", "tb3-00", "tb3-01", "tb3-02", pattern="attraction"),
        event(0.4, "kill", "tb3-01"),
        event(0.8, "join", "tb3-00", "tb3-01"),
        event(1.2, "run", "tb3-00", "tb3-01", "tb3-02", pattern="random_walk"),
        event(1.6, "place"),
    ]
    assert events_of(walk(3, meta={"events": events})) == (
        (0.4, "kill tb3-01"),
        (0.8, "join 2 robots"),
        (1.2, "run random_walk"),
        (1.6, "place"),
    )


def test_events_too_close_to_be_written_apart_are_written_together(walk: Walk) -> None:
    events = [event(1.0, "join", "tb3-00"), event(1.02, "run", "tb3-00"), event(1.03, "place")]
    events.append(event(1.04, "place"))
    assert events_of(walk(3, meta={"events": events})) == ((1.0, "join tb3-00, run tb3-00, place"),)


def test_too_many_events_are_not_told(walk: Walk) -> None:
    events = [event(0.1 * k, "place") for k in range(1, MOST_EVENTS + 2)]
    assert events_of(walk(3, meta={"events": events})) == ()
    assert len(events_of(walk(3, meta={"events": events[1:]}))) == MOST_EVENTS


def test_a_trace_from_elsewhere_tells_nothing(walk: Walk) -> None:
    assert events_of(walk(3)) == ()
