"""The options of a page in a secured swarm: its certificate, and what its identity may do."""

from __future__ import annotations

import asyncio
import ssl
from pathlib import Path

import pytest

from swarmd.cli.web import WebOptions
from swarmd.core.errors import ConfigError
from tests.support.keys import SwarmKeys


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> SwarmKeys:
    folder = tmp_path_factory.mktemp("keys")
    return SwarmKeys(folder, "meadow", ["r1"], operators=["alice"], viewers=["eve"])


@pytest.mark.parametrize(("name", "role"), [("alice", "operator"), ("eve", "viewer")])
def test_a_page_may_do_what_its_identity_may(keys: SwarmKeys, name: str, role: str) -> None:
    page = WebOptions("127.0.0.1", 0, token="an-operators-token").of(keys[name])
    assert page.access.role("an-operators-token") == role
    assert page.access.role("another") == ""


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
