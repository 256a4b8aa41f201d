"""`swarmctl` in the process of a test: the start of another one costs most of its time."""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from unittest import mock

from swarmd.cli.swarmctl import cli, exit_code_of, run_cli

SWARMCTL = (sys.executable, "-c", "from swarmd.cli.swarmctl import main; main()")


@dataclass(frozen=True, slots=True)
class Finished:
    """The exit code and output of a `swarmctl`."""

    code: int
    out: str
    err: str

    @property
    def outcome(self) -> tuple[int, str]:
        """The exit code and the last line, which counts the robots."""
        return self.code, self.out.splitlines()[-1]

    @property
    def json(self) -> Any:
        """Its answer with `-o json`."""
        return json.loads(self.out)


def swarmctl(*words: str, environ: Mapping[str, str] | None = None) -> Finished:
    """Run a command to its end, without a terminal; `environ` is added to the environment."""
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch.dict(os.environ, environ or {}),
        mock.patch.object(sys, "stdin", io.StringIO()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        code = run_cli(cli, list(words), "swarmctl", exit_code_of)
    return Finished(code, out.getvalue(), err.getvalue())
