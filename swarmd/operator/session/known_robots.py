"""A cache of robots' names and labels for the completion of command lines."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from swarmd.core.files import cache_folder
from swarmd.core.keys import is_id

if TYPE_CHECKING:
    from swarmd.link.settings import NetworkSettings
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator

MAX_NAMES = 1024  # the most names of robots, and the most labels
MAX_SWARMS = 32
"""Swarms whose names are kept: those of the latest looks."""
MAX_AGE = 60.0
"""s after which the names are looked up anew."""
EMPTY_AGE = 5.0
"""s after which the names are looked up anew if no robot was found."""
LOOK_TIME = 0.25
"""How long such a look takes at most, in s: the shell waits for it."""


def remember(settings: NetworkSettings, view: MembersView) -> None:
    """Write the names and labels of a look to the user's cache; a failure is ignored."""
    names = view.members.keys() | view.roster
    if names:
        _write(settings, names, _labels(view))


def _labels(view: MembersView) -> list[str] | None:
    """The labels of all robots; None if the look has no status."""
    statuses = [status.status for status in view.members.values() if status.status is not None]
    return [label for status in statuses for label in status.labels] if statuses else None


def _write(
    settings: NetworkSettings, names: Iterable[str], labels: Iterable[str] | None = None
) -> None:
    """Write names and labels; None for `labels` keeps the labels in the file."""
    with contextlib.suppress(OSError, RuntimeError):
        path = _path(settings)
        path.parent.mkdir(parents=True, exist_ok=True)
        kept = known_labels(settings) if labels is None else labels
        content = {
            "names": sorted(filter(is_id, names))[:MAX_NAMES],
            "labels": sorted({*filter(is_id, kept)})[:MAX_NAMES],
        }
        draft = path.with_name(f".{path.name}.{os.getpid()}")  # tempfile takes 10 ms to import
        try:
            draft.write_text(json.dumps(content))
            draft.replace(path)
        except OSError:
            draft.unlink(missing_ok=True)
        files = sorted(path.parent.glob("members-*.json"), key=lambda one: one.stat().st_mtime)
        for old in files[:-MAX_SWARMS]:
            old.unlink(missing_ok=True)


def remembered(settings: NetworkSettings) -> tuple[list[str], float]:
    """The cached names, and their age in s; an infinite age without a cache."""
    try:
        age = max(time.time() - _path(settings).stat().st_mtime, 0.0)
    except (OSError, RuntimeError):
        return [], float("inf")
    return _read(settings, "names"), age


def known_labels(settings: NetworkSettings) -> list[str]:
    """The cached labels."""
    return _read(settings, "labels")


def _read(settings: NetworkSettings, key: str) -> list[str]:
    try:
        found = json.loads(_path(settings).read_bytes()[: 256 * MAX_NAMES])[key]
        return [name for name in found if isinstance(name, str) and is_id(name)]
    except (OSError, RuntimeError, ValueError, TypeError, LookupError):
        return []


def known_names(operator: Operator) -> list[str]:
    """The cached names; if they are old, a short look renews them."""
    settings = operator.settings
    names, age = remembered(settings)
    if age <= (MAX_AGE if names else EMPTY_AGE) or settings.profile == "routed":
        return names
    view = operator.members(timeout=LOOK_TIME, needs_status=False)
    names = sorted(view.members.keys() | view.roster) or names
    _write(settings, names, _labels(view))
    return names


def _path(settings: NetworkSettings) -> Path:
    return cache_folder() / f"members-{settings.profile}-{settings.swarm}.json"
