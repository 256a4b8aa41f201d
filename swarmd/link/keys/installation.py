"""Installs the identity of a bundle into its folder, whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from swarmd.core.errors import ConfigError
from swarmd.core.files import remove_whole, sync_folder
from swarmd.link.keys.bundle import OpenedBundle
from swarmd.link.keys.certificate_check import check_certificate
from swarmd.link.keys.identity import INFO, Identity, load_identity


def check_replaces(opened: OpenedBundle, old: Identity | None, *, is_forced: bool) -> None:
    """ConfigError if a bundle must not replace an identity of the same swarm.

    `is_forced` permits another name and another authority, never an older roster.
    """
    if old is None:
        return
    new = opened.bundle.info
    if new.authority != old.info.authority:
        if not is_forced:
            raise ConfigError(
                f"the bundle is of another authority of swarm {new.swarm} than {old.folder};"
                " --force replaces it, and this machine then leaves the swarm of the old one"
            )
        return
    if new.name != old.name and not is_forced:
        raise ConfigError(
            f"the bundle is of {new.name}, and this machine is {old.name}; --force replaces it"
        )
    if opened.roster.generation < old.roster.generation:
        raise ConfigError(
            f"the bundle has generation {opened.roster.generation} of the roster, and this machine"
            f" {old.roster.generation}; make a new bundle with `swarmctl keys bundle {new.name}`"
        )


def installed(folder: Path) -> Identity | None:
    """The identity in a folder; None without an identity, or if it cannot be read."""
    if not (folder / INFO).exists():
        return None
    try:
        return load_identity(folder)
    except ConfigError:
        return None  # a bundle repairs it


def is_same(opened: OpenedBundle, old: Identity) -> bool:
    """Whether an installed identity has the certificate, authority and roster of a bundle."""
    bundle = opened.bundle
    return (
        old.certificate.read_bytes() == bundle.certificate
        and old.authority.read_bytes() == bundle.authority
        and old.signed_roster == bundle.roster.roster
    )


@contextmanager
def replaced_identity(folder: Path, opened: OpenedBundle) -> Iterator[Identity]:
    """A context manager that replaces the identity in `folder` by the identity of a bundle.

    The block gets the new identity; an error in the block restores the old identity. The new
    identity is written beside `folder` and checked before the old identity is moved. If `folder` is
    a symbolic link, the new folder replaces the link, and the target of the link stays. ConfigError
    if certificate and key do not match, OSError if a file cannot be written.
    """
    draft = folder.with_name(f".{folder.name}.partial")
    backup = folder.with_name(f".{folder.name}.before")
    is_backup_made = False  # True: the old identity, if any, is in `backup`
    try:
        # 1. Restore the identity of an installation that was interrupted; remove other remains.
        folder.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        if backup.exists() and not folder.exists():
            backup.rename(folder)
        for leftover in (draft, backup):
            remove_whole(leftover)

        # 2. Write and check the new identity.
        draft.mkdir(mode=0o700)
        opened.bundle.write(draft)
        checked = load_identity(draft)
        facts = check_certificate(checked.certificate, checked.key, checked.authority)
        if (facts.name, facts.expires) != (checked.name, checked.info.expires):
            raise ConfigError(f"the certificate of the bundle is of {facts.name}; make a new one")

        # 3. Put the new identity in place of the old identity.
        if os.path.lexists(folder):
            folder.rename(backup)
        is_backup_made = True
        draft.rename(folder)
        sync_folder(folder.parent)
        yield load_identity(folder)
    except BaseException:  # also a KeyboardInterrupt restores the old identity
        remove_whole(draft)
        if is_backup_made:
            remove_whole(folder)
            with suppress(FileNotFoundError):  # there was no old identity
                backup.rename(folder)
        raise
    remove_whole(backup)
