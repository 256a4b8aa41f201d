"""What the pages promise: links that lead somewhere, real verbs, options, targets and metrics."""

from __future__ import annotations

import ast
import contextlib
import math
import re
import runpy
import shlex
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import click
import pytest
import yaml
from msgspec import Struct

from swarmd.core.clock import TICK
from swarmd.core.hazard import HazardKind
from swarmd.core.key_table import PUBLISHED
from swarmd.core.messages import Reason
from swarmd.core.values import Scan
from swarmd.drivers.crazyflie.driver import CrazyflieOptions
from swarmd.drivers.ros.messages import LaserScan
from swarmd.drivers.ros.options import RmwOptions, Ros1Options
from swarmd.mission.schema import MissionFile
from swarmd.operator.cli.daemon import swarmd
from swarmd.operator.cli.swarmctl import VERBS, cli
from swarmd.plugins import DRIVERS
from swarmd.robot.protection.binding_range import BindingRange
from swarmd.robot.protection.compatibility import barrier_settings
from swarmd.settings.platforms import PlatformFile, load_platform, platform_names
from swarmd.sim.experiments.lessons import Lesson, load_lessons
from swarmd.sim.experiments.requirements import RUNS, parse_requirement
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.metrics.placed import is_placed
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_names
from swarmd.sim.scenarios.schema import ScenarioFile
from swarmd.sim.world.realism import Realism
from tests.support.shape import FILES, keys_of
from tests.support.swarmctl import parse_line

pytestmark = pytest.mark.integration

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("patterns/**/*.md"),
        ROOT / "benchmarks/README.md",
    ]
)
# Of the forge alone: on the site they have no place.
TEMPLATES = sorted((ROOT / ".github").rglob("*.md"))
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]+))?\)")
FORMER = re.compile(r'<a id="([\w-]+)"></a>\[[^\]]+\]\(([^)#\s]+)#([\w-]+)\)')
IMAGE = re.compile(r'<(?:img|source|video)[^>]* src="([^"]+)"')
TARGET = re.compile(r"^make(?: [A-Z]+=\S+)* ([a-z0-9-]+)", re.MULTILINE)
FILE = re.compile(r"# (\w+\.(?:py|yaml))\n")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
NAMES = Path(__file__).with_name("public_names.txt")
EXAMPLE = "udp"  # the driver in examples/
NAME = re.compile(r"`(swarmd(?:\.\w+)+)`")
GROUPS = [f"swarmd.{name}" for name in ("patterns", "drivers", "emulators", "commands", "metrics")]
SOURCE = re.compile(r"`((?:swarmd|patterns|drivers|sim|config|studies|tests)/[\w/-]+\.\w+)`")
MEMBER = re.compile(r"`([A-Z]\w*[a-z]\w*)\.(\w+)(?:\(\))?`")
CLASS = re.compile(r"^class (\w+)(?:\[.*?\])?(?:\((.*?)\))?:", re.MULTILINE | re.DOTALL)
STEP = re.compile(r"^\| \d+ \| `([\w/]+\.py)` `(\w+)` \|", re.MULTILINE)
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)

CODE_WORD = re.compile(r"`([^`\n]+)`|^\| ([\w, ]+) \|", re.MULTILINE)
# Where the keys of each file stand: pages below docs.
KEY_PAGES: dict[type[Struct], tuple[str, ...]] = {
    **dict.fromkeys(FILES, ("configuration.md",)),
    PlatformFile: ("configuration.md", "walls.md", "mixed_swarms.md", "reference/platforms.md"),
    **dict.fromkeys((ScenarioFile, Realism), ("configuration.md", "reference/scenarios.md")),
    **dict.fromkeys((RmwOptions, Ros1Options), ("configuration.md", "ros.md", "ros_commands.md")),
    MissionFile: ("missions.md",),
    CrazyflieOptions: ("configuration.md", "robots/crazyflie.md"),
}


@cache
def reference() -> dict[str, Any]:
    """The names of docs/site/reference.py."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "docs" / "site")
        return runpy.run_path(str(ROOT / "docs" / "site" / "reference.py"))


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@cache
def text_of(page: Path) -> str:
    """The text of a page with its parts that are made from the code."""
    return str(reference()["filled"](page.read_text()))


def blocks(page: Path, language: str) -> list[str]:
    return [text for kind, text in BLOCK.findall(text_of(page)) if kind == language]


def commands(page: Path, program: str = "swarmctl") -> list[list[str]]:
    """The words of each line in a block that begins with `program`, without comments."""
    text = "\n".join(blocks(page, "")).replace("\\\n", " ")
    lines = text.splitlines()
    pattern = re.compile(rf"(?:\$ )?(?:\w+=\S+ )?{program}\s+(.+?)(?:\s+#.*)?$")
    return [shlex.split(match[1]) for match in map(pattern.match, lines) if match]


def commands_of_pages(program: str) -> Iterator[tuple[Path, list[str]]]:
    for page in [*PAGES, *TEMPLATES]:
        yield from ((page, words) for words in commands(page, program))


def files(page: Path) -> dict[str, str]:
    """The blocks that begin with the name of a file, by that name."""
    listed = [text for kind in ("yaml", "python") for text in blocks(page, kind)]
    return {match[1]: text for text in listed if (match := FILE.match(text))}


def outgoing(page: Path) -> list[tuple[str, str]]:
    """(file or empty, anchor or empty) of each link of the page into the repository."""
    text = BLOCK.sub("", text_of(page))
    links = LINK.findall(text) + [(image, "") for image in IMAGE.findall(text)]
    return [link for link in links if "://" not in link[0]]


def anchors(page: Path) -> set[str]:
    """The anchors that a forge gives to the headings of a page."""
    titles = HEADING.findall(BLOCK.sub("", text_of(page)))
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_the_pattern_in_the_readme_is_the_example() -> None:
    assert (ROOT / "examples" / "shy.py").read_text() in blocks(ROOT / "README.md", "python")


@pytest.mark.parametrize(
    ("page", "name"),
    [
        ("tutorial/2-own-behaviour.md", "beeclust.py"),
        ("patterns.md", "waiting_walk.py"),
        ("from_argos.md", "diffusion.py"),
        ("zenoh.md", "zenoh/stop.py"),
    ],
)
def test_the_program_on_the_page_is_the_example(page: str, name: str) -> None:
    assert (ROOT / "examples" / name).read_text() in blocks(ROOT / "docs" / page, "python")


def test_that_pattern_is_at_most_15_lines_of_code() -> None:
    lines: set[int] = set()
    for node in ast.walk(ast.parse((ROOT / "examples" / "shy.py").read_text())):
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.stmt) and not is_text:
            is_block = isinstance(node, ast.ClassDef | ast.FunctionDef | ast.If)
            end = node.lineno if is_block else node.end_lineno or node.lineno
            lines.update(range(node.lineno, end + 1))
    assert 10 <= len(lines) <= 15


@pytest.mark.integration
def test_links_lead_to_files_and_headings() -> None:
    wrong = []
    for page in PAGES:
        for to, anchor in outgoing(page):
            file = page.parent / to if to else page
            if not file.exists() or (anchor and anchor not in anchors(file)):
                wrong.append(f"{name_of(page)}: {to}#{anchor}")
    assert wrong == []


def test_a_former_place_of_a_heading_leads_to_it() -> None:
    """Its anchor, in front of a link; links of pages and texts of others have it."""
    former = [(page, *found) for page in PAGES for found in FORMER.findall(page.read_text())]
    assert ("docs/experiments.md", "scenarios") in {
        (name_of(page), one) for page, one, *_ in former
    }
    wrong = [
        f"{name_of(page)}: {anchor}"
        for page, anchor, to, heading in former
        if anchor in anchors(page) or heading not in anchors(page.parent / to)
    ]
    assert wrong == []


def test_files_of_the_repository_that_a_page_names_exist() -> None:
    named = [(page, file) for page in PAGES for file in SOURCE.findall(page.read_text())]
    assert [f"{name_of(page)}: {file}" for page, file in named if not (ROOT / file).is_file()] == []


def test_each_page_has_its_place_on_the_site() -> None:
    """In docs/site/contents.py."""
    made = runpy.run_path(str(ROOT / "docs" / "site" / "contents.py"))
    contents = [*made["CONTENTS"].values(), *made["INNER"].values()]
    listed = [f"{page}.md" for pages in contents for page in pages]
    assert sorted(["docs/README.md", *listed]) == sorted(map(name_of, PAGES))


def test_the_sidebar_has_at_most_30_entries() -> None:
    """Further pages stand below one of these."""
    made = runpy.run_path(str(ROOT / "docs" / "site" / "contents.py"))
    assert sum(map(len, made["CONTENTS"].values())) <= 30


def test_commands_are_as_swarmctl_takes_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their files need not exist."""
    monkeypatch.setattr(
        click.Path, "convert", lambda path, value, *_: path.coerce_path_result(value)
    )
    wrong = []
    for page, words in commands_of_pages("swarmctl"):
        with click.Context(cli) as ctx:
            try:
                parse_line(cli, words, ctx)
            except click.UsageError as error:
                wrong.append(f"{name_of(page)}: {' '.join(words)}: {error.format_message()}")
            except click.exceptions.Exit:  # --help
                continue
    assert wrong == []


def test_templates_of_issues_ask_for_output_and_name_files_that_exist() -> None:
    assert {page.name: commands(page)[0] for page in TEMPLATES} == {
        "bug.md": ["--version"], "question.md": ["--version"], "robot.md": ["--version"]
    }  # fmt: skip
    named = [file for page in TEMPLATES for file in re.findall(r"[\w/]+\.md", page.read_text())]
    assert named
    assert [file for file in named if not (ROOT / file).is_file()] == []


def test_each_verb_has_an_example_as_swarmctl_takes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        click.Path, "convert", lambda path, value, *_: path.coerce_path_result(value)
    )
    wrong = []
    for verb in cli.list_commands(click.Context(cli)):
        with click.Context(cli) as ctx:
            command = cli.get_command(ctx, verb)
            _, _, example = ((command and command.epilog) or "").rpartition("swarmctl ")
            try:
                parse_line(cli, shlex.split(example), ctx)
            except click.UsageError as error:
                wrong.append(f"{verb}: {error.format_message()}")
        if example.split()[:1] != [verb]:
            wrong.append(f"{verb}: {example}")
    assert wrong == []


def test_commands_are_as_swarmd_takes_them() -> None:
    wrong = []
    for page, words in commands_of_pages("swarmd"):
        line = f"{name_of(page)}: {' '.join(words)}"
        with click.Context(swarmd) as ctx:
            try:
                parse_line(swarmd, words, ctx)
            except click.UsageError as error:
                wrong.append(f"{line}: {error.format_message()}")
                continue
        said = swarmd.make_context("swarmd", words).params
        platform, driver = said["platform"], said["driver"]
        if platform and not platform.endswith(".yaml") and platform not in platform_names():
            wrong.append(f"{line}: no such platform")
        if driver and driver not in (*entry_points(group=DRIVERS).names, EXAMPLE):
            wrong.append(f"{line}: no such driver")
        if platform and driver is None:
            wrong.append(f"{line}: drives a simulated robot")
    assert wrong == []


def test_targets_of_make_exist() -> None:
    known = set(re.findall(r"^([a-z0-9-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    wrong = []
    for page in PAGES:
        inline = re.findall(r"`(make [^`\n]+)`", BLOCK.sub("", text_of(page)))
        targets = TARGET.findall("\n".join([*inline, *blocks(page, "")]))
        wrong += [f"{name_of(page)}: make {name}" for name in targets if name not in known]
    assert wrong == []


def test_metrics_and_requirements_exist() -> None:
    """Those of `--metrics` and of `exp check`; one of a file must be a file of the page or here."""
    wrong = []
    for page in PAGES:
        verbs = [words for words in commands(page) if words[0] == "exp"]
        checked = [words[3:] for words in verbs if words[1] == "check"]
        names = {parse_requirement(text).metric for texts in checked for text in texts}
        options = [words[words.index("--metrics") + 1] for words in verbs if "--metrics" in words]
        names |= {name for names in options for name in names.split(",")}
        for name in sorted(names - {RUNS, *METRICS} - {*filter(is_placed, names)}):
            file = name.partition(":")[0]
            is_file = file in ("report", "reading", *files(page)) or (ROOT / file).is_file()
            if not is_file:
                wrong.append(f"{name_of(page)}: {name}")
    assert wrong == []


def seeds_that_decide(text: str) -> int:
    """The least number of seeds with which `exp check --sure` can find a requirement met.

    By hand: Wilson's interval of n of n runs begins at n / (n + z^2), with z^2 = 3.8415. Other
    means and medians need the 10 runs of docs/experiments.md.
    """
    one = parse_requirement(text)
    if one.metric == RUNS or one.statistic in ("min", "max"):
        return 1
    if one.metric in METRICS and METRICS[one.metric].unit == "0 or 1":
        share = one.value if one.comparison in (">=", ">") else 1.0 - one.value
        return math.ceil(3.8415 * share / (1.0 - share))
    return 10


def test_a_page_says_how_many_seeds_its_requirements_take() -> None:
    """Of runs that are too few for a sure answer; `class check` may make fewer than the page."""
    runs = [(page, words) for page, words in commands_of_pages("swarmctl")
            if words[:2] == ["exp", "run"] and "--out" in words]  # fmt: skip
    made = {
        words[words.index("--out") + 1]: int(words[words.index("--seeds") + 1])
        for _, words in runs
        if "--seeds" in words
    }
    lessons = {place.partition(":")[0]: lesson.seeds for lesson in load_lessons().values()
               if lesson.pattern for place in lesson.targets}  # fmt: skip
    too_few, wrong = set(), []
    for page, words in commands_of_pages("swarmctl"):
        if words[:2] != ["exp", "check"]:
            continue
        folder = words[2].partition(":")[0]
        seeds = min(made.get(folder, 20), lessons.get(folder, 20))
        text = " ".join(text_of(page).split())
        for needed in map(seeds_that_decide, words[3:]):
            if needed > seeds:
                too_few.add((name_of(page), needed))
                if "--sure" not in text or f"{needed} seeds" not in text:
                    wrong.append(f"{name_of(page)}: {folder} of {seeds} seeds takes {needed} seeds")
    assert ("experiments.md", 35) in {(name.rpartition("/")[2], n) for name, n in too_few}
    assert wrong == []


def test_the_tables_of_outcomes_have_what_their_number_of_runs_can_show() -> None:
    """Beside a wanted bound: the lower end of Wilson's interval of n of n runs, n / (n + z^2)."""
    runs = set[int]()
    for page in ROOT.glob("patterns/*/page.md"):
        for table in re.findall(r"^\| what \| wanted \|.*\n(?:\|.*\n)*", page.read_text(), re.M):
            rows = [[cell.strip() for cell in line.split("|")] for line in table.splitlines()]
            column = rows[0].index("runs") if "runs" in rows[0] else 0
            runs |= {int(row[column]) for row in rows if row[column].isdecimal()}
    text = " ".join((ROOT / "patterns/README.md").read_text().split())
    assert {20, 40} <= runs
    for n in runs - set(range(20)):  # a row with fewer says so
        least = 100 * n / (n + 3.8415)
        assert re.search(rf"\b{least:.{int(least > 99)}f} %[^;]* after {n}\b", text), n
    assert f"90 % [takes {math.ceil(3.8415 * 0.9 / 0.1)} runs]" in text


def test_members_of_classes_that_a_page_names_exist() -> None:
    named = [(page, *names) for page in PAGES for names in MEMBER.findall(page.read_text())]
    wrong = [
        f"{name_of(page)}: {kind}.{member}"
        for page, kind, member in named
        if not _has_member(kind, member)
    ]
    assert wrong == []


@pytest.mark.parametrize(
    "page", [page for page in PAGES if FILE.search(page.read_text())], ids=name_of
)
def test_files_of_a_page_are_ready_to_use(page: Path, tmp_path: Path) -> None:
    for name, text in files(page).items():
        (tmp_path / name).write_text(text)
    for example in (ROOT / "examples").glob("*.py"):
        (tmp_path / example.name).write_text(example.read_text())
    for name, text in files(page).items():
        if "\nmission:" in text:  # tests/mission/test_shipped.py
            continue
        if name.endswith(".yaml"):
            assert load_scenario(tmp_path / name).robots
        else:
            compile(text, name, "exec")


@pytest.mark.parametrize("name", platform_names())
def test_the_page_on_sensing_lists_how_far_each_platform_must_see(name: str) -> None:
    platform = load_platform(name)
    barrier, needed = barrier_settings(platform), "-"
    if barrier is not None:
        needed = f"{BindingRange(platform, barrier, TICK).for_sensor():.2f} m"
    row = f"| `{name}` | {needed} | {platform.scan.range_max:.2f} m |"
    assert row in (ROOT / "docs/evidence/sensing.md").read_text()


def test_each_step_of_a_story_names_a_function() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text()
    stories = text.partition("\n## Four stories\n")[2].partition("\n## ")[0]
    steps = STEP.findall(stories)
    assert len(steps) == sum(line.startswith("| ") for line in stories.splitlines()) - 4
    for file, function in steps:
        path = next(one for one in (ROOT / "swarmd" / file, ROOT / file) if one.is_file())
        assert re.search(rf"^ *(?:async )?def {function}\(", path.read_text(), re.MULTILINE), file


def test_names_of_the_library_are_there() -> None:
    wrong = [
        f"{name_of(page)}: {name}"
        for page in PAGES
        for name in NAME.findall(text_of(page))
        if not _is_there(name)
    ]
    assert wrong == []


@pytest.mark.parametrize(
    ("pattern", "where"),
    [
        ("dispersion", "all 11"),
        ("vicsek_alignment", "waffle_pi_lds02; with a shared frame: crazyflie, epuck2, thymio"),
        ("phototaxis", "epuck2"),
        ("shelter_choice", "in simulation alone: no platform has `reading:ground`"),
        ("foraging", "gripper"),
    ],
)
def test_the_list_of_patterns_says_on_which_platforms_each_runs(pattern: str, where: str) -> None:
    text = (ROOT / "patterns/README.md").read_text().partition("runs_on`, from")[2]
    text = text.partition("<!-- end of")[0]
    (row,) = re.findall(rf"^\| `{pattern}` \| (.*) \|$", text, re.MULTILINE)
    assert where in row


@pytest.mark.parametrize(
    ("platform", "option", "has_places"),
    [
        ("burger", "shared_pose", True),
        ("thymio", "pose_frame", False),
        ("crazyflie", "pose_frame", True),
        ("crazyflie", "shared_pose", False),
    ],
)
def test_only_options_that_a_driver_takes_give_places_of_peers(
    platform: str, option: str, has_places: bool
) -> None:
    """As in the tables of docs/configuration.md and docs/robots/crazyflie.md."""
    provided = reference()["_provided"](load_platform(platform), option)
    assert ("neighbors.heading" in provided) == has_places


def test_the_readme_shows_the_verbs_of_every_day() -> None:
    shown = {words[0] for words in commands(ROOT / "README.md")}
    assert {"members", "run", "stop", "estop", "reset", "describe", "demo", "sim", "exp"} <= shown
    assert shown - {"demo", "sim", "exp", "--swarm"} <= set(VERBS)


@pytest.mark.parametrize(
    ("part", "rows"),
    [
        ("patterns", ["`opinions`", "`spacing`"]),
        ("comparison", ["`attraction`", "`hop_gradient`", "`voter_model`"]),
        ("platforms", [*(f"`{name}`" for name in platform_names()), "`braking_linear`"]),
        ("settings", ["`profile`", "`on_low_battery`", "`half_width_deg`", "`keep_bytes`"]),
        ("driver_options", ["`command_timeout`", "`loop`"]),
        ("ros_options", ["`shared_pose_error_deg`", "`services`", "`domain`", "`shared_cmd_vel`"]),
        ("mixed", [f"`{name}`" for name in platform_names()]),
        ("words", ["`run`", "`stop`", "`estop`", "`low battery`", "`lost link, daemon killed`"]),
        ("scenarios", [*(f"`{name}`" for name in scenario_names()), "`neighborhood`"]),
        ("metrics", [f"`{name}`" for name in METRICS]),
        ("commands", ["`--interface NAME`", "`--seeds SEEDS`"]),
        ("reasons", ["`stale_scan`", "`estop`"]),
        ("keys", [*(f"`state/{name}`" for name in PUBLISHED), "`control/run/ASKER`"]),
        ("payloads", ["`yaw`"]),
        ("messages_any_driver", ["`waits for its watchdog`"]),
    ],
)
def test_the_generated_reference_is_complete(part: str, rows: list[str]) -> None:
    """Each part has a row, with further cells, of what it must list."""
    lines = reference()["part"](part).splitlines()
    found = {match[1] for line in lines if (match := re.match(r"\| (`.+?`) \| .*\w", line))}
    assert set(rows) <= found


@pytest.mark.parametrize("part", ["settings", "driver_options", "ros_options"])
def test_each_generated_key_has_a_meaning(part: str) -> None:
    lines = reference()["part"](part).splitlines()
    heads = {line for line in lines if line.startswith("| key ")}
    assert heads == {"| key | meaning | accepted | default |"}
    rows = [line[2:].split(" | ") for line in lines if line.startswith("| `")]
    assert len(rows) >= 7
    assert [name for name, meaning, *_ in rows if not meaning.strip()] == []


@pytest.mark.parametrize("section", ["The whole file", "groups.NAME", "start", "events"])
def test_each_key_of_a_scenario_has_a_meaning(section: str) -> None:
    text = reference()["part"]("scenarios").partition(f"### {section}\n")[2].partition("\n### ")[0]
    rows = [line[2:].split(" | ") for line in text.splitlines() if line.startswith("| `")]
    assert len(rows) >= 8
    assert [row[0] for row in rows if len(row) < 4 or not row[1].strip()] == []


@cache
def words_of(page: str) -> set[str]:
    """The words in code, headings and the first cells of tables, of a page below docs."""
    text = text_of(ROOT / "docs" / page)
    code = [block for _, block in BLOCK.findall(text)]
    rest = BLOCK.sub("", text)
    cells = [cell for cells in CODE_WORD.findall(rest) for cell in cells]
    return set(re.findall(r"\w+", " ".join([*code, *cells, *HEADING.findall(rest)])))


@pytest.mark.parametrize("file", FILES)
def test_each_key_stands_in_its_page(file: type[Struct]) -> None:
    words = set[str]().union(*map(words_of, KEY_PAGES[file]))
    unknown = {
        f"{kind.__name__}.{key}" for kind, keys in keys_of(file).items() for key in keys - words
    }
    assert unknown == set()


@pytest.mark.parametrize(
    ("names", "page"), [({*HazardKind}, "failures.md"), ({*Reason}, "trouble.md")]
)
def test_each_hazard_and_reason_stands_in_its_page(names: set[str], page: str) -> None:
    assert names - words_of(page) == set()


def test_each_verb_stands_in_a_page_that_people_write() -> None:
    texts = " ".join(page.read_text() for page in PAGES)
    assert {name for name in VERBS if f"swarmctl {name}" not in texts} == set()


def test_each_part_that_is_made_from_the_code_has_one_page() -> None:
    texts = "".join(page.read_text() for page in PAGES)
    made = [line[1] for line in reference()["_PART"].finditer(texts)]
    kept = [found[2] for found in reference()["_KEPT"].finditer(texts)]
    assert sorted(made + kept) == sorted(reference()["PARTS"])
    assert texts.count("*`make reference` makes this part") == len(made)
    assert texts.count("\n<!-- `make reference` writes this part") == len(kept)


def test_parts_that_pages_keep_are_those_of_the_code() -> None:
    texts = {page: page.read_text() for page in PAGES}
    stale = [name_of(page) for page, text in texts.items() if reference()["kept"](text) != text]
    assert not stale, f"`make reference` writes the parts of {', '.join(stale)} again"


def test_names_of_ros_stand_beside_those_of_a_scan() -> None:
    """Each field of a LaserScan, by the definition of rosbags, and fields of ours alone."""
    page = (ROOT / "docs" / "patterns.md").read_text()
    rows = re.findall(r"^\| `sensor_msgs/LaserScan` \| (.+) \| (.+) \|$", page, re.MULTILINE)
    ros, ours = (" ".join(cells) for cells in zip(*rows, strict=True))
    fields = {*LaserScan.__annotations__} - {"__msgtype__"}
    assert fields - {*re.findall(r"\w+", f"{ros} {ours}")} == set()
    assert {*re.findall(r"`scan\.(\w+)", ours)} <= {*Scan.__struct_fields__}


def test_names_on_which_users_build_are_those_of_the_file() -> None:
    """A name that is gone or has another signature is a line of its diff."""
    rule = "a name of a release goes only after a minor version that warns of it: CONTRIBUTING.md"
    kept, lines = (text.splitlines() for text in (NAMES.read_text(), reference()["public_names"]()))
    gone, new = ([x for x in a if x not in b] for a, b in ((kept, lines), (lines, kept)))
    text = "\n".join([rule, "`make names` writes the file again:", *gone, "is now:", *new])
    assert lines == kept, text


@pytest.mark.parametrize(
    ("page", "heading", "text"),
    [
        ("api", "### Scan", "class Scan("),
        ("api", "### MovementPattern", "class MovementPattern(Pattern[P])"),
        ("experiments", "### simulate", "seeds: int | Iterable[int]=20,"),
        ("testing", "### PatternContract", "class PatternContract"),
    ],
)
def test_a_page_of_docstrings_names_classes_and_functions(
    page: str, heading: str, text: str
) -> None:
    lines = text_of(ROOT / "docs" / "reference" / f"{page}.md")
    assert f"{heading}\n\n```python\n" in lines
    assert text in lines


@pytest.mark.parametrize(("number", "lesson"), load_lessons().items())
def test_the_page_of_a_lesson_has_the_targets_by_which_a_class_is_marked(
    number: str, lesson: Lesson
) -> None:
    """`class check` makes the runs of a lesson with a pattern, so that it does not count them."""
    (page,) = (ROOT / "docs" / "tutorial").glob(f"{number}-*.md")
    checks = [words[2:] for words in commands(page) if words[:2] == ["exp", "check"]]
    asked = {place: [one for one in texts if not lesson.pattern or not one.startswith(RUNS)]
             for place, *texts in checks}  # fmt: skip
    assert lesson.targets == asked


@pytest.mark.parametrize("number", ["2", "5"])
def test_a_class_is_marked_by_the_scenario_of_the_page(number: str, tmp_path: Path) -> None:
    (page,) = (ROOT / "docs" / "tutorial").glob(f"{number}-*.md")
    text = next(text for name, text in files(page).items() if name.endswith(".yaml"))
    wanted = yaml.safe_load(text)
    (group,) = wanted["groups"].values()
    lesson = load_lessons()[number]
    assert wanted.pop("plugin_dir") == "."
    assert group.pop("pattern") == lesson.pattern
    assert lesson.scenario == wanted


@cache
def _classes() -> dict[str, list[tuple[list[str], str]]]:
    """The bases of each class, and its text, by its name; two classes may have one name."""
    found: dict[str, list[tuple[list[str], str]]] = {}
    for folder in ("swarmd", "patterns", "drivers", "sim", "studies"):
        for path in ROOT.glob(f"{folder}/**/*.py"):
            text = path.read_text()
            for match in CLASS.finditer(text):
                end = re.compile(r"^\S", re.MULTILINE).search(text, match.end())
                body = text[match.end() : end.start() if end else None]
                found.setdefault(match[1], []).append((re.findall(r"\w+", match[2] or ""), body))
    return found


def _has_member(kind: str, member: str) -> bool:
    """Whether a class of this name, or one of its bases, defines or sets the member."""
    method, name = rf"^ +(?:async )?def {member}\(", rf"(?:^    |self\.){member} ?[:=]"
    defines = re.compile(f"{method}|{name}", re.MULTILINE)
    return any(
        defines.search(body) or any(_has_member(base, member) for base in bases if base != kind)
        for bases, body in _classes().get(kind, ())
    )


def _is_there(name: str) -> bool:
    """Whether it is an entry-point group, a module, or something in a module."""
    if name in GROUPS:
        return True
    module, _, last = name.rpartition(".")
    with contextlib.suppress(ImportError):
        return hasattr(import_module(module), last) or bool(import_module(name))
    return False
