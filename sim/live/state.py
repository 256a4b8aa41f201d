"""Options of a live world, and messages between the world and its viewers.

The state is ground truth, which robots never receive.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from swarmd.core.bounds import Count, Line, Metres, Name, Rate, Seconds, Word
from swarmd.core.codec import MAX_SENSOR_PAYLOAD, Decoder
from swarmd.sim.world.scalar_fields import Field

Action = Literal[
    "start", "finish", "poses", "place", "remove", "take_out", "fields", "fault", "mend"
]
Triple = tuple[Metres, Metres, Metres]


class WorldOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The command line of a world's process, as JSON."""

    swarm: str
    scenario: str | None = None  # the file of an effective scenario, instead of the next three
    robots: dict[str, str] = {}  # platform by id
    arena: str = "6x6"  # as of `parse_arena`
    layout: str = "grid:1.0"  # as of `parse_layout`
    seed: int = 0
    realism: Literal["ideal", "realistic"] = "ideal"
    lidar_visibility: Literal["body", "real"] = "body"
    radio_range: float | None = None  # m; None: without limit
    endpoint: str = "tcp/127.0.0.1:0"  # for drivers; port 0 is any
    emulator: str | None = None
    emulator_endpoint: str = "tcp/127.0.0.1:0"  # for the drivers of the emulator
    shared_frame: bool = False
    trace: str | None = None  # the path of the recording
    trace_rate: float = 50.0  # Hz
    seconds: float | None = None  # of simulation that are recorded, from the start or a `start` on


class WorldState(Struct, frozen=True, kw_only=True):
    """The world at one instant; row i of each list is robot `ids[i]`, which is in the arena."""

    time: Seconds  # of simulation
    real_time_factor: Rate  # over the last second; 0 in the first second
    arena: tuple[Metres, Metres]
    ids: tuple[Name, ...]
    poses: tuple[Triple, ...]  # x, y in m, yaw in rad
    twists: tuple[Triple, ...]  # linear, angular, lateral in each base frame
    commanded: tuple[bool, ...]  # whether a fresh command is in force
    contacts: Count  # episodes between robots since recording began
    arena_contacts: Count  # episodes with walls, boxes and poles since recording began
    is_recording: bool
    recorded: Seconds
    overruns: Count  # late steps
    dropped: Count  # malformed messages
    boxes: dict[Name, Triple] = {}  # poses of the movable boxes in the arena
    # Pairs in contact in the last 0.5 s, each a robot and a robot or part of the arena.
    touching: tuple[tuple[Name, Name], ...] = ()
    faults: dict[Name, Line] = {}  # those that are on, by robot


class WorldRequest(Struct, frozen=True, kw_only=True):
    """A request to the world, by its action.

    - `start`: restart the recording.
    - `finish`: write the recording.
    - `poses`: return the state alone.
    - `place`: put the movable `box` at rest at `pose`.
    - `remove`: take the movable `box` out of the arena.
    - `take_out`: take the `robot` out of the arena.
    - `fields`: replace each field of the world by the field of the same name in `fields`.
    - `fault`, `mend`: begin or end `fault` (as of `fault_of`) of `robots`.
    """

    action: Action
    box: Word = ""
    robot: Word = ""
    pose: Triple = (0.0, 0.0, 0.0)
    fields: Annotated[tuple[Field, ...], Meta(max_length=1000)] = ()
    fault: Annotated[dict[Name, float | Name], Meta(max_length=20)] = {}
    robots: Annotated[tuple[Name, ...], Meta(max_length=1000)] = ()


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
