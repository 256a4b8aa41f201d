"""The parts of pages that jobs write."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from studies.night.sources import ROOT
from swarmd.core.files import write_whole

PART = re.compile(r"(<!-- results: (\w+)[^>]*-->\n).*?(<!-- end of results -->)", re.DOTALL)
"""A part of a page: its first line with its name, what a job writes, and its last line."""
_HEAD = re.compile(r"<!-- results: (\w+) -->\n")


def pages() -> Iterator[Path]:
    """The pages that may have parts."""
    for pattern in ("*.md", "docs/**/*.md", "patterns/**/*.md", "benchmarks/*.md"):
        yield from sorted(ROOT.glob(pattern))


def with_part(page: str, name: str, text: str) -> str:
    """The text of a page with this text as its part `name`; ValueError if it has no such part."""
    if name not in {found[2] for found in PART.finditer(page)}:
        raise ValueError(f"wanted a part `<!-- results: {name} -->` ... `<!-- end of results -->`")

    def put(found: re.Match[str]) -> str:
        return f"{found[1]}\n{text}\n\n{found[3]}" if found[2] == name else found[0]

    return PART.sub(put, page)


def parts_of(output: str, name: str) -> dict[str, list[str]]:
    """The lines of each part that a program printed, by its name; `name` is that of the first."""
    first, *more = _HEAD.split(output.rstrip() + "\n")
    found = {name: first, **dict(zip(more[::2], more[1::2], strict=True))}
    return {part: text.strip().splitlines() for part, text in found.items() if text.strip()}


def table_on_page(name: str) -> list[str]:
    """The lines of a part without its last one, which says where it was made; none without it."""
    for path in pages():
        for found in PART.finditer(path.read_text()):
            if found[2] == name:
                return _table_of(found).splitlines()
    return []


def _table_of(found: re.Match[str]) -> str:
    text = found[0].removeprefix(found[1]).removesuffix(found[3]).strip()
    return text.rpartition("\n")[0].strip()


def write_origin(name: str, origin: str) -> None:
    """Write the last line of a part of all pages: where its table was made, and is current."""
    for path in pages():
        before = path.read_text()
        after = before
        for found in PART.finditer(before):
            if found[2] == name:
                after = with_part(after, name, f"{_table_of(found)}\n\n{origin}")
        if after != before:
            write_whole(path, after.encode())


def write_parts(texts: dict[str, str]) -> list[str]:
    """Write these parts into all pages that have them; the names that no page has."""
    missing = set(texts)
    for path in pages():
        before = path.read_text()
        after = before
        for name in {found[2] for found in PART.finditer(before)} & texts.keys():
            after = with_part(after, name, texts[name])
            missing.discard(name)
        if after != before:
            write_whole(path, after.encode())
    return sorted(missing)
