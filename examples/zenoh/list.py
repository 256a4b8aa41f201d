"""List the robots and programs of a swarm: python examples/zenoh/list.py meadow"""

import sys
import threading
import time

import zenoh


def main() -> None:
    """Wait 5 s for a token; then print each for a second, or as long as the second word says."""
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    swarm = sys.argv[1]
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 1.0
    lock = threading.Lock()
    is_found = threading.Event()

    def show(sample: zenoh.Sample) -> None:
        change = "here" if sample.kind == zenoh.SampleKind.PUT else "gone"
        is_found.set()
        with lock:
            print(str(sample.key_expr).rpartition("/")[2], change, flush=True)

    with zenoh.open(zenoh.Config()) as session:
        session.liveliness().declare_subscriber(f"swarm/{swarm}/*", show, history=True)
        if not is_found.wait(5.0):
            sys.exit(f"no robot of {swarm} was found in 5 s")
        time.sleep(seconds)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("interrupted")
