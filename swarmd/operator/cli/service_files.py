"""Steps that change this machine or the root of another one; each is printed."""

from __future__ import annotations

import os
import shutil
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import click

from swarmd.core.errors import ConfigError
from swarmd.core.files import open_folder, whole_file
from swarmd.daemon.systemd import CONFIG_FILE, CONFIG_FOLDER, USER
from swarmd.operator.cli.options import Failure

_IDENTITIES = "identities"
RUNNING_SYSTEMD = Path("/run/systemd/system")
"""Exists while systemd runs (sd_booted)."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Changes below `root`, which are printed; `is_dry`: printed only."""

    root: Path = Path("/")
    is_dry: bool = False

    def within(self, path: Path) -> Path:
        """Where an absolute path of the machine lies."""
        return self.root / path.relative_to("/")

    def write(self, path: Path, text: str) -> None:
        """Write a file that everyone can read, whole or not at all."""
        there = self.within(path)
        if there.exists() and there.read_text() == text:
            click.echo(f"keep {there}: it is as wanted")
            return
        click.echo(f"{self._step('write')} {there}")
        if not self.is_dry:
            there.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(there) as partial:
                partial.write_text(text)
                partial.chmod(0o644)

    def remove(self, path: Path) -> None:
        """Remove a file or a folder with all that is in it; an absent one is passed over."""
        there = self.within(path)
        if not there.exists():
            return
        click.echo(f"{self._step('remove')} {there}")
        if self.is_dry:
            return
        if there.is_dir():
            shutil.rmtree(there)
        else:
            there.unlink()

    def run(self, name: str, *words: str, otherwise: str) -> bool:
        """Run a program, with `--root` for another root folder than `/`; True if it has run.

        If the program is not installed: prints the line `otherwise`, and returns False. Failure if
        the program ends with an error.
        """
        if shutil.which(name) is None:
            click.echo(f"skip {name}: it is not on this machine; {otherwise}")
            return False
        command = [name, *(() if self.root == Path("/") else ("--root", str(self.root))), *words]
        click.echo(f"{self._step('run')} {' '.join(command)}")
        if not self.is_dry:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                why = " ".join((done.stderr or done.stdout).split()) or f"code {done.returncode}"
                raise Failure(f"{' '.join(command)}: {why}", 1)
        return True

    def manages_services(self) -> bool:
        """True if the systemd that runs here is that of the root."""
        return self.root == Path("/") and RUNNING_SYSTEMD.exists()

    def _step(self, verb: str) -> str:
        return f"would {verb}" if self.is_dry else verb


def check_may_write(steps: Steps) -> None:
    """ConfigError unless this process may change the root."""
    if not steps.root.is_dir():
        raise ConfigError(f"--root {steps.root}: no such folder; mount the card, or make it first")
    if not steps.is_dry and not os.access(steps.within(Path("/etc")), os.W_OK):
        if os.access(steps.root, os.W_OK) and not steps.within(Path("/etc")).exists():
            return
        raise ConfigError(f"{steps.within(Path('/etc'))} cannot be written; run this with sudo")


def keep_for_root(root: Path = Path("/")) -> None:
    """Make root the owner of the folder around the identities; nothing if this process is not root.

    The account of the service owns the folder of each identity, since the daemon writes renewed
    certificates into this folder. The account must not own the folder above the identities: it
    could put links into that folder, through which commands of root would change other files.
    ConfigError if another user than root owns /etc/swarmd, or if one of the folders is a link.
    """
    if os.geteuid() != 0:
        return
    account = _account(root)
    folder = root / CONFIG_FOLDER.relative_to("/")
    try:
        with open_folder(folder) as outer:
            if os.fstat(outer).st_uid != 0:
                raise ConfigError(f"{folder} is not owned by root; run: chown root {folder}")
            with open_folder(_IDENTITIES, outer) as handle:
                os.fchown(handle, 0, 0 if account is None else account[1])
                os.fchmod(handle, 0o700 if account is None else 0o750)
    except FileNotFoundError:
        return
    except NotADirectoryError as error:  # the path is a file or a link
        where = folder / _IDENTITIES
        raise ConfigError(f"{folder} or {where} is a link; make it a folder of root") from error


def give_to_service(root: Path = Path("/")) -> bool:
    """Let the service's account read the daemon's file, and own the identities of the machine.

    `root`: the root folder of the file system. Returns False, and changes nothing, without such an
    account, without the folder /etc/swarmd, or if this process is not root. An identity whose
    folder another user can write stays as it is, since that user may have put links to other files
    into the folder. ConfigError if another user than root owns /etc/swarmd, or if one of the
    folders is a link.
    """
    account = _account(root)
    folder = root / CONFIG_FOLDER.relative_to("/")
    if account is None or not folder.exists() or os.geteuid() != 0:
        return False
    keep_for_root(root)
    with open_folder(folder) as outer:
        with suppress(OSError):  # absent, or a link, which root has made
            file = os.open(CONFIG_FILE.name, os.O_RDONLY | os.O_NOFOLLOW, dir_fd=outer)
            try:
                os.fchown(file, 0, account[1])
                os.fchmod(file, 0o640)
            finally:
                os.close(file)
        with suppress(FileNotFoundError), open_folder(_IDENTITIES, outer) as identities:
            for name in os.listdir(identities):
                with suppress(NotADirectoryError), open_folder(name, identities) as identity:
                    _give(identity, account)
    return True


def _give(folder: int, account: tuple[int, int]) -> None:
    """Give an identity of root to an account, the folder last: until then only root changes it."""
    about = os.fstat(folder)
    if about.st_uid != 0 or about.st_mode & 0o022:
        return
    for name in os.listdir(folder):
        os.chown(name, *account, dir_fd=folder, follow_symlinks=False)
    os.fchown(folder, *account)


def _account(root: Path) -> tuple[int, int] | None:
    """User and group of the service's account; None without one."""
    passwd = root / "etc/passwd"
    for line in passwd.read_text().splitlines() if passwd.exists() else ():
        name, *fields = line.split(":")
        if name == USER and len(fields) > 2:
            return int(fields[1]), int(fields[2])
    return None
