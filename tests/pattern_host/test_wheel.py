"""Wheels of pushed patterns: what is unpacked, and what is refused."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Mapping
from random import Random

import pytest

from swarmd.core.errors import PluginError
from swarmd.pattern_host import wheel
from swarmd.pattern_host.wheel import WheelPattern, inspect_wheel

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
