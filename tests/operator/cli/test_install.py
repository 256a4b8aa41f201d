"""`swarmd install` and `swarmd service install` as root, beside a hostile account `swarmd`."""

from __future__ import annotations

import os
import shutil
import signal
import stat
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from click.testing import CliRunner

from swarmd.link.keys.bundle import Bundle, write_bundle
from swarmd.link.keys.identity import load_identity
from swarmd.operator.cli.daemon import swarmd
from swarmd.operator.cli.service_files import give_to_service
from tests.support.keys import SwarmKeys

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(os.geteuid() != 0, reason="needs root and another account"),
]

USER, GROUP = 4321, 1234
ROUNDS = 20


@pytest.fixture
def root() -> Iterator[Path]:
    """The root of a robot with the account, whose folders another user can reach."""
    folder = Path(tempfile.mkdtemp(prefix="swarmd-"))
    folder.chmod(0o755)
    try:
        (folder / "etc/swarmd").mkdir(parents=True)
        (folder / "etc/passwd").write_text(f"swarmd:x:{USER}:{GROUP}::/:/bin/false\n")
        (folder / "outside/folder").mkdir(parents=True)
        (folder / "outside/secret").write_text("secret")
        (folder / "outside/secret").chmod(0o600)
        (folder / "outside/folder/file").write_text("kept")
        yield folder
    finally:
        shutil.rmtree(folder)


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    keys = SwarmKeys(tmp_path / "keys", "meadow", ("r1",), operators=("alice",))
    issued = keys.authority.issue("r1")
    packed = Bundle(
        info=issued.info,
        certificate=issued.certificate,
        key=issued.key,
        authority=issued.authority,
        roster=issued.roster,
    )
    write_bundle(tmp_path / "r1.bundle", packed)
    return tmp_path / "r1.bundle"


def install(root: Path, bundle: Path) -> None:
    done = CliRunner().invoke(swarmd, ["install", str(bundle), "--root", str(root), "--force"])
    assert done.exception is None, done.exception


def facts(folder: Path) -> dict[str, tuple[object, ...]]:
    """Owner, mode, links and content of all below a folder, as they must stay."""
    found: dict[str, tuple[object, ...]] = {}
    for path in (folder, *sorted(folder.rglob("*"))):
        about = path.lstat()
        content = path.read_bytes() if path.is_file() else tuple(sorted(os.listdir(path)))
        found[str(path)] = (about.st_uid, about.st_gid, about.st_mode, content)
    return found


@contextmanager
def account(act: Callable[[], None]) -> Iterator[None]:
    """A process of the account that repeats `act` during the block."""
    ready, told = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which the child needs not
        child = os.fork()
    if child == 0:
        try:
            os.setgroups([])
            os.setgid(GROUP)
            os.setuid(USER)
            os.write(told, b".")
            while True:
                with suppress(OSError):
                    act()
        finally:
            os._exit(1)
    os.close(told)
    try:
        assert os.read(ready, 1) == b"."
        yield
    finally:
        os.close(ready)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def give_away(folder: Path) -> None:
    """Let the account own a folder and all in it, as a daemon that renews an identity does."""
    for path in (folder, *folder.rglob("*")):
        os.chown(path, USER, GROUP, follow_symlinks=False)


@pytest.mark.parametrize("name", [".meadow.partial", ".meadow.before", "meadow"])
def test_a_link_that_the_account_has_left_leads_nowhere(
    root: Path, bundle: Path, name: str
) -> None:
    identities = root / "etc/swarmd/identities"
    identities.mkdir()
    (identities / name).symlink_to(root / "outside/folder")
    give_away(identities)
    before = facts(root / "outside")
    install(root, bundle)
    assert facts(root / "outside") == before
    assert not (identities / "meadow").is_symlink()
    assert load_identity(identities / "meadow").name == "r1"


def test_no_race_of_the_account_changes_a_file_elsewhere(root: Path, bundle: Path) -> None:
    identities = root / "etc/swarmd/identities"
    install(root, bundle)
    give_away(identities)
    outside = root / "outside"
    before = facts(outside)
    turn = [0]

    def plant() -> None:
        turn[0] += 1
        folder = identities / (".meadow.partial", ".meadow.before", "meadow")[turn[0] % 3]
        with suppress(OSError):
            folder.rename(identities / f"old{turn[0]}")
        with suppress(OSError):
            folder.symlink_to(outside / "folder")
        for inner in (identities / "meadow", folder):
            for place in ("key.pem", "roster", ".key.pem.partial"):
                with suppress(OSError):
                    (inner / place).unlink()
                with suppress(OSError):
                    (inner / place).symlink_to(outside / "secret")
                with suppress(OSError):
                    (inner / f"hard-{place}").hardlink_to(outside / "secret")
        with suppress(OSError):
            folder.unlink()
        with suppress(OSError):
            (identities / "meadow/inner").symlink_to(outside)

    with account(plant):
        for _ in range(ROUNDS):
            install(root, bundle)
            give_to_service(root)
            assert facts(outside) == before
    assert facts(outside) == before
    install(root, bundle)
    assert load_identity(identities / "meadow").name == "r1"


def test_the_account_owns_its_identity_and_not_the_folder_around_it(
    root: Path, bundle: Path
) -> None:
    install(root, bundle)
    identities = root / "etc/swarmd/identities"
    about = identities.stat()
    assert (about.st_uid, about.st_gid, stat.S_IMODE(about.st_mode)) == (0, GROUP, 0o750)
    for path in (identities / "meadow", *(identities / "meadow").iterdir()):
        assert (path.stat().st_uid, path.stat().st_mode & 0o077) == (USER, 0)

    def renew() -> None:
        """As a daemon that takes a roster."""
        from swarmd.link.keys.identity import write_private

        write_private(identities / "meadow/roster", b"newer")

    with account(renew):
        while (identities / "meadow/roster").read_bytes() != b"newer":
            pass


def test_a_file_that_never_ends_does_not_hold_an_installation(root: Path, bundle: Path) -> None:
    install(root, bundle)
    key = root / "etc/swarmd/identities/meadow/key.pem"
    key.unlink()
    os.mkfifo(key)
    os.chown(key, USER, GROUP)
    install(root, bundle)
    assert load_identity(key.parent).name == "r1"
