"""Tests that are written as a story: what happens to a driver and its base, one step a line."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import Any

import pytest

from swarmd.core.values import Value
from swarmd.testing.driver_contract import DriverHarness, play

Tell = Callable[..., Awaitable[None]]
Test = Callable[..., None]


def as_test(
    tell: Tell,
    run: Callable[[Tell, Mapping[str, Any]], None],
    own: Iterable[str],
    fixtures: Iterable[str] = (),
) -> Test:
    """A test that calls `run` with the story and its fixtures.

    pytest gives the fixtures named here and those that the story takes; `own` are the arguments
    that `run` gives.
    """
    taken = list(inspect.signature(tell).parameters)
    asked = dict.fromkeys([*fixtures, *(name for name in taken if name not in own)])

    def test(**given: Any) -> None:
        async def told(**made: Any) -> None:
            known = {**given, **made}
            await tell(**{name: known[name] for name in taken})

        run(told, given)

    for name in ("__name__", "__qualname__", "__doc__", "__module__"):
        setattr(test, name, getattr(tell, name))
    parameters = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY) for name in asked]
    wrapper: Any = test
    wrapper.__wrapped__, wrapper.__signature__ = tell, inspect.Signature(parameters)
    wrapper.pytestmark = list(getattr(tell, "pytestmark", ()))
    return test


def story(
    *makers: Callable[..., Any], connected: bool = True, **options: Value
) -> Callable[[Tell], Test]:
    """A test of a story with a driver, once for the base of each maker.

    A maker takes fixtures by name. The story takes `harness`, `robot` (the base) and fixtures.
    """

    def of(tell: Tell) -> Test:
        def run(told: Tell, given: Mapping[str, Any]) -> None:
            make = given.get("make", makers[0])
            robot = make(**{name: given[name] for name in _fixtures_of(make)})

            async def with_robot(harness: DriverHarness) -> None:
                await told(harness=harness, robot=robot)

            play(robot, with_robot, connected=connected, **options)

        fixtures = [name for make in makers for name in _fixtures_of(make)]
        if len(makers) == 1:
            return as_test(tell, run, ("harness", "robot"), fixtures)
        test = as_test(tell, run, ("harness", "robot"), ("make", *fixtures))
        return pytest.mark.parametrize("make", makers)(test)

    return of


def _fixtures_of(make: Callable[..., Any]) -> list[str]:
    """The arguments that a maker needs."""
    kinds = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    given = inspect.signature(make).parameters.values()
    return [one.name for one in given if one.default is one.empty and one.kind in kinds]
