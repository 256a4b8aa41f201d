"""Which identity a daemon and a swarmctl use, and which they refuse."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.link.datagram import tag_of
from swarmd.link.keys.identity import authority_of, identity_folders
from swarmd.settings.settings import DaemonSettings, load_daemon_settings
from swarmd.settings.swarmfile import load_swarm
from tests.support.keys import SwarmKeys

FIELD = {"swarm": "meadow", "profile": "field", "interface": "lo"}


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> SwarmKeys:
    return SwarmKeys(tmp_path_factory.mktemp("keys"), "meadow", ["r1"], operators=["alice"])


@pytest.fixture
def home(tmp_path: Path) -> dict[str, str]:
    return {"HOME": str(tmp_path)}


def daemon(environ: dict[str, str], **overrides: object) -> DaemonSettings:
    return load_daemon_settings(None, overrides, environ)


def test_a_daemon_takes_id_and_keys_from_its_identity(
    keys: SwarmKeys, home: dict[str, str]
) -> None:
    settings = daemon(home, identity=str(keys.folder_of("r1")), **FIELD)
    assert settings.identity == keys["r1"]
    assert (settings.id, settings.provenance["id"]) == ("r1", "identity")


def test_the_identity_of_the_user_is_found_by_the_name_of_the_swarm(
    keys: SwarmKeys, home: dict[str, str]
) -> None:
    folder = identity_folders("meadow", home)[0]
    keys.authority.issue("r1").write(folder)
    found = daemon(home, swarm="meadow", id="r1")
    assert found.identity is not None
    assert found.identity.folder == folder
    assert daemon(home, swarm="meadow", id="r1", insecure=True).identity is None
    _, identity = load_swarm(None, {"swarm": "meadow"}, home)
    assert identity == found.identity


@pytest.mark.parametrize("profile", ["field", "routed"])
def test_a_network_needs_an_identity_or_insecure(profile: str, home: dict[str, str]) -> None:
    network = FIELD | {"profile": profile, "routers": ["tcp/10.0.0.1:7447"]}
    with pytest.raises(ConfigError) as refused:
        daemon(home, id="r1", **network)
    text = str(refused.value)
    assert all(word in text for word in ("meadow", "swarmctl keys init", "--insecure"))
    assert "\n" not in text
    assert daemon(home, id="r1", insecure=True, **network).identity is None


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"id": "r2"}, ["'r1'", "'r2'"]),
        ({"identity": "alice"}, ["operator alice", "--insecure"]),
        ({"swarm": "lab"}, ["'meadow'", "'lab'"]),
        ({"insecure": True}, ["exclude"]),
        ({"identity": "nothing"}, ["nothing", "No such file"]),
    ],
)
def test_an_identity_that_is_not_of_this_robot_is_refused(
    keys: SwarmKeys, home: dict[str, str], overrides: dict[str, object], words: list[str]
) -> None:
    wanted = FIELD | {"identity": "r1"} | overrides
    wanted["identity"] = str(keys.folder_of(str(wanted["identity"])))
    with pytest.raises(ConfigError) as refused:
        daemon(home, **wanted)
    assert all(word in str(refused.value) for word in words)


def test_secured_and_insecure_swarms_do_not_meet(keys: SwarmKeys, tmp_path: Path) -> None:
    other = SwarmKeys(tmp_path, "meadow", ["r1"])
    authorities = [authority_of(one) for one in (None, keys["r1"], other["r1"])]
    assert len({tag_of("field", "meadow", one) for one in authorities}) == 3
    assert tag_of("field", "meadow", authority_of(keys["alice"])) == tag_of(
        "field", "meadow", authorities[1]
    )
