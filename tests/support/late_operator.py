"""An operator in a network namespace that looks first and sends later; one JSON line an answer.

For `look` on standard input {"seen": [robots]}; for `run SECONDS` {robot: [code, text]} of a
request with the epochs of the last look, null for a robot that did not answer within that time.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from swarmd.core.messages import Epoch
from swarmd.core.verbs import RunRequest
from swarmd.operator.cli.options import CommonOptions
from swarmd.operator.session.operator import Operator


def run(
    operator: Operator, epochs: dict[str, Epoch | None], timeout: float
) -> dict[str, list[str] | None]:
    outcome = operator.request(RunRequest, epochs, pattern="drive", timeout=timeout)
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
                answer = run(operator, epochs, float(line.split()[1]))
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
