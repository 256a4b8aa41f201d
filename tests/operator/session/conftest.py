"""The swarms on loopback that tests of `link/` have, too."""

from __future__ import annotations

from tests.link.conftest import robots, settings, until

__all__ = ["robots", "settings", "until"]
