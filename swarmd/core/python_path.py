"""Names modules that `$PYTHONPATH` puts in the place of those that swarmd was installed with.

A sourced workspace of ROS puts the packages of another Python before those of this one. Imported
only after an error: stdlib alone, since any other module may be one of them.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from pathlib import Path

MAX_NAMED = 3
REMEDY = "start it without: env -u PYTHONPATH"


def replaced_modules(environ: Mapping[str, str] = os.environ) -> dict[str, Path]:
    """The modules of this Python that others of `$PYTHONPATH` replace, each with its folder."""
    own = set(sys.stdlib_module_names)
    for key in ("purelib", "platlib"):
        own.update(_modules_in(Path(sysconfig.get_path(key))))
    found: dict[str, Path] = {}
    for entry in filter(None, environ.get("PYTHONPATH", "").split(os.pathsep)):
        folder = Path(os.path.abspath(entry))  # as Python makes it
        if str(folder) in {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}:
            continue
        for name in _modules_in(folder):
            if name in own:
                found.setdefault(name, folder)
    return found


def replaced_text(environ: Mapping[str, str] = os.environ) -> str:
    """The first modules that `$PYTHONPATH` replaces, and a remedy, in a line; or empty."""
    found = replaced_modules(environ)
    if not found:
        return ""
    named = [f"{name} ({found[name]})" for name in sorted(found)[:MAX_NAMED]]
    more = f" and {len(found) - MAX_NAMED} more" if len(found) > MAX_NAMED else ""
    return f"from PYTHONPATH come {', '.join(named)}{more}; {REMEDY}"


def import_fault(error: BaseException, environ: Mapping[str, str] = os.environ) -> str:
    """The line for an error that a module of `$PYTHONPATH` has raised; empty for another error."""
    found = replaced_modules(environ)
    files = {Path(file) for one in _chain(error) for file in _files_in(one)}
    for name, folder in sorted(found.items()):
        if any(_is_of(file, name, folder) for file in files):
            why = " ".join(f"{type(error).__name__}: {error}".split())
            return f"{name} comes from PYTHONPATH ({folder}), and fails: {why}; {REMEDY}"
    return ""


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """The error and those that caused it."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__


def _files_in(error: BaseException) -> Iterator[str]:
    """The files in which an error arose, or which it names."""
    named: object = None
    if isinstance(error, SyntaxError):
        named = error.filename
    elif isinstance(error, ImportError):  # such as "cannot import name"
        named = error.path
    elif isinstance(error, AttributeError):  # of a module
        named = getattr(error.obj, "__file__", None)
    if isinstance(named, str):
        yield named
    trace = error.__traceback__
    while trace is not None:
        yield trace.tb_frame.f_code.co_filename
        trace = trace.tb_next


def _is_of(file: Path, module: str, folder: Path) -> bool:
    """Whether a file is that of a module or package in a folder."""
    return file.is_relative_to(folder / module) or (
        file.parent == folder and file.name.partition(".")[0] == module
    )


def _modules_in(folder: Path) -> Iterator[str]:
    """The names of the modules and packages in a folder of `sys.path`."""
    try:
        entries = os.listdir(folder)
    except OSError:
        return
    for entry in entries:
        name, _, suffix = entry.partition(".")
        is_module = not suffix or suffix == "py" or suffix.endswith(("so", "pyc"))
        if name.isidentifier() and is_module and not name.startswith("__"):
            yield name
