"""Wheels of pushed patterns: what is unpacked, and what is refused."""

from __future__ import annotations

import io
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from random import Random

import pytest

from swarmd.core.errors import PluginError
from swarmd.pattern_host import wheel
from swarmd.pattern_host.wheel import WheelPattern, inspect_wheel, packed_folder

ABOUT = "own-2.1.dist-info"
GOOD: dict[str, str] = {
    "own_code/__init__.py": "",
    f"{ABOUT}/METADATA": "Name: own\nVersion: 2.1\n",
    f"{ABOUT}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\n",
    f"{ABOUT}/entry_points.txt": "[swarmd.patterns]\nown = own_code:Own\n",
}


def made(files: Mapping[str, str]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return content.getvalue()


def test_a_wheel_names_its_pattern() -> None:
    assert inspect_wheel(made(GOOD), "own.whl") == WheelPattern("own", "2.1", "own_code:Own")


SPOILT = {
    "outside": {"../../own.py": ""},
    "absolute": {"/etc/own.py": ""},
    "backslash": {"own_code\\..\\x.py": ""},
    "native": {"own_code/fast.abi3.so": ""},
    "versioned": {"own_code/libfast.so.1": ""},
    "data": {"own-2.1.data/scripts/own": ""},
    "standard": {"random.py": ""},
    "runtime": {"swarmd/__init__.py": ""},
    "platform": {f"{ABOUT}/WHEEL": "Root-Is-Purelib: false\n"},
    "no pattern": {f"{ABOUT}/entry_points.txt": ""},
    "two patterns": {f"{ABOUT}/entry_points.txt": "[swarmd.patterns]\na = a:A\nb = b:B\n"},
    "bad name": {f"{ABOUT}/entry_points.txt": "[swarmd.patterns]\nBad Name = a:A\n"},
    "no class": {f"{ABOUT}/entry_points.txt": "[swarmd.patterns]\nown = own code\n"},
    "no name": {".": ""},
    "file and folder": {"own_code": ""},
    "deep file and folder": {"own_code/a/b": "", "own_code/a": ""},
    "unreadable": {f"{ABOUT}/entry_points.txt": "own = own_code:Own\n"},
}


@pytest.mark.parametrize("files", SPOILT.values(), ids=SPOILT)
def test_wheels_that_may_do_harm_or_name_no_pattern_are_refused(files: Mapping[str, str]) -> None:
    with pytest.raises(PluginError, match=r"^own\.whl"):
        inspect_wheel(made({**GOOD, **files}), "own.whl")


@pytest.mark.parametrize("checked", [1, 2])
def test_a_file_with_more_than_its_head_states_is_refused(checked: int) -> None:
    """An import would unpack all of it, whatever the head says."""
    size, content = 2**20, io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in {**GOOD, "own_code/large.py": " " * size}.items():
            archive.writestr(name, text)
    sizes, less = struct.pack("<I", size), struct.pack("<I", 1)
    whole, part = (struct.pack("<I", zlib.crc32(b" " * count)) for count in (size, checked))
    data = content.getvalue().replace(sizes, less).replace(whole, part)
    with pytest.raises(PluginError, match=r"^own\.whl.*own_code/large\.py"):
        inspect_wheel(data, "own.whl")


def test_damaged_wheels_are_refused_in_one_line() -> None:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in GOOD.items():
            archive.writestr(name, text)
    whole, random, faults = content.getvalue(), Random(1), list[str]()
    for _ in range(300):
        damaged = bytearray(whole)
        for _ in range(random.randint(1, 4)):
            damaged[random.randrange(len(damaged))] = random.randrange(256)
        try:
            inspect_wheel(bytes(damaged), "own.whl")
        except PluginError as error:
            faults.append(str(error))
    assert faults
    assert all(text.startswith("own.whl") and "\n" not in text for text in faults)


def test_links_and_other_files_are_refused() -> None:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, text in GOOD.items():
            archive.writestr(name, text)
        link = zipfile.ZipInfo("own_code/passwords")
        link.external_attr = 0o120777 << 16
        archive.writestr(link, "/etc/passwd")
    for spoilt in (content.getvalue(), b"", b"PK\x03\x04 and no more", made(GOOD)[:-40]):
        with pytest.raises(PluginError, match=r"^own\.whl"):
            inspect_wheel(spoilt, "own.whl")


def test_a_wheel_that_unpacks_to_too_much_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wheel, "MAX_UNPACKED", 1000)
    with pytest.raises(PluginError, match="at most"):
        inspect_wheel(made({**GOOD, "own_code/large.txt": "x" * 1000}), "own.whl")
    monkeypatch.setattr(wheel, "MAX_UNPACKED", 1 << 20)
    monkeypatch.setattr(wheel, "MAX_FILES", 3)
    with pytest.raises(PluginError, match="at most"):
        inspect_wheel(made(GOOD), "own.whl")


def folder_of(folder: Path, **files: str) -> Path:
    """The folder of a pattern with these files, beside its `pattern.py`."""
    code = "from .gains import TURN\nclass P(Params): ...\nclass Grad(MovementPattern[P]): ...\n"
    named = {name.replace("__", "."): text for name, text in files.items()}
    for name, text in {"pattern.py": code, "gains.py": "TURN = 0.4\n", **named}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def test_a_packed_folder_is_a_wheel_with_all_its_files(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "grad", page__md="page")
    (folder / "__pycache__").mkdir()
    (folder / "__pycache__" / "gains.pyc").write_bytes(b"old")
    (folder / ".notes").write_text("mine")
    content = packed_folder(folder, "grad")
    assert inspect_wheel(content, "grad") == WheelPattern(
        "grad", "", "swarmd_pushed_grad.pattern:Grad"
    )
    inside = {name.rpartition("/")[2] for name in zipfile.ZipFile(io.BytesIO(content)).namelist()}
    about = {"METADATA", "WHEEL", "entry_points.txt"}
    assert inside - about == {"__init__.py", "pattern.py", "gains.py", "page.md"}


def test_each_file_of_a_folder_changes_the_bytes_that_are_pushed(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "grad", page__md="page")
    first = packed_folder(folder, "grad")
    os.utime(folder / "gains.py", (1e9, 1e9))
    assert packed_folder(folder, "grad") == first
    for name in ("pattern.py", "gains.py", "page.md"):
        text = (folder / name).read_text()
        (folder / name).write_text(f"{text}\n")
        assert packed_folder(folder, "grad") != first
        (folder / name).write_text(text)


@pytest.mark.parametrize(
    ("classes", "chosen"),
    [
        ("class Own(Pattern[Params]): ...", "Own"),
        ("class Base(MovementPattern[P]): ...\nclass Own(Base): ...", "Own"),
        ("class MyPattern(api.VotingPattern[P]): ...\nclass Own(MyPattern): ...", "Own"),
        ("class A(Pattern[P]): ...\nclass Grad(Pattern[P]): ...", "Grad"),
        ("class Grad(Helper): ...", "Grad"),
    ],
)
def test_the_class_of_a_folder_is_found_by_its_source(
    tmp_path: Path, classes: str, chosen: str
) -> None:
    (tmp_path / "pattern.py").write_text(f"{classes}\n")
    content = packed_folder(tmp_path, "grad")
    assert inspect_wheel(content, "grad").value == f"swarmd_pushed_grad.pattern:{chosen}"


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({"pattern__py": "class A(Other): ...\n"}, "Grad"),
        ({"pattern__py": "def broken(:\n"}, "pattern.py:1"),
        ({"fast__so": "x"}, "native"),
    ],
)
def test_a_folder_that_cannot_be_pushed_is_refused_in_one_line(
    tmp_path: Path, files: dict[str, str], told: str
) -> None:
    folder = folder_of(tmp_path / "grad", **files)
    with pytest.raises(PluginError, match=told) as error:
        inspect_wheel(packed_folder(folder, "grad"), "grad")
    assert "\n" not in str(error.value)
