"""What depends on the processor is named: the functions that give other bits."""

from __future__ import annotations

import errno
import socket
import struct
from pathlib import Path

import pytest

from studies.processors.__main__ import run_all
from studies.processors.runs import (
    SCENARIOS,
    Variant,
    differences,
    differing_facts,
    run_variant,
    variants,
)
from studies.processors.socket_options import SocketOptions
from swarmd.core.pin import pinned_environment


@pytest.mark.integration
def test_a_hash_seed_and_processes_change_no_bit_and_a_processor_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pin of this process, as a night has it, does not hide what the processor changes."""
    for name, value in pinned_environment().items():
        monkeypatch.setenv(name, value)
    names, share = ["doorway"], 0.1
    run_variant(Variant({}), tmp_path / "here", names, share)
    run_variant(Variant({"PYTHONHASHSEED": "7"}, cores=2), tmp_path / "program", names, share)
    assert differences(tmp_path / "here", tmp_path / "program") == {"doorway": ""}
    assert differing_facts(tmp_path / "here", tmp_path / "program") == []
    others = variants()
    if "all three" not in others:
        pytest.skip("this processor has no variants that an environment chooses")
    run_variant(others["all three"], tmp_path / "there", names, share)
    facts = differing_facts(tmp_path / "here", tmp_path / "there")
    differs = differences(tmp_path / "here", tmp_path / "there")["doorway"]
    of_processor = any(name.startswith(("math.", "numpy.")) for name in facts)
    assert of_processor or not (differs or "libm without FMA" in others), facts


def ask(path: Path, sock: socket.socket, level: int, name: int, value: bytes) -> int:
    """The answer to a request, as socket_options.c sends it."""
    with socket.socket(socket.AF_UNIX) as helper:
        helper.connect(str(path))
        socket.send_fds(helper, [struct.pack("=ii", level, name), value], [sock.fileno()])
        return int.from_bytes(helper.recv(4), "little")


def test_an_option_is_set_on_the_socket_of_the_other_process(tmp_path: Path) -> None:
    yes = struct.pack("=i", 1)
    with SocketOptions(tmp_path / "options") as helper, socket.socket() as sock:
        assert ask(tmp_path / "options", sock, socket.SOL_SOCKET, socket.SO_KEEPALIVE, yes) == 0
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        wrong = ask(tmp_path / "options", sock, socket.SOL_SOCKET, 9999, yes)
        assert wrong == errno.ENOPROTOOPT
        assert helper.served == {(socket.SOL_SOCKET, socket.SO_KEEPALIVE)}


def test_a_request_without_a_socket_is_refused(tmp_path: Path) -> None:
    with SocketOptions(tmp_path / "options"), socket.socket(socket.AF_UNIX) as helper:
        helper.connect(str(tmp_path / "options"))
        helper.sendall(struct.pack("=ii", 1, 9) + b"\1\0\0\0")
        assert int.from_bytes(helper.recv(4), "little") == errno.EINVAL


@pytest.mark.evidence
def test_only_variants_whose_functions_differ_change_traces(tmp_path: Path) -> None:
    assert run_all(tmp_path, [*SCENARIOS], 1.0) == 0
