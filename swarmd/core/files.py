"""Writes files whole or not at all, also across a power cut; reads paths, and files of others."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from swarmd.core.errors import ConfigError

MAX_FILE = 1 << 28
"""The most bytes that `read_regular` reads, unless the caller names another number."""


def as_text(path: str | Path) -> str:
    """The path as text; ConfigError if its bytes are not UTF-8: no JSON or YAML can hold it."""
    text = str(path)
    try:
        text.encode()
    except UnicodeEncodeError as error:
        shown = text[max(error.start - 30, 0) : error.end + 30]
        raise ConfigError(f"{shown!r} is not UTF-8; rename the file or folder") from error
    return text


def user_path(text: str) -> Path:
    """The path of a text with `~` expanded; the `~name` of an unknown user is not expanded."""
    return Path(os.path.expanduser(text))  # Path.expanduser raises RuntimeError


def real_path(path: Path) -> Path:
    """The absolute path with links followed, as far as they lead: a loop of links is no error."""
    return Path(os.path.realpath(path))  # before Python 3.13 Path.resolve raises RuntimeError


def leads_nowhere(path: Path) -> bool:
    """True if the path, or a folder above it, is a link without a target, such as to a drive that
    is not mounted: what is missing there may exist. OSError if a folder cannot be read."""
    return any(one.is_symlink() and not one.exists() for one in (path, *path.parents))


def open_regular(path: str | Path, flags: int = 0) -> BinaryIO:
    """Open a regular file to read. OSError for a device, a pipe, a socket or a folder.

    A file of others may be a device, whose content may never end, a named pipe, for whose writer
    `open` would wait, or a link to one of these. `flags`: further flags of open(2).
    """
    # By name: Windows, where results can be read, lacks O_NONBLOCK, and other systems O_BINARY.
    flags |= os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    handle = os.open(path, flags)
    if stat.S_ISREG(os.fstat(handle).st_mode):
        return open(handle, "rb")
    os.close(handle)
    raise OSError(errno.EINVAL, "is not a regular file", str(path))


def read_regular(path: str | Path, limit: int = MAX_FILE, flags: int = 0) -> bytes:
    """The content of a regular file of `limit` bytes at most; OSError for any other file.

    Reads as many bytes as the file has when it is opened: a file that grows meanwhile ends there.
    """
    with open_regular(path, flags) as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            raise OSError(errno.EFBIG, f"has {size} bytes, more than {limit}", str(path))
        return file.read(size)


def read_member(path: str | Path, name: str, limit: int) -> bytes:
    """The file `name` in a zip archive of others; OSError without one of `limit` bytes at most."""
    from zipfile import ZipFile  # 8 ms of each start of swarmctl

    with open_regular(path) as file:
        try:
            with ZipFile(file) as archive, archive.open(name) as member:
                content = member.read(limit + 1)
        except OSError:
            raise
        except Exception as error:  # a damaged archive makes zipfile and its codecs raise anything
            text = f"is no zip archive with a readable {name}: {' '.join(str(error).split())}"
            raise OSError(errno.EINVAL, text, str(path)) from error
    if len(content) > limit:
        raise OSError(errno.EFBIG, f"{name} in it has more than {limit} bytes", str(path))
    return content


def cache_folder() -> Path:
    """The user's folder for cached files; RuntimeError without a home."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "swarmd"


def partial_path(path: Path) -> Path:
    """The temporary path at which a file is written before it gets its name."""
    return path.with_name(f".{path.name}.partial")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path to write to in the block.

    After the block, the temporary file replaces the file. After an exception, the temporary file is
    removed. After a power cut the file may be empty, unless the caller has called fsync.
    """
    partial = partial_path(path)
    try:
        yield partial
        partial.replace(path)
    except BaseException:
        with suppress(OSError):
            partial.unlink()
        raise


def write_whole(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Write a file to disk: after a power cut the file has its old or its new content. OSError.

    `mode`: the permissions of the file, reduced by the umask of the process.
    """
    with whole_file(path) as partial:
        partial.unlink(missing_ok=True)  # a leftover of an interrupted write may have another mode
        handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
        with open(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(handle)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Write the entries of a folder to disk (fsync), so that a new name outlives a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def open_folder(path: str | Path, within: int | None = None) -> Iterator[int]:
    """The descriptor of a folder, relative to the folder `within`. OSError if it is a link."""
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
    handle = os.open(path, flags, dir_fd=within)
    try:
        yield handle
    finally:
        os.close(handle)


def lock_file(handle: int, *, waits: bool) -> bool:
    """Lock an open file or folder exclusively, until its descriptor is closed.

    False if the file system has no locks, as NFS without a lock daemon and some Lustre: then
    nothing is locked, and the caller decides whether that is safe. BlockingIOError if another
    process has the lock, unless `waits`.
    """
    import fcntl  # not on Windows, where results can be read

    try:
        fcntl.flock(handle, fcntl.LOCK_EX if waits else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return False
        raise
    return True


_NO_LOCKS = frozenset({errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP})
"""What flock(2) gives on a file system without locks."""


def remove_whole(path: Path) -> None:
    """Remove a folder with its content, or the link in its place; errors are ignored.

    First the folder gets the user of this process as its owner: another owner could add files
    during the removal.
    """
    with suppress(OSError):
        if path.is_symlink():
            path.unlink()
        folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        try:
            os.fchown(folder, os.geteuid(), os.getegid())
            os.fchmod(folder, 0o700)
        finally:
            os.close(folder)
    import shutil  # imports three compressors, which takes 2 ms

    shutil.rmtree(path, ignore_errors=True)


def write_fault(folder: Path) -> str:
    """Why no file can be written to a folder; empty if a file can be written.

    For a missing folder its nearest folder above is tried. Writes and removes a file of one block:
    permissions alone do not show a full or read-only disk.
    """
    from tempfile import TemporaryFile  # 10 ms of each start of swarmctl

    there = folder.absolute()
    try:
        nearest = next(path for path in (there, *there.parents) if path.exists())
        with TemporaryFile(dir=nearest) as file:
            file.write(bytes(4096))
            file.flush()
    except (OSError, StopIteration) as error:
        return getattr(error, "strerror", None) or "there is no such folder"
    return ""
