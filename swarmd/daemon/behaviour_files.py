"""The files of pushed behaviours in `<state>/behaviours/`: whole or absent, also after a power cut.

::

    table                           the manifests of the swarm, signed
    versions                        which versions this robot has, and how they stand
    code/<name>/<sha256>/<name>.py  a behaviour of one file
    code/<name>/<sha256>/code.whl   a wheel
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
from swarmd.core.errors import CodecError, PluginError
from swarmd.core.files import sync_folder, write_whole
from swarmd.pattern_host.wheel import inspect_wheel
from swarmd.plugins import IN_WHEEL
from swarmd.robot.pushed_code import PushedCode

log = logging.getLogger(__name__)

CODE, WHEEL = "code", "code.whl"

_versions = msgspec.msgpack.Decoder(dict[str, PushedCode])


class BehaviourFiles:
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
