"""Recorded runs of a robot in simulated time are repeated command by command."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from msgspec import structs

from swarmd.core.errors import ConfigError
from swarmd.core.events import (
    CodeInput,
    HazardsInput,
    Input,
    OdometryInput,
    PoseInput,
    ReadingsInput,
)
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.host_messages import PatternFailed
from swarmd.core.libm import digest_of_libm
from swarmd.core.low_battery import LowBatterySettings
from swarmd.core.messages import LimitingObstacle, Reason, State
from swarmd.core.values import Pose, SharedPose, Twist
from swarmd.daemon.recording import frames, messages
from swarmd.daemon.recording.head import head_of
from swarmd.daemon.recording.inputs import GEOMETRY, InputReader
from swarmd.daemon.recording.reader import RecordedFile, read_file
from swarmd.mission.mission import mission_class
from swarmd.operator.replay.replay import Compared, Parity, decision_text, recordings_of, total
from swarmd.pattern_host.loader import PatternLoader
from swarmd.robot.actions import Actions
from swarmd.robot.protection.decision import Decision
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.robot import Robot
from tests.support.hand import BACK, FORWARD, HandOn
from tests.support.recorded_stories import ORIGINS, PATTERNS, Busy, Story, repeat, rewritten


def assert_equal(parity: Parity, least: int) -> None:
    assert parity.notes == ()
    assert parity.safe.count > least
    assert parity.safe.is_equal
    assert parity.requested.count > least / 10
    assert parity.requested.is_equal


def test_a_change_of_pattern_parameters_and_an_estop_are_repeated(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.recorder.begin(story.robot)
    story.robot.advance(1.0)
    story.run("drive", speed=0.1)
    story.robot.ask("param", params={"speed": 0.2})
    story.robot.advance(2.0)
    story.run("random_walk")
    story.robot.applied("estop", id="e1", reason="a chair")
    story.robot.advance(1.0)
    story.robot.ask("reset", ids=("e1",))
    story.robot.advance(0.5)
    story.run("drive", speed=0.15)
    assert_equal(story.replayed(), 300)


def test_inputs_that_the_robot_got_with_an_earlier_time_are_repeated_in_their_order(
    tmp_path: Path,
) -> None:
    story = Story(tmp_path)
    taken: list[float] = []

    def take(robot: Robot, input: Input, now: float) -> Actions | None:
        taken.append(now - 0.06 if type(input) is OdometryInput else now)
        return story.recorder.step(robot, input, taken[-1])

    story.robot._take = take
    story.recorder.begin(story.robot)
    taken.clear()
    story.robot.advance(1.0)
    story.run("drive", speed=0.1)
    assert taken != sorted(taken)
    file = story.recorder.finish()
    times = [message.at for message in file.messages]
    assert times == sorted(times)
    reader = InputReader()
    read = [timed.now for one in file.messages if (timed := reader.read(one)) is not None]
    assert read[-len(taken) :] == taken
    assert_equal(repeat([file], ORIGINS)[1], 60)


def test_a_pattern_that_is_not_here_is_named_with_the_option_for_it(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.recorder.begin(story.robot)
    story.robot.advance(1.0)
    story.run("drive", speed=0.1)
    story.robot.advance(1.0)
    notes = story.replayed({"random_walk": ORIGINS["random_walk"]}).notes
    assert "--plugin-dir: no pattern 'drive'" in notes[0]


def test_a_run_of_a_robot_with_a_ring_is_repeated(tmp_path: Path) -> None:
    story = Story(tmp_path, has_ring=True)
    story.recorder.begin(story.robot)
    story.robot.advance(1.0)
    story.run("drive", 6.0, speed=0.15)
    assert {True, False} == {twist.is_zero for _, twist in story.robot.commands}
    assert_equal(story.replayed(), 150)


def test_a_run_within_a_fence_is_repeated(tmp_path: Path) -> None:
    corners = [(-0.3, -2.0), (0.45, -2.0), (0.45, 2.0), (-0.3, 2.0)]
    story = Story(tmp_path, fence=FenceSettings(frame="w", polygon=corners))
    story.recorder.begin(story.robot)
    story.robot.ask("run", pattern="drive", params={"speed": 0.15})
    is_fenced = set()
    for number in range(60):
        x = 0.3 if 15 < number < 30 else 0.0
        pose = SharedPose(story.robot.now, Pose(x, 0.0, 0.1 * math.sin(number)), 0.02, 0.2, "w")
        story.robot.step(PoseInput(pose))
        story.robot.advance(0.1)
        is_fenced.add(story.robot.robot.decision.is_bounded)
    assert is_fenced == {False, True}
    assert_equal(story.replayed(), 100)


def test_a_run_that_a_low_battery_ends_is_repeated(tmp_path: Path) -> None:
    given = LowBatterySettings(below=0.2, pattern="drive", params={"speed": 0.05})
    story = Story(tmp_path, on_low_battery=given)
    story.recorder.begin(story.robot)
    story.robot.ask("run", pattern="drive", params={"speed": 0.15})
    for charge in (0.3, *(0.1,) * 20):
        story.robot.step(ReadingsInput({"battery": charge}))
        story.robot.advance(0.5)
    battery = story.robot.status.battery
    assert battery is not None
    assert battery.runs
    assert_equal(story.replayed(), 100)


DRAWN = """\
mission: Drives at two speeds, each until a draw
parts: {slow: {pattern: drive, params: {speed: 0.1}}, fast: {pattern: drive, params: {speed: 0.2}}}
sequence:
  - {part: slow, until: {probability: 0.9}}
  - {part: fast, transitions: {slow: {probability: 0.9}}}
then: repeat
"""


def test_the_draws_of_a_mission_are_repeated(tmp_path: Path) -> None:
    path = tmp_path / "drawn.yaml"
    path.write_text(DRAWN)
    made = mission_class(path, PatternLoader(ORIGINS))
    story = Story(tmp_path, patterns={**PATTERNS, "drawn": made})
    story.recorder.begin(story.robot)
    story.robot.advance(1.0)
    story.run("drawn", 0.5)
    phases = set()
    for _ in range(15):
        story.robot.advance(0.5)
        phases.add(story.robot.robot.report["phase"])
    parity = story.replayed({**ORIGINS, "drawn": (str(path), True)})
    assert_equal(parity, 150)
    assert phases == {"slow", "fast"}


def test_a_recording_that_begins_after_earlier_runs_and_a_latch_is_repeated(
    tmp_path: Path,
) -> None:
    story = Story(tmp_path)
    story.robot.advance(1.0)
    story.run("random_walk")
    story.robot.applied("estop", id="e1", reason="a chair")
    story.robot.advance(1.0)
    story.recorder.begin(story.robot)
    story.robot.advance(1.0)
    story.robot.ask("reset", ids=("e1",))
    story.robot.advance(1.0)
    story.run("drive", speed=0.1)
    assert_equal(story.replayed(), 80)


def test_late_copies_of_stops_from_before_the_recording_change_no_replay(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.run("drive", speed=0.1)
    story.robot.applied("stop", id="s1")
    story.robot.applied("estop", id="e1", reason="a chair")
    story.robot.ask("reset", ids=("e1",))
    story.recorder.begin(story.robot)
    story.robot.advance(1.0)
    story.robot.ask("stop", id="s1", age=2.0)
    story.run("drive", speed=0.1)
    story.robot.ask("estop", id="e1", reason="a chair", is_relayed=True)
    story.robot.advance(1.0)
    assert story.robot.robot.state is State.RUNNING
    recorded = story.recorder.finish()
    assert_equal(repeat([recorded], ORIGINS)[1], 80)
    events = [one.at for one in recorded.messages if one.topic == "/event"]
    assert min(events) >= 1.7e18  # ns: the wall time at which the recording began


def test_a_stop_that_was_on_its_way_when_the_recording_began_is_repeated(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.run("drive", speed=0.1)
    story.recorder.begin(story.robot)
    story.robot.advance(0.5)
    story.robot.ask("stop", age=1.0)
    story.robot.advance(1.0)
    assert story.robot.robot.state is State.STOPPED
    parity = story.replayed()
    assert parity.safe.count > 20
    assert parity.safe.is_equal


def test_a_step_that_is_answered_after_the_next_load_is_compared(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.recorder.begin(story.robot)
    story.run("random_walk")
    story.robot.is_hung = True
    story.robot.sent.clear()
    while not story.robot.sent:
        story.robot.advance(0.05)
    (step,) = story.robot.sent
    story.robot.ask("run", pattern="drive", params={"speed": 0.1})
    story.robot.host_answers(step)
    story.robot.is_hung = False
    story.robot.host_answers(story.robot.sent[-1])
    story.robot.advance(2.0)
    assert story.robot.robot.state is State.RUNNING
    assert_equal(story.replayed(), 60)


@pytest.mark.short_rows(3)
@pytest.mark.parametrize("has_ring", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_a_recording_begun_at_any_time_is_repeated_to_the_bit(
    tmp_path: Path, seed: int, has_ring: bool
) -> None:
    busy = Busy(tmp_path, seed, has_ring=has_ring)
    busy.wander(float(busy.random.uniform(0.0, 15.0)))
    busy.robot.ask("run", pattern="drive", params={"speed": 0.1})
    busy.robot.advance(float(busy.random.uniform(0.1, 2.0)))
    is_running = busy.robot.robot.state is State.RUNNING
    busy.story.recorder.begin(busy.robot)
    busy.robot.advance(1.0)
    busy.wander(6.0)
    parity = busy.story.replayed()
    assert parity.safe.count > 150
    assert parity.safe.is_equal
    assert parity.requested.count > 20
    assert parity.requested.is_equal
    assert len(parity.notes) == is_running, "only the pattern of a run in progress is not known"


def test_a_replay_goes_on_after_a_loss_to_the_bit(tmp_path: Path) -> None:
    busy = Busy(tmp_path, 1)
    recorder = busy.story.recorder
    recorder.begin(busy.robot)
    busy.wander(3.0)
    taken, recorder._converter = recorder._converter, None
    busy.wander(3.0)
    recorder._converter = taken
    recorder.add(frames.DroppedEntry(busy.robot.now, 100))
    recorder._is_memory_due = True
    busy.wander(3.0)
    parity = busy.story.replayed()
    assert parity.safe.count > 150
    assert parity.safe.is_equal
    assert parity.requested.is_equal
    assert "dropped" in parity.notes[0]


def parts_of_three(folder: Path) -> list[RecordedFile]:
    """Three parts of one recording, each of which begins with the robot's memory."""
    busy = Busy(folder, 2)
    recorder = busy.story.recorder
    recorder.begin(busy.robot)
    for _ in range(3):
        recorder._is_memory_due = True
        busy.wander(3.0)
    file = recorder.finish()
    begins = [at for at, one in enumerate(file.messages) if one.topic == "/memory"]
    return [
        replace(file, about={**file.about, "file": str(number)}, messages=file.messages[begin:end])
        for number, (begin, end) in enumerate(pairwise([0, *begins[1:], None]), start=9)
    ]


def decisions_in(files: Sequence[RecordedFile]) -> int:
    return sum(one.topic == "/decision" for file in files for one in file.messages)


def test_parts_in_any_order_and_copies_of_parts_are_one_recording(tmp_path: Path) -> None:
    first, second, third = parts = parts_of_three(tmp_path)
    cut = replace(second, messages=second.messages[:100], fault="cut off")
    torn = replace(first, fault="damaged", messages=[*first.messages, *first.messages[-9:]])
    (files,) = recordings_of([cut, third, first, torn, second, first])
    _, parity = repeat(files, ORIGINS)
    assert_equal(parity, 150)
    assert parity.safe.count == decisions_in(parts)


@pytest.mark.parametrize("is_cut", [False, True])
def test_a_replay_goes_on_behind_a_missing_part(tmp_path: Path, is_cut: bool) -> None:
    first, second, third = parts_of_three(tmp_path)
    cut = replace(second, messages=second.messages[:100], fault="cut off")
    kept = [first, cut, third] if is_cut else [first, third]
    _, parity = repeat(kept, ORIGINS)
    assert parity.safe.is_equal
    assert parity.requested.is_equal
    assert parity.difference is None
    assert parity.safe.count == decisions_in(kept)
    assert "missing" in parity.notes[0]


def test_nothing_is_compared_behind_a_damaged_chunk_until_the_next_memory(tmp_path: Path) -> None:
    whole = parts_of_three(tmp_path)
    path = rewritten(whole[0], tmp_path / "first.mcap")
    intact = path.read_bytes()
    behind = 0
    # Not every byte is one of a chunk. The first chunks have the directions of all rays.
    for at in range(len(intact) // 2, len(intact), len(intact) // 64):
        data = bytearray(intact)
        data[at] ^= 0xFF
        path.write_bytes(data)
        damaged = read_file(path)
        gaps = [one.follows_gap for one in damaged.messages]
        if True in gaps[1:]:
            behind = gaps.index(True, 1)
            break
    assert 0 < behind < len(damaged.messages) < len(whole[0].messages)
    kept = [replace(damaged, messages=damaged.messages[:behind]), *whole[1:]]
    _, parity = repeat([damaged, *whole[1:]], ORIGINS)
    assert parity.safe.is_equal
    assert parity.requested.is_equal
    assert parity.safe.count == decisions_in(kept)


def test_nothing_is_compared_behind_a_scan_without_the_directions_of_its_rays(
    tmp_path: Path,
) -> None:
    first, *others = parts_of_three(tmp_path)
    at = next(n for n, one in enumerate(first.messages) if one.topic.endswith(GEOMETRY))
    cut = replace(first, messages=[*first.messages[:at], *first.messages[at + 1 :]])
    _, parity = repeat([cut, *others], ORIGINS)
    assert 0 < parity.safe.equal == parity.safe.count < decisions_in([first, *others])
    assert parity.difference is None
    assert "a scan without the directions of its rays" in parity.notes[0]


def test_a_recording_in_a_run_without_a_readable_memory_is_refused(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.robot.advance(1.0)
    story.run("drive", speed=0.1)
    story.recorder.begin(story.robot)
    story.robot.advance(1.0)
    found = story.recorder.finish()
    kept = [one for one in found.messages if one.topic != "/memory"]
    with pytest.raises(ConfigError, match="begins in a run"):
        repeat([replace(found, messages=kept)], ORIGINS)
    with pytest.raises(ConfigError, match="begins in a run"):
        repeat([found], ORIGINS, story.robot.platform)
    identity = head_of(found.about, "").identity
    setup = structs.replace(identity.setup, version="0.0.7")
    other = structs.replace(
        head_of(found.about, ""), identity=structs.replace(identity, setup=setup)
    )
    about = {**found.about, **other.texts()}
    with pytest.raises(ConfigError, match=r"version 0\.0\.7"):
        repeat([replace(found, messages=kept, about=about)], ORIGINS)


def test_a_recording_that_ends_with_its_memory_is_refused(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.robot.advance(1.0)
    story.recorder.begin(story.robot)
    story.robot.advance(1.0)
    file = story.recorder.finish()
    topics = [one.topic for one in file.messages]
    end = topics.index("/memory")
    decision = file.messages[topics.index("/decision")]
    cut = replace(file, messages=[decision, *file.messages[: end + 1]])
    with pytest.raises(ConfigError, match="nothing can be compared"):
        repeat([cut], ORIGINS)


def test_a_recording_outside_a_run_without_a_memory_is_repeated_with_a_note(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.robot.advance(1.0)
    story.recorder.begin(story.robot)
    story.run("drive", speed=0.1)
    found = story.recorder.finish()
    kept = [one for one in found.messages if one.topic != "/memory"]
    _, parity = repeat([replace(found, messages=kept)], ORIGINS)
    assert parity.safe.count > 30
    assert [note for note in parity.notes if "memory" in note]


def test_a_fault_of_provisional_code_and_new_code_are_repeated(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.recorder.begin(story.robot)
    story.robot.advance(1.0)
    story.run("drive", speed=0.1)
    story.robot.step(CodeInput())
    story.provisional = {story.robot.robot.generation}
    story.robot.advance(1.0)
    story.robot.host_says(PatternFailed(story.robot.robot.generation, "on purpose"))
    story.robot.advance(1.0)
    assert story.robot.robot.state is State.FAULTED
    recorded = story.recorder.finish()
    assert "/code" in {one.topic for one in recorded.messages}
    assert_equal(repeat([recorded], ORIGINS)[1], 100)


def test_another_speed_limit_is_a_difference(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.recorder.begin(story.robot)
    story.robot.advance(1.0)
    story.run("drive", speed=0.2)
    found = story.recorder.finish()
    slow = replace(
        story.robot.platform, limits=structs.replace(story.robot.platform.limits, linear=0.1)
    )
    _, parity = repeat([found], ORIGINS, slow)
    assert parity.safe.first is not None
    assert parity.safe.largest > 0.05


def test_two_lives_of_a_daemon_are_repeated_one_after_the_other(tmp_path: Path) -> None:
    files = []
    for life in range(2):
        story = Story(tmp_path)
        story.robot.advance(life)
        story.recorder.begin(story.robot)
        story.robot.advance(1.0)
        story.run("drive", speed=0.1 + 0.05 * life)
        files.append(story.recorder.finish())
    parts = recordings_of(files)
    assert [len(part) for part in parts] == [1, 1]
    assert_equal(total(repeat(part, ORIGINS)[1] for part in parts), 160)


def test_hazards_are_repeated(tmp_path: Path) -> None:
    story = Story(tmp_path)
    robot = story.robot

    def tell(*hazards: Hazard) -> None:
        robot.step(HazardsInput(hazards))

    tell(Hazard(HazardKind.CLIFF))  # before the recording, which begins with it
    story.recorder.begin(robot)
    robot.advance(1.0)
    tell()
    robot.advance(0.2)
    story.run("drive", speed=0.1)
    tell(Hazard(HazardKind.BUMP, "front left"), Hazard(HazardKind.STALL))
    robot.advance(0.7)
    tell()
    robot.advance(1.5)
    assert not robot.twist.is_zero
    tell(Hazard(HazardKind.LIFTED))
    robot.advance(0.5)
    assert robot.robot.state is State.STOPPED
    tell()
    robot.advance(1.0)
    story.run("drive", speed=0.15)
    assert_equal(story.replayed(), 150)


def test_a_hand_is_repeated_to_the_bit(tmp_path: Path) -> None:
    """Taken above a run, driven with late words, lost, resumed; and taken before the recording."""
    story = Story(tmp_path)
    robot = story.robot
    hand = HandOn(robot)
    robot.advance(1.0)
    hand.take()
    hand.drive(0.3, BACK)
    story.recorder.begin(robot)
    hand.drive(0.5, BACK)
    assert robot.twist.linear < 0.0
    hand.release()
    story.run("drive", speed=0.1)
    hand.take()
    hand.drive(0.5, FORWARD)
    hand.word(BACK, age=1.0)
    hand.drive(0.5, BACK)
    robot.advance(1.0)
    assert robot.status.reason is Reason.HAND_LOST
    robot.applied("resume")
    robot.advance(1.0)
    assert not robot.twist.is_zero
    assert_equal(story.replayed(), 60)


def test_another_c_library_is_named(tmp_path: Path) -> None:
    story = Story(tmp_path)
    story.robot.advance(1.0)
    story.recorder.begin(story.robot)
    story.run("drive", speed=0.1)
    found = story.recorder.finish()
    assert head_of(found.about, "").libm == digest_of_libm()
    for libm, is_named in (("0badf00d", True), ("", False), (digest_of_libm(), False)):
        head = structs.replace(head_of(found.about, ""), libm=libm)
        other = replace(found, about={**found.about, **head.texts()})
        _, parity = repeat([other], ORIGINS)
        assert [("libm" in note and libm in note) for note in parity.notes] == [True] * is_named


@pytest.mark.parametrize(
    ("replayed", "recorded", "is_equal"),
    [
        (Twist(0.1, -0.2), Twist(0.1, -0.2), True),
        (Twist(0.1, 0.0), Twist(0.1, -0.0), False),
        (Twist(0.1, 0.0), Twist(0.1, math.nan), False),
        (Twist(0.1, math.inf), Twist(0.1, math.inf), True),
        (Twist(math.inf, 0.0), Twist(math.nan, 0.0), False),
    ],
)
def test_commands_are_compared_to_the_bit(replayed: Twist, recorded: Twist, is_equal: bool) -> None:
    compared = Compared()
    compared.add(replayed, recorded, 2.5)
    assert compared.is_equal is is_equal
    assert compared.first == (None if is_equal else 2.5)


def test_the_line_of_a_decision_names_the_tightest_obstacle() -> None:
    near = LimitingObstacle(math.radians(-30.0), 0.21, 0.05)
    far = LimitingObstacle(math.radians(80.0), 0.9, 0.4)
    decision = Decision(
        "barrier", Twist(0.2), Twist(0.05, 0.1), None, True, (near, far), 0.21, 0.0, 7
    )
    entry = frames.DecisionEntry(1.0, "scan", "running", "protection", decision)
    text = decision_text(messages.deserialize(*messages.decision_message(entry, 1.0)))
    assert text.startswith("running protection, barrier active: 0.200 m/s 0.000 rad/s -> 0.050 m/s")
    assert text.endswith("an obstacle at -30 deg, 0.21 m, cap 0.050 m/s")
    held = structs.replace(entry, reason="scan_stale", decision=structs.replace(decision, rows=()))
    text = decision_text(messages.deserialize(*messages.decision_message(held, 1.0)))
    assert "scan_stale" in text
    assert "obstacle" not in text
