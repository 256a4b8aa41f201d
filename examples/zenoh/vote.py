"""Vote with the robots that run voter_model: python examples/zenoh/vote.py meadow teacher 2"""

import sys
import time

import msgpack
import zenoh

VERSION = b"\x01"  # the first byte of each payload; MessagePack follows


def main() -> None:
    """Hold the token of a program, and put an opinion twice a second.

    The first votes may reach no robot: robots are found one by one, and hear the later votes.
    """
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    swarm, program, opinion = sys.argv[1], sys.argv[2], int(sys.argv[3])
    seconds = float(sys.argv[4]) if len(sys.argv) > 4 else 10.0
    end = time.monotonic() + seconds
    with zenoh.open(zenoh.Config()) as session:
        token = session.liveliness().declare_token(f"swarm/{swarm}/{program}")
        vote = session.declare_publisher(f"swarm/{swarm}/{program}/message/voter_model/opinion")
        while time.monotonic() < end:
            vote.put(VERSION + msgpack.packb(opinion))
            time.sleep(0.5)
        token.undeclare()
        if not any(reply.ok for reply in session.liveliness().get(f"swarm/{swarm}/*")):
            sys.exit(f"no robot of {swarm} was found in {seconds:g} s")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("interrupted: no more votes")
