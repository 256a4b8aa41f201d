"""Plugin of pytest: the first row of parameters of each test, for a second pass over the same code.

`-p tests.support.first_rows`. The first row should be the row that reaches a branch which no other
test reaches.
"""

from __future__ import annotations

import pytest


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect the rows after the first row of each test."""
    first: dict[str, pytest.Item] = {}
    for item in items:
        first.setdefault(item.nodeid.partition("[")[0], item)
    kept = {*map(id, first.values())}
    config.hook.pytest_deselected(items=[item for item in items if id(item) not in kept])
    items[:] = first.values()
