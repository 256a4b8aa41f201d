"""The options of a page in a secured swarm: its certificate, and what its identity may do."""

from __future__ import annotations

import asyncio
import re
import ssl
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from swarmd.core.errors import ConfigError
from swarmd.link.keys.roster import KeyPermit
from swarmd.operator.cli.web import WebOptions, web_options
from tests.support.keys import SwarmKeys

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> SwarmKeys:
    folder = tmp_path_factory.mktemp("keys")
    pupil = KeyPermit(role="pupils", key=bytes(64), may=("stop",), until=2**32)
    return SwarmKeys(
        folder, "meadow", ["r1"], operators=["alice"], viewers=["eve"], permits={"anna": pupil}
    )


@pytest.mark.parametrize(
    ("name", "role", "key"),
    [
        ("alice", "operator", "alice (operator)"),
        ("eve", "viewer", "eve (viewer)"),
        ("anna", "operator", "anna (pupils: stop; until 2106-02-07 06:28 UTC)"),
    ],
)
def test_a_page_may_do_what_its_identity_may(
    keys: SwarmKeys, name: str, role: str, key: str
) -> None:
    """The robots judge what the page of a name with a permit commands."""
    page = WebOptions("127.0.0.1", 0, token="an-operators-token").of(keys[name])
    assert page.access.role("an-operators-token") == role
    assert page.access.role("another") == ""
    assert page.access.key == key


@pytest.mark.parametrize("name", ["alice", "eve"])
def test_in_a_secured_swarm_a_page_on_loopback_has_a_token(keys: SwarmKeys, name: str) -> None:
    made = [WebOptions("127.0.0.1", 0).of(keys[name]) for _ in range(2)]
    assert made[0].token != made[1].token
    for page in made:
        assert page.access.role("") == ""
        assert page.access.role(page.token)


def test_without_an_identity_a_page_is_as_its_options_say(keys: SwarmKeys) -> None:
    page = WebOptions("127.0.0.1", 0)
    assert page.of(None) == page
    with pytest.raises(ConfigError, match="no identity"):
        WebOptions("127.0.0.1", 0, tls=()).of(None).context()


async def test_tls_without_files_takes_the_certificate_of_the_identity(keys: SwarmKeys) -> None:
    page = WebOptions("127.0.0.1", 0, tls=()).of(keys["alice"])
    server = await asyncio.start_server(lambda *_: None, "127.0.0.1", 0, ssl=page.context())
    port = server.sockets[0].getsockname()[1]
    trusting = ssl.create_default_context(cafile=str(keys["alice"].authority))
    _, writer = await asyncio.open_connection(
        "127.0.0.1", port, ssl=trusting, server_hostname="alice"
    )
    (names,) = writer.get_extra_info("peercert")["subject"]
    assert names == (("commonName", "alice"),)
    writer.close()
    server.close()


def test_files_of_ones_own_win(keys: SwarmKeys) -> None:
    files = (Path("page.pem"), Path("page.key"))
    assert WebOptions("127.0.0.1", 0, tls=files).of(keys["alice"]).tls == files


@click.command()
@web_options
def tokens(page: WebOptions) -> None:
    """Print the tokens of a page."""
    click.echo(f"{page.token} {page.viewer_token}")


@pytest.mark.parametrize("option", ["--token", "--viewer-token"])
def test_a_token_on_the_command_line_is_refused_without_repeating_it(option: str) -> None:
    done = CliRunner().invoke(tokens, [option, "heron-41-basalt"])
    assert done.exit_code == 2
    assert option in done.output
    assert "heron" not in done.output


def test_a_token_is_the_first_line_of_a_file_or_new(tmp_path: Path) -> None:
    file, empty = tmp_path / "token", tmp_path / "empty"
    file.write_text("heron-41-basalt\nnote\n")
    empty.write_text("\n")
    done = CliRunner().invoke(tokens, ["--token", str(file), "--viewer-token", "-"])
    operator, viewer = done.output.split()
    assert operator == "heron-41-basalt"
    assert len(viewer) == 16
    assert CliRunner().invoke(tokens, ["--token", str(empty)]).exit_code == 2


def test_no_option_of_a_program_takes_a_secret_as_its_value() -> None:
    """All options whose names sound like one: they take a file, or no value at all."""
    text = (ROOT / "tests" / "docs" / "public_names.txt").read_text(encoding="utf-8")
    found = re.findall(r"--[a-z-]*(?:token|secret|pass|credential|pin)\b[a-z-]* ([^,\s]+)", text)
    assert len(found) >= 8  # of four verbs with a page
    assert set(found) == {"FILE"}
