"""The option --web of `swarmctl demo` and `swarmctl sim up`, and the page of their fleet."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING, Any

import click

from swarmd.core.errors import R
from swarmd.operator.cli.web import Served, WebOptions, check_web, web_options
from swarmd.plugins import pattern_names
from swarmd.sim.cli.options import need

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator
    from swarmd.sim.live.fleet import Fleet

ENDED = "The simulated world has ended, and its robots with it."


def page_option(function: Callable[..., R]) -> Callable[..., R]:
    """Give a verb --web and the options of a page, as the parameter `page`: None without --web."""

    @functools.wraps(function)
    def wrapper(*args: Any, web: bool, page: WebOptions, **kwargs: Any) -> R:
        if web:
            need("mujoco", "websockets", extra="sim,plot,web")
            check_web(page)
        return function(*args, page=page if web else None, **kwargs)

    text = "Serve a page with true positions, walls, states and commands."
    return click.option("--web", is_flag=True, help=text)(web_options(wrapper))


@contextmanager
def world_page(fleet: Fleet, web: WebOptions | None) -> Iterator[Served | None]:
    """Serve a web page that shows a running fleet and commands its robots; yield the page.

    `web`: options of the page; None: nothing is served, and None is yielded.
    """
    if web is None:
        yield None
        return
    from swarmd.link.settings import NetworkSettings
    from swarmd.operator.cli.plugin_check import describe_patterns
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.view.commander import LiveCommander
    from swarmd.sim.live.link import WorldView
    from swarmd.sim.view.world_source import WorldSource

    spec = fleet.spec

    # The source of the page reads the swarm with its own operator; the commander, which carries out
    # the commands of the page, makes an operator for each command.
    def make_operator() -> Operator:
        return Operator(NetworkSettings(swarm=spec.swarm))

    with ExitStack() as exit_stack:  # closes in reverse order: first the page, then its sources
        operator = exit_stack.enter_context(make_operator())
        world = exit_stack.enter_context(WorldView(spec.swarm, fleet.endpoint))
        describe = functools.partial(describe_patterns, (), spec.plugin_dir)  # (): all patterns
        names = sorted(pattern_names(spec.plugin_dir))
        source = WorldSource(operator, names, fleet, world, describe)
        exit_stack.callback(source.close)
        source.start()
        commander = LiveCommander(make_operator, source.expected)
        exit_stack.callback(commander.close)
        yield exit_stack.enter_context(closing(Served(source, commander, web, ENDED)))
