"""A Zenoh program beside a swarm, with Zenoh's own defaults, for `benchmarks/network_scale.py`.

`python -m benchmarks.zenoh_program SWARM NAME ROBOTS [PATTERN/CHANNEL JSON]` prints a line of JSON.
`all`: seconds from `open` until ROBOTS robots have answered. With a channel, the program puts the
JSON value on the channel twice a second. `taken`: seconds from `open` until a robot that runs chat
has received a value. The program ends at the end of its standard input.
"""

from __future__ import annotations

import json
import sys
import threading
import time

import msgpack
import zenoh

PERIOD = 0.5  # s


def main(swarm: str, name: str, robots: str, channel: str = "", value: str = "") -> None:
    began = time.monotonic()
    with zenoh.open(zenoh.Config()) as session:
        session.liveliness().declare_token(f"swarm/{swarm}/{name}")

        def heard() -> dict[str, int]:
            """How many senders each robot has heard."""
            replies = session.get(f"swarm/{swarm}/*/state/status", target=zenoh.QueryTarget.ALL)
            answers = [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
            statuses = [msgpack.unpackb(answer[1:]) for answer in answers]
            return {one["robot"]: one["report"].get("heard", 0) for one in statuses}

        while len(before := heard()) < int(robots):
            time.sleep(0.01)
        times, ended = {"all": time.monotonic() - began}, threading.Event()

        def put() -> None:
            while channel and not ended.is_set():
                key = f"swarm/{swarm}/{name}/message/{channel}"
                session.put(key, b"\x01" + msgpack.packb(json.loads(value)))
                ended.wait(PERIOD)

        putting = threading.Thread(target=put)
        putting.start()
        if channel.startswith("chat/"):
            while all(count <= before.get(robot, 0) for robot, count in heard().items()):
                time.sleep(0.01)
            times["taken"] = time.monotonic() - began
        print(json.dumps(times), flush=True)
        sys.stdin.read()
        ended.set()
        putting.join()


if __name__ == "__main__":
    main(*sys.argv[1:])
