"""What the recorder writes to the ring of the black box, and when; no process."""

from __future__ import annotations

import asyncio
import os
from contextlib import closing
from pathlib import Path

import pytest

from swarmd.core.events import (
    TICK_INPUT,
    Input,
    NoteInput,
    OdometryInput,
    PeersInput,
    decode_input,
    tag_of,
)
from swarmd.core.values import Odometry, Pose, Twist
from swarmd.daemon.recorder import Recorder
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.ring import Ring, entries_of
from tests.support.robot_harness import RobotHarness


class Ringed:
    """A robot whose recorder has a ring with one segment; `writes`: of frames, since then."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.harness = RobotHarness("burger")
        with closing(asyncio.new_event_loop()) as loop:
            self.recorder = Recorder(loop, print)
        ring = Ring(folder / "r", {}, capacity=1 << 20, seconds=60.0, boot=1.0, wall=2.0)
        self.ring = self.recorder.black_box.ring = ring
        self.writes = 0
        _pwrite = os.pwrite

        def pwrite(file: int, data: bytes, at: int) -> int:
            self.writes += at != 0
            return _pwrite(file, data, at)

        self.recorder.remember(self.harness.robot, self.harness.now, 1.0)
        monkeypatch.setattr(os, "pwrite", pwrite)

    def step(self, input: Input) -> None:
        """As the daemon does."""
        self.harness.now += 0.01
        try:
            self.recorder.step(self.harness.robot, input, self.harness.now)
        finally:
            self.recorder.settle(self.harness.robot)

    def kinds(self) -> list[str]:
        """The kinds of the inputs in the ring."""
        entries = entries_of(self.ring.left())
        return [
            tag_of(decode_input(one.data)) for one in entries if isinstance(one, frames.InputEntry)
        ]


def test_inputs_without_a_decision_are_in_the_ring_with_the_next_tick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    story = Ringed(tmp_path, monkeypatch)
    for count in range(10):
        for _ in range(3):
            story.step(OdometryInput(Odometry(0.1 * count, Pose(), Twist())))
        story.step(PeersInput({}))
        story.step(TICK_INPUT)
    assert story.writes == 10
    assert story.kinds() == 10 * [*3 * ["odometry"], "peers", "tick"]
    story.step(NoteInput("an event"))  # which may tell why the daemon is killed
    assert story.kinds()[-1] == "note"
    story.ring.close()


def test_an_input_that_ends_the_daemon_is_in_the_ring(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    story = Ringed(tmp_path, monkeypatch)
    monkeypatch.setattr(type(story.harness.robot), "step", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        story.step(OdometryInput(Odometry(0.1, Pose(), Twist())))
    assert story.kinds() == ["odometry"]
    story.ring.close()
