"""Writes a new pattern and its test; both pass the contract as they are."""

from __future__ import annotations

import keyword
import sys
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template

import click

from swarmd.core.keys import is_id
from swarmd.plugins import installed_patterns


def write_plugin(name: str, folder: Path, kind: str) -> tuple[Path, Path]:
    """Write both files and return their paths; UsageError, and no file, for an unusable name.

    The texts are those of `templates/`.
    """
    _check_name(name)
    paths = (folder / f"{name}.py", folder / f"test_{name}.py")
    for path in paths:
        if path.exists():
            raise click.UsageError(f"{path} is there already; move it away or take another name")
    _check_free(name)
    folder_of_texts = files("swarmd.cli") / "templates"
    texts = [(folder_of_texts / f"{head}{kind}.txt").read_text() for head in ("", "test_")]
    class_name = "".join(word.capitalize() for word in name.split("_"))
    if class_name in "".join(texts):  # such as Twist, which it imports
        class_name += "Pattern"
    folder.mkdir(parents=True, exist_ok=True)
    for path, text in zip(paths, texts, strict=True):
        with path.open("x", encoding="utf-8") as file:
            file.write(Template(text).substitute(name=name, kind=class_name))
    return paths


def _check_name(name: str) -> None:
    is_test = name.startswith("test_")
    if is_id(name) and name.isidentifier() and not keyword.iskeyword(name) and not is_test:
        return
    wanted = "expected 1 to 63 of a-z, 0-9 and _, the first a letter, no word of Python's, no test_"
    raise click.UsageError(
        f"a pattern's file is a Python module, and {name!r} is no name: {wanted}"
    )


def _check_free(name: str) -> None:
    """UsageError if a module or an installed pattern has the name."""
    origin = installed_patterns().get(name)
    if origin is not None:
        raise click.UsageError(f"{origin.source} has a pattern {name!r}; take another name")
    if name in sys.stdlib_module_names or find_spec(name) is not None:
        raise click.UsageError(f"{name!r} is the name of a Python module; take another name")
