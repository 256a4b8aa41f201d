"""Numbers in pages: each ratio has its interval, few runs are named, and tables are their JSON."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from studies.outcomes import outcome

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PATTERNS = {path.parent.name: path for path in sorted(ROOT.glob("patterns/*/page.md"))}
PAGES = [
    path for folder in (".", "evidence", "tutorial", "robots")
    for path in sorted((DOCS / folder).glob("*.md"))
] + [*PATTERNS.values(), ROOT / "patterns/README.md", *ROOT.glob("studies/**/*.md")]  # fmt: skip
MEASURED = {
    name: path.read_text().partition("\n## Measured\n\n")[2].partition("\n## ")[0]
    for name, path in PATTERNS.items()
}
KEPT = {name: kept for name, kept in outcome.kept_outcomes().items() if kept.outcomes}
"""Of the patterns whose page has a table that a study wrote."""
KNOWN_AS_MISSED: dict[str, list[str]] = {}
"""Outcomes with "no" in the table of their page."""
FEW = "fewer than twenty"

_WORD = "two|three|four|five|six|seven|eight|nine|ten|eleven|twelve|twenty|thirty|forty|fifty"
_THAN = "as (?:fast|long|many|much|slow|soon|often)|faster|slower|longer|shorter|more|fewer|less"
RATIO = re.compile(
    rf"\b(?:\d+\.\d+ times\b|(?:(?:\d+|{_WORD}) times|twice|half|\d+ %) (?:{_THAN})\b)"
    r"(?! \(\d\S* to \d)"  # its interval
)
# What is no measurement of ours: a constant, a rule, or a source's value.
NO_CLAIM = {
    "configuration.md": ("1.1 times",),
    "keys.md": ("five times more",),  # a load; the shares beside it have their spread
    "paper.md": ("1.4 times",),
    "patterns.md": ("twice as often", "1.5 times"),
    "recording.md": ("7 % more",),  # the end of a range
    "ros_faults.md": ("1.5 times",),
    "best_of_n": ("1.89 times",),
    "chain_formation": ("half as often",),
    "hexagonal_lattice": ("1.5 times", "1.3 times"),
    "one_bit_aggregation": ("3.9 times",),
    "shepherding": ("1.5 times",),
    "sensing.md": ("2.5 times",),
}
SEEDS = re.compile(r"^swarmctl exp (?:run|bench)\b.* --seeds (\d+)\b", re.MULTILINE)

# What README.md quotes, and where: the first cell of a row of benchmarks/README.md.
QUOTED = {
    "[{0} % of a core idle, {1} % driving": "CPU, daemon and host, idle / driving",
    "driving, {0} MB](benchmarks/README.md#in-bursts)": "RSS; PSS",
    "(swarmd: [{0}](benchmarks/README.md#last-measured))": (
        "robot-seconds a CPU-second, 1000 robots with 24 rays"
    ),
    "later starts took {0} s": "`swarmctl demo` to 7 moving, without compiled files",
}


def prose(text: str) -> str:
    return " ".join(re.sub(r"```.*?```", "", text, flags=re.DOTALL).split())


def name_of(page: Path) -> str:
    return page.parent.name if page.name == "page.md" else page.name


def test_a_measured_ratio_has_its_interval() -> None:
    wrong = [
        f"{name_of(page)}: {match[0]}"
        for page in PAGES
        for match in RATIO.finditer(prose(page.read_text()))
        if match[0] not in NO_CLAIM.get(name_of(page), ())
    ]
    assert wrong == []


@pytest.mark.parametrize("pattern", MEASURED)
def test_the_first_line_of_measurements_has_the_number_of_runs(pattern: str) -> None:
    first = MEASURED[pattern].partition("\n")[0]
    match = re.match(
        r"\*\*Runs: ([\d,]+) (?:debates )?of each kind(, fewer than twenty)?\*\*", first
    )
    assert match is not None
    runs = int(match[1].replace(",", ""))
    assert (match[2] is not None) == (runs < 20)
    assert ("values are kept" in first) == (pattern in KEPT)
    assert pattern not in KEPT or runs == KEPT[pattern].seeds
    heads: list[str] = []
    for line in MEASURED[pattern].splitlines():
        cells = [cell.strip() for cell in line[1:-1].split("|")] if line[:1] == "|" else []
        if cells and "runs" in heads:
            counts = [int(n) for n in re.findall(r"\d+", cells[heads.index("runs")])]
            assert FEW in line or min(counts, default=runs) >= runs, line
        heads = heads or cells if cells else []


@pytest.mark.parametrize("pattern", KEPT)
def test_kept_outcomes_are_what_their_runs_give(pattern: str) -> None:
    kept = KEPT[pattern]
    text = MEASURED[pattern]
    assert len(outcome.RESULTS_PART.findall(text)) == 1
    assert outcome.with_results(text, kept.table) == text, "`python -m studies.outcomes` writes it"
    for one in kept.outcomes:
        assert one.runs >= kept.seeds >= 20 or FEW in one.what
        if one.joined is not None:
            again = getattr(outcome, f"{one.joined.kind}_of")(*one.joined.samples)
            assert again.value == pytest.approx(one.joined.value)
            # Another scipy may draw other resamples.
            assert again.interval == pytest.approx(one.joined.interval, rel=0.1), one.what


def test_a_kept_table_has_no_other_no_than_the_known_ones() -> None:
    """`python -m studies.outcomes` passes over what is kept as missed."""
    assert {name: kept.missed for name, kept in KEPT.items() if kept.missed} == KNOWN_AS_MISSED


@pytest.mark.parametrize(
    "page", ["missions.md", *sorted(f"tutorial/{path.name}" for path in DOCS.glob("tutorial/*.md"))]
)
def test_a_lesson_with_few_seeds_says_so(page: str) -> None:
    text = (DOCS / page).read_text()
    assert FEW in text.lower() or all(int(seeds) >= 20 for seeds in SEEDS.findall(text))


@pytest.mark.parametrize("quote", QUOTED)
def test_the_readme_quotes_the_newest_measurement(quote: str) -> None:
    """The last cell of the first row of this name below *Last measured*: the newest is first."""
    measured = (ROOT / "benchmarks/README.md").read_text().partition("\n## Last measured\n")[2]
    row = next(line for line in measured.splitlines() if line.startswith(f"| {QUOTED[quote]} |"))
    newest = re.findall(r"\d[\d.,]*", row.rpartition(" | ")[2])
    assert quote.format(*newest) in (ROOT / "README.md").read_text()
