"""A small daemon: runs driver `ros1` and commands 0.1 m/s at 20 Hz while its base is there.

    python daemon_process.py OPTIONS_AS_JSON

Prints the adapter's process id each time that the base has come.
"""

from __future__ import annotations

import asyncio
import json
import sys

from swarmd.core.values import Twist
from swarmd.drivers.ros1.driver import Ros1Driver
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink


async def main() -> None:
    driver = Ros1Driver(
        swarm="s", robot="r-1", platform=load_platform("burger"), options=json.loads(sys.argv[1])
    )
    heard = CollectingSink()
    task = asyncio.create_task(driver.run(heard))
    was_up = False
    while not task.done():
        driver.send(Twist(0.1), 1, 1)
        if heard.is_up and not was_up:
            print(driver.adapter_pid, flush=True)
        was_up = heard.is_up
        await asyncio.sleep(0.05)


if __name__ == "__main__":
    asyncio.run(main())
