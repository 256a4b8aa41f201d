"""Networks: arithmetic, their file and their text, and what is refused."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.kit.observation import PolicySpec, ReadingPart, ScanPart, encode_spec
from swarmd.kit.policy_network import (
    MAX_BYTES,
    Activation,
    PolicyNetwork,
    from_text,
    network_from_bytes,
    network_of,
    parameter_count,
    to_text,
)

SPEC = PolicySpec((ReadingPart("a"), ReadingPart("b")))


@pytest.mark.parametrize(("activation", "hidden"), [("tanh", np.tanh(-2.0)), ("relu", 0.0)])
def test_acts_layer_by_layer(activation: Activation, hidden: float) -> None:
    # One hidden unit of weights (1, 2) and bias 1, then outputs of (3, -1) and bias (0, 0.5).
    parameters = np.array([1.0, 2.0, 1.0, 3.0, -1.0, 0.0, 0.5])
    network = network_of(SPEC, parameters, (1,), activation)
    action = network.act(np.array([-1.0, -1.0], dtype=np.float32))
    assert action == pytest.approx(np.tanh([3.0 * hidden, 0.5 - hidden]))


def test_file_and_text_give_the_network_back() -> None:
    spec = PolicySpec((ScanPart(sectors=8),), lateral=True)
    count = parameter_count(spec, (5, 4))
    assert count == 5 * 9 + 4 * 6 + 3 * 5
    network = network_of(spec, np.random.default_rng(1).normal(size=count), (5, 4), "relu")
    observation = np.linspace(-1.0, 1.0, 8, dtype=np.float32)
    for copy in (network_from_bytes(network.to_bytes()), from_text(to_text(network))):
        assert copy.spec == spec
        assert copy.activation == "relu"
        assert copy.act(observation) == pytest.approx(network.act(observation), abs=1e-6)


def npz(**changes: object) -> bytes:
    arrays: dict[str, object] = {
        "spec": np.frombuffer(encode_spec(SPEC), dtype=np.uint8),
        "activation": np.array("tanh"),
        "weight_0": np.zeros((2, 2)),
        "bias_0": np.zeros(2),
    }
    file = io.BytesIO()
    kept = {k: v for k, v in {**arrays, **changes}.items() if v is not None}
    np.savez(file, **kept)  # type: ignore[arg-type]
    return file.getvalue()


def npy() -> bytes:
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    return file.getvalue()


def packed(array: Array | None = None, shape: tuple[int, ...] = ()) -> bytes:
    """A compressed file with one array, or with a header alone that promises `shape`."""
    content, file = io.BytesIO(), io.BytesIO()
    if array is not None:
        np.save(content, array)
    else:
        header = {"descr": "<f4", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(content, header)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("weight_0.npy", content.getvalue())
    return file.getvalue()


def broken_stream() -> bytes:
    """A file of to_bytes whose compressed data are no longer any."""
    network = network_of(SPEC, np.zeros(parameter_count(SPEC)))
    data = bytearray(network.to_bytes())
    start = 30 + data[26] + data[28]  # of the first member, after its local header
    data[start : start + 8] = b"\xff" * 8
    return bytes(data)


def test_a_file_of_numpy_is_taken() -> None:
    assert network_from_bytes(npz()).act(np.zeros(2, dtype=np.float32)).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "damaged"),
        (b"PK\x03\x04 no zip", "damaged"),
        (npz()[:-30], "damaged"),
        (bytes(MAX_BYTES + 1), "bytes"),
        (npz(bias_0=None), "damaged"),
        (npz(spec=np.frombuffer(b"{}", dtype=np.uint8)), "parts"),
        (npz(activation=np.array("sine")), "sine"),
        (npz(weight_0=np.zeros((2, 3))), "expected 2 inputs"),
        (npz(weight_0=np.zeros(2)), "matrices"),
        (npz(weight_0=np.full((2, 2), np.nan)), "not finite"),
        (npz(weight_0=np.zeros((3, 2)), bias_0=np.zeros(3)), "2 outputs"),
        (npz(weight_0=np.array([["a", "b"]] * 2)), "damaged"),
        (npz(activation=np.array([{}], dtype=object)), "damaged"),  # would be unpickled
        (npz(weight_0=np.zeros((2, 2), [("a", float), ("b", int)])), "damaged"),
        (npz(weight_0=np.zeros((2, 2), complex)), "damaged"),
        (npy(), "damaged"),
        (lambda: packed(np.zeros((4000, 2000))), "unpacked"),  # 64 MB of zeros in a few kB
        (packed(shape=(10**12,)), "damaged"),
        (broken_stream(), "damaged"),
    ],
)
def test_what_is_no_network_is_refused(data: bytes | Callable[[], bytes], text: str) -> None:
    """Large data are made in the test: each worker of pytest collects all rows."""
    with pytest.raises(ConfigError, match=text):
        network_from_bytes(data if isinstance(data, bytes) else data())


def test_text_that_is_none_and_parameters_of_another_number_are_refused() -> None:
    with pytest.raises(ConfigError, match="base64"):
        from_text("no text of a network!")
    with pytest.raises(ConfigError, match="5 parameters; expected 6"):
        network_of(SPEC, np.zeros(5))
    with pytest.raises(ConfigError, match="expected 2 inputs"):
        PolicyNetwork(SPEC, (), ())


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"activation": "sigmoid"}, "sigmoid"),
        ({"biases": (np.zeros((2, 1)),)}, "vectors"),
        ({"weights": ([[0.0, 0.0], [0.0, 0.0]],)}, "arrays"),
        ({"weights": (np.full((2, 2), 1e39),)}, "not finite"),  # as float32, as a file holds it
        ({"spec": PolicySpec(SPEC.parts, period=0.05)}, "period"),
    ],
)
def test_what_a_file_cannot_give_back_is_no_network(change: dict[str, Any], text: str) -> None:
    whole = {"spec": SPEC, "weights": (np.zeros((2, 2)),), "biases": (np.zeros(2),)}
    with pytest.raises(ConfigError, match=text):
        PolicyNetwork(**{**whole, **change})


def test_a_network_that_no_file_can_hold_is_refused_when_it_is_saved() -> None:
    hidden = (600, 600)
    values = np.random.default_rng(1).normal(size=parameter_count(SPEC, hidden))
    with pytest.raises(ConfigError, match="smaller network"):
        network_of(SPEC, values, hidden).to_bytes()
