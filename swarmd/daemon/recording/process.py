"""The recorder process: takes batches from a daemon and writes them to disk.

`python -m swarmd.daemon.recording.process SOCKET PARENT`. The recorder is a process of its own, so
that a slow or full disk, or the work of writing, never delays the daemon. When the daemon closes
the socket or ends, the recorder finishes its file and ends.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

from msgspec import structs

from swarmd.core import events
from swarmd.core.clock import boottime
from swarmd.core.errors import CodecError
from swarmd.core.host_messages import Stepped
from swarmd.core.values import ZERO, Scan, Value
from swarmd.daemon.recording import frames, messages
from swarmd.daemon.recording.cdr import Message
from swarmd.daemon.recording.inputs import GEOMETRY, INPUT, MEMORY
from swarmd.daemon.recording.writer import CHUNK_TIME, RecordingWriter

REPORT_PERIOD = 1.0


class Converter:
    """Writes entries as ROS messages, with times in ns since 1970.

    A robot may get an input with an earlier time than the input before. Its message gets the time
    of the message before, so that readers keep the order; a replay takes the time in the input.
    `chunk_time`: s after which a chunk is forced to the disk although it is not full.
    """

    def __init__(self, begin: frames.Begin, *, chunk_time: float = CHUNK_TIME) -> None:
        self._begin = begin
        wall = round(begin.wall * 1e9)
        boot = round(begin.at * 1e9)
        self._offset = wall - boot
        self._scans: dict[str, Scan] = {}  # by topic: the last scan, with its geometry
        self._memory: list[frames.MemoryEntry] = []  # the received parts of the present memory
        self._robot = begin.about.get("robot", "")
        self._last = 0  # ns; the time of the last message
        self.writer = RecordingWriter(
            Path(begin.folder),
            begin.name,
            {**begin.about, "wall_ns": str(wall), "boot_ns": str(boot)},
            limits=begin.limits,
            latched=frozenset({f"/scan{GEOMETRY}", f"/ranges{GEOMETRY}"}),
            chunk_time=chunk_time,
        )

    def ns(self, at: float) -> int:
        """The time in ns since 1970 of a time on the robot's clock."""
        return round(at * 1e9) + self._offset

    def add(self, entry: frames.Entry) -> None:
        """Write one entry of the daemon as a message of the recording."""
        stamp_s = 1e-9 * self.ns(entry.at)  # since 1970
        match entry:
            case frames.InputEntry():
                self._input(entry, stamp_s)
            case frames.MemoryEntry():
                self._memory_part(entry, stamp_s)
            case frames.DecisionEntry():
                self._write(entry, "/decision", messages.decision_message(entry, stamp_s))
            case frames.SentEntry():
                text = _said(self._robot, entry.channel, entry.value)
                self._text(entry, "/message/sent", text)
            case frames.TextEntry():
                message = messages.text_message(entry.json.decode(), stamp_s)
                self._write(entry, entry.topic, message)
            case frames.EventEntry():
                message = messages.log_message(entry.text, self._robot, stamp_s)
                self._write(entry, "/event", message)
            case frames.ClockEntry():
                self._write(entry, "/clock/pair", messages.clock_message(entry, stamp_s))
            case frames.DroppedEntry():  # by the daemon, when this process was too slow
                self.writer.dropped += entry.count
                self._text(entry, "/dropped", {"count": entry.count})

    def _memory_part(self, entry: frames.MemoryEntry, stamp: float) -> None:
        """Keep a part of the robot's memory (its serialised state); write the memory once complete.

        Of the parts kept so far, those of another memory (with another time `at`) are dropped, and
        those that do not precede this part. A part of more than MAX_PARTS is dropped: no robot
        writes it, and the work for each part rises with their number. `stamp`: s since 1970.
        """
        if entry.parts > frames.MAX_PARTS:
            return
        earlier = (part for part in self._memory if part.at == entry.at and part.part < entry.part)
        self._memory = [*earlier, entry]
        if len(self._memory) == entry.parts:
            data = b"".join(part.data for part in self._memory)
            self._memory = []  # a part that follows is of another memory
            self._write(entry, MEMORY, messages.bytes_message(data, stamp))

    def _write(self, entry: frames.Entry, topic: str, message: Message, sequence: int = 0) -> None:
        self._last = max(self._last, self.ns(entry.at))
        self.writer.add(topic, message, self._last, sequence)

    def _text(self, entry: frames.Entry, topic: str, value: object) -> None:
        text = frames.as_json(value).decode()
        self._write(entry, topic, messages.text_message(text, 1e-9 * self.ns(entry.at)))

    def _input(self, entry: frames.InputEntry, stamp: float) -> None:
        """Write an input of the robot twice: its bytes for a replay, and a message for viewers.

        `stamp`: s since 1970. A scan is written once, by messages that viewers and a replay read.
        """
        try:
            input = events.decode_input(entry.data)
        except CodecError:  # a value exceeds its bound; a replay reports such an input
            self._write(entry, INPUT, messages.input_message(entry.data, entry.at, stamp))
            return
        if isinstance(input, events.ScanInput | events.RangesInput):
            self._scan(entry, input, stamp)
            return
        self._write(entry, INPUT, messages.input_message(entry.data, entry.at, stamp))
        self._for_viewers(entry, input, stamp)

    def _for_viewers(self, entry: frames.InputEntry, input: events.Input, stamp: float) -> None:
        """Write an input as a ROS message if ROS has the type, else as JSON.

        `stamp`: s since 1970. Inputs without a use for viewers are left out.
        """
        match input:
            case events.OdometryInput():
                self._write(entry, "/odometry", messages.odometry_message(input.odometry))
            case events.NeighborsInput():
                message = messages.neighbors_message(input.neighbors, stamp)
                self._write(entry, "/neighbors", message)
            case events.PoseInput():
                self._write(entry, "/pose", messages.pose_message(input.pose))
            case events.ReadingsInput():
                self._write(entry, "/readings", messages.readings_message(input.readings, stamp))
            case events.DriverInput():
                self._write(entry, "/driver", messages.driver_message(input, stamp))
            case events.MessageInput():
                text = _said(input.sender, input.channel, input.value)
                self._text(entry, "/message/received", text)
            case events.HostInput(event=Stepped() as stepped):
                twist = stepped.outputs.twist or ZERO
                scan_seq = stepped.scan_seq
                message = messages.requested_message(twist, scan_seq, stamp)
                self._write(entry, "/command/requested", message)
            case events.HostInput() | events.NoteInput() | events.TickInput():
                pass  # nothing to view
            case _:  # an input of a single field becomes this field, else a list of its fields
                fields = structs.astuple(input)
                value = fields[0] if len(fields) == 1 else fields
                self._text(entry, f"/{events.tag_of(input)}", value)

    def _scan(
        self, entry: frames.InputEntry, input: events.ScanInput | events.RangesInput, stamp: float
    ) -> None:
        """Write a scan, and first its geometry if that has changed."""
        topic = f"/{events.tag_of(input)}"
        is_new = len(input.scan.bearings) > 0
        scan = frames.with_geometry(input.scan, self._scans.get(topic))
        if scan is None:
            return
        data = entry.data
        if is_new or topic not in self._scans:
            self._write(entry, topic + GEOMETRY, messages.geometry_message(scan))
            data = events.encode_input(type(input)(frames.without_geometry(scan)))
        self._scans[topic] = scan
        self._write(entry, INPUT, messages.input_message(data, entry.at, stamp))
        self._write(entry, topic, messages.scan_message(scan), scan.seq)


def _said(sender: str, channel: str, value: Value) -> dict[str, Value]:
    return {"sender": sender, "channel": channel, "value": value}


def run(link: socket.socket, now: Callable[[], float] = boottime) -> None:
    """The loop of the recorder process: write what the daemon sends until the daemon closes `link`.

    `now`: the robot's clock in s. The daemon gets a report with the written bytes every
    REPORT_PERIOD. An OSError of the file, such as a full disk, is reported to the daemon, and
    raised as well, since the daemon may have stopped reading reports.
    """
    converter: Converter | None = None  # None until the first entry, Begin, names the file
    last_report_at = -REPORT_PERIOD
    link.settimeout(CHUNK_TIME)
    try:
        # Without a batch for CHUNK_TIME, `_received` returns a batch without entries, so that the
        # flush and the report come in time.
        while frame := _received(link):
            for entry in frames.decode_batch(frame):
                if isinstance(entry, frames.Begin):
                    converter = Converter(entry)
                elif converter is not None:
                    converter.add(entry)
            if converter is None:
                continue
            converter.writer.flush_if_due(converter.ns(now()))
            if time.monotonic() - last_report_at >= REPORT_PERIOD:
                last_report_at = time.monotonic()
                _report(link, converter)
    except OSError as error:
        _report(link, converter, error.strerror or str(error))
        if converter is not None:
            converter.writer.abandon()  # so that `close` does not finish the file
        raise
    finally:
        if converter is not None:
            converter.writer.close()


def _received(link: socket.socket) -> bytes:
    """The next batch; no bytes once the socket is closed.

    After CHUNK_TIME without a batch, a batch without entries, which has a byte.
    """
    while True:
        try:
            return link.recv(1 << 18)
        except TimeoutError:
            return b"\x90"  # MessagePack of an empty list
        except ConnectionResetError:
            continue  # the daemon ended with an unread report: its last batches follow


def _report(link: socket.socket, converter: Converter | None, fault: str = "") -> None:
    """Report the present file, the written bytes and a fault to the daemon."""
    path = "" if converter is None else str(converter.writer.path or "")
    written_bytes = 0 if converter is None else converter.writer.written
    with contextlib.suppress(OSError):
        link.send(frames.encode(frames.RecorderReport(path, written_bytes, fault)))


def main() -> None:
    """Entry of the process: serve the socket that the daemon has opened."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the daemon closes the socket
    os.nice(10)
    with socket.socket(fileno=int(sys.argv[1])) as link:
        try:
            run(link)
        except OSError as error:
            sys.exit(f"the recording could not be finished: {error.strerror or error}")


if __name__ == "__main__":
    main()
