"""Stores the latches of one robot on disk, so that a restart does not lose an emergency stop."""

from __future__ import annotations

import logging
import os
from pathlib import Path

from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.files import sync_folder
from swarmd.core.messages import Latch
from swarmd.robot.latches import LatchRecord

log = logging.getLogger(__name__)


class LatchFile:
    """The file `latches` in a robot's state folder."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "latches"
        self._decode = Decoder(LatchRecord)
        self._written: LatchRecord | None = None

    def read(self) -> LatchRecord:
        """The record that was written last, else an empty one. An unreadable file latches."""
        try:
            return self._decode(self.path.read_bytes())
        except FileNotFoundError:
            return LatchRecord()
        except (OSError, CodecError) as error:
            log.warning("%s cannot be read (%s): estopped until reset", self.path, error)
            reason = f"{self.path.name} could not be read: {error}"
            latch = Latch(issuer="swarmd", scope="robots", reason=reason[:300])
            return LatchRecord(held={"unreadable": latch})

    def write(self, record: LatchRecord) -> bool:
        """Write the record and wait until it is on the disk; False, with a log line, if that fails.

        An unchanged record is not written again: an operator repeats an estop on every link.
        """
        if record == self._written:
            return True
        temporary = self.path.with_suffix(".new")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with temporary.open("wb") as file:
                file.write(encode(record))
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(self.path)
            sync_folder(self.path.parent)  # without it the rename may be lost
        except OSError as error:
            log.error("%s cannot be written (%s): latched in memory only", self.path, error)
            return False
        self._written = record
        return True
