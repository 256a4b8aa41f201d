"""What a robot keeps on its disk: latches, goals with labels, and pushed behaviours.

Each file is whole or absent, also after a power cut. In the folder of one robot::

    latches                                    emergency stops; written before their ack
    goal                                       goals and labels
    behaviours/table                           the manifests of the swarm, signed
    behaviours/versions                        which versions this robot has, and how they stand
    behaviours/code/<name>/<sha256>/<name>.py  a behaviour of one file
    behaviours/code/<name>/<sha256>/code.whl   a wheel
"""

from __future__ import annotations

import hashlib
import logging
import shutil
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path

import msgspec

from swarmd.core.behaviour import Manifest, Table, decode_table, encode_table
from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError, PluginError
from swarmd.core.files import sync_folder, write_fault, write_whole
from swarmd.core.goal import GoalRecord
from swarmd.core.messages import Latch
from swarmd.pattern_host.wheel import inspect_wheel
from swarmd.plugins import IN_WHEEL
from swarmd.robot.latches import LatchRecord
from swarmd.robot.pushed_code import PushedCode

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


class GoalFile:
    """The file `goal` in a robot's state folder: goals and labels."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "goal"
        self._decode = Decoder(GoalRecord)

    def read(self) -> GoalRecord:
        """The record that was written last, else an empty one."""
        try:
            return self._decode(self.path.read_bytes())
        except FileNotFoundError:
            return GoalRecord()
        except (OSError, CodecError) as error:
            log.warning("%s cannot be read (%s): goal and labels are lost", self.path, error)
            return GoalRecord()

    def write(self, record: GoalRecord) -> None:
        """Write the record and wait until it is on the disk. OSError if that fails."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(self.path, encode(record))


CODE, WHEEL = "code", "code.whl"

_versions = msgspec.msgpack.Decoder(dict[str, PushedCode])


class CodeFiles:
    """The folder of the pushed behaviours of one robot; nothing is made before it is needed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def read(self) -> tuple[Table, dict[str, PushedCode]]:
        """The table and the versions; empty, with a log line, what cannot be read."""
        table: Table = ()
        versions: dict[str, PushedCode] = {}
        try:
            table = decode_table((self.folder / "table").read_bytes())
            versions = _versions.decode((self.folder / "versions").read_bytes())
        except FileNotFoundError:
            pass
        except (OSError, CodecError, msgspec.MsgspecError) as error:
            log.warning("%s cannot be read (%s): behaviours are pulled again", self.folder, error)
        return table, versions

    def write(self, table: Table, versions: Mapping[str, PushedCode]) -> None:
        """Write both, and wait until they are on the disk. OSError if that fails."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self._write("versions", msgspec.msgpack.encode(versions))
        self._write("table", encode_table(table))

    def _write(self, name: str, content: bytes) -> None:
        path = self.folder / name
        with suppress(OSError):
            if path.read_bytes() == content:
                return
        write_whole(path, content)

    def add(self, manifest: Manifest, code: bytes) -> None:
        """Write code that a manifest names. PluginError if it is no such code, OSError."""
        if len(code) != manifest.size or hashlib.sha256(code).digest() != manifest.digest:
            raise PluginError(f"{manifest.label}: the code has not the SHA-256 of its manifest")
        folder = self._folder_of(manifest.name, manifest.digest)
        partial = folder.with_name(f".{folder.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        try:
            if manifest.kind == "file":
                write_whole(partial / f"{manifest.name}.py", code)
            else:
                found = inspect_wheel(code, manifest.label)
                if (found.name, found.value) != (manifest.name, manifest.value):
                    raise PluginError(f"{manifest.label} is a wheel of {found.name}")
                write_whole(partial / WHEEL, code)
            shutil.rmtree(folder, ignore_errors=True)
            partial.rename(folder)
            for above in (folder.parent, self.folder / CODE, self.folder):
                sync_folder(above)
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise

    def code(self, name: str, digest: bytes) -> bytes | None:
        """The code of a version; None if it is not here or damaged."""
        folder = self._folder_of(name, digest)
        for path in (folder / f"{name}.py", folder / WHEEL):
            with suppress(OSError):
                content = path.read_bytes()
                return content if hashlib.sha256(content).digest() == digest else None
        return None

    def place(self, manifest: Manifest) -> tuple[str, bool]:
        """Where a pattern host finds the code, as in `Load.origins`."""
        folder = self._folder_of(manifest.name, manifest.digest)
        if manifest.kind == "file":
            return str(folder / f"{manifest.name}.py"), True
        return f"{folder / WHEEL}{IN_WHEEL}{manifest.value}", False

    def prune(self, kept: Collection[tuple[str, bytes]]) -> None:
        """Remove all code but that of the names and digests in `kept`."""
        folders = {self._folder_of(name, digest) for name, digest in kept}
        with suppress(OSError):
            for one in (self.folder / CODE).glob("*/*"):
                if one.is_dir() and one not in folders:
                    shutil.rmtree(one, ignore_errors=True)
                    with suppress(OSError):
                        one.parent.rmdir()

    def _folder_of(self, name: str, digest: bytes) -> Path:
        return self.folder / CODE / name / digest.hex()
