"""Searches through sequences of orders and events: `python -m tests.sequences [SUBJECT ...]`.

Without a subject all run, each as far as `make sequences` goes. Results land in `build/sequences`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "build" / "sequences"
SUBJECTS: Mapping[str, str] = {
    "robot": "tests.sequences.robot",
    "orders": "tests.sequences.orders",
    "drivers": "tests.sequences.drivers",
}
"""By name, the module whose `main(folder, arguments)` searches, and returns an exit status."""


def main(arguments: Sequence[str]) -> int:
    """Search the subject that the first argument names, with the others; without one, all."""
    if arguments and arguments[0] not in SUBJECTS:
        print(f"no subject {arguments[0]}; there are {', '.join(SUBJECTS)}", file=sys.stderr)
        return 2
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: a fork copies one thread
    status = 0
    for name in arguments[:1] or SUBJECTS:
        status |= import_module(SUBJECTS[name]).main(FOLDER, arguments[1:])
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
