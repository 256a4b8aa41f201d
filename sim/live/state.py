"""Options of a live world, and messages between the world and its viewers.

The state is ground truth, never for robots.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from swarmd.core.bounds import Count, Line, Metres, Name, Rate, Seconds, Word
from swarmd.core.codec import MAX_SENSOR_PAYLOAD, Decoder
from swarmd.sim.world.scalar_fields import Field

Action = Literal["start", "finish", "poses", "place", "remove", "take_out", "fields"]
Triple = tuple[Metres, Metres, Metres]


class WorldOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The command line of a world's process, as JSON.

    `scenario`: the file of an effective scenario; without one `robots` (platform by id) start in
    `arena` by `layout`, texts as of `parse_arena` and `parse_layout`. `endpoint` is for drivers,
    `emulator_endpoint` for those of an `emulator`. Port 0 is any. `trace`
    is the path of the recording, `trace_rate` in Hz; it ends after `seconds` of simulation, which
    count from the start or from a request `start`. `radio_range` in m; None: without limit.
    """

    swarm: str
    scenario: str | None = None
    robots: dict[str, str] = {}
    arena: str = "6x6"
    layout: str = "grid:1.0"
    seed: int = 0
    realism: Literal["ideal", "realistic"] = "ideal"
    lidar_visibility: Literal["body", "real"] = "body"
    radio_range: float | None = None
    endpoint: str = "tcp/127.0.0.1:0"
    emulator: str | None = None
    emulator_endpoint: str = "tcp/127.0.0.1:0"
    shared_frame: bool = False
    trace: str | None = None
    trace_rate: float = 50.0
    seconds: float | None = None


class WorldState(Struct, frozen=True, kw_only=True):
    """The world at one instant; row i of each list is robot `ids[i]`, which is in the arena.

    `time` s of simulation, `real_time_factor` over the last second (0 before there is one),
    `poses` x, y in m and yaw in rad, `twists` linear, angular, lateral in each base frame,
    `commanded` whether a fresh command is in force. Contact episodes since recording began:
    `contacts` between robots, `arena_contacts` with walls, boxes and poles. `recorded` in s.
    `overruns`: late steps, `dropped`: malformed messages. `boxes`: the poses of the movable boxes
    in the arena, by name. `touching`: pairs that were in contact in the last 0.5 s, each a robot
    and a robot or part of the arena.
    """

    time: Seconds
    real_time_factor: Rate
    arena: tuple[Metres, Metres]
    ids: tuple[Name, ...]
    poses: tuple[Triple, ...]
    twists: tuple[Triple, ...]
    commanded: tuple[bool, ...]
    contacts: Count
    arena_contacts: Count
    is_recording: bool
    recorded: Seconds
    overruns: Count
    dropped: Count
    boxes: dict[Name, Triple] = {}
    touching: tuple[tuple[Name, Name], ...] = ()


class WorldRequest(Struct, frozen=True, kw_only=True):
    """A request to the world.

    `start` restarts the recording, `finish` writes it, `poses` returns the state, `place` puts the
    movable `box` at rest at `pose`, `remove` takes it out of the arena, `take_out` the `robot`;
    `fields` replaces all fields that have the names of its `fields`.
    """

    action: Action
    box: Word = ""
    robot: Word = ""
    pose: Triple = (0.0, 0.0, 0.0)
    fields: Annotated[tuple[Field, ...], Meta(max_length=1000)] = ()


class WorldReply(Struct, frozen=True, kw_only=True):
    """The state after the action, or `text` why it failed; `path` of a written trace."""

    is_done: bool
    text: Line
    state: WorldState
    path: Annotated[str, Meta(max_length=4096)] = ""


decode_state = Decoder(WorldState, MAX_SENSOR_PAYLOAD)
decode_request = Decoder(WorldRequest)
decode_reply = Decoder(WorldReply, MAX_SENSOR_PAYLOAD)


def state_key(swarm: str) -> str:
    """The key on which the state is published."""
    return f"world/{swarm}/state"


def control_key(swarm: str) -> str:
    """The key at which the world answers requests."""
    return f"world/{swarm}/control"
