"""Contexts of an operator: named sets of network options; `swarmctl` uses the chosen context.

The file `contexts.yaml`, in the folder of the user's configuration, holds the contexts::

    use: meadow
    contexts:
      meadow: {swarm: meadow, profile: field, interface: wlan0}
      class: {config: /home/anna/class/swarm.yaml}
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import msgspec
from msgspec import Struct

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.files import leads_nowhere, read_regular, write_whole
from swarmd.core.keys import check_id
from swarmd.link.keys.identity import user_folder
from swarmd.link.settings import Profile, parse_endpoint

if TYPE_CHECKING:
    from swarmd.settings.layered import Fault, Keys

ENVIRONMENT = "SWARM_CONTEXT"


class Context(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The network options of a context, as `swarmctl` takes them; None or empty: not set.

    `config` and `identity` are absolute paths.
    """

    swarm: str | None = None
    profile: Profile | None = None
    interface: str | None = None
    seeds: tuple[str, ...] = ()
    config: str | None = None
    identity: str | None = None
    insecure: bool = False


class Contexts(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The contexts of a user by name; `use`: the name of the context in use."""

    use: str | None = None
    contexts: dict[str, Context] = {}

    def get(self, name: str) -> Context:
        """The context of that name. ConfigError, with the nearest name, if it does not exist."""
        if name in self.contexts:
            return self.contexts[name]
        raise ConfigError(f"{unknown('context', name, self.contexts)}; see `swarmctl context list`")

    def with_use(self, name: str) -> Contexts:
        """A copy with the context `name` in use. ConfigError if there is no such context."""
        self.get(name)
        return Contexts(use=name, contexts=self.contexts)

    def with_context(self, name: str, context: Context) -> Contexts:
        """A copy with `context` added or replaced. ConfigError for a wrong name or value."""
        check_id(name, "context")
        for _, fault in _faults_of(context, ()):
            raise ConfigError(fault)
        return Contexts(use=self.use, contexts={**self.contexts, name: context})

    def without(self, name: str) -> Contexts:
        """A copy without the context `name`. ConfigError if there is no such context."""
        self.get(name)
        left = {known: context for known, context in self.contexts.items() if known != name}
        return Contexts(use=None if self.use == name else self.use, contexts=left)


def contexts_path(environ: Mapping[str, str] = os.environ) -> Path | None:
    """The path of this user's contexts file; None without a home."""
    folder = user_folder(environ)
    return None if folder is None else folder / "contexts.yaml"


def load_contexts(path: Path | None) -> Contexts:
    """The contexts in a file, empty without one. ConfigError names the first fault, and a remedy.

    An empty file is a fault: `save_contexts` writes none, so it is what a full disk has left.
    """
    contexts, faults = read_contexts(path)
    if faults:
        assert path is not None
        raise ConfigError(f"{faults[0]}; {remedy(path)}")
    return contexts


def read_contexts(path: Path | None) -> tuple[Contexts, tuple[str, ...]]:
    """The contexts in a file that can be read, and a line for each fault of the file."""
    if path is None or not _is_there(path):
        return Contexts(), ()
    from swarmd.settings.layered import Layered, read  # imported late: most commands need no YAML

    try:
        name, data = _content(path)
    except ConfigError as error:
        return Contexts(), (str(error),)
    contexts, faults = read(data, Contexts, _check)
    source = Layered((name, data))
    return contexts or Contexts(), tuple(str(source.error(*fault)) for fault in faults)


def remedy(path: Path) -> str:
    """What a user does about a contexts file that cannot be read."""
    import shlex  # 2 ms, only for errors

    try:
        read_regular(path)
    except PermissionError:
        return f"make it yours: sudo chown -R $USER {shlex.quote(str(path.parent))}"
    except OSError:
        pass
    return "correct it, or move it away and add the contexts again"


def _is_there(path: Path) -> bool:
    """False if there is no such file; True also if the file or its folder cannot be read.

    True also for a link that leads nowhere, such as to a drive that is not mounted.
    """
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return leads_nowhere(path.parent)
    except OSError:
        pass
    return True


def _content(path: Path) -> tuple[str, dict[str, Any]]:
    """The name of a contexts file in errors, and what it holds. ConfigError if it is not YAML."""
    from swarmd.settings.yamlfile import read, shown  # as in `read_contexts`

    name = shown(path)
    data = read(path)
    if not data and path.stat().st_size == 0:
        raise ConfigError(f"{name}: is empty, such as after a full disk; expected contexts")
    return name, data


def save_contexts(path: Path | None, contexts: Contexts) -> None:
    """Write the contexts to disk, whole or not at all. ConfigError without a home."""
    from swarmd.settings.yamlfile import text_of  # as in `read_contexts`

    if path is None:
        raise ConfigError("contexts are kept in $HOME/.config/swarmd; set HOME")
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    write_whole(path, text_of(msgspec.to_builtins(contexts)).encode())


def context_in_use(environ: Mapping[str, str] = os.environ) -> tuple[str, Context] | None:
    """The name and the options of the context that `$SWARM_CONTEXT` or the user has chosen.

    ConfigError if there is no such context, or the file is wrong.
    """
    path = contexts_path(environ)
    named = environ.get(ENVIRONMENT)
    if not named and (path is None or not _is_there(path)):
        return None
    contexts = load_contexts(path)
    name = named or contexts.use
    return (name, contexts.get(name)) if name else None


def readable_part(swarm: str, environ: Mapping[str, str] = os.environ) -> Context | None:
    """The valid options of the context in use of a file with faults, if the context is of `swarm`.

    For instance a newer version has written a key that this one does not know. None if it is not
    known that the context is of `swarm`, and if its identity or another path is wrong.
    """
    from swarmd.settings.layered import read  # as in `read_contexts`

    path = contexts_path(environ)
    try:
        data = {} if path is None or not _is_there(path) else _content(path)[1]
    except ConfigError:
        return None
    contexts = data.get("contexts")
    name = environ.get(ENVIRONMENT) or data.get("use")
    if not isinstance(contexts, dict) or not isinstance(name, str):
        return None
    options = contexts.get(name)
    if not isinstance(options, dict) or options.get("swarm") != swarm:
        return None
    context, faults = read(options, Context)
    is_secret_wrong = any(keys[0] in ("identity", "insecure") for keys, _ in faults)
    if is_secret_wrong or any(_faults_of(context, ())):
        return None
    return cast(Context, context)


def add_context(
    name: str, context: Context, *, use: bool = False, environ: Mapping[str, str] = os.environ
) -> Path:
    """Add or replace a context of this user; returns the file. ConfigError for a wrong value."""
    path = contexts_path(environ)
    contexts = load_contexts(path).with_context(name, context)
    save_contexts(path, contexts.with_use(name) if use else contexts)
    assert path is not None
    return path


def _check(value: Any, keys: Keys) -> Iterator[Fault]:
    if isinstance(value, Context):
        yield from _faults_of(value, keys)
    elif isinstance(value, Contexts) and value.use is not None and value.use not in value.contexts:
        yield ("use",), f"use names {unknown('context', value.use, value.contexts)}"


def _faults_of(context: Context, keys: Keys) -> Iterator[Fault]:
    try:
        if context.swarm is not None:
            check_id(context.swarm, "swarm")
        for seed in context.seeds:
            parse_endpoint(seed, "seeds has ")
    except ConfigError as error:
        yield keys, str(error)
    for name in ("config", "identity"):
        path = getattr(context, name)
        if path is not None and not os.path.isabs(path):
            yield (*keys, name), f"{name} is {path!r}; expected an absolute path"
