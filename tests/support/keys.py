"""Keys of a swarm for tests: an authority and the identities of names, in a folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from swarmd.link.keys.authority import Authority
from swarmd.link.keys.identity import Identity, load_identity
from swarmd.link.keys.roster import KeyPermit, Role

P256_ORDER = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551


def flipped(signature: bytes) -> bytes:
    """The other signature of the same content, (r, n - s), which needs no private key."""
    s = P256_ORDER - int.from_bytes(signature[32:], "big")
    return signature[:32] + s.to_bytes(32, "big")


class SwarmKeys:
    """The authority of `swarm` in `folder`, and an identity for each name, in a folder of its own.

    20 names take about 0.1 s.
    """

    def __init__(
        self,
        folder: Path,
        swarm: str,
        robots: Iterable[str] = (),
        *,
        operators: Iterable[str] = (),
        viewers: Iterable[str] = (),
        permits: Mapping[str, KeyPermit] | None = None,
    ) -> None:
        self.folder = folder
        self.authority = Authority.create(folder / "authority", swarm)
        self.authority.change(
            add=dict.fromkeys(robots, Role.ROBOT)
            | dict.fromkeys(operators, Role.OPERATOR)
            | dict.fromkeys(viewers, Role.VIEWER),
            permits=permits,
        )
        for name in self.authority.roster.names:
            self.authority.issue(name).write(self.folder_of(name))

    def folder_of(self, name: str) -> Path:
        """The folder of an identity, for `--identity` and the setting `identity`."""
        return self.folder / name

    def __getitem__(self, name: str) -> Identity:
        """The identity of a name."""
        return load_identity(self.folder_of(name))
