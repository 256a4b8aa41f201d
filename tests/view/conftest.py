from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.chromium import FOUND, Browser, Page, chromium
from tests.swarm.conftest import swarm

__all__ = ["swarm"]


@pytest.fixture(scope="session")
def a_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """One browser for all tests: its start takes longer than most of them."""
    if FOUND is None:
        pytest.skip("no Chromium here")
    with chromium(tmp_path_factory.mktemp("chromium")) as one:
        yield one


@pytest.fixture
def page(a_browser: Browser) -> Iterator[Page]:
    """A page without a past."""
    with a_browser.page() as one:
        yield one
