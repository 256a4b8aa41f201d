"""Classes from files: read when a load begins, kept until the next; pushed ones compared."""

from __future__ import annotations

import hashlib
import io
import sys
import zipfile
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ChangedCodeError, PluginError
from swarmd.core.values import Inputs
from swarmd.kit.behavior import Pattern
from swarmd.kit.factory import assemble
from swarmd.kit.params import Params
from swarmd.pattern_host.loader import PatternLoader, import_file
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


FOLDER = {
    "pattern.py": """
from swarmd.api import Inputs, Outputs, Params, Pattern
from .gains import TURN
from .more.deep import DEEP

class Grad(Pattern[Params]):
    values = (TURN, DEEP)

    def step(self, inputs: Inputs) -> Outputs:
        from .later import LATER
        return Outputs(report={"later": LATER})
""",
    "gains.py": "TURN = 0.4\n",
    "later.py": "from .gains import TURN\nLATER = TURN + 1\n",
    "more/deep.py": "from ..gains import TURN\nDEEP = -TURN\n",
}


def folder_pattern(folder: Path, **changed: str) -> Path:
    """The `pattern.py` of a folder with several modules."""
    for name, text in {**FOLDER, **changed}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder / "pattern.py"


def stepped(kind: type[Pattern[Params]]) -> Mapping[str, object]:
    """What a step of the class reports."""
    return kind.step(object.__new__(kind), Inputs(now=0.0, dt=0.0)).report


@pytest.fixture(autouse=True)
def nothing_stays_imported() -> Iterator[None]:
    """Modules and finders of the plugins of a test do not outlive it; those of others stay."""
    finders = list(sys.meta_path)
    before = {name for name in sys.modules if name.startswith("swarmd_plugin_")}
    yield
    sys.meta_path[:] = finders
    for name in [name for name in sys.modules if name.startswith("swarmd_plugin_")]:
        if name not in before:
            del sys.modules[name]


def test_the_folder_of_a_pattern_is_a_package_also_for_imports_of_a_method(tmp_path: Path) -> None:
    file = folder_pattern(tmp_path / "grad")
    kind = PatternLoader({"grad": (str(file), True)})("grad")
    assert getattr(kind, "values") == (0.4, -0.4)  # noqa: B009
    assert stepped(kind) == {"later": 1.4}
    assert not list(tmp_path.rglob("__pycache__"))


def test_a_method_imports_what_the_folder_held_at_the_load(tmp_path: Path) -> None:
    file = folder_pattern(tmp_path / "grad")
    loader = PatternLoader({})
    places = {"grad": (str(file), True)}
    loader.begin(places)
    first = loader("grad")
    (tmp_path / "grad" / "later.py").write_text("LATER = 7\n")
    assert stepped(first) == {"later": 1.4}
    loader.begin(places)  # such as of `plugin reload`
    assert stepped(loader("grad")) == {"later": 7}


def test_a_file_beside_a_folder_is_no_part_of_it(tmp_path: Path) -> None:
    folder_pattern(tmp_path / "grad")
    other = tmp_path / "lone.py"
    other.write_text(FOLDER["pattern.py"].replace("from .more.deep import DEEP", "DEEP = 0"))
    (tmp_path / "gains.py").write_text("TURN = 1.0\n")
    with pytest.raises(ImportError):
        import_file(other)


def test_a_folder_with_too_many_modules_is_refused_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("swarmd.pattern_host.loader.MAX_MODULES", 3)
    with pytest.raises(PluginError, match="folder of their own"):
        import_file(folder_pattern(tmp_path / "grad"))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('"""für"""\n', 1),
        ('"""Drives."""\n\nwort = "größe"\n', 3),
        ("def größe(): pass\n", 1),
    ],
)
def test_a_file_that_is_no_utf_8_is_refused_with_line_and_remedy(
    tmp_path: Path, text: str, line: int
) -> None:
    file = tmp_path / "own.py"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(PluginError, match=rf"own\.py:{line}: .* UTF-8"):
        import_file(file)


def test_a_file_that_names_its_encoding_is_imported(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_bytes("# -*- coding: latin-1 -*-\nword = 'größe'\n".encode("latin-1"))
    assert import_file(file).word == "größe"
