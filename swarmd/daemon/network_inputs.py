"""What comes to a daemon from other robots and from its interface, handed to its robot."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

from swarmd.core.clock import ClockSample, boottime
from swarmd.core.codec import decode_value
from swarmd.core.errors import CodecError
from swarmd.core.messages import Latch, Reply
from swarmd.core.values import PeerPlace
from swarmd.daemon.audit import Audit
from swarmd.daemon.neighbors import NeighborSelection
from swarmd.daemon.recorded_robot import RecordedRobot
from swarmd.daemon.recorder import Recorder
from swarmd.daemon.systemd import Notifier
from swarmd.network.datagram import Address, Message, RunLease, Stop
from swarmd.network.goal_sync import FoundGoal
from swarmd.network.interface_watch import InterfaceChange
from swarmd.recording import frames
from swarmd.robot.actions import Actions

log = logging.getLogger(__name__)


class NetworkInputs:
    """Hands what the network delivers to `robot`, and the robot's actions to `carry_out`.

    `stop` takes a stop, the address from which it came, and what takes its reply. `drop` counts
    what does not count.
    """

    def __init__(
        self,
        robot: RecordedRobot,
        carry_out: Callable[[Actions], None],
        *,
        stop: Callable[[Stop, str, Callable[[Reply], None]], None],
        drop: Callable[[str], None],
        audit: Audit,
        neighborhood: NeighborSelection,
        recorder: Recorder,
        notify: Notifier,
    ) -> None:
        self._robot = robot
        self._carry_out = carry_out
        self._stop, self._drop = stop, drop
        self._audit = audit
        self._neighborhood = neighborhood
        self._recorder = recorder
        self._notify = notify

    def on_stop(self, stop: Stop, source: Address, answer: Callable[[Reply], None]) -> None:
        """Carry out a stop or estop of an operator or relay; the reply goes to `answer`."""
        self._stop(stop, f"{source[0]}:{source[1]}", answer)

    def on_latches(self, latches: Mapping[str, Latch]) -> None:
        """The swarm-wide latches of a peer."""
        before, held = self._robot.state, set(self._robot.latches)
        self._carry_out(self._robot.on_latches(latches, boottime()))
        for id in sorted(self._robot.latches.keys() - held):
            latch = self._robot.latches[id]
            self._audit.note(f"latch {id}", latch.issuer, "a peer", latch.reason, boottime())
        if self._robot.state is not before:
            text = self._robot.status(boottime()).detail
            log.info("estopped by the latch of a peer: %s", text)

    def on_goal(self, found: FoundGoal) -> None:
        """The greatest goal of a peer."""
        goal, before = found.goal, self._robot.goal
        self._carry_out(self._robot.on_goal(goal, found.age, boottime(), may_join=found.may_join))
        held = self._robot.goal
        if held is not None and held.goal == goal and (before is None or before.goal != goal):
            on_join = f"on_join {goal.on_join}" if goal.pattern else ""
            self._audit.note(goal.text, goal.issuer, "a peer", on_join, boottime())

    def on_run_lease(self, lease: RunLease) -> None:
        """The operator of a run with a lease was heard."""
        self._robot.on_run_lease(lease.id, lease.count, boottime())

    def on_message(self, message: Message) -> None:
        """A message of the pattern of a peer."""
        try:
            value = decode_value(message.payload)
            is_accepted = self._robot.on_message(message.robot, message.channel, value, boottime())
        except CodecError:
            self._drop("msg:malformed")
            return
        if not is_accepted:
            self._drop("msg:not_a_neighbor")

    def on_place(self, place: PeerPlace) -> None:
        """Where a peer is by its own word."""
        self._neighborhood.on_place(place, boottime())
        self._robot.on_peer_place(place, boottime())

    def on_clock(self, sample: ClockSample) -> None:
        """A reading of the clock of a peer, for recordings."""
        self._recorder.add(frames.ClockEntry(boottime(), *sample))

    def on_duplicate(self, holder: str | None) -> None:
        """Another daemon, `holder`, has the same id; None: no longer."""
        if holder is not None:
            log.error("id %s is also held by %s", self._robot.id, holder)
        self._carry_out(self._robot.on_duplicate(holder, boottime()))

    def on_interface(self, change: InterfaceChange) -> None:
        """Tell of a change of the interface; with another address the robot stands."""
        log.warning("%s", change.line)
        self._notify.status(change.line)
        if change.must_reopen:
            self._carry_out(self._robot.on_network_changed(change.line, boottime()))
        else:
            self._robot.log(change.line, boottime())
