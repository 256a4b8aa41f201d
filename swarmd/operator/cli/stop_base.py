"""`swarmd stop-base`: commands zero to the base without a daemon, as systemd does after its end."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import click

from swarmd.core.errors import DriverError
from swarmd.driver_api.driver import ZeroSenderProvider, ZeroSenderSpec
from swarmd.driver_api.watchdog import ZERO_PERIOD, made_zero_sender
from swarmd.operator.cli.options import FILE, Duration

ZERO_TIME = 0.5
"""Seconds of zeros: ten commands, of which a base on a bad link gets one."""
_CLOSE_TIMEOUT = 1.0
_NO_DRIVER = 5  # the exit code of a DriverError, as in swarmd.operator.cli.daemon


@click.command("stop-base")
@click.option("--config", type=FILE, metavar="FILE", help="The daemon's YAML file.")
@click.option(
    "--within", type=Duration(), default=3.0, help="How long it tries to reach the base [3s]."
)
def stop_base(config: Path | None, within: float) -> None:
    """Command zero to the base of the daemon's settings for half a second, and exit.

    The unit of `swarmd service install` runs this command after each end of the daemon. The command
    opens a connection of its own to the base, since that of the daemon ended with the daemon.
    """
    from swarmd.daemon.driver import make_bare_driver
    from swarmd.settings.settings import load_daemon_settings

    settings = load_daemon_settings(config, {})
    driver = make_bare_driver(settings)
    if not isinstance(driver, ZeroSenderProvider):
        click.echo(f"driver {settings.file.driver} cannot send zero without its daemon")
        return
    spec = driver.zero_sender()
    if spec is None:
        click.echo(f"driver {settings.file.driver} has a process of its own that sends the zeros")
        return
    _end_after(within + ZERO_TIME + _CLOSE_TIMEOUT)
    sent = _send_zeros(spec, within)
    click.echo(f"{settings.id}: {sent} zeros sent; whether its base took them is not known")


def _send_zeros(spec: ZeroSenderSpec, within: float) -> int:
    """Send zeros for ZERO_TIME once connected; returns how many. DriverError if not connected."""
    sender = made_zero_sender(spec.maker, spec.options)
    sender.open()
    try:
        deadline = time.monotonic() + within
        while not getattr(sender, "is_connected", True):
            if time.monotonic() >= deadline:
                raise DriverError(f"the base was not reached within {within:g} s; no zero was sent")
            time.sleep(ZERO_PERIOD)
        count = round(ZERO_TIME / ZERO_PERIOD)
        for _ in range(count):
            sender.send_zero()
            time.sleep(ZERO_PERIOD)
        return count
    finally:
        sender.close()


def _end_after(seconds: float) -> None:
    """End this process after `seconds`: a library may block while it connects or closes."""
    timer = threading.Timer(seconds, os._exit, (_NO_DRIVER,))
    timer.daemon = True
    timer.start()
