"""What `tests/core/test_fork_server.py` runs: tells what it was given, then ends as it is told."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path

from swarmd.core.processes import die_with_parent


def main() -> None:
    if "tied" in sys.argv:
        die_with_parent(int(sys.argv[-1]))
    told = {
        "arguments": sys.argv[1:],
        "folder": os.getcwd(),
        "name": Path("/proc/self/comm").read_text().strip(),
        "environ": os.environ.get("GIVEN"),
        "safe_path": os.environ.get("PYTHONSAFEPATH"),
        "input": sys.stdin.read() if os.read(0, 1) else "",
        "is_leader": os.getsid(0) == os.getpid(),
        "takes_sigint": signal.getsignal(signal.SIGINT) is signal.default_int_handler
        and signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ()),
        "parent": os.getppid(),
    }
    print(json.dumps(told), flush=True)
    print("error", file=sys.stderr, flush=True)
    if "wait" in sys.argv:
        signal.pause()
    sys.exit(7)
