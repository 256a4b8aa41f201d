"""Problems that others report (docs/problems.md): their cheap commands end as the page says.

test_docs.py parses all of them.
"""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from swarmd.core.errors import ConfigError
from swarmd.sim.cli.exp import exp

PAGE = (Path(__file__).resolve().parents[2] / "docs/problems.md").read_text()


def command(start: str) -> list[str]:
    """The words after `swarmctl exp` of the first command of the page that begins so."""
    found = re.search(rf"^swarmctl exp ({start} .*)$", PAGE, re.MULTILINE)
    assert found is not None
    return shlex.split(found[1])


@pytest.mark.integration
def test_a_parked_robot_is_neither_met_nor_pushed(tmp_path: Path) -> None:
    words = [*command("run drive"), "--seeds", "1", "--set", "duration=12", "-j", "1"]
    done = CliRunner().invoke(exp, [*words, "--out", str(tmp_path / "out"), "-o", "json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)["variants"][0]["metrics"]
    assert found["robot_contacts"]["max"] == 0.0
    # It drove there: 1.5 m less both outlines remain at first.
    assert 0.05 < found["minimum_gap"]["min"] < 0.5


def test_robots_that_cannot_see_each_other_are_refused(tmp_path: Path) -> None:
    words = [*command("run mixed"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(exp, words)
    assert isinstance(done.exception, ConfigError)
    text = str(done.exception)
    for pair in re.findall(r"(\w+: \w+) is not seen", PAGE):
        assert f"{pair} is not seen" in text
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("section", re.findall(r"^## (.+)$", PAGE, re.MULTILINE))
def test_each_problem_names_its_source_and_has_a_command_with_output(section: str) -> None:
    body = PAGE.partition(f"## {section}\n")[2].partition("\n## ")[0]
    assert re.search(r"\([\w-]+/[\w-]+#\d+\)", body)
    assert re.search(
        r"^```\n(?:swarmctl|make) .+?^```\n(?:<!-- example -->\n)?```text\n",
        body,
        re.MULTILINE | re.DOTALL,
    )
