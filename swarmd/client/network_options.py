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
    from swarmd.settings.swarmfile import SwarmFile

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

        A context is a named set of options. The options are returned as they are if `config` names
        a swarm file, or if `swarm` or $SWARM names another swarm than the context. ConfigError if
        the context does not exist.
        """
        import msgspec

        from swarmd.settings.contexts import ENVIRONMENT, context_in_use

        if self.config is not None:
            return self
        environ = dict(os.environ)
        if self.context is not None:  # replaces the context that the environment names
            environ[ENVIRONMENT] = self.context
        name_and_context = context_in_use(environ)
        if name_and_context is None:
            return self
        _, context = name_and_context
        swarm = self.swarm or os.environ.get("SWARM")
        is_of_other_swarm = swarm and context.swarm not in (None, swarm)
        if is_of_other_swarm:
            return self
        values = msgspec.structs.asdict(context)
        values["swarm"] = swarm or context.swarm
        for name in ("config", "identity"):
            values[name] = Path(values[name]) if values[name] else None
        not_set = {name: value for name, value in values.items() if not getattr(self, name)}
        return replace(self, **not_set)

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

        The context in use does not count here: `in_context` has added its options. ConfigError for
        a wrong file or option, and for the identity of a robot, since robots do not answer
        questions of robots.
        """
        from swarmd.security.identity import check_asker

        if self.config is None:
            settings, identity = self._of_options()
            robots: list[str] = []
        else:
            settings, identity = self._of_file(self.config)
            robots = list(settings.robots)
        check_asker(identity)
        return settings, robots, identity

    def _of_file(self, config: Path) -> tuple[SwarmFile, Identity | None]:
        """The content of a swarm file, whose values these options replace, and the identity."""
        from swarmd.settings.swarmfile import load_swarm  # YAML, which most commands do without

        overrides = {  # None: the value of the file
            "swarm": self.swarm,
            "profile": self.profile,
            "interface": self.interface,
            "seeds": list(self.seeds) or None,
            "identity": None if self.identity is None else str(self.identity),
            "insecure": self.insecure or None,
        }
        # `load_swarm` reads $SWARM, and the user's folder with the installed identities.
        return load_swarm(config, overrides, os.environ)

    def _of_options(self) -> tuple[NetworkSettings, Identity | None]:
        """The settings of the network by these options and $SWARM, and the identity."""
        from swarmd.network.settings import NetworkSettings, Profile
        from swarmd.security.identity import choose_identity

        settings = NetworkSettings(
            swarm=self.swarm or os.environ.get("SWARM") or DEFAULT_SWARM,
            profile=cast(Profile, self.profile or "dev"),
            interface=self.interface,
            seeds=self.seeds,
        )
        settings.check()
        identity = choose_identity(settings.swarm, self.identity, insecure=self.insecure)
        return settings, identity
