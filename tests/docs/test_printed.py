"""One runner over all pages: what a page prints beside a command is what the command gives.

`make test` compares what is cheap and needs no robots, `make evidence` the rest. A block that
nothing runs has the mark `EXAMPLE` in its page. `...` stands for anything, as in doctest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest

from tests.support.page_reader import Reader
from tests.support.pages import EXAMPLE, SUMMARY, Blocks, Printed, blocks_of

ROOT = Path(__file__).resolve().parents[2]
SHORT = (
    "swarmctl exp bench doorway --pattern foraging",
    "swarmctl exp check-mission",
    "swarmctl exp run aggregation --pattern swirl",
    "swarmctl import",
    "swarmctl mission check",
    "swarmctl plugin check",
    "printf",
    "sed",
    "swarmd --config",
)
"""How commands begin whose output is compared in `make test`; the others are evidence."""
OFFLINE = ("class", "exp", "import", "mission", "plugin new", "plugin check")
"""Verbs that need no robots."""
DEFINITIONS = (
    "README.md",
    "docs/drivers.md",
    "docs/patterns.md",
    *(f"docs/tutorial/{name}.md" for name in ("2-own-behaviour", "3-statistics", "5-protection")),
)
"""Pages whose snippets define patterns, metrics or tests, and run in `make test`."""
BEES = (ROOT / "examples" / "beeclust.py").read_text()
GIVEN: Mapping[str, Mapping[str, str]] = {
    "docs/from_ros2swarm.md": {
        "attraction_pattern.yaml": """\
/**:
  ros__parameters:
    attraction_max_range: 2.0
    attraction_min_range: 0.12
    attraction_front_attraction: -1.0
    attraction_threshold: 1
    attraction_linear_if_alone: 0.0
    attraction_angular_if_alone: 1.0
    max_translational_velocity: 0.26
    max_rotational_velocity: 1.82
"""
    },
    "docs/tutorial/teachers.md": {
        "handed-in/anna/beeclust.py": BEES,
        "handed-in/ben/beeclust.py": BEES.replace("return Twist(linear=self", "Twist(linear=self"),
        "handed-in/dora/beeclust.py": BEES.replace("= 120.0", "= 5.0"),
        "handed-in/eva/bee.py": BEES,
    },
}
"""Files that a page expects of its reader and does not show."""
FIRST: Mapping[str, tuple[str, ...]] = {
    "docs/figures.md": (
        "swarmctl exp run aggregation --seeds 2 --set duration=20 --out runs/a",
        "cp -r runs/a runs/b",
        "swarmctl exp run aggregation --seeds 4 --set duration=20 --out runs/gather",
    ),
    "docs/patterns.md": ("swarmctl plugin new swirl --dir mine",),
    "docs/recording.md": (
        "swarmctl record start --all",
        "swarmctl run flocking --all",
        "swarmctl stop --all",
        "swarmctl record stop --all",
        "swarmctl record fetch --all -d evening",
        "swarmctl record merge evening -o evening.mcap",
    ),
    "docs/tutorial/README.md": (
        "swarmctl exp run aggregation --seeds 5 --out runs/first"
        " --metrics one_cluster_at_end,gather_time,robot_contacts",
    ),
}
"""Commands of other pages, or of other blocks, without which a page cannot be run."""
PRELUDE: Mapping[str, str] = {
    "docs/learning.md": """
import onnx
import swarmd
onnx.save(onnx.helper.make_model(onnx.helper.make_graph([], "empty", [], [])), "gather.onnx")
""",
    "docs/patterns.md": (ROOT / "examples" / "shy.py").read_text()
    + """
import math
from swarmd.api import *
PushParams = ShyParams
""",
    "docs/python.md": """
import asyncio
import swarmd
swarm = keep_open(swarmd.connect())
""",
    "docs/zenoh.md": """
import msgpack
import zenoh
session = keep_open(zenoh.open(zenoh.Config()))
payload = b"1" + msgpack.packb({"state": "idle"})
""",
}
"""What each snippet of a page takes for granted."""
LIVE = frozenset({"docs/drive.md", "docs/python.md", "docs/zenoh.md"})
"""Pages whose snippets need robots."""
HINT = f"output stands in a `text` block below its commands, or has the mark {EXAMPLE} above it:"


@cache
def pages() -> dict[str, Blocks]:
    """All pages by their path."""
    folders = ("docs", "patterns", "studies", "benchmarks", "examples", "drivers")
    found = [*ROOT.glob("*.md"), *(one for name in folders for one in ROOT.glob(f"{name}/**/*.md"))]
    names = sorted(one.relative_to(ROOT).as_posix() for one in found)
    return {name: blocks_of(name, (ROOT / name).read_text()) for name in names}


def is_short(printed: Printed) -> bool:
    return all(command.startswith(SHORT) for command in printed.commands)


def printed_of(page: str, *, short: bool) -> list[Printed]:
    return [one for one in pages()[page].printed if is_short(one) is short]


def counts() -> dict[str, int]:
    """How many blocks of all pages there are, and what runs them."""
    every = [block for blocks in pages().values() for block in blocks.all]
    kinds = Counter(block.kind for block in every)
    printed = [one for blocks in pages().values() for one in blocks.printed]
    snippets = {page: len(blocks.of("snippet")) for page, blocks in pages().items()}
    quick = sum(map(is_short, printed))
    defined = sum(snippets[page] for page in DEFINITIONS)
    return {
        "blocks": len(every),
        "of commands": kinds["commands"],
        "of data": kinds["data"],
        "outputs": len(printed),
        "outputs compared in make test": quick,
        "outputs compared in make evidence": len(printed) - quick,
        "snippets": kinds["snippet"],
        "snippets run in make test": defined,
        "snippets run in make evidence": kinds["snippet"] - defined,
        "marked as examples": kinds["example"],
        "run by nothing": sum(len(blocks.faults) for blocks in pages().values()),
    }


def needs_robots(page: str) -> bool:
    listed = [
        *FIRST.get(page, ()),
        *(one for each in pages()[page].printed for one in each.commands),
    ]
    verbs = [command.partition("swarmctl ")[2] for command in listed]
    return page in LIVE or any(verb and not verb.startswith(OFFLINE) for verb in verbs)


@pytest.fixture
def reader(page: str, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Reader]:
    """Of the page that is the test's parameter; `make test` starts no robots."""
    is_evidence = request.node.get_closest_marker("evidence") is not None
    with Reader(tmp_path, files_of(page), has_robots=is_evidence and needs_robots(page)) as one:
        yield one


def files_of(page: str) -> dict[str, str]:
    return {**pages()[page].files, **GIVEN.get(page, {})}


def test_each_block_is_compared_run_or_marked(
    record_property: Callable[[str, object], None],
) -> None:
    record_property(SUMMARY, ", ".join(f"{count} {what}" for what, count in counts().items()))
    faults = [fault for blocks in pages().values() for fault in blocks.faults]
    none_of([HINT, *faults] if faults else [])


@pytest.mark.parametrize(
    "text",
    [
        "```console\n$ swarmctl members\n```\n",
        "```text \nNAME  STATE\n```\n",
        "```text title\nNAME  STATE\n```\n",
        "````text\nNAME  STATE\n````\n",
        "~~~\nNAME  STATE\n~~~\n",
        "> ```text\n> NAME  STATE\n> ```\n",
        "```text\nNAME  STATE\n```\n",
        "```\nNAME  STATE\n```\n",
    ],
)
def test_a_block_that_nothing_runs_is_a_fault(text: str) -> None:
    assert blocks_of("page.md", text).faults[0].startswith("page.md:")


def with_printed(*, short: bool) -> list[str]:
    return [page for page in pages() if printed_of(page, short=short)]


@pytest.mark.integration
@pytest.mark.parametrize("page", with_printed(short=True))
def test_cheap_output_of_a_page_is_that_of_its_commands(page: str, reader: Reader) -> None:
    compare(page, reader, printed_of(page, short=True))


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.parametrize("page", with_printed(short=False))
def test_output_of_a_page_is_that_of_its_commands(page: str, reader: Reader) -> None:
    compare(page, reader, printed_of(page, short=False))


def compare(page: str, reader: Reader, printed: list[Printed]) -> None:
    for command in FIRST.get(page, ()):
        reader.run(command)
    none_of([fault for one in printed if (fault := reader.fault(one))])


def none_of(faults: list[str]) -> None:
    """Fail with a line for each fault."""
    if faults:
        pytest.fail("\n".join(faults), pytrace=False)


def with_snippets(*, short: bool) -> list[str]:
    listed = [page for page, blocks in pages().items() if blocks.of("snippet")]
    return [page for page in listed if (page in DEFINITIONS) is short]


@pytest.mark.parametrize("page", with_snippets(short=True))
def test_definitions_of_a_page_are_python(page: str, reader: Reader) -> None:
    execute(page, reader)


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.parametrize("page", with_snippets(short=False))
def test_snippets_of_a_page_run(page: str, reader: Reader) -> None:
    for command in FIRST.get(page, ()):
        reader.run(command)
    execute(page, reader)


def execute(page: str, reader: Reader) -> None:
    """Run all snippets of a page in one module, as its reader would from the top."""
    for block in pages()[page].of("snippet"):
        reader.execute(PRELUDE.get(page, ""), page)
        try:
            reader.execute("\n" * (block.line - 1) + block.text, page)
        except Exception as error:
            raise AssertionError(f"{page}:{block.line}: {error!r}") from error
