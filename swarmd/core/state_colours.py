"""The colours of the states of robots, for tools that draw them: ROS markers and Foxglove."""

from __future__ import annotations

from swarmd.core.messages import State

Colour = tuple[float, float, float]
"""Red, green and blue, 0 to 1."""
HELD: Colour = (0.95, 0.55, 0.1)
"""Of a robot that runs and may not move."""
UNKNOWN: Colour = (0.5, 0.5, 0.5)
_COLOURS: dict[str, Colour] = {
    State.IDLE: (0.2, 0.4, 0.9),
    State.RUNNING: (0.1, 0.7, 0.2),
    State.STOPPED: (0.9, 0.8, 0.1),
    State.ESTOPPED: (0.7, 0.0, 0.0),
    State.FAULTED: (0.6, 0.1, 0.7),
}


def colour_of(state: str, *, is_held: bool) -> Colour:
    """The colour of a robot; grey for an unknown state."""
    return HELD if is_held else _COLOURS.get(state, UNKNOWN)
