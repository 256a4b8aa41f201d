"""Shared by the tests of drivers: one roscore for the tests that do not end it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.roscore import RosCore, why_no_ros1


@pytest.fixture(scope="session")
def roscore(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosCore]:
    """A running roscore; skipped, with the reason, where there is no ROS 1."""
    lacks = why_no_ros1()
    if lacks:
        pytest.skip(lacks)
    with RosCore(tmp_path_factory.mktemp("ros")) as running:
        yield running
