"""An identity is put into place whole, or what was there stays."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from swarmd.core.errors import ConfigError
from swarmd.link.keys.bundle import Bundle, OpenedBundle
from swarmd.link.keys.identity import load_identity
from swarmd.link.keys.installation import replaced_identity
from tests.support.keys import SwarmKeys


@pytest.fixture
def keys(tmp_path: Path) -> SwarmKeys:
    return SwarmKeys(tmp_path / "keys", "meadow", ("r1", "r2"), operators=("alice",))


def opened(keys: SwarmKeys, name: str) -> OpenedBundle:
    issued = keys.authority.issue(name)
    bundle = Bundle(
        info=issued.info,
        certificate=issued.certificate,
        key=issued.key,
        authority=issued.authority,
        roster=issued.roster,
    )
    return OpenedBundle(bundle, keys.authority.roster)


def test_an_error_while_it_is_in_place_brings_the_old_one_back(
    keys: SwarmKeys, tmp_path: Path
) -> None:
    folder = tmp_path / "identities/meadow"
    with replaced_identity(folder, opened(keys, "r1")):
        pass
    with pytest.raises(KeyError), replaced_identity(folder, opened(keys, "r2")):
        raise KeyError
    assert load_identity(folder).name == "r1"
    assert [path.name for path in folder.parent.iterdir()] == ["meadow"]


def test_an_installation_that_was_cut_off_is_undone_by_the_next(
    keys: SwarmKeys, tmp_path: Path
) -> None:
    folder = tmp_path / "identities/meadow"
    with replaced_identity(folder, opened(keys, "r1")):
        pass
    folder.rename(folder.with_name(".meadow.before"))
    with pytest.raises(KeyError), replaced_identity(folder, opened(keys, "r2")):
        raise KeyError
    assert load_identity(folder).name == "r1"


def test_what_does_not_fit_together_is_not_installed(keys: SwarmKeys, tmp_path: Path) -> None:
    r1, r2 = opened(keys, "r1"), opened(keys, "r2")
    foreign = opened(SwarmKeys(tmp_path / "foreign", "meadow", ("r1",), operators=("eve",)), "r1")
    wrong = (
        {"certificate": r2.bundle.certificate},
        {"certificate": r2.bundle.certificate, "key": r2.bundle.key},
        {"authority": foreign.bundle.authority},
        {"certificate": foreign.bundle.certificate, "key": foreign.bundle.key},
        {"key": b"-----BEGIN PRIVATE KEY-----\n"},
    )
    folder = tmp_path / "identities/meadow"
    for change in wrong:
        bundle = msgspec.structs.replace(r1.bundle, **change)
        with pytest.raises(ConfigError), replaced_identity(folder, OpenedBundle(bundle, r1.roster)):
            pass
        assert not list(folder.parent.iterdir())
