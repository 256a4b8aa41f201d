"""The memory of a robot holds all that the robot knows, and makes nothing else."""

from __future__ import annotations

import ast
import pickle
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.errors import CodecError
from swarmd.core.events import ScanInput
from swarmd.core.kernels import KERNELS
from swarmd.patterns.random_walk.pattern import RandomWalk
from swarmd.robot import memory
from swarmd.robot.memory import recall, remember
from swarmd.robot.robot import Robot
from swarmd.testing.scans import Disc, scan_of
from tests.support.kernel_forms import typed_text
from tests.support.robot_harness import RobotHarness


@pytest.fixture
def harness() -> RobotHarness:
    harness = RobotHarness(patterns={"random_walk": RandomWalk})
    harness.advance(1.0)
    harness.ask("run", pattern="random_walk")
    harness.advance(3.0)
    return harness


def recalled(harness: RobotHarness) -> Robot:
    robot = harness.robot
    return recall(remember(robot), robot.identity.setup)


def test_a_recalled_robot_has_the_same_status_and_memory(harness: RobotHarness) -> None:
    other = recalled(harness)
    assert other.status(harness.now) == harness.robot.status(harness.now)
    assert other.epoch == harness.robot.epoch
    assert other.state is harness.robot.state


def test_a_recalled_robot_shares_nothing_with_the_first(harness: RobotHarness) -> None:
    other = recalled(harness)
    before = other.status(harness.now)
    harness.advance(1.0)
    harness.applied("estop", id="e1", reason="a chair")
    assert other.status(before.uptime) != harness.robot.status(harness.now)
    assert not other.latches


@pytest.mark.parametrize("seconds", [0.0, 1.0])
def test_a_robot_that_has_seen_nothing_has_a_memory(seconds: float) -> None:
    harness = RobotHarness(patterns={"random_walk": RandomWalk})
    harness.advance(seconds)
    assert recalled(harness).status(harness.now) == harness.robot.status(harness.now)


def test_a_recalled_robot_goes_on_with_its_tracks(harness: RobotHarness) -> None:
    noise = np.random.default_rng(1)
    harness.scans = lambda seq, now: replace(
        scan_of(harness.platform, [Disc(1.0, 0.5, 0.1)], seq=seq, noise=0.005, rng=noise), stamp=now
    )
    harness.ask("param", params={"avoidance": "orca"})
    harness.advance(1.5)
    robot, other = harness.robot, recalled(harness)
    for k in range(2):
        now = harness.now + 0.1 * (k + 1)
        scan = ScanInput(harness.scans(10_000 + k, now))
        for one in (robot, other):
            one.step(scan, now)
        found = robot.tracks(now)
        assert found is not None
        assert len(found.tracks) == 1
        assert other.tracks(now) == found


def test_views_of_one_array_share_its_numbers_again(harness: RobotHarness) -> None:
    numbers = np.zeros(4)
    harness.robot._sensors.readings = {"whole": numbers, "part": numbers[1:3]}  # type: ignore[dict-item]
    readings: Any = recalled(harness).readings
    readings["whole"][2] = 7.0
    assert readings["part"].tolist() == [0.0, 7.0]


def packed(*nodes: list[Any], kinds: tuple[list[Any], ...] = (), numbers: bytes = b"") -> bytes:
    """A memory of nodes, each [kind, parts]; the first kinds are KINDS."""
    content = [memory.FORMAT, [*([name, [], 0] for name in KINDS), *kinds], nodes, numbers]
    return zlib.compress(msgspec.msgpack.encode(content))


KINDS = ("tuple", "list", "dict", "ndarray", "view", "bytes", "Random", "deque", "set")
TUPLE, LIST, DICT, NDARRAY, VIEW, BYTES, RANDOM, DEQUE, SET, OWN = range(len(KINDS) + 1)


def of(name: str, *fields: str, checksum: int = 0) -> bytes:
    """A memory whose robot is an object of some class."""
    return packed([OWN, [None] * len(fields)], kinds=([name, fields, checksum],))


DOUBLED = [[LIST, [0]], *([TUPLE, [[n], [n]]] for n in range(60))]
"""Each value has the last one twice: whatever compares or hashes them takes 2**60 steps."""


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"no memory",
        zlib.compress(msgspec.msgpack.encode([1, [], [], b""])),
        packed(),
        packed([LIST, [1, 2]]),
        packed([99, []]),
        packed([LIST, [[7]]]),
        # What is no class of a robot.
        of("swarmd.core.files.sync_folder"),
        of("swarmd.core.machine.Path"),
        of("swarmd.core.values.Path", "name"),
        of("swarmd.robot.memory.recall"),
        of("swarmd.robot.memory._Reader", "_memory"),
        of("swarmd.robot.robot.HANDLERS"),
        of("swarmd.robot.robot.Robot.step"),
        of("swarmd.robot.nothing.Robot"),
        of("swarmd.robot..robot.Robot"),
        of("builtins.print"),
        of("os.system"),
        of("type"),
        # A class with other fields, another layout, or no fields.
        of("swarmd.core.values.Twist", "linear"),
        of("swarmd.core.messages.State", "value"),
        of("swarmd.robot.robot.Robot", checksum=1),
        of("swarmd.robot.robot.Robot", "step"),
        of("swarmd.robot.latches.Latches", "__class__", "__dict__"),
        # A few bytes for a large object, or for much work.
        zlib.compress(bytes(1 << 25)),
        packed([NDARRAY, ["<f8", False, "C", 10**12]]),
        packed([NDARRAY, ["<f8", False, "C", -1]], numbers=bytes(8)),
        packed([NDARRAY, ["O", False, "C", 1]], numbers=bytes(8)),
        packed([NDARRAY, ["(1000000,)f8", False, "C", 1]], numbers=bytes(8)),
        packed([NDARRAY, ["|u1", False, "C", 8]], [VIEW, [[0], 0, "<f8", 0, 0, 10**12, 0]]),
        packed(
            [NDARRAY, ["|u1", False, "C", 8]],
            [VIEW, [[0], 0, "<f8", False, True, 10**12, 0]],
            numbers=bytes(8),
        ),
        packed([BYTES, [2**40]]),
        packed([BYTES, [-1]]),
        packed([RANDOM, [3, [1], None]], [BYTES, [0]]),
        packed([DEQUE, [-1]]),
        packed([DICT, [1]]),
        packed([DICT, [[1], 1]], [LIST, []]),
        packed([LIST, [[0]]]),
        packed(*DOUBLED),
        packed(*DOUBLED[:20], [SET, [[19]]]),
        packed(*([TUPLE, [[max(n - 1, 0)]] if n else []] for n in range(5000))),
        packed(
            *([OWN, []] for _ in range(memory.MAX_OBJECTS + 1)),
            kinds=(["swarmd.robot.latches.Latches", [], 0],),
        ),
    ],
)
def test_other_bytes_are_refused_at_once_and_run_nothing(
    harness: RobotHarness,
    data: bytes,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    good, settings = remember(harness.robot), harness.robot.identity.setup
    with pytest.raises(CodecError, match="of this version") as caught:
        recall(data, settings)
    assert str(caught.value).isprintable()
    assert capsys.readouterr().out == ""
    assert not any(tmp_path.iterdir())
    assert recall(good, settings).status(harness.now) == harness.robot.status(harness.now)


def test_a_memory_of_an_older_format_is_named(harness: RobotHarness) -> None:
    data = zlib.compress(pickle.dumps([1, 2], pickle.HIGHEST_PROTOCOL))
    with pytest.raises(CodecError, match="format 1; expected 4"):
        recall(data, harness.robot.identity.setup)


def test_a_memory_that_was_cut_off_is_refused(harness: RobotHarness) -> None:
    data = remember(harness.robot)
    for end in range(0, len(data), len(data) // 7):
        with pytest.raises(CodecError):
            recall(data[:end], harness.robot.identity.setup)


def test_a_memory_beyond_its_limit_or_with_a_foreign_value_is_not_made(
    harness: RobotHarness,
) -> None:
    with pytest.raises(CodecError, match="packed 100, fit"):
        remember(harness.robot, 100)
    harness.robot._sensors.readings = {"a": lambda: 1.0}  # type: ignore[dict-item]
    with pytest.raises(CodecError, match="cannot be written"):
        remember(harness.robot)


@pytest.mark.parametrize("name", KERNELS, ids=lambda name: name.rpartition(".")[2])
def test_a_kernel_checks_the_indices_of_arrays_without_bounds(name: str) -> None:
    """`recall` makes objects of what a file states; an index beyond an array of C may do anything.

    The compiler checks each index of a view, but not where a function turns that off.
    """
    source = typed_text(name)
    for one in ast.parse(source).body:
        text = "\n".join(source.splitlines()[one.lineno - 1 : one.end_lineno])
        is_open = re.search(r"cython\.\w+\[\d+\]|boundscheck\(False\)|p_double", text)
        is_pickled = "auto_pickle(False)" not in " ".join(
            map(ast.unparse, getattr(one, "decorator_list", ()))
        )
        if isinstance(one, ast.ClassDef) and is_open and is_pickled:
            assert "def check_indices" in text, one.name


@pytest.mark.parametrize("name", KERNELS, ids=lambda name: name.rpartition(".")[2])
def test_a_new_object_of_a_kernel_has_all_its_views(name: str) -> None:
    """A view that is not set ends the process where its object is written to a memory."""
    for one in ast.parse(typed_text(name)).body:
        decorators = " ".join(map(ast.unparse, getattr(one, "decorator_list", ())))
        if not isinstance(one, ast.ClassDef) or "auto_pickle(False)" in decorators:
            continue
        fields = [field for field in one.body if isinstance(field, ast.AnnAssign)]
        views = {ast.unparse(one.target) for one in fields if "::1" in ast.unparse(one.annotation)}
        methods = {
            method.name: method for method in one.body if isinstance(method, ast.FunctionDef)
        }
        assert views <= stored(methods, "__init__"), one.name


def stored(methods: Mapping[str, ast.FunctionDef], name: str) -> set[str]:
    """The attributes that a method and those it calls set."""
    found = set[str]()
    for node in ast.walk(methods[name]) if name in methods else ():
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            found.add(node.attr)
        if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("self."):
            found |= stored(methods, ast.unparse(node.func).removeprefix("self."))
    return found
