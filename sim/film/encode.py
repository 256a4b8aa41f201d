"""Frames into a file, by the system's ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import IO

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError, PluginError, SwarmError
from swarmd.core.files import partial_path

_PALETTE = (
    "split[a][b];[a]palettegen=stats_mode=diff:max_colors={colours}[p];"
    "[b][p]paletteuse=dither=none:diff_mode=rectangle"
)
FORMATS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        ".mp4": (
            *("-c:v", "libx264", "-preset", "medium", "-crf", "20", "-pix_fmt", "yuv420p"),
            *("-movflags", "+faststart", "-f", "mp4"),
        ),
        ".gif": ("-filter_complex", _PALETTE.format(colours=96), "-f", "gif"),
        ".webp": ("-c:v", "libwebp_anim", "-q:v", "60", "-loop", "0", "-f", "webp"),
    }
)
"""The arguments of ffmpeg by the suffix of the file."""


def check_output(path: Path) -> None:
    """ConfigError for a name or folder that no film can have, PluginError without ffmpeg."""
    if path.suffix not in FORMATS:
        raise ConfigError(f"{path}: a film's name ends in {', '.join(FORMATS)}")
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: there is no folder {path.parent}; make it first")
    if shutil.which("ffmpeg") is None:
        raise PluginError("films need the program ffmpeg; install it: apt install ffmpeg")


class Encoder:
    """Writes frames (height, width, 3) of uint8 to a film that appears whole or not at all."""

    def __init__(self, path: Path, size: tuple[int, int], rate: int) -> None:
        """`size` in pixels, both even; `rate` in frames/s.

        ConfigError for a wrong path, PluginError without the program ffmpeg.
        """
        check_output(path)
        self._path, self._partial = path, partial_path(path)
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed by __exit__
        width, height = size
        self._process = subprocess.Popen(
            [
                *("ffmpeg", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"),
                *("-s", f"{width}x{height}", "-r", str(rate), "-i", "-", "-an"),
                *FORMATS[path.suffix],
                str(self._partial.resolve()),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            start_new_session=True,  # Ctrl-C ends it through this process, not beside it
        )
        assert self._process.stdin is not None
        self._pipe: IO[bytes] = self._process.stdin

    def __enter__(self) -> Encoder:
        return self

    def write(self, frame: NDArray[np.uint8]) -> None:
        """Add a frame; SwarmError if ffmpeg has failed."""
        try:
            self._pipe.write(np.ascontiguousarray(frame).data)
        except BrokenPipeError:
            raise SwarmError(self._problem()) from None

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        try:
            if kind is not None:
                self._process.kill()
            else:
                self._finish()
        finally:
            self._process.wait()
            with suppress(BrokenPipeError):  # what could not be written any more
                self._pipe.close()
            self._errors.close()
            self._partial.unlink(missing_ok=True)

    def _finish(self) -> None:
        try:
            self._pipe.close()
        except BrokenPipeError:
            raise SwarmError(self._problem()) from None
        if self._process.wait() != 0:
            raise SwarmError(self._problem())
        self._partial.replace(self._path)

    def _problem(self) -> str:
        self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        why = " ".join(lines[-1].split())[:200] if lines else "it gave no reason"
        return f"{self._path}: ffmpeg could not write the film: {why}"
