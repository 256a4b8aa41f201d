"""List the robots and programs of a swarm: python examples/zenoh/list.py meadow"""

import sys
import threading
import time

import zenoh


def main() -> None:
    """Print each liveliness token for a second, or as many seconds as the second word says."""
    swarm = sys.argv[1]
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 1.0
    lock = threading.Lock()

    def show(sample: zenoh.Sample) -> None:
        change = "here" if sample.kind == zenoh.SampleKind.PUT else "gone"
        with lock:
            print(str(sample.key_expr).rpartition("/")[2], change, flush=True)

    with zenoh.open(zenoh.Config()) as session:
        session.liveliness().declare_subscriber(f"swarm/{swarm}/*", show, history=True)
        time.sleep(seconds)


if __name__ == "__main__":
    main()
