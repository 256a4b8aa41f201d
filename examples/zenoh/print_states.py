"""Print the state of each robot when it changes, from Zenoh alone: no import of swarmd.

swarmctl zenoh --out meadow.json5
python examples/zenoh/print_states.py meadow.json5 meadow
"""

import argparse
import contextlib
import queue

import msgpack
import zenoh

VERSION = 1  # the first byte of each payload; MessagePack follows


def main() -> None:
    """Subscribe to the statuses of all robots, and print each change."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("config", help="what `swarmctl zenoh --out` wrote")
    parser.add_argument("swarm", help="the name of the swarm")
    parser.add_argument("--count", type=int, default=0, help="lines until the end; 0: no end")
    options = parser.parse_args()
    arrived: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    shown: dict[str, tuple[str, ...]] = {}
    count = 0
    with (
        contextlib.suppress(KeyboardInterrupt),
        zenoh.open(zenoh.Config.from_file(options.config)) as session,
    ):
        key = f"swarm/{options.swarm}/*/state/status"
        session.declare_subscriber(key, lambda sample: arrived.put(sample.payload.to_bytes()))
        while not options.count or count < options.count:
            payload = arrived.get()
            if payload[0] != VERSION:
                continue  # of a robot with another version of swarmd
            status = msgpack.unpackb(payload[1:])
            state = (status["state"], status["pattern"] or "-", status["reason"] or "moves")
            if shown.get(status["robot"]) != state:
                shown[status["robot"]] = state
                count += 1
                print(status["robot"], *state, flush=True)
    print(f"changes: {count}, of {len(shown)} robots")


if __name__ == "__main__":
    main()
