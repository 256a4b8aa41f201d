"""Makes the driver that a daemon's settings name, with a watchdog where needed."""

from __future__ import annotations

from swarmd.core.errors import ConfigError
from swarmd.driver_api.driver import Driver, ZeroSenderProvider
from swarmd.driver_api.watchdog import watchdog_name
from swarmd.plugins import load_driver
from swarmd.settings.driver_options import BaseOptions, base_options, effective_command_timeout
from swarmd.settings.settings import DaemonSettings


def make_bare_driver(settings: DaemonSettings) -> Driver:
    """The driver that the settings name, not yet connected, without a watchdog.

    Raises SwarmError if the driver or its options are wrong.
    """
    common = BaseOptions.__struct_fields__
    driver: Driver = load_driver(settings.driver)(
        swarm=settings.network.swarm,
        robot=settings.id,
        platform=settings.platform,
        options={k: v for k, v in settings.driver_options.items() if k not in common},
    )
    return driver


def make_driver(settings: DaemonSettings) -> Driver:
    """The daemon's driver, not yet connected, watched as its options say.

    Raises SwarmError if the driver or its options are wrong.
    """
    name = settings.driver
    base = base_options(settings.driver_options, f"driver {name}")
    driver = make_bare_driver(settings)
    if effective_command_timeout(base, driver) != "none":
        return driver
    if base.idle_output == "silent":
        raise ConfigError(
            f"driver {name}: idle_output is silent, but command_timeout counts as none where it"
            " is not given; add command_timeout: base, or its seconds"
        )
    if not isinstance(driver, ZeroSenderProvider):
        raise ConfigError(
            f"driver {name}: command_timeout is none, and this driver has no watchdog;"
            " give command_timeout: base, or its seconds, if this base stops by itself"
        )
    spec = driver.zero_sender()
    if spec is None:
        return driver
    from swarmd.driver_api.watchdog_client import WatchedDriver

    watchdog = watchdog_name(settings.network.swarm, settings.id)
    return WatchedDriver(driver, spec, name=watchdog, tie=settings.die_with_parent)
