"""What depends on the processor is named: the first function that gives other bits."""

from __future__ import annotations

import errno
import shutil
import socket
import struct
from io import BytesIO
from pathlib import Path

import pytest

from studies.processors.__main__ import run_all
from studies.processors.cause import OF_LIBM, Side, described, first_cause, first_difference
from studies.processors.runs import (
    SCENARIOS,
    Variant,
    differences,
    differing_facts,
    run_variant,
    variants,
)
from studies.processors.socket_options import SocketOptions

SIN, COS, ATAN2 = (OF_LIBM.index(name) for name in ("sin", "cos", "atan2"))
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc compiles elementary.c")


def calls(*rows: tuple[float, float, float, float]) -> bytes:
    return b"".join(struct.pack("=4d", *row) for row in rows)


ONE = (SIN, 1.0, 0.0, 0.84)
TWO = (ATAN2, 1.0, 2.0, 0.46)


def test_the_first_call_that_differs_is_found() -> None:
    many = [ONE] * 5000
    one, other = (BytesIO(calls(*many, row, TWO)) for row in (TWO, (ATAN2, 1.0, 2.0, 0.47)))
    found = first_difference(one, other)
    assert found is not None
    assert (found[0], found[1]) == (5000, calls(TWO))
    assert first_difference(BytesIO(calls(ONE, TWO)), BytesIO(calls(ONE, TWO))) is None
    ended = first_difference(BytesIO(calls(ONE)), BytesIO(calls(ONE, TWO)))
    assert ended == (1, b"", calls(TWO))


@pytest.mark.parametrize(
    ("one", "other", "function", "words"),
    [
        (ONE, (SIN, 1.0, 0.0, 0.85), "sin", "sin(1.0) is 0.84 here, 0.85 there"),
        (TWO, (ATAN2, 1.0, 2.0, 0.5), "atan2", "atan2(1.0, 2.0) is 0.46 here, 0.5 there"),
        (ONE, (SIN, 1.5, 0.0, 0.84), "", "arguments of sin"),
        (ONE, (COS, 1.0, 0.0, 0.84), "", "sin here, cos there"),
        (ONE, None, "", "ends first"),
    ],
)
def test_a_function_is_the_cause_if_its_arguments_are_equal(
    one: tuple[float, ...], other: tuple[float, ...] | None, function: str, words: str
) -> None:
    a, b = (struct.pack("=4d", *row) if row else b"" for row in (one, other))
    name, text = described(a, b)
    assert name == function
    assert words in text


@pytest.mark.integration
def test_a_hash_seed_and_processes_change_no_bit_and_a_processor_is_named(tmp_path: Path) -> None:
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
    assert not differs or any(name.startswith(("math.", "numpy.")) for name in facts), facts


@needs_gcc
@pytest.mark.integration
@pytest.mark.skipif("libm without FMA" not in variants(), reason="the C library has no choice here")
def test_the_first_function_with_other_bits_is_found_in_a_run() -> None:
    without_fma = variants()["libm without FMA"].environment
    cause = first_cause("doorway", 1.5, Side({}), Side(without_fma))
    assert cause is not None
    assert cause.function in OF_LIBM
    file, _, line = cause.line.partition(":")
    assert file.endswith(".py")
    assert int(line) > 0


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


@needs_gcc
@pytest.mark.evidence
def test_each_difference_between_variants_has_a_cause(tmp_path: Path) -> None:
    assert run_all(tmp_path, [*SCENARIOS], 1.0) == 0
