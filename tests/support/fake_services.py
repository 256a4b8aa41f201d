"""The services of a daemon that are asked and never answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from swarmd.core.verbs import VERBS
from swarmd.daemon.requests import Services


class FakeService:
    """Has a method for each verb of the table; the asked calls are in `calls`, by verb."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, object]] = []

    def __getattr__(self, name: str) -> Callable[..., None]:
        verb = name.removeprefix("on_")
        if verb == name or verb not in VERBS:
            raise AttributeError(name)
        return lambda asked, *_: self.calls.append((verb, asked))


def fake_services(service: Any = None) -> Services:
    """Services that are all `service`, by default a fake."""
    service = FakeService() if service is None else service
    return Services(**dict.fromkeys(Services.__dataclass_fields__, service))
