"""Platforms with one thing changed, for tests that are about that thing or about anything but."""

from __future__ import annotations

from dataclasses import replace

from swarmd.core.values import Platform
from swarmd.robot.protection.settings import Mode


def with_mode(platform: Platform, mode: Mode) -> Platform:
    """The platform with another protection mode, all else as its file says."""
    return replace(platform, protection={**platform.protection, "mode": mode})


def with_plain_scan(platform: Platform) -> Platform:
    """The platform with a sensor that says what it sees: +inf nothing, -inf too near, 0 lost."""
    return replace(platform, scan=replace(platform.scan, zero="no_return", near="reported"))
