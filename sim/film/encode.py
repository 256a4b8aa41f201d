"""Frames into a file, by the system's ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType

from swarmd.core.errors import ConfigError, PluginError, SwarmError
from swarmd.core.files import whole_file

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


@contextmanager
def encoder(path: Path, size: tuple[int, int], rate: int) -> Iterator[Callable[[bytes], object]]:
    """Yield a function that adds a frame, the rows of RGB bytes, to a film.

    The film appears whole at the end of the block, or not at all. `size`: width and height in
    pixels, both even; `rate` in frames/s. `check_output` accepts `path`. SwarmError if ffmpeg
    fails.
    """
    width, height = size
    with whole_file(path) as partial, tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            [
                *("ffmpeg", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"),
                *("-s", f"{width}x{height}", "-r", str(rate), "-i", "-", "-an"),
                *FORMATS[path.suffix],
                str(partial.resolve()),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,  # Ctrl-C ends it through this process, not beside it
        )
        assert process.stdin is not None
        try:
            yield process.stdin.write
            process.stdin.close()
            if process.wait() != 0:
                raise BrokenPipeError
        except BrokenPipeError:
            process.wait()
            errors.seek(0)
            lines = errors.read().decode(errors="replace").strip().splitlines()
            why = " ".join(lines[-1].split())[:200] if lines else "it gave no reason"
            raise SwarmError(f"{path}: ffmpeg could not write the film: {why}") from None
        finally:
            process.kill()
            process.wait()
            with suppress(BrokenPipeError):  # what could not be written any more
                process.stdin.close()
