"""The memory of a robot holds all that the robot knows, and makes nothing else."""

from __future__ import annotations

import ast
import pickle
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

import swarmd
from swarmd.core.errors import CodecError
from swarmd.core.events import ScanInput
from swarmd.patterns.random_walk import RandomWalk
from swarmd.robot import memory
from swarmd.robot.memory import recall, remember
from swarmd.robot.robot import Robot
from swarmd.testing.scans import Disc, scan_of
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
    return recall(remember(robot), robot._lifecycle.identity.settings)


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


def pickled(*parts: bytes) -> bytes:
    return zlib.compress(b"".join(parts) + b".")


METHOD, MEMORY = b"cswarmd.robot.memory\n_method\n", b"cswarmd.robot.memory\n"


class Harmful:
    def __reduce__(self) -> Any:
        return print, ("this must not run",)


class Addresses:
    """An array of objects whose bytes are addresses."""

    def __init__(self, name: str, *rest: Any) -> None:
        self.made = getattr(memory, name), (bytearray(8), *rest)

    def __reduce__(self) -> Any:
        return self.made


def test_bytes_are_never_taken_for_the_addresses_of_objects(harness: RobotHarness) -> None:
    settings = harness.robot._lifecycle.identity.settings
    array = Addresses("_array", (1,), (8,), "O")
    view = Addresses("_view", 0, (1,), (8,), "O", False)
    for one in (array, view):
        with pytest.raises(CodecError, match="expected numbers"):
            recall(zlib.compress(pickle.dumps(one, pickle.HIGHEST_PROTOCOL)), settings)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"no memory",
        zlib.compress(pickle.dumps(Harmful())),
        zlib.compress(b"cos\nsystem\n(S'true'\ntR."),
        zlib.compress(b"cswarmd.core.files\nsync_folder\n(S'/'\ntR."),
        zlib.compress(b"cswarmd.robot.memory\npickle.loads\n(S'/'\ntR."),
        # A class that a module of the core imports, its method, and the call of that.
        pickled(METHOD, b"(cswarmd.core.machine\nPath\n(S'told'\ntRS'touch'\ntR)R"),
        pickled(METHOD, b"(cswarmd.core.values\nPath\n(S'told'\ntRS'touch'\ntR)R"),
        pickled(METHOD, b"(crandom\nRandom\n)RS'randbytes'\ntR(I9\ntR"),
        pickled(MEMORY, b"_Unpickler\n(S''\nNtR"),
        # A few bytes for a large object.
        pickled(b"cbuiltins\nbytearray\n(I1000000000000\ntR"),
        pickled(MEMORY, b"_array\n(C\x08", bytes(8), b"(I1000000000000\nt(I0\ntS'<f8'\ntR"),
        pickled(MEMORY, b"_array\n(N(I9\nt(I8\ntS'<f8'\ntR"),
        pickled(MEMORY, b"_view\n(C\x08", bytes(8), b"I0\n(I1000000000000\nt(I0\ntS'<f8'\nI00\ntR"),
        zlib.compress(pickle.dumps([1, 2])),
        zlib.compress(bytes(1 << 25)),
    ],
)
def test_other_bytes_are_refused_and_run_nothing(
    harness: RobotHarness,
    data: bytes,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CodecError, match=r"of this version|list"):
        recall(data, harness.robot._lifecycle.identity.settings)
    assert capsys.readouterr().out == ""
    assert not any(tmp_path.iterdir())


def test_a_memory_that_was_cut_off_is_refused(harness: RobotHarness) -> None:
    data = remember(harness.robot)
    for end in range(0, len(data), len(data) // 7):
        with pytest.raises(CodecError):
            recall(data[:end], harness.robot._lifecycle.identity.settings)


def test_a_memory_beyond_its_limit_or_with_a_foreign_value_is_not_made(
    harness: RobotHarness,
) -> None:
    with pytest.raises(CodecError, match="at most 100"):
        remember(harness.robot, 100)
    harness.robot._sensors.readings = {"a": lambda: 1.0}  # type: ignore[dict-item]
    with pytest.raises(CodecError, match="cannot be written"):
        remember(harness.robot)


KERNELS = [
    path for path in Path(swarmd.__path__[0]).rglob("*.py") if "import cython" in path.read_text()
]


@pytest.mark.parametrize("path", KERNELS, ids=lambda path: path.stem)
def test_a_new_object_of_a_kernel_has_all_its_views(path: Path) -> None:
    """A view that is not set ends the process where its object is written to a memory."""
    for one in ast.parse(path.read_text()).body:
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
