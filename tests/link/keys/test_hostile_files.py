"""Each reader of a file that a stranger may hand over, with each kind of hostile file.

A reader ends soon and with one line: it returns what it could read, or raises a SwarmError. A pipe
without a writer or a device without an end would hold a reader that does not look before it opens,
and a file of 8 GiB would take its memory.
"""

from __future__ import annotations

import functools
import io
import os
import socket
import struct
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.errors import SwarmError
from swarmd.daemon.recording.fetch import read_exchanges
from swarmd.daemon.recording.reader import read_file
from swarmd.link.keys import authority
from swarmd.link.keys.authority import Authority
from swarmd.link.keys.bundle import read_bundle
from swarmd.link.keys.identity import INFO, load_identity
from swarmd.link.keys.private_keys import load_private_key
from swarmd.operator.acceptance.result_file import RECORD, read_record
from swarmd.operator.cli.plugin import _network_text
from swarmd.operator.verbs.push.ask import read_source
from swarmd.plugins import is_mission
from swarmd.settings import yamlfile
from swarmd.settings.platforms import load_platform
from swarmd.settings.swarmfile import load_swarm
from swarmd.sim.experiments.manifest import read_manifest
from swarmd.sim.experiments.store import _listed
from swarmd.sim.metrics.own import metric_of_file
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.trace import load_trace
from swarmd.sim.world.floor import picture

DEEP = b"[" * 20_000  # beyond the recursion of any parser
JSON = (
    b'{"robot": "a", "platform": "b", "driver": "c", "began": "d", "more": "' + b"e" * 300 + b'"}'
)


def zipped(content: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytearray:
    output = io.BytesIO()
    with zipfile.ZipFile(output, "w", method) as archive:
        archive.writestr(RECORD, content)
    return bytearray(output.getvalue())


def changed(archive: bytearray, local: int, value: bytes) -> bytes:
    """The archive with other bytes at this place of its local head, and of its central head."""
    for start in (archive.find(b"PK\x03\x04") + local, archive.find(b"PK\x01\x02") + local + 2):
        archive[start : start + len(value)] = value
    return bytes(archive)


def damaged(archive: bytearray) -> bytes:
    begin = 30 + len(RECORD)  # behind the local head and the name
    archive[begin : begin + 12] = b"\xff" * 12
    return bytes(archive)


CONTENTS: dict[str, bytes] = {
    "empty": b"",
    "zeros": bytes(4096),
    "cut": JSON[:40],
    "not UTF-8": b'{"robot": "\xe4", "scenario": "\xe4", "format": 1}\n\xe4',
    "UTF-16": "id: 1".encode("utf-16"),
    "BOM": b"\xef\xbb\xbf" + JSON,
    "deep list": DEEP,
    "deep key": b'{"steps": ' + DEEP,
    "deep unknown key": b'{"unknown": ' + DEEP,
    "deep expression": b"-" * 200_000 + b"1",
    "not a number": b'{"robot": NaN, "format": Infinity}',
    "keys twice": b'{"robot": "a", "robot": "b"}',
    "long number": b"1" * 5_000,
    "long cell": b'task,seed,value\n"' + b"x" * 200_000,
    "zip, encrypted": changed(zipped(JSON), 6, struct.pack("<H", 1)),
    "zip, unknown method": changed(zipped(JSON), 8, struct.pack("<H", 99)),
    "zip, bad deflate": damaged(zipped(JSON)),
    "zip, bad lzma": damaged(zipped(JSON, zipfile.ZIP_LZMA)),
    "zip, cut": bytes(zipped(JSON)[:-30]),
    "zip, not UTF-8": bytes(zipped(b'{"robot": "\xe4"}')),
    "zip, deep": bytes(zipped(b'{"unknown": ' + DEEP)),
    "zip, bomb": bytes(zipped(bytes(20_000_000))),
}


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _socket(path: Path) -> None:
    folder = os.open(path.parent, os.O_RDONLY)
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(f"/proc/self/fd/{folder}/{path.name}")  # a path of a test may be too long
    os.close(folder)


def _loop(path: Path) -> None:
    path.symlink_to(path.name)


def _huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 33)


SPECIAL: dict[str, Callable[[Path], object]] = {
    "pipe": _pipe,
    "endless device": lambda path: path.symlink_to("/dev/zero"),
    "socket": _socket,
    "folder": Path.mkdir,
    "dangling link": lambda path: path.symlink_to("nowhere"),
    "loop of links": _loop,
    "8 GiB": _huge,
    "missing": lambda path: None,
}

FILES: dict[str, bytes | Callable[[Path], object]] = {**CONTENTS, **SPECIAL}


@functools.cache
def _authority_files() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        Authority.create(Path(folder) / "keys", "lab")
        names = authority.KEY, authority.CERTIFICATE, authority.STATE
        return {name: (Path(folder) / "keys" / name).read_bytes() for name in names}


def _open_authority(path: Path) -> object:
    """Open the authority with all but this of its files intact."""
    for name, content in _authority_files().items():
        if name != path.name:
            (path.parent / name).write_bytes(content)
    return authority.is_encrypted(path.parent), Authority(path.parent)


DOORS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "result of an acceptance test": ("a.zip", read_record),
    "folder of an acceptance test": (RECORD, lambda path: read_record(path.parent)),
    "trace": ("a.npz", load_trace),
    "YAML": ("a.yaml", yamlfile.read),
    "platform": ("a.yaml", lambda path: load_platform(str(path))),
    "swarm": ("swarm.yaml", lambda path: load_swarm(path, {}, {})),
    "scenario": ("a.yaml", lambda path: load_scenario(str(path))),
    "mission": ("a.yaml", is_mission),
    "experiment": ("manifest.json", lambda path: read_manifest(path.parent)),
    "failures": ("failures.json", lambda path: _listed(path.parent, "runs")),
    "metric": ("a.py", lambda path: metric_of_file(f"{path}:f")),
    "pattern": ("a.py", read_source),
    "wheel": ("a.whl", read_source),
    "policy": ("a.npz", _network_text),
    "ONNX": ("a.onnx", _network_text),
    "recording": ("a.mcap", read_file),
    "clocks": ("clocks.jsonl", read_exchanges),
    "bundle": ("a.swarm", read_bundle),
    "identity": (INFO, lambda path: load_identity(path.parent)),
    "key": ("key.pem", load_private_key),
    "key of an authority": (authority.KEY, _open_authority),
    "certificate of an authority": (authority.CERTIFICATE, _open_authority),
    "state of an authority": (authority.STATE, _open_authority),
    "picture": ("a.png", lambda path: picture(str(path))),
}


def ending(read: Callable[[Path], Any], path: Path) -> str:
    """The line of the fault; empty if the file could be read."""
    try:
        read(path)
    except (SwarmError, OSError) as error:  # the command line shows both in one line
        return str(error)
    return ""


@pytest.mark.parametrize("door", DOORS)
def test_a_hostile_file_ends_in_one_line(door: str, tmp_path: Path) -> None:
    name, read = DOORS[door]
    for number, (kind, make) in enumerate(FILES.items()):
        path = tmp_path / str(number) / name
        path.parent.mkdir()
        if isinstance(make, bytes):
            path.write_bytes(make)
        else:
            make(path)
        assert ending(read, path).count("\n") == 0, kind


@pytest.mark.parametrize(
    ("kind", "cause"),
    [
        ("zip, encrypted", "encrypted"),
        ("zip, bad deflate", "decompressing"),
        ("zip, deep", "recursion"),
        ("zip, not UTF-8", "utf-8"),
        ("zip, bomb", "more than"),
        ("pipe", "regular file"),
        ("endless device", "regular file"),
    ],
)
def test_a_result_of_an_acceptance_test_that_cannot_be_read_names_its_cause(
    kind: str, cause: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.zip"
    if kind in CONTENTS:
        path.write_bytes(CONTENTS[kind])
    else:
        SPECIAL[kind](path)
    with pytest.raises(SwarmError, match=cause):
        read_record(path)
