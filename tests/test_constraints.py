"""constraints.txt: versions that install on the oldest supported Python."""

from importlib.metadata import distributions
from pathlib import Path

from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

# Debian 12 and Raspberry Pi OS 12 ship Python 3.11.2.
OLDEST_PYTHON = "3.11.2"


def test_each_pinned_version_installs_on_the_python_of_debian_12() -> None:
    lines = Path("constraints.txt").read_text().splitlines()
    pinned = {canonicalize_name(line.split("==")[0]) for line in lines if "==" in line}
    installed = {canonicalize_name(one.metadata["Name"]): one for one in distributions()}
    found = {name: installed[name].metadata for name in pinned & installed.keys()}
    wanted = {
        name: one["Requires-Python"] for name, one in found.items() if "Requires-Python" in one
    }
    refusing = {
        name: text
        for name, text in wanted.items()
        if text and not SpecifierSet(text).contains(OLDEST_PYTHON)
    }
    assert len(wanted) > 100  # the tools for tests and checks are installed
    assert not refusing
