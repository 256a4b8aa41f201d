"""The list of survivors: what was said of each mutant that no test killed at first."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from studies.mutants.mutant import Mutant
from swarmd.core.errors import ConfigError

FILE = Path(__file__).with_name("survivors.toml")
KINDS = ("killed", "equivalent", "open")


class Judged(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A mutant that survived once."""

    path: str
    inside: str
    was: str
    now: str
    number: int = 1
    kind: str
    """`killed`: a test kills it since. `equivalent`: no input shows it. `open`: neither."""
    why: str
    """The test that kills it, the reason why no input shows it, or what a test would need."""

    @property
    def mutant(self) -> Mutant:
        """The mutant."""
        return Mutant(
            path=self.path, inside=self.inside, was=self.was, now=self.now, number=self.number
        )


def read(file: Path = FILE) -> Mapping[Mutant, Judged]:
    """The list by mutant; ConfigError for a file that is none."""
    try:
        rows = msgspec.convert(tomllib.loads(file.read_text())["survivors"], list[Judged])
    except (ValueError, KeyError) as error:
        raise ConfigError(f"{file}: {error!r}; expected [[survivors]] as the others") from error
    for row in rows:
        if row.kind not in KINDS or not row.why.strip():
            text = f"expected a kind of {', '.join(KINDS)}, and a reason"
            raise ConfigError(f"{file}: {row.mutant.name}: {text}")
    found = {row.mutant: row for row in rows}
    if len(found) < len(rows):
        raise ConfigError(f"{file}: a mutant stands twice")
    return found


def faults(
    outcomes: Mapping[Mutant, bool], judged: Mapping[Mutant, Judged], *, is_whole: bool = True
) -> Sequence[str]:
    """What the list says otherwise than the run, a line each; empty if they agree.

    `outcomes`: whether a test killed each mutant that was tried. `is_whole`: all were tried.
    """
    found = []
    for mutant, is_killed in outcomes.items():
        row = judged.get(mutant)
        if not is_killed and row is None:
            found.append(f"survives, and is not listed: {mutant.name}")
        elif not is_killed and row is not None and row.kind == "killed":
            found.append(f"survives again, although a test is listed: {mutant.name}")
        elif is_killed and row is not None and row.kind != "killed":
            found.append(f"is killed, and listed as {row.kind}: {mutant.name}")
    if is_whole:
        gone = judged.keys() - outcomes.keys()
        found += sorted(f"is listed, and no mutant any more: {mutant.name}" for mutant in gone)
    return found
