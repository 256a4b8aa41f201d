"""Finds the swarm that an operator addresses, from options, environment, context and swarm file."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self, cast

if TYPE_CHECKING:
    from swarmd.network.operator.operator import Operator
    from swarmd.network.settings import NetworkSettings
    from swarmd.security.identity import Identity

DEFAULT_SWARM = "default"


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

        A context is a named set of options. A context sets no option that the command line or
        $SWARM sets. No context is used if the options or $SWARM_CONFIG name a swarm file, or if
        the options or $SWARM name another swarm than the context. ConfigError if the context does
        not exist.
        """
        import msgspec

        from swarmd.settings.contexts import ENVIRONMENT, context_in_use

        # 1. Find the context: the option --context replaces the variable of the environment.
        if self.config is not None:
            return self
        environ = dict(os.environ)
        if self.context is not None:
            environ[ENVIRONMENT] = self.context
        name_and_context = context_in_use(environ)
        if name_and_context is None:
            return self
        _, context = name_and_context
        swarm = self.swarm or os.environ.get("SWARM")
        if swarm and context.swarm not in (None, swarm):
            return self

        # 2. Take its values for the options that are not set.
        values = msgspec.structs.asdict(context)
        values["swarm"] = swarm or context.swarm
        for name in ("config", "identity"):
            values[name] = Path(values[name]) if values[name] else None
        missing = {name: value for name, value in values.items() if not getattr(self, name)}
        return replace(self, **missing)

    def operator(self, tell: Callable[[str], object] = lambda text: None) -> Operator:
        """An operator in the swarm's network, a context manager.

        `tell` takes a line for the user if the operator's certificate ends soon. ConfigError for a
        wrong file or option, NetworkError if the network cannot be used.
        """
        from swarmd.network.operator.operator import Operator

        settings, roster, identity = self.network()
        if identity is not None:
            from swarmd.texts.keys import own_end

            if text := own_end(identity.name, identity.info.expires, time.time()):
                tell(text)
        return Operator(settings, roster=roster, identity=identity)

    def network(self) -> tuple[NetworkSettings, list[str], Identity | None]:
        """The settings of the network, the robots that they name, and the identity.

        ConfigError for a wrong file or option.
        """
        return self.in_context()._network()

    def _network(self) -> tuple[NetworkSettings, list[str], Identity | None]:
        """The settings of the network, the robots that a swarm file names, and the identity.

        Only these options and $SWARM count, not the context in use. ConfigError also for the
        identity of a robot (`check_asker`), since robots do not answer questions of robots.
        """
        from swarmd.network.settings import NetworkSettings, Profile
        from swarmd.security.identity import check_asker, choose_identity

        if self.config is not None:
            from swarmd.settings.swarmfile import load_swarm  # YAML, which most commands do without

            # Options replace values of the file; None: not given.
            overrides = {
                "swarm": self.swarm,
                "profile": self.profile,
                "interface": self.interface,
                "seeds": list(self.seeds) or None,
                "identity": None if self.identity is None else str(self.identity),
                "insecure": self.insecure or None,
            }
            # Of the environment: $SWARM, and the user's folder with the installed identities.
            file, identity = load_swarm(self.config, overrides, os.environ)
            check_asker(identity)
            return file, list(file.robots), identity
        settings = NetworkSettings(
            swarm=self.swarm or os.environ.get("SWARM") or DEFAULT_SWARM,
            profile=cast(Profile, self.profile or "dev"),
            interface=self.interface,
            seeds=self.seeds,
        )
        settings.check()
        identity = choose_identity(settings.swarm, self.identity, insecure=self.insecure)
        check_asker(identity)
        return settings, [], identity
