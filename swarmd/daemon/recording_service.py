"""Answers the requests on recordings of one robot: start, stop, list and fetch."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path

from swarmd.core import verbs
from swarmd.core.clock import boottime, clock_id
from swarmd.core.errors import PluginError
from swarmd.core.files import write_fault
from swarmd.core.messages import Code, RecordingSummary, Reply
from swarmd.core.refusal import Refusal
from swarmd.daemon.recorder import Recorder
from swarmd.daemon.recording.head import RecordingHead
from swarmd.daemon.recording_files import piece_of, recordings_in
from swarmd.daemon.requests import SendReply
from swarmd.plugins import need
from swarmd.settings.swarmfile import RecordingSection


class RecordingService:
    """Answers the requests on recordings of one robot. `on_event` takes a line for its log."""

    def __init__(
        self,
        robot: str,
        section: RecordingSection,
        head: Callable[[], RecordingHead],
        on_event: Callable[[str], None],
    ) -> None:
        self._robot = robot
        self._section = section
        self._head = head
        self._folder = Path(section.folder or "recordings")
        self._on_event = on_event
        self.recorder = Recorder(asyncio.get_running_loop(), on_event)
        self._is_closed = False

    @property
    def summary(self) -> RecordingSummary | None:
        """The present recording; None while nothing is recorded."""
        recorder = self.recorder
        if not recorder.is_on:
            return None
        report = recorder.process.report
        return RecordingSummary(
            file=report.path[-1000:], size=report.bytes, dropped=recorder.process.dropped
        )

    def on_record(self, request: verbs.RecordRequest, answer: SendReply) -> None:
        """Start or stop the recording; the reply to a start follows once its folder was tried."""
        if request.action == "start":  # the disk may be slow, and must not delay the daemon
            tried = asyncio.get_running_loop().run_in_executor(None, write_fault, self._folder)
            tried.add_done_callback(lambda done: self._carry_out(request, done.result(), answer))
        else:
            self._carry_out(request, "", answer)

    def _carry_out(self, request: verbs.RecordRequest, fault: str, answer: SendReply) -> None:
        """Start or stop the recording; `fault`: why no file can be written to its folder."""
        if self._is_closed:
            return
        recorder = self.recorder
        is_on = self.recorder.is_on
        code = Code.APPLIED
        refusal = None
        if request.action == "start" and is_on:
            text = "records already"
        elif request.action == "start":
            try:
                if fault:
                    raise OSError(f"{self._folder}: {fault}")
                self._start()
                text = f"records to {self._folder}"
            except (OSError, PluginError) as error:
                code = Code.FAILED
                refusal = Refusal.INVALID_REQUEST
                text = f"cannot record: {error}"
        elif is_on:
            recorder.process.stop()
            text = f"recorded {recorder.process.report.path or 'nothing yet'}"
            if recorder.process.dropped:
                text += f"; {recorder.process.dropped} entries were dropped: the disk is slow"
        else:
            text = "did not record"
        answer(Reply(id=request.id, robot=self._robot, code=code, refusal=refusal, text=text[:300]))

    def start_if_wanted(self) -> None:
        """Start to record if the settings say so; a failure is logged as an event."""
        if self._section.from_start:
            try:
                self._start()
            except (OSError, PluginError) as error:
                self._on_event(f"cannot record: {error}")

    def _start(self) -> None:
        need("mcap", "rosbags", extra="record")
        self.recorder.start(self._folder, self._robot, self._head().texts(), self._section)

    # Recordings for operators

    def on_recordings(self, _: verbs.Nothing) -> Callable[[], verbs.RecordingsReply]:
        """List the recordings on disk; the returned function runs in a thread."""
        return self._list

    def on_fetch(self, query: verbs.FetchQuery) -> Callable[[], verbs.FetchReply]:
        """Bytes of a recording file; the returned function runs in a thread."""
        return partial(piece_of, self._robot, self._folder, ".mcap", query)

    def close(self) -> None:
        """Finish the recording."""
        self._is_closed = True
        self.recorder.process.close()

    def _list(self) -> verbs.RecordingsReply:
        recorder = self.recorder
        open_now = Path(recorder.process.report.path).name if recorder.is_on else ""
        return verbs.RecordingsReply(
            robot=self._robot,
            now=boottime(),
            clock=clock_id(),
            files=recordings_in(self._folder, open_now=open_now, dropped=recorder.process.dropped),
            fault=recorder.process.fault[:1000],
        )
