"""Trust in Python files that results name: run only if the user has run or trusted them before.

Results may come from a stranger, with the paths and digests in their manifest. So a digest of the
manifest shows that a file is unchanged since the runs, but not that the user knows the file. The
file `run_code` in the user's state folder lists the digests of all code that the user's commands
have run.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from swarmd.core.errors import ConfigError
from swarmd.settings.settings import state_folder

_LIST = "run_code"


def remember_code(digests: Iterable[str]) -> None:
    """Add SHA-256 digests to the user's list; no error if the list cannot be written."""
    new = sorted({*digests} - _known())
    if new:
        with suppress(OSError, ConfigError):
            folder = state_folder(os.environ)
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            with (folder / _LIST).open("a", encoding="ascii") as file:
                file.write("".join(f"{digest}\n" for digest in new))


def check_code(
    folder: Path, recorded: Mapping[str, str], present: Mapping[str, str], *, is_trusted: bool
) -> None:
    """ConfigError if a Python file that the results in `folder` name may not be run.

    The results may come from another person, whose code must not run unread. `recorded`: SHA-256 in
    the manifest by file name; `present`: SHA-256 of the files now. A file may be run if both are
    equal and this user has run the same code before. `is_trusted`: all files may be run, and their
    digests are added to the user's list of code.
    """
    if is_trusted:
        remember_code(present.values())
        return
    known = _known()
    for name, digest in sorted(present.items()):
        if not recorded.get(name):
            fault = "is new since the runs"
        elif recorded[name] != digest:
            fault = "has changed since the runs"
        elif digest not in known:
            fault = "is code that you have not run before"
        else:
            continue
        raise ConfigError(
            f"{folder}: {name} {fault} (SHA-256 {digest[:8]}..); read the file, then run it with"
            " --trust"
        )


def _known() -> set[str]:
    with suppress(OSError, ConfigError, UnicodeDecodeError):
        return {*(state_folder(os.environ) / _LIST).read_text(encoding="ascii").split()}
    return set()
