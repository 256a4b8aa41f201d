"""Hides names and addresses in what leaves the machine.

A name is replaced by as many `x`, a digit of an address by `0`: the lengths stay, so that messages
in CDR, MessagePack and JSON stay readable, and a recording can still be judged and replayed.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterable
from pathlib import Path

from mcap.writer import CompressionType, Writer

from swarmd.core.events import HostInput, SensorInput, TickInput
from swarmd.core.files import read_regular
from swarmd.daemon.recording.inputs import MEMORY, InputReader
from swarmd.daemon.recording.messages import TEXT, is_known
from swarmd.daemon.recording.reader import read_file
from swarmd.daemon.recording.writer import METADATA, PROFILE, Channels

_IPV4 = rb"(?<![\w.])(?:\d{1,3}\.){3}\d{1,3}(?![\w.])"
_HARDWARE = rb"(?<![\w:])(?:[0-9a-fA-F]{2}:){5}[0-9a-fA-F]{2}(?![\w:])"
_IPV6 = rb"(?<![\w:])(?:fe80|fd[0-9a-f]{2}|2[0-9a-f]{3}):[0-9a-fA-F:]{2,}"
_HOME = rb"/(?:home|Users)/[^/\s\"']+"
_Numbers = SensorInput | HostInput | TickInput
_TEXTS = (TEXT, "rcl_interfaces/msg/Log", "swarmd_msgs/msg/DriverState")
"""Kinds of input and types of message with numbers, and with texts."""
_HEAD = "head"
"""The text of a recording that is encoded in base64 (`daemon/recording/head.py`)."""


class Mask:
    """Hides words and addresses in bytes."""

    def __init__(self, words: Iterable[str], *, is_on: bool = True) -> None:
        """`words`: names of hosts and users. `is_on` False: nothing is hidden."""
        names = sorted({word for word in words if word}, key=len, reverse=True)
        self._names: re.Pattern[bytes] | None = None
        if names:
            listed = b"|".join(re.escape(name.encode()) for name in names)
            self._names = re.compile(rb"(?<![A-Za-z0-9])(?:" + listed + rb")(?![A-Za-z0-9])")
        self._addresses = re.compile(b"|".join((_IPV4, _HARDWARE, _IPV6)))
        self._homes = re.compile(_HOME)
        self.is_on = is_on

    def apply(self, data: bytes) -> bytes:
        """The bytes with hidden names and addresses, of the same length."""
        if not self.is_on:
            return data
        if self._names is not None:
            data = self._names.sub(lambda found: b"x" * len(found[0]), data)
        data = self._homes.sub(lambda found: re.sub(rb"[^/]", b"x", found[0]), data)
        return self._addresses.sub(lambda found: re.sub(rb"[0-9a-fA-F]", b"0", found[0]), data)

    def text(self, text: str) -> str:
        """The text with hidden names and addresses."""
        return self.apply(text.encode()).decode(errors="replace")


def masked_recording(path: Path, mask: Mask) -> bytes:
    """A recording with hidden names and addresses; the file itself if nothing is hidden.

    Measured numbers stay to the bit: only texts are masked, since two bytes of a number may look
    like a short name. The robot's memory is left out. ConfigError if the file is no recording.
    """
    if not mask.is_on:
        return read_regular(path)
    recording = read_file(path)
    about = {key: mask.text(value) for key, value in recording.about.items()}
    if (head := recording.about.get(_HEAD)) is not None:
        about[_HEAD] = base64.b64encode(mask.apply(base64.b64decode(head))).decode()
    output = io.BytesIO()
    writer = Writer(output, compression=CompressionType.ZSTD)
    writer.start(PROFILE, "swarmd")
    writer.add_metadata(METADATA, about)
    channels = Channels(writer)
    inputs = InputReader()
    for message in recording.messages:
        input = inputs.read(message)
        has_text = message.kind in _TEXTS if input is None else not isinstance(input[0], _Numbers)
        if is_known(message.kind) and message.topic != MEMORY:
            channel = channels.id_of(message.topic, message.kind)
            data = mask.apply(message.payload) if has_text else message.payload
            writer.add_message(channel, message.at, data, message.at, message.sequence)
    writer.finish()  # type: ignore[no-untyped-call]
    return output.getvalue()
