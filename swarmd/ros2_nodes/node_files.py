"""The files of nodes: those of a folder, or of a folder in the wheel of a pushed pattern."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from zipfile import ZipFile

from swarmd.core.errors import ConfigError
from swarmd.core.files import read_regular
from swarmd.ros2_nodes.refusal import one_line

MAX_LISTED = 20_000
"""Files of a source folder that are looked through for message types."""
MAX_SIZE = 4 * 1024 * 1024
"""Bytes of one file."""


class NodeFiles:
    """Reads files below a folder, which may lie in a wheel.

    `base`: the folder of the launch file; relative names begin there.
    """

    def __init__(self, base: Path) -> None:
        self.base = Path(os.path.normpath(base))
        self._wheel = next((one for one in self.base.parents if os.path.isfile(one)), None)

    @cached_property
    def _contents(self) -> dict[str, bytes]:
        """The content of each file of the wheel by its absolute path; empty without a wheel."""
        if self._wheel is None:
            return {}
        with ZipFile(self._wheel) as archive:
            return {
                str(self._wheel / name): archive.read(name)
                for name in archive.namelist()
                if not name.endswith("/")
            }

    def path(self, name: str) -> Path:
        """The absolute path of a file or folder that is named from the folder of the launch file.

        `~` is expanded.
        """
        return Path(os.path.normpath(self.base / os.path.expanduser(name)))

    def is_file(self, path: Path) -> bool:
        """Whether there is such a file."""
        return str(path) in self._contents if self._wheel is not None else os.path.isfile(path)

    def is_folder(self, path: Path) -> bool:
        """Whether there is such a folder."""
        if self._wheel is None:
            return os.path.isdir(path)
        return any(name.startswith(f"{path}/") for name in self._contents)

    def read(self, path: Path) -> bytes:
        """The content of a file; ConfigError in one line if it cannot be read."""
        if self._wheel is not None:
            if str(path) not in self._contents:
                raise ConfigError(f"{one_line(path.name)}: the pushed folder has no such file")
            return self._contents[str(path)]
        try:
            return read_regular(path, MAX_SIZE)
        except PermissionError as error:
            raise ConfigError(
                f"{one_line(str(path))}: cannot be read: {error.strerror}; a robot reads its"
                " plugin_dir and"
                " pushed folders alone: put the nodes there"
            ) from error
        except OSError as error:
            text = error.strerror or str(error)
            name = one_line(str(path))
            raise ConfigError(f"{name}: cannot be read: {text}; check the path") from error
        except ValueError as error:  # a null byte
            raise ConfigError(f"{one_line(str(path))}: is no path of a file: {error}") from error

    def listed(self, folder: Path, suffixes: Sequence[str]) -> list[Path]:
        """The files below a folder with one of these suffixes, in their order.

        Hidden folders are left out. ConfigError for a folder of more than MAX_LISTED files.
        """
        if self._wheel is not None:
            names = sorted(self._contents)
            inside = [Path(name) for name in names if name.startswith(f"{folder}/")]
            return [path for path in inside if path.suffix in suffixes]
        found = []
        count = 0
        for place, folders, files in os.walk(folder):
            folders[:] = sorted(name for name in folders if not name.startswith((".", "__")))
            count += len(files)
            if count > MAX_LISTED:
                raise ConfigError(
                    f"{folder} has more than {MAX_LISTED} files; name the folder of the nodes"
                    " alone in `path`"
                )
            found += [Path(place, name) for name in sorted(files) if name.endswith(tuple(suffixes))]
        return found
