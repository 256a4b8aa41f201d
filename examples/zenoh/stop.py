"""Stop all robots of a swarm: python examples/zenoh/stop.py meadow; with estop: latched"""

import sys
import uuid

import msgpack
import zenoh


def main() -> None:
    """Ask three times, and print the answer of each robot."""
    swarm, verb = sys.argv[1], "estop" if "estop" in sys.argv else "stop"
    request = {"verb": verb, "id": uuid.uuid4().hex, "operator": "stop.py"}
    payload = b"\x01" + msgpack.packb(request)  # the version of the format, and MessagePack
    config = zenoh.Config()
    config.insert_json5("open/return_conditions/connect_scouted", "true")
    with zenoh.open(config) as session:
        answered: set[str] = set()
        for _ in range(3):  # a robot that is found after the first question gets the next one
            key = f"swarm/{swarm}/*/control/{verb}/anyone"
            for reply in session.get(key, target=zenoh.QueryTarget.ALL, payload=payload):
                sample = reply.ok  # None: a robot is gone, or refuses the payload
                answer = msgpack.unpackb(sample.payload.to_bytes()[1:]) if sample else {}
                if answer and answer["robot"] not in answered:
                    answered.add(answer["robot"])
                    print(answer["robot"], answer["code"], answer["text"])


if __name__ == "__main__":
    main()
