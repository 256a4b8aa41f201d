"""Stores the latches of one robot on disk, so that a restart does not lose an emergency stop."""

from __future__ import annotations

import logging
from pathlib import Path

from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.files import write_fault, write_whole
from swarmd.core.messages import Latch
from swarmd.robot.latches import LatchRecord

log = logging.getLogger(__name__)


class LatchFile:
    """The file `latches` in a robot's state folder, which the daemon writes on its loop.

    A latch is on the disk before it is acknowledged. The robot does not run when its latches
    change, so that a slow disk ends no run. The command zero is sent before.

    `fault`: why what is latched now would be lost by a restart; empty if it would not.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "latches"
        self._decode = Decoder(LatchRecord)
        self._written: LatchRecord | None = None
        self._unwritten: LatchRecord | None = None
        self.fault = ""

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

    def check(self) -> bool:
        """Write what could not be written before, else try the folder; True if `fault` changed."""
        before = self.fault
        if self._unwritten is not None:
            self.write(self._unwritten)
        else:
            why = write_fault(self.path.parent)
            self.fault = f"{self.path.parent} cannot be written ({why})" if why else ""
        return self.fault != before

    def write(self, record: LatchRecord) -> bool:
        """Write the record and wait until it is on the disk; False, with a log line, if that fails.

        An unchanged record is not written again: an operator repeats an estop on every link.
        """
        if record == self._written:
            return True
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self.path, encode(record))
        except OSError as error:
            if not self.fault:
                log.error("%s cannot be written (%s): latched in memory only", self.path, error)
            self._unwritten = record
            self.fault = f"{self.path.parent} cannot be written ({error.strerror})"
            return False
        self._written, self._unwritten, self.fault = record, None, ""
        return True
