"""A recording holds the instants that its robot got, to the bit, whatever the clock shows."""

from __future__ import annotations

import math
import struct
import tempfile
from pathlib import Path
from typing import cast

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.events import TICK_INPUT, Input, OdometryInput
from swarmd.core.messages import State
from swarmd.core.values import ZERO, Odometry, Pose
from swarmd.daemon.recording import frames, messages
from swarmd.daemon.recording.inputs import INPUT, InputReader
from swarmd.daemon.recording.process import Converter
from swarmd.daemon.recording.reader import RecordedMessage, clock_of, read_file
from swarmd.robot.robot import Robot
from swarmd.settings.file_limits import FileLimits
from tests.support.recorded_stories import FileRecorder

MINUTE, DAY, YEAR = 60 * 10**9, 86_400 * 10**9, 365 * 86_400 * 10**9
UPTIMES = st.one_of(st.integers(0, 2 * MINUTE), st.integers(0, DAY), st.integers(0, 30 * YEAR))
READINGS = UPTIMES.map(lambda ns: ns // 10**9 + 1e-9 * (ns % 10**9))
"""What CPython's `clock_gettime` gives: timemodule.c adds the seconds to 1e-9 times the rest."""
WAITED = st.one_of(st.just(0.0), st.floats(0.0, 1.0))
INSTANTS = st.builds(lambda reading, waited: max(reading - waited, 0.0), READINGS, WAITED)


class Listener:
    """In place of a robot: keeps the instants of its inputs."""

    state = State.IDLE

    def __init__(self) -> None:
        self.instants: list[float] = []

    def step(self, input: Input, now: float) -> None:
        self.instants.append(now)


def converter_in(folder: str) -> Converter:
    whole = FileLimits(file_seconds=1e10)  # one file
    return Converter(frames.Begin(12.3, folder, "a", {}, 1.7e9, whole))


# 60 + 1e-9 * 150000003 is 60.150000003000002, and 60150000003 / 1e9 is 60.150000003.
@given(st.lists(INSTANTS, min_size=1, max_size=50))
@example([60 + 1e-9 * ns for ns in range(150_000_000, 150_000_200)])
@example([61.5 - 1 / 3])
def test_an_input_is_read_with_the_instant_that_the_robot_got(instants: list[float]) -> None:
    robot = Listener()
    with tempfile.TemporaryDirectory() as folder:
        recorder = FileRecorder(Path(folder))
        recorder._converter = converter_in(folder)
        for number, now in enumerate(instants):
            measured = OdometryInput(Odometry(now, Pose(), ZERO)) if number % 2 else TICK_INPUT
            recorder.step(cast("Robot", robot), measured, now)
        recorded = recorder.finish()
    reader = InputReader()
    read = [reader.read(one) for one in recorded.messages if one.topic == INPUT]
    found = [one.now for one in read if one is not None]
    count = len(instants)
    assert struct.pack(f"{count}d", *robot.instants) == struct.pack(f"{count}d", *instants)
    assert struct.pack(f"{count}d", *found) == struct.pack(f"{count}d", *instants)


def test_a_time_in_ns_alone_would_not_give_these_instants(tmp_path: Path) -> None:
    instants = [60 + 1e-9 * ns for ns in range(150_000_000, 150_001_000)]
    converter = converter_in(str(tmp_path))
    for now in instants:
        converter.add(frames.input_entry(TICK_INPUT, now))
    converter.writer.close()
    (path,) = tmp_path.glob("*.mcap")
    recorded = read_file(path)
    times = [clock_of(recorded.about, one.at) for one in recorded.messages]
    assert times != instants
    assert all(abs(a - b) < 1e-9 for a, b in zip(times, instants, strict=True))


@pytest.mark.parametrize("now", [math.nan, math.inf, -1.0, 1.1e9])
def test_an_instant_that_no_clock_shows_is_refused(now: float) -> None:
    kind, payload = messages.input_message(b"", now, 0.0)
    with pytest.raises(CodecError, match="expected 0 to"):
        InputReader().read(RecordedMessage(INPUT, kind, 0, 0, payload))


@pytest.mark.parametrize("wall", ["9" * 400, "", "1e9"])
def test_a_clock_that_is_no_number_of_ns_is_refused(wall: str) -> None:
    with pytest.raises(ConfigError, match="does not tell its clock"):
        clock_of({"wall_ns": wall, "boot_ns": "0"}, 10**18)
