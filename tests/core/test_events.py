"""Inputs of a robot: their bytes, their bounds, and that the robot takes each kind."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from swarmd.core import events
from swarmd.core.errors import CodecError
from swarmd.core.goal import Goal
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.host_messages import HostDied, Loaded, Stepped, TrialDone
from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import Body, Epoch, Latch, PeerFault, Reason
from swarmd.core.values import Neighbor, Odometry, Outputs, PeerPlace, Pose, Scan, SharedPose, Twist
from swarmd.core.verbs import StopRequest
from swarmd.robot import robot

SCAN = Scan(3, 1.5, np.array([1.0, np.inf, np.nan]), np.arange(3.0), 0.1, 3.5, np.zeros(3))
STOP = StopRequest(id="s", operator="anna", targets={"a": Epoch("00", 1)})
INPUTS: tuple[events.Input, ...] = (
    events.OdometryInput(Odometry(1.0, Pose(1.0, 2.0, 3.0), Twist(0.1, 0.2, 0.3))),
    events.NeighborsInput((Neighbor("b", 0.5, 1.0, None, 0.1, False),)),
    events.PoseInput(SharedPose(1.0, Pose(), 0.1, 0.1, "hall")),
    events.ReadingsInput({"battery": 0.5}),
    events.HazardsInput((Hazard(HazardKind.BUMP, "front"),)),
    events.DriverInput(True, "there", Reason.DRIVER_LOST, True),
    events.MessageInput("b", "vote/opinion", {"value": [1, None, b"x", 0.5]}),
    events.PeersInput({"b": Body(platform="burger", surface_speed=1.0, radius=0.2), "c": None}),
    events.PeerFaultsInput((PeerFault(robot="b", kind="mute", by=3, of=4, since=2.5),)),
    events.PlaceInput(PeerPlace("b", "hall", 1.0, 2.0, 0.1, 0.5)),
    events.KinInput("b", KinMessage(7, 1000, -5, 5, 0, b"\x04\xb0\xff\xe2", True)),
    events.LatchesInput({"e1": Latch(issuer="anna", scope="swarm")}),
    events.GoalInput(Goal(generation=1, issuer="anna", id="g", signature=b"12"), None, True),
    events.LeaseInput("g", 3),
    events.LeaseInput("g", 3, 1.5),
    events.LeaseInput("g", 3, None),
    events.DuplicateInput(None),
    events.HostInput(HostDied(1, "gone")),
    events.HostInput(TrialDone(1, "")),
    events.RequestInput(STOP),
    events.CodeInput(),
    events.ProvisionalInput((1, 2)),
    events.ForgetInput(("00ff",)),
    events.NetworkInput("wlan0: another address"),
    events.RosterInput("2", True),
    events.LeaveInput(),
    events.NoteInput("a line"),
    events.TICK_INPUT,
)


@pytest.mark.parametrize("input", INPUTS, ids=events.tag_of)
def test_an_input_is_the_same_after_encoding(input: events.Input) -> None:
    assert events.decode_input(events.encode_input(input)) == input


@pytest.mark.parametrize("kind", [events.ScanInput, events.RangesInput])
def test_the_arrays_of_a_scan_are_exact_and_may_be_written(
    kind: type[events.ScanInput | events.RangesInput],
) -> None:
    back = events.decode_input(events.encode_input(kind(SCAN)))
    assert isinstance(back, kind)
    for name in ("ranges", "bearings", "ages"):
        array = getattr(back.scan, name)
        assert array.tobytes() == getattr(SCAN, name).tobytes()
        assert array.flags.writeable
    assert (back.scan.seq, back.scan.stamp, back.scan.range_max) == (3, 1.5, 3.5)


def test_an_event_of_the_pattern_host_keeps_its_type() -> None:
    for event in (Loaded(1, 10.0, frozenset({"a"}), {}), Stepped(1, Outputs(Twist(0.2)), 7)):
        back = events.decode_input(events.encode_input(events.HostInput(event)))
        assert isinstance(back, events.HostInput)
        assert type(back.event) is type(event)
        assert back.event.generation == 1


def test_the_robot_takes_each_kind_of_input() -> None:
    assert set(robot.HANDLERS) == set(get_args(events.Input))


@pytest.mark.parametrize(
    "input",
    [
        events.MessageInput("x" * 64, "a/b", 1),
        events.MessageInput("b", "x" * 128, 1),
        events.ReadingsInput({str(n): 0.0 for n in range(1001)}),
        events.ProvisionalInput((-1,)),
        events.NoteInput("x" * 10_001),
    ],
)
def test_what_exceeds_a_bound_is_malformed(input: events.Input) -> None:
    with pytest.raises(CodecError):
        events.decode_input(events.encode_input(input))


@pytest.mark.parametrize("data", [b"", b"\xc1", b"\x91\xa3abc", b"\x92\xa4scan\x01"])
def test_other_bytes_are_malformed(data: bytes) -> None:
    with pytest.raises(CodecError):
        events.decode_input(data)
