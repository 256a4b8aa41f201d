"""A live robot is stopped by a user whose settings cannot be read, as after `sudo -E swarmctl`."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from swarmd.core.messages import State
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.settings.contexts import Context, add_context
from tests.support.fake_body import resting_body
from tests.support.processes import CAP, DaemonProcess, unique_swarm, wait_until
from tests.support.swarmctl import SWARMCTL, Finished, ask_in_time, heard_statuses

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(
        os.geteuid() != 0 or shutil.which("setpriv") is None, reason="needs root and setpriv"
    ),
]

STRANGER = 23456
WITHOUT_RIGHTS = ("setpriv", "--bounding-set=-all", "--inh-caps=-all")


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[str]:
    """A robot r1 that answers; its swarm."""
    swarm = unique_swarm()
    with (
        resting_body(swarm, "r1") as body,
        DaemonProcess(tmp_path, swarm=swarm, robot="r1", endpoint=body.endpoint) as daemon,
    ):
        daemon.wait_ready()
        yield swarm


def ask(home: Path, *words: str) -> Finished:
    """`swarmctl` of a user with this home; root without its rights obeys modes as others do."""
    kept = {
        key: value for key, value in os.environ.items() if not key.startswith(("XDG_", "SWARM"))
    }
    done = subprocess.run(
        [*WITHOUT_RIGHTS, *SWARMCTL, *words],
        env={**kept, "HOME": str(home)},
        capture_output=True,
        text=True,
        timeout=CAP,
        check=False,
    )
    return Finished(done.returncode, done.stdout, done.stderr)


def given_away(path: Path) -> None:
    """Give a file or folder to another user, who alone may read it."""
    os.chown(path, STRANGER, STRANGER)
    path.chmod(0o700 if path.is_dir() else 0o600)


@pytest.mark.parametrize("path", [".config/swarmd/contexts.yaml", ".config/swarmd", ".config"])
def test_an_estop_by_name_of_the_swarm_is_applied(tmp_path: Path, robot: str, path: str) -> None:
    home = tmp_path / "home"
    add_context("lab", Context(swarm=robot), use=True, environ={"HOME": str(home)})
    given_away(home / path)
    done = ask_in_time(lambda: ask(home, "--swarm", robot, "estop"), late=(2, 6))
    assert done.code == 0, done
    assert "contexts.yaml" in done.err
    with Operator(NetworkSettings(swarm=robot)) as operator:
        wait_until(
            lambda: heard_statuses(operator, ["r1"])["r1"].state is State.ESTOPPED, "it is latched"
        )
    refused = ask(home, "estop")
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "--swarm NAME" in refused.err
