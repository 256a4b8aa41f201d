"""Record the opinions that robots send in a vote, from Zenoh alone: no import of swarmd.

swarmctl zenoh --out meadow.json5
swarmctl run voter_model --all
python examples/zenoh/record_opinions.py meadow.json5 meadow --out opinions.csv
"""

import argparse
import contextlib
import csv
import queue

import msgpack
import zenoh

VERSION = 1  # the first byte of each payload; MessagePack follows


def main() -> None:
    """Subscribe to the messages of all patterns, and write those on channels of opinions."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("config", help="what `swarmctl zenoh --out` wrote")
    parser.add_argument("swarm", help="the name of the swarm")
    parser.add_argument("--channel", default="opinion", help="how the channel ends")
    parser.add_argument("--count", type=int, default=0, help="messages until the end; 0: no end")
    parser.add_argument("--out", default="opinions.csv", help="the table")
    options = parser.parse_args()
    arrived: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    count = 0
    with (
        contextlib.suppress(KeyboardInterrupt),
        zenoh.open(zenoh.Config.from_file(options.config)) as session,
        open(options.out, "w", newline="", encoding="utf-8") as file,
    ):
        key = f"swarm/{options.swarm}/*/state/message"
        session.declare_subscriber(key, lambda sample: arrived.put(sample.payload.to_bytes()))
        table = csv.writer(file)
        table.writerow(("robot", "at", "channel", "opinion"))
        while not options.count or count < options.count:
            payload = arrived.get()
            if payload[0] != VERSION:
                continue  # of a robot with another version of swarmd
            one = msgpack.unpackb(payload[1:])  # `ShownMessage` of docs/zenoh.md
            if one["channel"].endswith(options.channel):
                count += 1
                table.writerow((one["robot"], f"{one['at']:.3f}", one["channel"], one["value"]))
                file.flush()
    print(f"{options.out}: {count} opinions")


if __name__ == "__main__":
    main()
