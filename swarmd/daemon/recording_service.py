"""Records the robot on request, and hands its recordings to operators piece by piece."""

from __future__ import annotations

import asyncio
import json
import logging
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from swarmd.core.bounds import FileName
from swarmd.core.clock import boottime, clock_id
from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.messages import Code, RecordingSummary, Refusal, Reply
from swarmd.core.verbs import (
    FetchQuery,
    FetchReply,
    Nothing,
    RecordingFile,
    RecordingsReply,
    RecordRequest,
)
from swarmd.daemon.recorder import Recorder
from swarmd.daemon.requests import SendReply
from swarmd.plugins import need
from swarmd.recording.head import RecordingHead
from swarmd.recording.reader import clock_of
from swarmd.settings.swarmfile import RecordingSection

log = logging.getLogger(__name__)

MAX_FILES = 500


class RecordingService:
    """The recordings of one robot, as its settings say. `on_event` takes lines for its log."""

    def __init__(
        self,
        robot: str,
        section: RecordingSection,
        head: Callable[[], RecordingHead],
        on_event: Callable[[str], None],
    ) -> None:
        self._robot, self._section, self._head = robot, section, head
        self._folder = Path(section.folder or "recordings")
        self._on_event = on_event
        loop = asyncio.get_running_loop()
        self.recorder = Recorder(loop, on_event)

    @property
    def summary(self) -> RecordingSummary | None:
        """What is being recorded; None: nothing."""
        recorder = self.recorder
        if not recorder.is_on:
            return None
        report = recorder.report
        return RecordingSummary(
            file=report.path[-1000:], size=report.bytes, dropped=recorder.dropped
        )

    def on_record(self, request: RecordRequest, answer: SendReply) -> None:
        """Start or stop the recording."""
        recorder, is_on = self.recorder, self.recorder.is_on
        code, refusal = Code.APPLIED, None
        if request.action == "start" and is_on:
            text = "records already"
        elif request.action == "start":
            try:
                self._start()
                text = f"records to {self._folder}"
            except (OSError, PluginError) as error:
                code, refusal = Code.FAILED, Refusal.INVALID_REQUEST
                text = f"cannot record: {error}"
        elif is_on:
            recorder.stop()
            text = f"recorded {recorder.report.path or 'nothing yet'}"
            if recorder.dropped:
                text += f"; {recorder.dropped} entries were dropped: the disk is slow"
        else:
            text = "did not record"
        answer(Reply(id=request.id, robot=self._robot, code=code, refusal=refusal, text=text[:300]))

    def start_if_wanted(self) -> None:
        """Record from the start of the daemon if its settings say so; a failure is an event."""
        if self._section.from_start:
            try:
                self._start()
            except (OSError, PluginError) as error:
                self._on_event(f"cannot record: {error}")

    def _start(self) -> None:
        need("mcap", "rosbags", extra="record")
        self.recorder.start(self._folder, self._robot, self._head().texts(), self._section.limits)

    # Recordings for operators

    def on_recordings(self, _: Nothing) -> Callable[[], RecordingsReply]:
        """The recordings that there are; listed in a thread."""
        return self._list

    def on_fetch(self, query: FetchQuery) -> Callable[[], FetchReply]:
        """Bytes of a recording; read in a thread."""
        return partial(self._fetch, query)

    def close(self) -> None:
        """Finish the recording."""
        self.recorder.close()

    def _list(self) -> RecordingsReply:
        try:
            found = (path for path in self._folder.glob("*.mcap") if _is_told(path.name))
            paths = sorted(found)[-MAX_FILES:]
        except OSError:
            paths = []
        open_now = Path(self.recorder.report.path).name if self.recorder.is_on else ""
        lost = self.recorder.dropped
        files = [_described(path, lost if path.name == open_now else None) for path in paths]
        recorder = self.recorder
        return RecordingsReply(
            robot=self._robot,
            now=boottime(),
            clock=clock_id(),
            files=tuple(one for one in files if one is not None),
            fault=recorder.fault[:1000],
        )

    def _fetch(self, query: FetchQuery) -> FetchReply:
        data, size, text = b"", 0, ""
        try:
            if not query.file.endswith(".mcap"):
                raise FileNotFoundError
            with (self._folder / query.file).open("rb") as file:
                size = file.seek(0, 2)
                file.seek(query.offset)
                data = file.read(query.length)
        except FileNotFoundError:
            text = "there is no such recording"
        except OSError as error:
            text = error.strerror or "cannot be read"
        return FetchReply(
            robot=self._robot,
            file=query.file,
            offset=query.offset,
            size=size,
            data=data,
            crc=zlib.crc32(data),
            text=text,
        )


def _is_told(name: str) -> bool:
    """True if operators can ask for a file of this name."""
    with suppress(msgspec.ValidationError):
        return msgspec.convert(name, FileName).isprintable()
    return False


def _described(path: Path, lost: int | None) -> RecordingFile | None:
    """One file; `lost`: entries that were dropped so far if it is being written, else None."""
    try:
        size = path.stat().st_size
    except OSError:  # it was removed meanwhile
        return None
    name = path.name
    try:
        index: dict[str, Any] = json.loads(path.with_suffix(".index.json").read_text())
        begin, end = (clock_of(index["about"], int(index[key])) for key in ("begin_ns", "end_ns"))
        return RecordingFile(
            name=name,
            size=size,
            is_open=False,
            crc=index["crc32"],
            dropped=index["dropped"],
            begin=begin,
            end=end,
        )
    except (OSError, ValueError, KeyError, ConfigError):  # it is being written, or was cut off
        return RecordingFile(name=name, size=size, is_open=lost is not None, dropped=lost or 0)
