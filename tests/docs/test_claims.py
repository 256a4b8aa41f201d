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
] + [*PATTERNS.values(), ROOT / "patterns/README.md"]  # fmt: skip
NOT_MEASURED = {"ros2_nodes": "it does what the nodes of its user do"}
MEASURED = {
    name: path.read_text().partition("\n## Measured\n\n")[2].partition("\n## ")[0]
    for name, path in PATTERNS.items()
    if name not in NOT_MEASURED
}
KEPT = {name: kept for name, kept in outcome.kept_outcomes().items() if kept.outcomes}
"""Of the patterns whose page has a table that a study wrote."""
README = (ROOT / "README.md").read_text()
PATTERNS_README = (ROOT / "patterns/README.md").read_text()
KNOWN_AS_MISSED: dict[str, list[str]] = {
    "cooperative_transport": [
        "share of runs in which the box arrives",
        "way of the box that arrives / straight way",
        "contacts",
    ]
}
"""Outcomes with "no" in the table of their page."""
DEBATES = 50
"""Of each seed, of patterns that vote without a body."""
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

HELD = "docs/evidence/beside.md"
BENCH, PAPER, FIRST = "benchmarks/README.md", "docs/paper.md", "docs/installation.md"
# What README.md quotes, and where: page, start of the row, and the column of the cell by its head.
QUOTED = {
    "[{0} % of their time](docs/evidence/beside.md#what-it-costs-in-ordinary-runs)": (
        HELD, "nine TurtleBots 4, 5 x 5 m               | as the platform", "held"
    ),
    "[{0} % of a core idle, {1} % driving": (BENCH, "daemon and host: CPU idle / driving", ""),
    "driving, {0} MB](benchmarks/README.md#all-budgets)": (
        BENCH, "daemon and host: RSS; PSS", ""
    ),
    "[{0} robot-seconds per CPU-second, {1} times as many as ours ({2} to {3})](benchmarks/": (
        BENCH, "ARGoS ", "1000 robots"
    ),
    "later starts took {0} s": (BENCH, "`swarmctl demo` to 7 moving, without compiled files", ""),
    "[{0} of {1} runs](docs/paper.md#hardware) of our attraction": (
        PAPER, "hardware_free, body, settling", "six linked at 120 s"
    ),
    "[{0} of {1}](docs/ros2_nodes.md#ros2swarm) of ROS2swarm's own attraction node": (
        "docs/ros2_nodes.md", "their own node", "six linked at 120 s"
    ),
    "[{0} of {1}](docs/paper.md#hardware) of our rewrite": (
        PAPER, "hardware_free, body, original", "six linked at 120 s"
    ),
    "[{0} of {1}](docs/paper.md#hardware) of robots that do not move": (
        PAPER, "hardware_free, still", "six linked at 120 s"
    ),
    "moved [{0} s](docs/installation.md#from-a-clone-to-moving-robots)": (
        FIRST, "all seven robots have moved", "s after `make demo`"
    ),
}  # fmt: skip
CONTROLS = {  # by row of "What is different", what its claim stands beside
    "ROS2swarm": "robots that do not move",
    "ARGoS": "times as many as ours",
    "Nav2": "without protection",
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
        r"\*\*Runs: ([\d,]+) (debates )?of each kind\*\*; their values are kept in", first
    )
    assert match is not None
    assert pattern in KEPT
    runs = int(match[1].replace(",", ""))
    assert runs >= 20
    assert runs == KEPT[pattern].seeds * (DEBATES if match[2] else 1)
    heads: list[str] = []
    for line in MEASURED[pattern].splitlines():
        cells = [cell.strip() for cell in line[1:-1].split("|")] if line[:1] == "|" else []
        if cells and "runs" in heads:
            counts = [int(n) for n in re.findall(r"\d+", cells[heads.index("runs")])]
            assert FEW in line or min(counts, default=runs) >= runs, line
        heads = heads or cells if cells else []


@pytest.mark.parametrize("pattern", MEASURED)
def test_a_page_has_one_part_that_the_study_writes_and_no_other_control(pattern: str) -> None:
    before, _, rest = MEASURED[pattern].partition("<!-- results: outcomes -->\n")
    part, _, after = rest.partition("<!-- end of results -->")
    assert part.count("\n| ") >= 2
    assert "| robots that never move reach |" not in before + after
    assert "results: outcomes" not in after


@pytest.mark.parametrize("pattern", KEPT)
def test_kept_outcomes_are_what_their_runs_give(pattern: str) -> None:
    kept = KEPT[pattern]
    text = MEASURED[pattern]
    part = text.partition("<!-- results: outcomes -->")[2].partition("<!-- end of results -->")[0]
    table, _, control = part.strip().partition("\n\n**The control, fewer than twenty runs**")
    assert table == kept.table, outcome.renewal(pattern)
    assert not control or "digest" not in kept.made_with  # of a file without the control
    for one in kept.outcomes:
        assert one.runs >= kept.seeds >= 20 or FEW in one.cells[outcome.HEAD.index("runs")]
        if one.joined is not None:
            again = getattr(outcome, f"{one.joined.kind}_of")(*one.joined.samples)
            assert again.value == pytest.approx(one.joined.value)
            # Another scipy may draw other resamples.
            assert again.interval == pytest.approx(one.joined.interval, rel=0.1), one.what


def test_a_kept_table_has_no_other_no_than_the_known_ones() -> None:
    """`python -m studies.outcomes` passes over what is kept as missed."""
    missed = {name: kept.missed for name, kept in KEPT.items() if kept.missed}
    assert missed == {name: what for name, what in KNOWN_AS_MISSED.items() if name in KEPT}


@pytest.mark.parametrize(
    "page", ["missions.md", *sorted(f"tutorial/{path.name}" for path in DOCS.glob("tutorial/*.md"))]
)
def test_a_lesson_with_few_seeds_says_so(page: str) -> None:
    text = (DOCS / page).read_text()
    assert FEW in text.lower() or all(int(seeds) >= 20 for seeds in SEEDS.findall(text))


def cell_of(page: str, row: str, head: str) -> str:
    """The cell of the column `head` (the last one: "") in the newest row that begins with `row`.

    The newest measurement stands first below *Last measured* of benchmarks/README.md.
    """
    text = (ROOT / page).read_text()
    lines = (text.partition("\n## Last measured\n")[2] if not head else text).splitlines()
    at = next(
        number
        for number, line in enumerate(lines)
        if line.startswith(f"| {row}") and (not head or head in head_of(lines, number))
    )
    return cells_of(lines[at])[head_of(lines, at).index(head) if head else -1]


def cells_of(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def head_of(lines: list[str], at: int) -> list[str]:
    """The head of the table around a line."""
    first = next(number for number in range(at, -1, -1) if not lines[number].startswith("|")) + 1
    return cells_of(lines[first])


def quoted(quote: str) -> str:
    """The words of a quote with the figures of its cell."""
    return quote.format(*re.findall(r"\d[\d.,]*", cell_of(*QUOTED[quote])))


@pytest.mark.parametrize("quote", QUOTED)
def test_the_readme_quotes_the_measured_figure(quote: str) -> None:
    assert quoted(quote) in README


def test_each_figure_of_the_readme_with_a_link_is_quoted() -> None:
    rest = re.sub(r"`[^`\n]*`", "", README)
    for quote in QUOTED:
        rest = rest.replace(quoted(quote), "")
    links = re.findall(r"\[([^][]*)\]\((?!http)[^()]*\)", rest)
    assert [text for text in links if re.search(r"(?<![\w.-])\d", text)] == []


def test_each_difference_names_its_control() -> None:
    section = README.partition("## What is different")[2].partition("\n## ")[0]
    rows = {row[0]: row[1] for row in re.findall(r"(?m)^\| \[(\w+)\](.*)$", section)}
    assert rows.keys() == CONTROLS.keys()
    assert [name for name, control in CONTROLS.items() if control not in rows[name]] == []


STILL = [
    cells_of(line)
    for line in PATTERNS_README.partition("## Robots that never move")[2].splitlines()
    if line.startswith("| `")
]


@pytest.mark.parametrize("pattern", sorted({name.strip("`") for name, *_ in STILL}))
def test_a_page_has_the_rows_that_robots_reach_which_never_move(pattern: str) -> None:
    """And its first row, which stands beside those of other patterns, is a row that they miss."""
    rows = [row for name, *row in STILL if name == f"`{pattern}`"]
    text = PATTERNS[pattern].read_text()
    of_page = text.partition("| robots that never move reach | wanted | with |\n|---|---|---|\n")[2]
    assert [cells_of(line) for line in of_page.partition("\n\n")[0].splitlines()] == rows
    lines = MEASURED[pattern].splitlines()
    first = lines[next(i for i, line in enumerate(lines) if line.startswith("|---")) + 1]
    assert cells_of(first)[0] not in [what for what, *_ in rows]
