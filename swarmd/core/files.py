"""Files that appear whole or not at all, folders that outlive a power cut, and names as text."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from swarmd.core.errors import ConfigError


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
    """The path of a text, in which `~` is a home; that of an unknown user stays as it is."""
    return Path(os.path.expanduser(text))  # Path.expanduser raises RuntimeError


def cache_folder() -> Path:
    """The user's folder of what can be made again; RuntimeError without a home."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "swarmd"


def partial_path(path: Path) -> Path:
    """Where a file is written, until it is whole and gets its name."""
    return path.with_name(f".{path.name}.partial")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """The path to write to in the block; then the file gets its name, after an error it is removed.

    After a power cut the file may be empty, unless the caller has written it to the disk (fsync).
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
    """Write a file to the disk: after a power cut it has its old or its new content. OSError.

    `mode`: the permissions of the file, less those that the umask of the process removes.
    """
    with whole_file(path) as partial:
        partial.unlink(missing_ok=True)  # of a write that was cut off, with its mode
        handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
        with open(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(handle)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Write the entries of a folder to the disk, so that a new name outlives a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def open_folder(path: str | Path, within: int | None = None) -> Iterator[int]:
    """The descriptor of a folder, below the folder `within`. OSError if the path is a link."""
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
    handle = os.open(path, flags, dir_fd=within)
    try:
        yield handle
    finally:
        os.close(handle)


def remove_whole(path: Path) -> None:
    """Remove a folder with all that is in it, or the link at its place; errors are passed over.

    The folder first becomes that of this process: its owner could add a file to it meanwhile.
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
    """Why files cannot be written to a folder, or the folder cannot be made; empty if they can.

    Writes a block and removes it: modes are not enough, since the disk may be full or read-only.
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
