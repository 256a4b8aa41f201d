"""Plot the way of one robot by its odometry, from Zenoh alone: no import of swarmd.

swarmctl zenoh --out meadow.json5
python examples/zenoh/plot_pose.py meadow.json5 meadow tb3-01 --count 300 --out way.png
"""

import argparse
import contextlib
import queue

import matplotlib.pyplot as plt
import msgpack
import zenoh

VERSION = 1  # the first byte of each payload; MessagePack follows


def main() -> None:
    """Subscribe to the motion of a robot, ten a second, and draw its way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("config", help="what `swarmctl zenoh --out` wrote")
    parser.add_argument("swarm", help="the name of the swarm")
    parser.add_argument("robot", help="the name of the robot")
    parser.add_argument("--count", type=int, default=300, help="poses until the end")
    parser.add_argument("--out", default="way.png", help="the picture")
    options = parser.parse_args()
    arrived: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    xs: list[float] = []
    ys: list[float] = []
    with (
        contextlib.suppress(KeyboardInterrupt),
        zenoh.open(zenoh.Config.from_file(options.config)) as session,
    ):
        key = f"swarm/{options.swarm}/{options.robot}/state/motion"
        session.declare_subscriber(key, lambda sample: arrived.put(sample.payload.to_bytes()))
        while len(xs) < options.count:
            payload = arrived.get()
            if payload[0] == VERSION:
                motion = msgpack.unpackb(payload[1:])  # `Motion` of docs/zenoh.md, an array
                xs.append(motion[2])
                ys.append(motion[3])
    figure, axes = plt.subplots()
    axes.plot(xs, ys)
    axes.set(xlabel="x [m]", ylabel="y [m]", title=options.robot, aspect="equal")
    figure.savefig(options.out)
    print(f"{options.out}: {len(xs)} poses of {options.robot}")


if __name__ == "__main__":
    main()
