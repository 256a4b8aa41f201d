"""The recorder process: takes batches from a daemon and writes them to the disk.

`python -m swarmd.recording.process SOCKET PARENT`. A process of its own, so that a slow disk, a
full one, or the work of writing never delays the daemon. It ends when the daemon closes the socket
or ends, and finishes its file then.
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

from swarmd.core.clock import boottime
from swarmd.recording import frames, messages
from swarmd.recording.cdr import Message
from swarmd.recording.writer import CHUNK_TIME, RecordingWriter

REPORT_PERIOD = 1.0
GEOMETRY = "/geometry"
"""Ends the topic of the directions and ages of a scan's rays, after that of the scan."""


class Converter:
    """Writes entries as ROS messages, with times in ns since 1970."""

    def __init__(self, begin: frames.Begin) -> None:
        self._begin = begin
        wall, boot = round(begin.wall * 1e9), round(begin.at * 1e9)
        self._offset = wall - boot
        self._geometry: dict[str, frames.ScanGeometry] = {}
        self._robot = begin.about.get("robot", "")
        self.writer = RecordingWriter(
            Path(begin.folder),
            begin.name,
            {**begin.about, "wall_ns": str(wall), "boot_ns": str(boot)},
            limits=begin.limits,
            latched=frozenset({f"/scan{GEOMETRY}", f"/ranges{GEOMETRY}"}),
        )

    def ns(self, at: float) -> int:
        """The time in ns since 1970 of a time on the robot's clock."""
        return round(at * 1e9) + self._offset

    def add(self, entry: frames.Entry) -> None:
        """Write one entry."""
        if isinstance(entry, frames.ScanEntry):
            self._scan(entry)
            return
        found = self._message(entry)
        if found is not None:
            topic, message = found
            self.writer.add(topic, message, self.ns(entry.at))

    def _scan(self, entry: frames.ScanEntry) -> None:
        at, topic = self.ns(entry.at), entry.topic
        if entry.geometry is not None:
            self._geometry[topic] = entry.geometry
        if topic not in self._geometry:
            return
        scan = frames.scan_of(entry, self._geometry[topic])
        if entry.geometry is not None:
            self.writer.add(topic + GEOMETRY, messages.geometry_message(scan), at)
        self.writer.add(topic, messages.scan_message(scan), at, scan.seq)

    def _message(self, entry: frames.Entry) -> tuple[str, Message] | None:
        stamp = 1e-9 * self.ns(entry.at)
        match entry:
            case frames.DecisionEntry():
                return "/decision", messages.decision_message(entry, stamp)
            case frames.OdometryEntry():
                return "/odometry", messages.odometry_message(entry.value)
            case frames.RequestedEntry():
                requested = messages.requested_message(entry.twist, entry.scan_seq, stamp)
                return "/command/requested", requested
            case frames.HostEntry():
                return "/host", messages.bytes_message(entry.data, stamp)
            case frames.NeighborsEntry():
                return "/neighbors", messages.neighbors_message(entry.value, stamp)
            case frames.PoseEntry():
                return "/pose", messages.pose_message(entry.value)
            case frames.ReadingsEntry():
                return "/readings", messages.readings_message(entry.value, stamp)
            case frames.DriverEntry():
                return "/driver", messages.driver_message(entry, stamp)
            case frames.MessageEntry():
                kind = "sent" if entry.sender == self._robot else "received"
                text = frames.as_json(
                    {"sender": entry.sender, "channel": entry.channel, "value": entry.value}
                )
                return f"/message/{kind}", messages.text_message(text.decode(), stamp)
            case frames.TextEntry():
                return entry.topic, messages.text_message(entry.json.decode(), stamp)
            case frames.EventEntry():
                return "/event", messages.log_message(entry.text, self._robot, stamp)
            case frames.ClockEntry():
                return "/clock/pair", messages.clock_message(entry, stamp)
            case frames.DroppedEntry():
                self.writer.dropped += entry.count
                text = frames.as_json({"count": entry.count})
                return "/dropped", messages.text_message(text.decode(), stamp)
        return None


def run(link: socket.socket, now: Callable[[], float] = boottime) -> None:
    """Take batches until the other end is closed, and finish the file."""
    converter: Converter | None = None
    reported = -REPORT_PERIOD
    link.settimeout(CHUNK_TIME)
    try:
        while True:
            frame = _received(link)
            if not frame:
                return
            for entry in frames.decode_batch(frame):
                if isinstance(entry, frames.Begin):
                    converter = Converter(entry)
                elif converter is not None:
                    converter.add(entry)
            if converter is None:
                continue
            converter.writer.flush_if_due(converter.ns(now()))
            if time.monotonic() - reported >= REPORT_PERIOD:
                reported = time.monotonic()
                _report(link, str(converter.writer.path or ""), converter.writer.written)
    except OSError as error:
        path = "" if converter is None else str(converter.writer.path or "")
        written = 0 if converter is None else converter.writer.written
        _report(link, path, written, error.strerror or str(error))
        if converter is not None:
            converter.writer.abandon()
            converter = None
    finally:
        if converter is not None:
            converter.writer.close()


def _received(link: socket.socket) -> bytes:
    """The next batch, an empty one while nothing comes; no bytes once the other end is closed."""
    while True:
        try:
            return link.recv(1 << 18)
        except TimeoutError:
            return b"\x90"
        except ConnectionResetError:
            continue  # the daemon ended with a report unread: what it sent before comes next


def _report(link: socket.socket, path: str, written: int, fault: str = "") -> None:
    with contextlib.suppress(OSError):
        link.send(frames.encode_report(frames.RecorderReport(path, written, fault)))


def main() -> None:
    """Take the socket that the daemon has opened."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the daemon closes the socket
    os.nice(10)
    with socket.socket(fileno=int(sys.argv[1])) as link:
        try:
            run(link)
        except OSError as error:  # the daemon has closed the socket already
            sys.exit(f"the recording could not be finished: {error.strerror or error}")


if __name__ == "__main__":
    main()
