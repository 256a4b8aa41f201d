"""Finds the swarm that an operator addresses, from options, environment, context and swarm file."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self, cast

from swarmd.core.errors import ConfigError, NetworkError

if TYPE_CHECKING:
    from swarmd.link.keys.identity import Identity
    from swarmd.link.settings import NetworkSettings
    from swarmd.operator.session.operator import Operator
    from swarmd.settings.contexts import Context

DEFAULT_SWARM = "default"
KEYLESS_LOOK = 3.0
"""s to look for robots without keys, if it cannot be known whether the swarm has keys."""
_OTHER_OPTIONS = (
    "a line with other options goes first: swarmctl --swarm NAME --profile PROFILE --interface"
    " INTERFACE estop"
)
_WITHOUT_FILE = "a line with --swarm NAME does without it: swarmctl --swarm NAME estop"


@dataclass(frozen=True, slots=True)
class FoundNetwork:
    """The network of an operator, and which files were not used for it.

    `robots`: those that a swarm file names. `identity`: None without keys. `faults`: a line for
    each file that cannot be read and was not used. `doubt`: why it cannot be known whether this
    user has an identity for the swarm; empty if it is known.
    """

    settings: NetworkSettings
    robots: tuple[str, ...]
    identity: Identity | None
    faults: tuple[str, ...] = ()
    doubt: str = ""


@dataclass(frozen=True, slots=True)
class NetworkOptions:
    """The options of the network; None or empty if not given.

    `context`: the name of a context (a named set of options) in place of the context in use.
    """

    swarm: str | None = None
    config: Path | None = None
    profile: str | None = None
    interface: str | None = None
    seeds: tuple[str, ...] = ()
    identity: Path | None = None
    insecure: bool = False
    context: str | None = None

    @classmethod
    def of_environment(cls) -> Self:
        """The swarm file that $SWARM_CONFIG names, if it is set."""
        config = os.environ.get("SWARM_CONFIG")
        return cls(config=Path(config) if config else None)

    def in_context(self) -> Self:
        """These options; options that are not set come from the context in use.

        A context is a named set of options. The options are returned as they are if `config` names
        a swarm file, or if `swarm` or $SWARM names another swarm than the context. ConfigError if
        the context does not exist, or the contexts cannot be read; if `swarm` or $SWARM names the
        swarm, the readable options of the context of this swarm count then, or none.
        """
        return self._in_context()[0]

    def _in_context(self) -> tuple[Self, str, bool]:
        """As `in_context`; why the contexts cannot be read; whether the options lack the context's.

        The text is empty if they can be read.
        """
        from swarmd.settings.contexts import ENVIRONMENT, context_in_use, readable_part

        if self.config is not None:
            return self, "", False
        environ = dict(os.environ)
        if self.context is not None:  # replaces the context that the environment names
            environ[ENVIRONMENT] = self.context
        swarm = self.swarm or os.environ.get("SWARM")
        fault = ""
        try:
            name_and_context = context_in_use(environ)
        except ConfigError as error:
            if not swarm or self.context is not None:
                raise ConfigError(f"{error}; {_WITHOUT_FILE}") from error
            fault = str(error)
            part = readable_part(swarm, environ)
            name_and_context = None if part is None else ("", part)
        if name_and_context is None:
            return self, fault, bool(fault)
        _, context = name_and_context
        is_of_other_swarm = swarm and context.swarm not in (None, swarm)
        if is_of_other_swarm:
            return self, "", False
        return self._filled(context, swarm), fault, False

    def _filled(self, context: Context, swarm: str | None) -> Self:
        """These options; those that are not set come from `context`. `swarm`: that counts more."""
        import msgspec

        values = msgspec.structs.asdict(context)
        values["swarm"] = swarm or context.swarm
        for name in ("config", "identity"):
            values[name] = Path(values[name]) if values[name] else None
        if self.insecure:  # the line decides about keys
            values["identity"] = None
        if self.identity is not None:
            values["insecure"] = False
        not_set = {name: value for name, value in values.items() if not getattr(self, name)}
        return replace(self, **not_set)

    def operator(
        self, tell: Callable[[str], object] = lambda text: None, *, needs_file: bool = True
    ) -> Operator:
        """An operator in the swarm's network, a context manager.

        `tell` takes a line for the user if the operator's certificate ends soon, and for each file
        that was not used because it cannot be read. `needs_file` False: a swarm file that `config`
        names is such a file, too, if `swarm` names the swarm; a stop needs no file. ConfigError for
        a wrong file or option, NetworkError if the network cannot be used.

        If it cannot be known whether this user has an identity for the swarm, the operator has none
        if robots without keys answer; else ConfigError. So no request is unsigned in place of
        signed.
        """
        from swarmd.operator.session.operator import Operator

        found = self.found_network(needs_file=needs_file)
        if found.settings.interface is not None and self.interface is None:
            _check_interface(found.settings.interface)
        way = _way(found.settings)
        for fault in found.faults:
            if fault != found.doubt:
                tell(f"{fault}; not used, sent by {way}")
        identity = found.identity
        if identity is not None:
            from swarmd.operator.texts.keys import own_end

            if text := own_end(identity.name, identity.info.expires, time.time()):
                tell(text)
        operator = Operator(found.settings, roster=found.robots, identity=identity)
        if found.doubt:
            try:
                _check_keyless(operator, found.doubt)
            except BaseException:
                operator.close()
                raise
            tell(f"{found.doubt}; not used, sent by {way} --insecure, as robots there have no keys")
        return operator

    def network(self) -> tuple[NetworkSettings, list[str], Identity | None]:
        """The settings of the network, the robots that they name, and the identity.

        ConfigError for a wrong file or option, and if it cannot be known whether there is an
        identity.
        """
        found = self.found_network()
        if found.doubt:
            raise ConfigError(f"{found.doubt}; {_keys_remedy(found.settings.swarm)}")
        return found.settings, list(found.robots), found.identity

    def found_network(self, *, needs_file: bool = True) -> FoundNetwork:
        """The network by these options and the context in use; `needs_file` as in `operator`.

        ConfigError for a wrong file or option, and for the identity of a robot, since robots do not
        answer questions of robots.
        """
        from swarmd.link.keys.identity import check_asker

        options, fault, is_partial = self._in_context()
        doubt = fault if is_partial else ""
        faults = (fault,) if fault else ()
        if options.config is None:
            try:
                found = options._of_options(doubt)
            except ConfigError as error:
                if options.profile == self.profile and options.seeds == self.seeds:
                    raise
                raise ConfigError(f"{error} (by the context in use); {_OTHER_OPTIONS}") from error
        else:
            # A file that the environment or the context names is like a context; one of the line
            # was meant. $SWARM counts less than the swarm that a file of the line names.
            is_of_line = self.config not in (None, self.of_environment().config)
            swarm = self.swarm or (os.environ.get("SWARM") if self.config is None else None)
            try:
                found = options._of_file(options.config)
            except _FileFault as error:
                if not swarm or (needs_file and is_of_line):
                    raise ConfigError(f"{error}; {_WITHOUT_FILE}") from error
                faults = (*faults, str(error))
                found = replace(options, config=None)._of_options(str(error))
        check_asker(found.identity)
        return replace(found, faults=faults)

    def _of_file(self, config: Path) -> FoundNetwork:
        """The network by a swarm file, whose values these options replace.

        _FileFault for a wrong file, ConfigError for a wrong identity.
        """
        # YAML, which most commands do without.
        from swarmd.settings.swarmfile import DaemonFile, check, layered, path_of

        overrides = {  # None: the value of the file
            "swarm": self.swarm,
            "profile": self.profile,
            "interface": self.interface,
            "seeds": list(self.seeds) or None,
            "identity": None if self.identity is None else str(self.identity),
            "insecure": self.insecure or None,
        }
        try:
            layers = layered(config, overrides, os.environ)
            file = layers.build(DaemonFile, check)
        except (ConfigError, OSError, ValueError) as error:  # ValueError: NUL in a path
            raise _FileFault(str(error)) from error
        # The line decides about keys.
        folder = None if self.insecure else path_of(layers, "identity", file.identity, config)
        is_insecure = self.insecure or (file.insecure and self.identity is None)
        if self.insecure and self.identity is not None:
            folder = self.identity
        identity, doubt = _chosen_identity(file.swarm, folder, "", insecure=is_insecure)
        return FoundNetwork(file, tuple(file.robots), identity, doubt=doubt)

    def _of_options(self, doubt: str) -> FoundNetwork:
        """The network by these options and $SWARM.

        `doubt`: why the options may lack an identity.
        """
        from swarmd.link.settings import NetworkSettings, Profile

        settings = NetworkSettings(
            swarm=self.swarm or os.environ.get("SWARM") or DEFAULT_SWARM,
            profile=cast(Profile, self.profile or "dev"),
            interface=self.interface,
            seeds=self.seeds,
        )
        settings.check()
        identity, doubt = _chosen_identity(
            settings.swarm, self.identity, doubt, insecure=self.insecure
        )
        return FoundNetwork(settings, (), identity, doubt=doubt)


def _check_interface(interface: str) -> None:
    """NetworkError, with the command that works, if the interface of a file is absent here."""
    from swarmd.link.carriers.interface_watch import index_of

    try:
        index_of(interface)
    except NetworkError as error:
        raise NetworkError(
            f"{error} (by the context or swarm file in use); {_OTHER_OPTIONS}"
        ) from error


class _FileFault(ConfigError):
    """A swarm file that cannot be read."""


def _chosen_identity(
    swarm: str, folder: Path | None, doubt: str, *, insecure: bool
) -> tuple[Identity | None, str]:
    """The identity in `folder`, else the installed one; and why one may be lacking, else "".

    `doubt`: why another folder may have been meant than the installed one. ConfigError, with the
    command that works, for an identity that cannot be read.
    """
    from swarmd.link.keys.identity import choose_identity, installed_identity

    if folder is None and not insecure:
        installed = installed_identity(swarm)
        if installed.folder is None and (doubt or installed.hidden):
            return None, doubt or f"{installed.hidden}"
    try:
        return choose_identity(swarm, folder, insecure=insecure), ""
    except (ConfigError, OSError) as error:
        raise ConfigError(f"{error}; {_keys_remedy(swarm)}") from error


def _keys_remedy(swarm: str) -> str:
    """What an operator does whose identity for a swarm cannot be read."""
    return (
        f"nothing is sent without keys; `swarmctl --swarm {swarm} --identity FOLDER estop` takes"
        " another copy of your keys, and --insecure in its place stops a swarm without keys"
    )


def _check_keyless(operator: Operator, doubt: str) -> None:
    """ConfigError unless robots without keys answer to an operator without keys."""
    if not operator.members(timeout=KEYLESS_LOOK, needs_status=False).members:
        swarm = operator.settings.swarm
        text = f"{doubt}; no robot of a swarm {swarm} without keys answers"
        raise ConfigError(f"{text} by {_way(operator.settings)}; {_keys_remedy(swarm)}")


def _way(settings: NetworkSettings) -> str:
    """The network that an operator uses, as options of a line."""
    by = f" --interface {settings.interface}" if settings.interface else ""
    return f"--swarm {settings.swarm} --profile {settings.profile}{by}"
