"""An operator in a network namespace who looks first and asks later; one JSON line an answer.

For `look` on standard input {"seen": [robots]}; for `run` {robot: [code, text]} of a request that
quotes what was seen at the last look, or null for one that did not answer.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from swarmd.cli.options import CommonOptions
from swarmd.core.messages import Epoch, RunRequest
from swarmd.network.operator import Operator


def run(operator: Operator, epochs: dict[str, Epoch | None]) -> dict[str, list[str] | None]:
    outcome = operator.request(RunRequest, epochs, pattern="drive", timeout=2.0)
    answers = {name: [reply.code.value, reply.text] for name, reply in outcome.replies.items()}
    return dict.fromkeys(outcome.missing) | answers


def main() -> None:
    epochs: dict[str, Epoch | None] = {}
    with CommonOptions(config=Path(sys.argv[1])).operator() as operator:
        for line in sys.stdin:
            answer: object
            if line.strip() == "look":
                view = operator.members()
                epochs = view.epochs(sorted(view.answered))
                answer = {"seen": sorted(view.answered)}
            else:
                answer = run(operator, epochs)
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
