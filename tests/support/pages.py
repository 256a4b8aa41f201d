"""The code blocks of a page: commands, the output printed beside them, snippets and examples.

sybil finds such blocks, too. Its items exist only below a conftest.py, and the pages stand outside
of `tests`; they take no marks, so that none can be left to `make evidence`. What is left of sybil
without items is the expression `BLOCK`.
"""

from __future__ import annotations

import doctest
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches

SUMMARY = "blocks of the pages"
"""The property of a test whose value ends the output of pytest."""
EXAMPLE = "<!-- example -->"
"""In the line before a block: nothing runs it."""
BLOCK = re.compile(
    r"^(?P<mark> *<!-- example -->\n)? *```(?P<language>\w*)\n(?P<text>.*?)^ *```$",
    re.MULTILINE | re.DOTALL,
)
FENCE = re.compile(r"^(?:[> ]*~~~|> *```| *````| *```(?!\w*$)).*$", re.MULTILINE)
"""A fence that `BLOCK` does not find."""
LANGUAGES = ("", "bash", "ini", "json", "python", "text", "toml", "yaml")
FILE = re.compile(r"# (\w+\.(?:py|yaml))\n")
PROGRAMS = re.compile(
    "babeld|batctl|cargo|colcon|cp|dask|done|export|for|git|ip|make|mkdir|modprobe|pip|pkill|podman"
    "|printf|pytest|python3?|rm|ros2|roslaunch|rosrun|sbatch|scp|sed|sh|source|ssh|sudo|swarmctl"
    "|swarmd|sysctl|tar|timeout|unzip|zenoh-bridge-ros2dds|zenohd"
)
"""The first words of commands in blocks without a language."""
_ASSIGNED = re.compile(r"""^(?:(?:\w+=(?:"[^"]*"|'[^']*'|\S*)|\$\w+)(?:\s+|$))+""")
_FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
_CHECKER = doctest.OutputChecker()


@dataclass(frozen=True, slots=True)
class Block:
    """A block between fences; `line` is that of its first line in the page."""

    page: str
    line: int
    language: str
    text: str
    is_example: bool

    @property
    def kind(self) -> str:
        """`example`, `snippet` (Python), `session`, `commands`, `output` or `data`."""
        if self.is_example:
            return "example"
        if self.language == "python":
            return "snippet"
        if self.language not in ("", "bash", "text"):
            return "data"
        if self.text.startswith("$ "):
            return "session"
        return "output" if self.language == "text" else "commands"


@dataclass(frozen=True, slots=True)
class Printed:
    """Output of a page, with the commands before it; it is what the last of them prints."""

    page: str
    line: int
    commands: tuple[str, ...]
    text: str


@dataclass(frozen=True, slots=True)
class Blocks:
    """The blocks of a page, and what they print; a fault names a block that nothing runs."""

    all: tuple[Block, ...]
    printed: tuple[Printed, ...]
    faults: tuple[str, ...]

    def of(self, kind: str) -> list[Block]:
        return [one for one in self.all if one.kind == kind]

    @property
    def files(self) -> dict[str, str]:
        """The files that the reader writes, by name."""
        return {found[1]: one.text for one in self.all if (found := FILE.match(one.text))}


def blocks_of(page: str, text: str) -> Blocks:
    """The blocks of a page with this text."""
    found = [
        Block(
            page,
            text.count("\n", 0, match.start("text")) + 1,
            match["language"],
            textwrap.dedent(match["text"]),
            match["mark"] is not None,
        )
        for match in BLOCK.finditer(text)
    ]
    printed, faults = list[Printed](), list[str]()
    for fence in FENCE.finditer(text):
        line = text.count("\n", 0, fence.start()) + 1
        faults.append(f"{page}:{line}: a block begins with ``` and a language: {fence[0]!r}")
    commands = ""
    for one in found:
        if one.language not in LANGUAGES:
            faults.append(f"{page}:{one.line}: nothing runs a block of {one.language!r}")
        if one.kind == "session":
            printed += _session(one)
        elif one.kind == "output" and not commands:
            faults.append(f"{page}:{one.line}: no block of commands stands before this output")
        elif one.kind == "output":
            printed.append(Printed(page, one.line, lines_of(commands), one.text))
        elif one.kind == "commands":
            word = _unknown(one.text)
            faults += [f"{page}:{one.line}: {word!r} is no command"] if word else []
        if one.kind != "data":
            commands = one.text if one.kind == "commands" else ""
    return Blocks(tuple(found), tuple(printed), tuple(faults))


def lines_of(commands: str) -> tuple[str, ...]:
    """Each command in one line, without comments that have a line of their own."""
    lines = commands.replace("\\\n", " ").splitlines()
    return tuple(line for line in lines if line and not line.startswith("#"))


def difference(wanted: str, got: str) -> str | None:
    """What a page prints and its command does not; `...` stands for anything, as in doctest.

    A line `...` stands for no line, too, and spaces for any spaces.
    """
    if _is_same(re.sub(r"^\.\.\.\n", "...", wanted, flags=re.MULTILINE), got):
        return None
    printed = [line for line in wanted.splitlines() if line.strip() not in ("", "...")]
    lines = [line for line in got.splitlines() if line.strip()]
    for line in printed:
        # A page may fold a line.
        if not any(_is_same(f"...{line.strip()}...", one) for one in lines):
            nearest = get_close_matches(line, lines, n=1, cutoff=0.0) or ["nothing"]
            return f"the page has {_short(line)}, its command gives {_short(nearest[0])}"
    more = [line for line in lines if not any(_is_same(one, line) for one in printed)]
    return f"its command also gives {_short(more[0])}" if more else "the lines have another order"


def _is_same(wanted: str, got: str) -> bool:
    return _CHECKER.check_output(wanted, got, _FLAGS)


def _session(block: Block) -> Iterator[Printed]:
    """Each output of a session, with the commands since the output before."""
    line = block.line
    commands: tuple[str, ...] = ()
    for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
        command, _, text = part.partition("\n")
        commands += (command,)
        if text:
            yield Printed(block.page, line + 1, commands, text)
            commands = ()
        line += part.count("\n")


def _unknown(commands: str) -> str | None:
    """The first word at the margin that is no program; assignments may stand before a program."""
    for line in lines_of(commands):
        words = _ASSIGNED.sub("", line, count=1).replace(";", " ").split()
        if words and not line.startswith(" ") and not PROGRAMS.fullmatch(words[0]):
            return words[0]
    return None


def _short(line: str) -> str:
    return repr(" ".join(line.split()))
