"""The recordings on disk of one robot, as operators list and fetch them."""

from __future__ import annotations

import json
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from swarmd.core import verbs
from swarmd.core.bounds import FileName
from swarmd.core.errors import ConfigError
from swarmd.core.files import open_regular, read_regular
from swarmd.daemon.recording.reader import clock_of

MAX_FILES = 500  # the newest files, which the answer to an operator lists


def recordings_in(folder: Path, *, open_now: str, dropped: int) -> tuple[verbs.RecordingFile, ...]:
    """The newest recordings in a folder, by name.

    `open_now`: the name of the file that is being written; empty without one. `dropped`: the count
    of entries that it lacks.
    """
    try:
        found = (path for path in folder.glob("*.mcap") if _is_told(path.name))
        paths = sorted(found)[-MAX_FILES:]
    except OSError:
        paths = []
    files = [_described(path, is_open=path.name == open_now, dropped=dropped) for path in paths]
    return tuple(one for one in files if one is not None)


def piece_of(robot: str, folder: Path, suffix: str, query: verbs.FetchQuery) -> verbs.FetchReply:
    """Bytes of a file in `folder` whose name ends in `suffix`, for an operator."""
    data = b""
    size = 0
    text = ""
    try:
        if not query.file.endswith(suffix):
            raise FileNotFoundError
        with open_regular(folder / query.file) as file:
            size = file.seek(0, 2)
            file.seek(query.offset)
            data = file.read(query.length)
    except FileNotFoundError:
        text = "there is no such recording"
    except OSError as error:
        text = error.strerror or "cannot be read"
    return verbs.FetchReply(
        robot=robot,
        file=query.file,
        offset=query.offset,
        size=size,
        data=data,
        crc=zlib.crc32(data),
        text=text,
    )


def _is_told(name: str) -> bool:
    """True if operators may ask for a file of this name."""
    with suppress(msgspec.ValidationError):
        return msgspec.convert(name, FileName).isprintable()
    return False


def _described(path: Path, *, is_open: bool, dropped: int) -> verbs.RecordingFile | None:
    """The entry of a recording in the reply to an operator; None if the file was removed.

    `path`: the .mcap file. `is_open`: the file is being written. `dropped`: the count of entries
    that an open file lacks.
    """
    try:
        size = path.stat().st_size
    except OSError:  # the file was removed meanwhile
        return None
    return _finished(path, size) or verbs.RecordingFile(
        name=path.name, size=size, is_open=is_open, dropped=dropped if is_open else 0
    )


def _finished(path: Path, size: int) -> verbs.RecordingFile | None:
    """The entry of a finished recording, from the index beside the file.

    None without a valid index: the file is being written, or was cut off.
    """
    try:
        index: dict[str, Any] = json.loads(read_regular(path.with_suffix(".index.json")))
        return verbs.RecordingFile(
            name=path.name,
            size=size,
            is_open=False,
            crc=index["crc32"],
            dropped=index["dropped"],
            begin=clock_of(index["about"], int(index["begin_ns"])),
            end=clock_of(index["about"], int(index["end_ns"])),
        )
    except (OSError, ValueError, KeyError, ConfigError):
        return None
