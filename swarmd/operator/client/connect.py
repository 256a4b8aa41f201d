"""A connection to a swarm from Python, for `with` and for `async with`.

::

    import swarmd

    with swarmd.connect("meadow") as swarm:
        print(swarm.members())
        swarm.run("attraction", seconds=60)

    async with swarmd.connect("meadow") as swarm:
        await swarm.run("attraction", seconds=60)
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, get_args

from swarmd.core.errors import ConfigError, unknown
from swarmd.link.settings import Profile
from swarmd.operator.client.loop_life import LoopLife
from swarmd.operator.client.network_options import NetworkOptions
from swarmd.operator.client.operator_pool import OperatorPool
from swarmd.operator.client.swarm import Places, Swarm, Tell
from swarmd.operator.session.targets import check_time, check_words

if TYPE_CHECKING:
    from swarmd.operator.client.async_swarm import AsyncSwarm
    from swarmd.operator.session.operator import Operator


class Connection:
    """The result of `connect`, for a `with` block, an `async with` block, or `open`."""

    def __init__(
        self,
        make: Callable[[Tell], Operator],
        *,
        timeout: float | None = None,
        tell: Tell | None = None,
        places: Places | None = None,
    ) -> None:
        self._make = make
        self._timeout = timeout
        self._places = places
        self._tell = logging.getLogger("swarmd.client").warning if tell is None else tell
        self._opened: Swarm | AsyncSwarm | None = None

    def open(self) -> Swarm:
        """The swarm, for notebooks whose cells share it; end it with `close`.

        ConfigError for a wrong option or file, NetworkError if the network cannot be used.
        """
        return self._open(LoopLife.of_caller())

    def _open(self, life: LoopLife | None) -> Swarm:
        """As `open`, of a caller on the loop of `life`; None: outside of a loop."""
        make = self._make
        tell = self._tell
        pool = OperatorPool(lambda: make(tell), life)
        try:
            with pool.lend():  # errors of options come now
                pass
        except BaseException:
            pool.close()
            raise
        return Swarm(pool, timeout=self._timeout, tell=tell, places=self._places)

    def __enter__(self) -> Swarm:
        self._check_free()
        self._opened = swarm = self.open()
        return swarm

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert isinstance(self._opened, Swarm)
        opened = self._opened
        self._opened = None
        opened.close()

    async def __aenter__(self) -> AsyncSwarm:
        import asyncio

        from swarmd.operator.client.async_swarm import AsyncSwarm
        from swarmd.operator.client.hand_over import begin

        self._check_free()
        opening = begin(partial(self._open, LoopLife.of_caller()))
        try:
            opened = await asyncio.wrap_future(opening)
            self._check_free()  # another task may have been faster
        except (asyncio.CancelledError, ConfigError):
            opening.add_done_callback(_close_opened)
            raise
        self._opened = swarm = AsyncSwarm(opened)
        return swarm

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._opened is not None
        assert not isinstance(self._opened, Swarm)
        opened = self._opened
        self._opened = None
        await opened.close()

    def _check_free(self) -> None:
        if self._opened is not None:
            raise ConfigError("this connection is in a block already; `connect` gives another one")


def _close_opened(opening: Future[Swarm]) -> None:
    """Close a connection that was opened for a cancelled caller."""
    if opening.exception() is None:
        opening.result().close()


def connect(
    swarm: str | None = None,
    *,
    config: str | Path | None = None,
    context: str | None = None,
    profile: str | None = None,
    interface: str | None = None,
    seeds: Iterable[str] = (),
    identity: str | Path | None = None,
    insecure: bool = False,
    timeout: float | None = None,
    tell: Tell | None = None,
) -> Connection:
    """A connection to a swarm: `with connect(...)` gives a `Swarm`, `async with` an `AsyncSwarm`.

    The arguments are the options of swarmctl. As in swarmctl, options that are not given come from
    `$SWARM`, `$SWARM_CONFIG` or the context in use (a named set of options, see `swarmctl
    context`). Without any of these, the swarm is `default`, of robots on this machine.

    `context`: a context in place of the context in use. `config`: a swarm file. `profile`: dev
    (robots on this machine), field (robots on the network interface `interface`) or routed (through
    Zenoh routers). `seeds`: endpoints of robots that multicast does not reach. `identity`: the
    folder of your certificate and keys; by default the folder of this user or machine for the
    swarm. `insecure`: use no identity. `timeout`: s, for each method that is called without a
    timeout. `tell` takes lines for the user, such as robots that did not answer; by default these
    lines are warnings of the logger `swarmd.client`.

    Raises ConfigError for an option of a wrong type. Nothing is opened before the block begins: its
    begin raises ConfigError for wrong options, and NetworkError if the network cannot be opened.
    """
    if profile is not None and profile not in get_args(Profile):
        raise ConfigError(unknown("profile", profile, get_args(Profile)))
    timeout = check_time("timeout", timeout)
    _check_types(
        texts={"swarm": swarm, "context": context, "interface": interface},
        paths={"config": config, "identity": identity},
    )
    if not isinstance(insecure, bool):  # a text such as "no" would count as True
        raise ConfigError(f"insecure is {insecure!r}; expected True or False")
    if config is None and context is None:  # `context` counts more than the environment
        config = NetworkOptions.of_environment().config  # the file that $SWARM_CONFIG names
    options = NetworkOptions(
        swarm=swarm,
        config=None if config is None else Path(config),
        context=context,
        profile=profile,
        interface=interface,
        seeds=check_words(seeds, "seeds"),
        identity=None if identity is None else Path(identity),
        insecure=insecure,
    )
    return Connection(options.operator, timeout=timeout, tell=tell)


def _check_types(*, texts: Mapping[str, object], paths: Mapping[str, object]) -> None:
    """ConfigError for an argument of a wrong type, which callers without a type checker may give.

    `texts`, `paths`: the arguments by name; None: not given.
    """
    for name, value in texts.items():
        if value is not None and not isinstance(value, str):
            raise ConfigError(f"{name} is {value!r}; expected a text")
    for name, value in paths.items():
        if value is not None and not isinstance(value, str | Path):
            raise ConfigError(f"{name} is {value!r}; expected a path")
