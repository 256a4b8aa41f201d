"""A base behind a bridge, which hands on bytes as they are, takes the other kind of velocity."""

from __future__ import annotations

import asyncio
import threading

from swarmd.drivers.ros2 import dds_bridge as ros2dds
from swarmd.testing.driver_contract import TIMEOUT, CollectingSink
from tests.drivers.ros2.robots import BridgedRobot
from tests.support import second_codec as second


def test_what_a_base_wants_is_known_before_it_is_heard() -> None:
    robot = BridgedRobot()
    zid = robot.hub.zid()
    robot.announce(f"@/{zid}/@ros2_lv/MS/cmd_vel/geometry_msgs§msg§Twist/:1::0,10")
    is_ending = threading.Event()

    def speak() -> None:
        while not is_ending.wait(0.0003):
            robot.publish()

    async def run() -> bool:
        driver, heard = robot.make({"cmd_vel_type": "twist_stamped"}), CollectingSink()
        running = asyncio.create_task(driver.run(heard))
        async with asyncio.timeout(TIMEOUT):
            while len(heard.states) < 2:
                await asyncio.sleep(0.01)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        return any(is_up for is_up, _ in heard.states)

    speaking = threading.Thread(target=speak)
    speaking.start()
    try:
        assert not any(asyncio.run(run()) for _ in range(3))
    finally:
        is_ending.set()
        speaking.join()
        robot.close()


def test_a_stamped_zero_stops_a_base_that_reads_it_as_a_twist() -> None:
    robot = BridgedRobot(is_stamped=True)
    sender = ros2dds.make_zero_sender(robot="r", given=dict(robot.options({})))
    sender.open()
    samples = robot.samples()
    while not samples:
        sender.send_zero()
        samples = robot.samples()
    sender.close()
    robot.close()
    payload = samples[0].payload.to_bytes()
    assert second.TwistStamped.deserialize(payload).twist == second.Twist()
    taken = second.Twist.deserialize(payload + bytes(48))
    assert abs(taken.linear.x) + abs(taken.linear.y) + abs(taken.angular.z) < 1e-300
