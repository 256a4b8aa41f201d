"""The settings in a bundle, and the files into which an installation writes these settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swarmd.core.errors import ConfigError
from swarmd.link.keys.identity import write_private
from swarmd.settings.layered import Layered
from swarmd.settings.swarmfile import DaemonFile, SwarmFile, check
from swarmd.settings.yamlfile import Data, read, shown, text_of

SWARM_YAML = "swarm.yaml"
"""The settings of a swarm, beside the identity of an operator and in the authority's folder."""
# Keys that belong to a machine and not to its swarm: an installation keeps their present values.
OWN_KEYS = (
    "interface",
    "listen",
    *(key for key in DaemonFile.__struct_fields__ if key not in SwarmFile.__struct_fields__),
)
_OF_ONE_MACHINE = frozenset({"roster", "identity", "insecure"})
_REPLACED = ("id", "swarm_file", "identity", "insecure")


@dataclass(frozen=True, slots=True)
class DraftedFile:
    """The content of a file to write.

    `before`: the content of the present file. `kept`: keys of the machine that stay. `dropped`:
    keys of the present file that are removed.
    """

    path: Path
    data: Data
    before: Data
    kept: tuple[str, ...]
    dropped: tuple[str, ...]

    @property
    def is_present(self) -> bool:
        """Whether the present file has this content already."""
        return self.path.exists() and self.data == self.before

    def write(self) -> None:
        """Write the file, whole or not at all; an earlier file becomes `<name>.before`."""
        if self.path.exists():
            before = self.path.with_name(f"{self.path.name}.before")
            write_private(before, self.path.read_bytes())
        write_yaml(self.path, self.data, f"Written by `swarmd install` for {self.data['id']}.")


def swarm_settings(
    swarm: str, config: Path | None, overrides: Mapping[str, object]
) -> dict[str, Any]:
    """The keys of a swarm.yaml, checked, for the bundles of a swarm.

    `config`: the file; None: no file. `overrides`: values that replace values of the file. The key
    `roster` is left out, since the signed roster of an identity has the names. `identity` and
    `insecure` are left out, since they hold for a single machine. ConfigError names the source of a
    wrong key.
    """
    given = {key: value for key, value in overrides.items() if value}
    sources: list[tuple[str, Mapping[str, Any]]] = [("command line", {"swarm": swarm, **given})]
    if config is not None:
        sources.append((shown(config), read(config)))
    layers = Layered(*sources)
    layers.build(SwarmFile)
    layers.build(DaemonFile, check)
    left_out = {"swarm", *_OF_ONE_MACHINE}
    return {"swarm": swarm, **{k: v for k, v in layers.data.items() if k not in left_out}}


def checked_settings(name: str, swarm: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The checked settings of the bundle in the file `name`. ConfigError if a key is wrong.

    Keys that `swarm_settings` leaves out are refused: only a manipulated bundle has such keys.
    """
    if refused := sorted(_OF_ONE_MACHINE & settings.keys()):
        raise ConfigError(f"{name}: a bundle does not set {', '.join(refused)}; make a new one")
    layers = Layered((name, {**settings, "swarm": swarm}))
    layers.build(SwarmFile)
    layers.build(DaemonFile, check)
    return layers.data


def draft_daemon_file(
    path: Path, robot: str, settings: Mapping[str, Any], overrides: Mapping[str, object]
) -> DraftedFile:
    """The content of the daemon's file for a robot.

    It has the settings of the swarm, then the keys of the present file that belong to the machine
    (OWN_KEYS, such as platform), then `overrides`. ConfigError if the present file or the result is
    wrong.
    """
    old = read(path) if path.exists() else {}
    kept = {key: old[key] for key in OWN_KEYS if key in old and key not in _REPLACED}
    given = {key: value for key, value in overrides.items() if value}
    data: Data = {"id": robot, **settings, **kept, **given}
    Layered((shown(path), data)).build(DaemonFile, check)
    return DraftedFile(
        path,
        data,
        old,
        tuple(key for key in kept if key not in given),
        tuple(key for key in old if key not in data),
    )


def write_yaml(path: Path, data: Mapping[str, Any], comment: str) -> None:
    """Write settings as YAML, readable only by the owner, whole or not at all."""
    write_private(path, f"# {comment}\n{text_of(dict(data))}".encode())
