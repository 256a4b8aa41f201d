"""The network side of a live world: links to the robots' drivers, and a Zenoh session for viewers.

`WorldLink` sends sensor data to daemons and receives their commands. Viewers receive the world's
state and send requests over Zenoh (`WorldView`). `EmulatorTransport` replaces the links of robots
if the world emulates the interface of a ROS driver.

No other module of the simulation imports Zenoh. Multicast and gossip are off: viewers connect to
the world alone.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import zenoh

from swarmd.core.closing import Closing
from swarmd.core.codec import MAX_CONTROL, encode
from swarmd.core.errors import CodecError, NetworkError, SwarmError
from swarmd.core.events import SensorInput, tag_of
from swarmd.core.values import Platform, Twist
from swarmd.driver_api import hw_codec
from swarmd.driver_api.emulator import Emulator, EmulatorFactory
from swarmd.link.carriers.robot_link import RobotServer, read_endpoint
from swarmd.link.carriers.session import (
    on_thread,
    open_listening,
    open_with,
    tune_sockets,
)
from swarmd.sim.live.state import (
    Action,
    Triple,
    WorldReply,
    WorldRequest,
    WorldState,
    control_key,
    decode_reply,
    decode_state,
    state_key,
)
from swarmd.sim.world.scalar_fields import Field

LEASE = 60.0  # s, of viewers
MAX_PENDING_REQUESTS = 64  # until the next step; more are dropped
MAX_PENDING_MESSAGES = 4096  # of all robots until the next step; more are dropped
_OPTIONS: dict[str, object] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/link/tx/lease": round(LEASE * 1000),
    # The loop never waits for a viewer that does not read; the sender may lag by a burst.
    "transport/link/tx/queue/size/real_time": 16,
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": 0,
    "transport/shared_memory/enabled": False,
}


@dataclass(frozen=True, slots=True)
class PendingRequest:
    """The payload of a request, and the function that sends the reply."""

    payload: bytes
    answer: Callable[[WorldReply], None]


class WorldLink:
    """The simulated world's link to daemons and viewers: sensor data out, newest commands in.

    Daemons connect to `endpoint`, viewers (Zenoh clients) to `viewers`.
    """

    def __init__(
        self,
        swarm: str,
        ids: Iterable[str],
        endpoint: str,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Listen at `endpoint` for daemons, and at a free port of the same host for viewers.

        `ids`: the robots. Port 0 selects a free port, which `self.endpoint` then holds. `clock`
        stamps arrivals of commands. NetworkError if the endpoint is in use, ConfigError if invalid.
        """
        self._lock = threading.Lock()  # guards `_requests`, which a Zenoh thread fills
        self._commands: dict[str, Command] = {}  # newest, by robot
        self._grips: dict[str, bool] = {}  # newest command of the gripper, by robot; True: closed
        self._messages: list[hw_codec.MessageWire] = []
        self._requests: list[PendingRequest] = []
        self._swarm = swarm
        self._dropped = 0  # invalid frames, and messages and requests beyond the limits

        self._robots = RobotServer(endpoint, swarm, ids, "the world", clock=clock)
        self.endpoint = self._robots.endpoint

        host = read_endpoint(self.endpoint, "").host
        host = f"[{host}]" if ":" in host else host  # IPv6
        self._session, self.viewers = open_listening(f"tcp/{host}:0", _OPTIONS, "the world")
        tune_sockets(self._session, LEASE)
        self._state = self._session.declare_publisher(state_key(swarm))
        self._session.declare_queryable(control_key(swarm), self._on_query)

    @property
    def dropped(self) -> int:
        """Frames and requests that were dropped, unreadable ones among them."""
        return self._dropped + self._robots.dropped

    def publish(self, robot: str, name: str, payload: bytes) -> None:
        """Send sensor data of a robot; dropped if the link is busy."""
        self._robots.send(robot, name, payload)

    def send(self, robot: str, input: SensorInput) -> None:
        """Publish what a sensor of a robot has measured."""
        self.publish(robot, tag_of(input), hw_codec.encode_input(input))

    def messages(self, robot: str, messages: Sequence[hw_codec.MessageWire]) -> None:
        """Publish the messages of patterns that the radio of `robot` receives now, in order.

        Many messages share a packet: the link drops packets beyond the size of its queue.
        """
        for first in range(0, len(messages), hw_codec.MAX_MESSAGES):
            self.publish(
                robot,
                "received",
                hw_codec.encode_messages(messages[first : first + hw_codec.MAX_MESSAGES]),
            )

    def publish_state(self, state: WorldState) -> None:
        """Publish the state for viewers."""
        self._state.put(encode(state))

    def receive(self) -> None:
        """Decode what daemons have sent; keep the newest commands and all messages."""
        for robot, name, payload, arrival in self._robots.receive():
            try:
                if name == "cmd_vel":
                    self._on_command(robot, payload, arrival)
                elif name == "sent":
                    self._on_sent(robot, payload)
                elif name == "grip":
                    self._grips[robot] = hw_codec.decode_grip(payload)
                else:
                    self._dropped += 1
            except CodecError:  # keep the newest valid command
                self._dropped += 1

    def take_commands(self) -> Mapping[str, Command]:
        """The newest command of each robot since the last call."""
        self.receive()
        commands = self._commands
        self._commands = {}
        return commands

    def take_grips(self) -> Mapping[str, bool]:
        """The newest command of each gripper since the last call, up to the last `receive`."""
        grips = self._grips
        self._grips = {}
        return grips

    def take_messages(self) -> list[hw_codec.MessageWire]:
        """The messages that patterns have sent, up to the last `receive`, in order of arrival."""
        messages = self._messages
        self._messages = []
        return messages

    def take_requests(self) -> list[PendingRequest]:
        """The requests since the last call; each needs one reply."""
        with self._lock:
            questions = self._requests
            self._requests = []
        return questions

    def close(self) -> None:
        """Close all links."""
        self._robots.close()
        self._session.close()

    def _on_command(self, robot: str, payload: bytes, arrival: float) -> None:
        wire = hw_codec.decode_command(payload)
        twist = Twist(wire.linear, wire.angular, wire.lateral)
        self._commands[robot] = Command(twist, arrival, wire.scan_seq)

    def _on_sent(self, robot: str, payload: bytes) -> None:
        wire = hw_codec.decode_message(payload)
        if wire.robot == robot and len(self._messages) < MAX_PENDING_MESSAGES:
            self._messages.append(wire)
        else:
            self._dropped += 1

    def _on_query(self, query: zenoh.Query) -> None:
        payload = query.payload.to_bytes() if query.payload is not None else b""

        def answer(reply: WorldReply) -> None:
            query.reply(control_key(self._swarm), encode(reply))
            query.drop()  # ends the requester's wait

        with self._lock:
            if len(payload) <= MAX_CONTROL and len(self._requests) < MAX_PENDING_REQUESTS:
                self._requests.append(PendingRequest(payload, answer))
                return
            self._dropped += 1
        query.drop()


class WorldView(Closing):
    """A viewer's Zenoh session with a simulated world: receives states and sends requests.

    A context manager, which closes the session.
    """

    def __init__(self, swarm: str, endpoint: str) -> None:
        retry = {"period_init_ms": 500, "period_max_ms": 500, "period_increase_factor": 1.0}
        options = {
            **_OPTIONS,
            "listen/endpoints": [],
            "connect/endpoints": [endpoint],
            "connect/retry": retry,
        }
        self._swarm = swarm
        self._endpoint = endpoint
        self._session = open_with(options, what=f"the world at {endpoint}")

    def watch(self, handler: Callable[[WorldState], None]) -> None:
        """Call `handler` with each state (10 Hz) on a daemon thread."""

        def on_sample(sample: zenoh.Sample) -> None:
            with contextlib.suppress(CodecError):  # of another program
                handler(decode_state(sample.payload.to_bytes()))

        self._session.declare_subscriber(state_key(self._swarm), on_thread(on_sample))

    def ask(self, action: Action, timeout: float = 10.0) -> WorldReply:
        """The world's reply to an action; NetworkError if none comes within `timeout` s."""
        return self._ask(WorldRequest(action=action), timeout)

    def place(self, box: str, pose: Triple, timeout: float = 10.0) -> WorldState:
        """Put a movable box at x, y in m and yaw in rad, at rest; returns the state afterwards.

        SwarmError if the box does not fit there or does not exist. NetworkError if the world does
        not reply within `timeout` s.
        """
        return self._done(WorldRequest(action="place", box=box, pose=pose), timeout)

    def remove(self, box: str, timeout: float = 10.0) -> WorldState:
        """Take a movable box out of the arena; SwarmError if it is not there."""
        return self._done(WorldRequest(action="remove", box=box), timeout)

    def change_fields(self, fields: tuple[Field, ...], timeout: float = 10.0) -> WorldState:
        """Put fields in the place of all fields that have their names."""
        return self._done(WorldRequest(action="fields", fields=fields), timeout)

    def take_out(self, robot: str, timeout: float = 10.0) -> WorldState:
        """Take a robot out of the arena for good; SwarmError if there is no such robot."""
        return self._done(WorldRequest(action="take_out", robot=robot), timeout)

    def change_fault(
        self,
        fault: Mapping[str, Any],
        robots: Sequence[str],
        *,
        is_on: bool = True,
        timeout: float = 10.0,
    ) -> WorldState:
        """Begin (`is_on`) or end a fault of robots.

        `fault`: as of `fault_of`. SwarmError for an unknown robot, and for a fault that the world
        does not know or cannot simulate.
        """
        request = WorldRequest(
            action="fault" if is_on else "mend",
            fault=dict(fault),
            robots=tuple(robots),
        )
        return self._done(request, timeout)

    def _done(self, request: WorldRequest, timeout: float) -> WorldState:
        reply = self._ask(request, timeout)
        if not reply.is_done:
            raise SwarmError(reply.text)
        return reply.state

    def _ask(self, request: WorldRequest, timeout: float) -> WorldReply:
        payload = encode(request)
        deadline = time.monotonic() + timeout
        while (left := deadline - time.monotonic()) > 0.0:
            replies = self._session.get(control_key(self._swarm), payload=payload, timeout=left)
            for reply in replies:
                if reply.ok is not None:
                    return decode_reply(reply.ok.payload.to_bytes())
            # Right after opening there is no link yet, and a get returns nothing at once.
            threading.Event().wait(0.02)
        raise NetworkError(
            f"the world of swarm {self._swarm!r} at {self._endpoint} did not answer"
            f" {request.action!r} within {timeout:g} s; is it running?"
        )

    def close(self) -> None:
        """Close the session."""
        self._session.close()


DRIVER = "simulated"
"""The driver of daemons whose robots are not emulated."""


@dataclass(frozen=True, slots=True)
class Command:
    """The newest command of a robot and its time of arrival.

    `scan_seq`: the scan behind the decision; -1: no scan, None: unknown.
    """

    twist: Twist
    arrival: float
    scan_seq: int | None = None


class EmulatorTransport:
    """The emulated interface of a ROS driver, in place of the world's own links to daemons.

    `side`: the emulator. It stands for the ROS bridge or router that daemons connect to.
    """

    def __init__(
        self,
        factory: EmulatorFactory,
        robots: Mapping[str, Platform],
        endpoint: str,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open the hub; raises what the factory raises."""
        self._clock = clock
        self._lock = threading.Lock()
        self._commands: dict[str, Command] = {}
        self.side: Emulator = factory(robots=robots, endpoint=endpoint, on_command=self._on_command)

    def send(self, robot: str, input: SensorInput) -> None:
        """Publish a measurement."""
        self.side.publish(robot, input)

    def take_commands(self) -> Mapping[str, Command]:
        """The newest command of each robot since the last call."""
        with self._lock:
            commands = self._commands
            self._commands = {}
        return commands

    def _on_command(self, robot: str, twist: Twist) -> None:
        command = Command(twist, self._clock())
        with self._lock:
            self._commands[robot] = command
