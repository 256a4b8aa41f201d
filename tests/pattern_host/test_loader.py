"""Classes from files: read when a load begins, kept until the next; pushed ones compared."""

from __future__ import annotations

import hashlib
import io
import sys
import zipfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ChangedCodeError
from swarmd.kit.behavior import Pattern
from swarmd.kit.factory import assemble
from swarmd.kit.params import Params
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import IN_WHEEL, pattern_names
from swarmd.settings.settings import load_platform

CODE = """
from pathlib import Path
from swarmd.api import *

with Path(__file__).with_suffix(".count").open("a") as file:
    file.write("1")

class OwnParams(Params, frozen=True):
    speed: Annotated[float, about("how fast", ge=0.0, le=1.0, unit="m/s")] = SPEED

class Own(MovementPattern[OwnParams]):
    params_type = OwnParams

    def drive(self, inputs):
        return Twist(self.params.speed)
"""
MISSION = """
mission: Votes on a speed
parts: {vote: {pattern: majority_rule}, go: {pattern: own}, other: {pattern: dispersion}}
map: [{from: vote.opinion, to: other.distance, values: [1.0, 1.1, 1.2]}]
parallel: [vote, go, other]
drives: go
parameters: {speed: go.speed}
"""


def load_mission(loader: PatternLoader, folder: Path) -> Pattern[Params]:
    """The mission as a host loads it."""
    found = pattern_names(folder)
    loader.begin({name: (origin.value, origin.is_file) for name, origin in found.items()})
    return assemble(
        "mission",
        (),
        find=loader,
        robot="robot-1",
        platform=load_platform("waffle_pi"),
        rng=np.random.default_rng(0),
    ).pattern


def test_a_mission_takes_its_parts_from_the_files_at_its_load(tmp_path: Path) -> None:
    loader = PatternLoader({})
    (tmp_path / "mission.yaml").write_text(MISSION)
    for speed in (0.1, 0.2):
        (tmp_path / "own.py").write_text(CODE.replace("SPEED", str(speed)))
        assert getattr(load_mission(loader, tmp_path).params, "speed") == speed  # noqa: B009
    assert (tmp_path / "own.count").read_text() == "11"  # once a load


PUSHED = """
from swarmd.api import Inputs, Outputs, Params, Pattern

class Own(Pattern[Params]):
    number = NUMBER

    def step(self, inputs: Inputs) -> Outputs:
        from own_code.later import NUMBER
        return Outputs(report={"number": NUMBER})
"""


@cache  # a wheel tells the time at which it was made
def wheel(number: int) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("own_code/__init__.py", PUSHED.replace("NUMBER", str(number), 1))
        archive.writestr("own_code/later.py", f"NUMBER = {number}")
    return content.getvalue()


@pytest.fixture
def path() -> Iterator[None]:
    """Wheels come and go on the import path of this process."""
    before = list(sys.path)
    yield
    sys.path[:] = before
    for name in [name for name in sys.modules if name.partition(".")[0] == "own_code"]:
        del sys.modules[name]


def load(loader: PatternLoader, file: Path, digest: bytes) -> type[Pattern[Params]]:
    """The pattern `own` in a file or wheel with this digest."""
    is_file = file.suffix == ".py"
    value = str(file) if is_file else f"{file}{IN_WHEEL}own_code:Own"
    loader.begin({"own": (value, is_file)}, {"own": digest})
    return loader("own")


@pytest.mark.usefixtures("path")
@pytest.mark.parametrize("kind", ["py", "whl"])
def test_pushed_code_is_imported_only_with_its_digest(tmp_path: Path, kind: str) -> None:
    def code(number: int) -> bytes:
        return PUSHED.replace("NUMBER", str(number), 1).encode() if kind == "py" else wheel(number)

    loader, file = PatternLoader({}), tmp_path / f"own.{kind}"
    for number in (1, 2):
        file.write_bytes(code(number))
        found = load(loader, file, hashlib.sha256(code(number)).digest())
        assert vars(found)["number"] == number
    for digest in (hashlib.sha256(code(1)).digest(), bytes(32)):
        with pytest.raises(ChangedCodeError, match="own"):
            load(loader, file, digest)


@pytest.mark.usefixtures("path")
def test_a_wheel_is_imported_from_the_copy_that_was_compared(tmp_path: Path) -> None:
    file = tmp_path / "code.whl"
    file.write_bytes(wheel(1))
    found = load(PatternLoader({}), file, hashlib.sha256(wheel(1)).digest())
    file.write_bytes(wheel(2))
    outputs = found.step(None, None)  # type: ignore[arg-type]  # it imports a module only now
    assert outputs.report == {"number": 1}
    copy = sys.path[0]
    assert Path(copy).read_bytes() == wheel(1)
    with pytest.raises(PermissionError), open(copy, "r+b", buffering=0) as sealed:
        sealed.write(wheel(2))


@pytest.mark.usefixtures("path")
@pytest.mark.parametrize("kind", ["py", "whl"])
def test_pushed_code_that_was_removed_is_changed_code(tmp_path: Path, kind: str) -> None:
    with pytest.raises(ChangedCodeError, match="push it again"):
        load(PatternLoader({}), tmp_path / f"own.{kind}", bytes(range(32)))
