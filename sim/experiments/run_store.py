"""The store of runs: results that are known to the bit, in a folder of the user's cache.

::

    KEY/result      the SHA-256 of what follows it, then the metrics of the run as JSON
    KEY/trace.npz   the trace, if it was kept
    aside/KEY       an entry that differed from the same run done again

KEY is the digest of what a result follows from (`run_key.py`). A folder of an entry gets its name
when it is whole. What cannot be used counts as not there: an entry that is cut off, damaged, of
another user or no folder, a store that cannot be written, a full disk. Files are copied, never
linked: a user may change the files of an experiment. Two processes may use one store at a time.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import msgspec

from swarmd.core.errors import ConfigError
from swarmd.core.files import (
    cache_folder,
    open_regular,
    partial_path,
    read_regular,
    remove_whole,
    user_path,
)

VARIABLE = "SWARMD_RUN_STORE"
"""The variable with the folder of the store; `off`: there is none."""
SIZE_VARIABLE = "SWARMD_RUN_STORE_GB"
"""The variable with the most gigabytes that the store holds."""
OFF = "off"
BOUND = 2 << 30
"""The most bytes that the store holds."""
_SHARE_OF_ENTRY = 1 / 8  # of the bound, the most that one entry takes
_SHARE_KEPT = 0.9  # of the bound, what is left when entries are removed
_SHARE_WRITTEN = 1 / 8  # of the bound, what is written before entries are removed
_FREE = 1 << 30  # bytes that stay free on the disk
_OLD = 3600.0  # s after which an entry that was never finished is removed
_RESULT = "result"
_TRACE = "trace.npz"
_ASIDE = "aside"
_PARTIAL = ".partial-"
_MAX_RESULT = 1 << 20  # bytes; the metrics of a run take some kB
_PIECE = 1 << 20  # bytes that are read at a time
_DIGEST = 64  # hexadecimal digits of a SHA-256
_FICLONE = 0x40049409  # ioctl_ficlone(2): the copy shares the blocks of the file
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_TAKEN = (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR)
"""What rename(2) gives if something has the name of an entry."""


class Entry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A run that is known."""

    key: str
    made: str  # the day of the run, such as 2026-11-29
    metrics: dict[str, float | None]  # in the order of the columns
    trace: str = ""  # the SHA-256 of the trace; empty: none was kept
    size: int = 0  # bytes of the trace
    bits: str = ""  # the hash of what the robots did
    rules: tuple[str, ...] = ()  # of protection and steering that acted


class _DamagedError(Exception):
    """What has the name of an entry is none."""


class RunStore:
    """The store in a folder, which need not exist.

    `bound`: the most bytes that it holds. `free`: bytes that stay free on its disk. `user`: whose
    files count, by number; None: the user of this process.
    """

    def __init__(
        self, folder: Path, *, bound: int = BOUND, free: int = _FREE, user: int | None = None
    ) -> None:
        self.folder = folder
        self._bound = bound
        self._free = free
        self._user = os.geteuid() if user is None else user
        self._written = 0  # bytes since entries were last removed

    def find(self, key: str, *, has_trace: bool) -> Entry | None:
        """The entry of a run; None without one. `has_trace`: an entry without a trace is none.

        What has the name of an entry and is damaged is removed.
        """
        if not self._is_usable():
            return None
        try:
            entry = self._read(key)
        except FileNotFoundError:
            return None
        except _DamagedError:
            self.remove(key)
            return None
        except OSError:  # such as of a disk that fails
            return None
        return None if has_trace and not entry.trace else entry

    def hand_out(self, entry: Entry, trace: Path | None) -> bool:
        """Copy the trace of an entry to a path, whole or not at all, and note that it was used.

        `trace`: None if only the metrics are wanted. False if the entry is damaged, and then
        removed, or if the copy cannot be written.
        """
        if trace is not None:
            try:
                self._copy_out(entry, trace)
            except _DamagedError:
                self.remove(entry.key)
                return False
            except OSError:
                return False
        with suppress(OSError):  # a store that can only be read
            os.utime(self.folder / entry.key / _RESULT, follow_symlinks=False)
        return True

    def keep(
        self,
        key: str,
        metrics: Mapping[str, float | None],
        trace: Path | None,
        made: str,
        *,
        bits: str = "",
        rules: tuple[str, ...] = (),
    ) -> None:
        """Keep a run; nothing is kept, without an error, where that is not possible.

        `trace`: of the run; None: none was kept. `made`: the day of the run. `bits`, `rules`: as of
        JobResult.
        """
        partial: Path | None = None
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            size = 0 if trace is None else trace.stat().st_size
            if not self._is_usable() or not self._has_room(size):
                return
            partial = Path(tempfile.mkdtemp(prefix=_PARTIAL, dir=self.folder))
            digest = ""
            if trace is not None:
                copy = partial / _TRACE
                _copy(trace, copy)
                digest = _digest_of(copy)
                size = copy.stat().st_size
            entry = Entry(
                key=key,
                made=made,
                metrics=dict(metrics),
                trace=digest,
                size=size,
                bits=bits,
                rules=rules,
            )
            text = msgspec.json.encode(entry)
            if msgspec.json.decode(text, type=Entry) != entry:  # a value that JSON cannot hold
                return
            head = hashlib.sha256(text).hexdigest().encode()
            (partial / _RESULT).write_bytes(b"%s\n%s" % (head, text))
            self._name(partial, entry)
            self._written += size + len(text)
        except OSError:
            return
        finally:
            if partial is not None:
                shutil.rmtree(partial, ignore_errors=True)
        if self._written >= _SHARE_WRITTEN * self._bound:
            self.shrink()

    def put_aside(self, key: str) -> Path:
        """Take an entry out of use; returns the folder that has it now."""
        target = self.folder / _ASIDE / key
        try:
            target.parent.mkdir(mode=0o700, exist_ok=True)
            if target.exists():
                remove_whole(target)
            (self.folder / key).rename(target)
        except OSError:  # a store that can only be read
            return self.folder / key
        return target

    def trace(self, entry: Entry) -> Path | None:
        """The trace of an entry, to be read; None if it is damaged, and then it is removed."""
        path = self.folder / entry.key / _TRACE
        with suppress(OSError):
            if _digest_of(path) == entry.trace:
                return path
        self.remove(entry.key)
        return None

    def remove(self, key: str) -> None:
        """Remove what has the name of an entry; no error if it stays."""
        path = self.folder / key
        with suppress(OSError):
            if not stat.S_ISDIR(path.lstat().st_mode):
                path.unlink()
                return
            gone = Path(tempfile.mkdtemp(prefix=_PARTIAL, dir=self.folder))
            try:
                path.rename(gone / key)  # at once: no other process sees a part of it
            finally:
                remove_whole(gone)

    def taken_since(self, begin: float) -> int:
        """The number of entries that have been there at `begin` (Unix time in s), and used since.

        Whoever measures what a program costs that calls `simulate` asks for it.
        """
        count = 0
        if not self._is_usable():
            return count
        with suppress(OSError), os.scandir(self.folder) as found:
            for item in found:
                if len(item.name) == _DIGEST and item.is_dir(follow_symlinks=False):
                    made = item.stat(follow_symlinks=False).st_mtime
                    with suppress(OSError):
                        used = os.stat(f"{item.path}/{_RESULT}", follow_symlinks=False).st_mtime
                        count += made < begin <= used
        return count

    def shrink(self, now: float | None = None) -> None:
        """Remove the entries whose last use is oldest, until the store is within its bound.

        Also removes what a killed process has left. `now`: Unix time in s; None: the clock's.
        """
        self._written = 0
        if not self._is_usable():
            return
        with suppress(OSError):
            self._remove_leftovers(time.time() if now is None else now)
            entries = sorted(self._entries())
            total = sum(size for _, size, _ in entries)
            if total <= self._bound:
                return
            for _, size, key in entries:
                self.remove(key)
                total -= size
                if total <= _SHARE_KEPT * self._bound:
                    return

    def _remove_leftovers(self, now: float) -> None:
        for path in self.folder.glob(f"{_PARTIAL}*"):
            with suppress(OSError):
                if now - path.lstat().st_mtime > _OLD:
                    remove_whole(path)

    def _entries(self) -> Iterator[tuple[float, int, str]]:
        """The time of the last use, the bytes and the key of each entry."""
        with os.scandir(self.folder) as found:
            for item in found:
                if len(item.name) != _DIGEST or not item.is_dir(follow_symlinks=False):
                    continue
                # what is no entry goes first
                used = 0.0
                size = 0
                with suppress(OSError), os.scandir(item.path) as files:
                    for file in files:
                        about = file.stat(follow_symlinks=False)
                        size += about.st_size
                        if file.name == _RESULT:
                            used = about.st_mtime
                yield used, size, item.name

    def _is_usable(self) -> bool:
        """Whether the store is a folder of this user that nobody else can write."""
        try:
            about = self.folder.stat()
        except OSError:
            return False
        is_own = stat.S_ISDIR(about.st_mode) and about.st_uid == self._user
        return is_own and not about.st_mode & _WRITABLE_BY_OTHERS

    def _has_room(self, size: int) -> bool:
        disk = os.statvfs(self.folder)
        is_left = disk.f_bavail * disk.f_frsize - size >= self._free
        return is_left and size <= _SHARE_OF_ENTRY * self._bound

    def _read(self, key: str) -> Entry:
        """The entry of a key. FileNotFoundError without one, _DamagedError for something else."""
        folder = self.folder / key
        about = folder.lstat()
        if not stat.S_ISDIR(about.st_mode) or about.st_uid != self._user:
            raise _DamagedError
        try:
            content = read_regular(folder / _RESULT, _MAX_RESULT, os.O_NOFOLLOW)
        except OSError as error:
            raise _DamagedError from error
        digest = content[:_DIGEST]
        text = content[_DIGEST + 1 :]
        if hashlib.sha256(text).hexdigest().encode() != digest:
            raise _DamagedError
        try:
            entry = msgspec.json.decode(text, type=Entry)
        except msgspec.MsgspecError as error:
            raise _DamagedError from error
        if entry.key != key:
            raise _DamagedError
        return entry

    def _copy_out(self, entry: Entry, trace: Path) -> None:
        """Copy the trace; OSError if it cannot be written, _DamagedError for another trace."""
        source = self.folder / entry.key / _TRACE
        try:
            about = source.lstat()
        except OSError as error:
            raise _DamagedError from error
        is_its = stat.S_ISREG(about.st_mode) and about.st_uid == self._user
        if not is_its or about.st_size != entry.size:
            raise _DamagedError
        partial = partial_path(trace)
        try:
            _copy(source, partial)
            if _digest_of(partial) != entry.trace:
                raise _DamagedError
            partial.replace(trace)
        finally:
            with suppress(OSError):
                partial.unlink(missing_ok=True)

    def _name(self, partial: Path, entry: Entry) -> None:
        """Give a whole entry its name, unless an entry that is as good has it. OSError."""
        target = self.folder / entry.key
        try:
            partial.rename(target)
            return
        except OSError as error:
            if error.errno not in _TAKEN:
                raise
        if self.find(entry.key, has_trace=bool(entry.trace)) is None:
            self.remove(entry.key)
            partial.rename(target)


def run_store(environ: Mapping[str, str]) -> RunStore | None:
    """The store that the environment names, by default one in the user's cache; None: it is off.

    ConfigError for a size that is no number above 0.
    """
    text = environ.get(VARIABLE, "")
    if text == OFF or not hasattr(os, "geteuid"):  # not on Windows
        return None
    try:
        folder = user_path(text) if text else cache_folder() / "runs"
    except RuntimeError:  # there is no home
        return None
    size = environ.get(SIZE_VARIABLE, "")
    if not size:
        return RunStore(folder)
    try:
        gigabytes = float(size)
    except ValueError:
        gigabytes = 0.0
    if not 0.0 < gigabytes < 1e9:
        raise ConfigError(f"{SIZE_VARIABLE} is {size!r}; expected a number of GB, such as 2")
    return RunStore(folder, bound=int(gigabytes * 2**30))


def _copy(source: Path, target: Path) -> None:
    """Copy a regular file, which is no link; the copy shares its blocks where a disk can do that.

    The target is replaced. OSError.
    """
    import fcntl  # not on Windows, which has no store

    target.unlink(missing_ok=True)
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    with (
        open_regular(source, os.O_NOFOLLOW) as file,
        open(os.open(target, flags, 0o666), "wb") as copy,
    ):
        try:
            fcntl.ioctl(copy.fileno(), _FICLONE, file.fileno())
        except OSError:  # most file systems, and two file systems
            shutil.copyfileobj(file, copy)


def _digest_of(path: Path) -> str:
    digest = hashlib.sha256()
    with open_regular(path, os.O_NOFOLLOW) as file:
        while piece := file.read(_PIECE):
            digest.update(piece)
    return digest.hexdigest()
