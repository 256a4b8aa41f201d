"""Recorded robots of a crowd, with clocks of any uptime, are repeated to the bit, also together."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swarmd.recording import frames, messages
from swarmd.recording.merge import place, survey
from swarmd.recording.reader import read_file
from swarmd.replay.replay import Life, prepare, recordings_of, repeat
from swarmd.replay.swarm import first_difference, place_lives, repeat_together
from tests.support.clocked_crowd import crowd
from tests.support.recorded_crowd import ROUND_TRIP, clock_of, recorded_crowd
from tests.support.recorded_stories import ORIGINS, rewritten
from tests.support.swarmctl import swarmctl

DAY = 86_400.0
SECONDS, APART, JOINED = 6.0, 7.0, 4.8


@pytest.mark.evidence
@pytest.mark.parametrize("seed", range(2, 12))
def test_each_robot_of_a_crowd_is_repeated(tmp_path: Path, seed: int) -> None:
    seconds, uptime = 8.0, (60.0, 600.0, DAY)[seed % 3]
    crowded = recorded_crowd(tmp_path, crowd(4, seconds), seed, seconds, uptime=uptime)
    assert min(crowded.active.values()) > 10
    for folder in sorted(tmp_path.iterdir()):
        recordings = recordings_of(map(read_file, sorted(folder.glob("*.mcap"))))
        assert len(recordings) == crowded.lives[folder.name]
        for files in recordings:
            _, parity = repeat(files, ORIGINS)
            assert parity.notes == ()
            assert parity.safe.is_equal
            assert parity.requested.is_equal
            assert parity.safe.count > 10
            assert parity.difference is None


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four robots, whose clocks are 7 s apart; tb3-03 is killed and starts again."""
    folder = tmp_path_factory.mktemp("crowd")
    made = recorded_crowd(folder, crowd(4, SECONDS), 1, SECONDS, uptime=60.0, apart=APART)
    assert min(made.active.values()) > 10
    return folder


def lives_in(folder: Path) -> list[Life]:
    paths = sorted(folder.rglob("*.mcap"))
    lives = [prepare(files, ORIGINS) for files in recordings_of(map(read_file, paths))]
    place_lives(lives, paths)
    return lives


def test_a_swarm_is_repeated_together_in_the_order_of_its_clocks(recorded: Path) -> None:
    lives = lives_in(recorded)
    repeat_together(lives)
    assert first_difference(lives) is None
    names = ["tb3-01", "tb3-02", "tb3-03", "tb3-03", "tb3-04"]
    assert [life.head.identity.robot for life in lives] == names
    for life, begin in zip(lives, (0.0, 0.0, 0.0, JOINED, 0.0), strict=True):
        parity = life.parity()
        assert parity.safe.is_equal
        assert parity.requested.is_equal
        assert parity.notes == ()
        # By their wall clocks these robots would begin 7 s apart.
        assert life.begin == pytest.approx(begin, abs=0.02 + life.error)
        assert life.error < 2 * ROUND_TRIP


def test_the_first_robot_instant_and_field_that_differ_are_told(recorded: Path) -> None:
    lives = lives_in(recorded)
    _, second, *_, last = lives
    at = altered(second, 0.2)
    assert altered(last, 0.8) > at + 1.0
    repeat_together(lives)
    found = first_difference(lives)
    assert found is not None
    life, difference = found
    assert life.head.identity.robot == "tb3-02"
    assert difference.field == "safe"
    assert difference.at == pytest.approx(at, abs=1e-6)
    assert difference.inputs[-1][1] == pytest.approx(at, abs=1e-6)


def altered(life: Life, share: float) -> float:
    """Change the last bit of a recorded command, after a share of all messages; its time in s."""
    begin = round(share * len(life.messages))
    for number, message in enumerate(life.messages[begin:], start=begin):
        if message.topic == "/decision":
            decision = messages.deserialize(message.kind, message.payload)
            speed = struct.pack("<d", decision.safe.linear.x)
            other = struct.pack("<d", np.nextafter(decision.safe.linear.x, np.inf))
            if message.payload.count(speed) == 1:
                payload = message.payload.replace(speed, other)
                life.messages[number] = replace(message, payload=payload)
                return 1e-9 * (message.at - life.messages[0].at)
    raise AssertionError("no decision with a command of its own")


@pytest.mark.parametrize(
    "times", [(math.nan, 61.0, 61.0), (60.0, math.inf, 61.0), (60.0, 1e300, 61.0), (-1e308, 0, 0)]
)
def test_an_exchange_that_no_clock_can_have_is_left_out(
    recorded: Path, tmp_path: Path, times: tuple[float, float, float]
) -> None:
    entry = frames.ClockEntry(0.0, "tb3-01", clock_of("tb3-01"), *times)
    payload = messages.clock_message(entry, 0.0).payload
    paths = []
    for number, path in enumerate(sorted(recorded.rglob("*.mcap"))):
        file = read_file(path)
        changed = [
            replace(one, payload=payload) if one.topic == "/clock/pair" else one
            for one in file.messages[:60]
        ]
        other = replace(file, messages=changed)
        paths.append(rewritten(other, tmp_path / f"{number}.mcap"))
    placed = place(survey(paths))
    assert [one.alignment is None for one in placed] == [False, True, True, True]


@pytest.mark.parametrize(
    ("words", "robots", "seconds"),
    [
        (("--life", "2"), 1, SECONDS - JOINED),
        (("--why", "tb3-04", "--until", "2"), 4, 2.0),
    ],
)
def test_swarmctl_repeats_a_folder_of_robots(
    recorded: Path, words: Sequence[str], robots: int, seconds: float
) -> None:
    done = swarmctl("replay", str(recorded), *words, "-o", "json")
    assert done.code == 0, done.err
    found = done.json["robots"]
    assert len(found) == robots
    assert all(one["safe"]["count"] == one["safe"]["equal"] for one in found)
    assert max(one["seconds"] for one in found) == pytest.approx(seconds, abs=0.1)
    assert done.json["first_difference"] is None
    assert ("tb3-04, before the end" in done.err) == ("--why" in words)


@pytest.mark.parametrize("words", [("--life", "3"), ("--why", "tb3-09")])
def test_a_life_or_robot_that_is_not_there_is_refused(recorded: Path, words: Sequence[str]) -> None:
    assert swarmctl("replay", str(recorded), *words).code == 2
