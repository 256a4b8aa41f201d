"""A small neural network that maps observations to actions, and its file.

The file is an .npz of numpy: `spec` (the declaration as JSON), `activation`, and `weight_0`,
`bias_0`, `weight_1`, ... of its layers. No object is unpickled.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.kit.observation import Observation, PolicySpec, check_spec, decode_spec, encode_spec

Activation = Literal["tanh", "relu"]
MAX_BYTES = 512 * 1024
"""Of a file; as text it fits into one pushed pattern."""
_MAX_UNPACKED = 16 * MAX_BYTES  # a small file of zeros else fills the memory of a robot


@dataclass(frozen=True, slots=True, eq=False)
class PolicyNetwork:
    """A network of dense layers; the last layer ends in tanh, so that actions are in [-1, 1].

    `weights[i]` has the shape (outputs, inputs), `biases[i]` (outputs,). The first layer takes the
    observation of `spec`, the last layer gives the action. ConfigError if the shapes do not fit, or
    if the network is too large for a file.
    """

    spec: PolicySpec
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    activation: Activation = "tanh"

    def __post_init__(self) -> None:
        """Check the network by the same rules as a file."""
        if self.activation not in get_args(Activation):
            raise ConfigError(f"policy: activation is {self.activation!r}; expected tanh or relu")
        check_spec(self.spec)
        arrays = (*self.weights, *self.biases)
        if not all(isinstance(array, np.ndarray) and array.dtype.kind in "fiu" for array in arrays):
            raise ConfigError("policy: weights and biases must be arrays of real numbers")
        if any(w.ndim != 2 for w in self.weights) or any(b.ndim != 1 for b in self.biases):
            raise ConfigError("policy: weights must be matrices and biases vectors")
        shapes = [weight.shape for weight in self.weights]
        sizes = [self.spec.size, *(len(bias) for bias in self.biases)]
        wanted = list(zip(sizes[1:], sizes[:-1], strict=True))
        if shapes != wanted or not shapes or sizes[-1] != self.spec.actions:
            raise ConfigError(
                f"policy: layers {shapes} with biases of {sizes[1:]}; expected {sizes[0]} inputs,"
                f" {self.spec.actions} outputs, and each layer to fit the one before"
            )
        with np.errstate(over="ignore"):  # a file holds float32
            is_finite = all(np.isfinite(array.astype(np.float32)).all() for array in arrays)
        if not is_finite:
            raise ConfigError("policy: a weight is not finite; train it again")

    def act(self, observation: Observation) -> Array:
        """The action (actions,) for an observation (size,), each number in [-1, 1]."""
        values = np.asarray(observation, dtype=np.float64)
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = weight @ values + bias
            is_relu = layer < last and self.activation == "relu"
            values = np.maximum(values, 0.0) if is_relu else np.tanh(values)
        return values

    def to_bytes(self) -> bytes:
        """The content of its file, with weights as float32; ConfigError if it is too large."""
        arrays: dict[str, Any] = {
            "spec": np.frombuffer(encode_spec(self.spec), dtype=np.uint8),
            "activation": np.array(self.activation),
        }
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays |= {f"weight_{i}": weight.astype(np.float32)}
            arrays |= {f"bias_{i}": bias.astype(np.float32)}
        file = io.BytesIO()
        np.savez_compressed(file, **arrays)
        if len(data := file.getvalue()) > MAX_BYTES:
            raise ConfigError(
                f"policy: a file of {len(data)} bytes; robots take {MAX_BYTES} or less: train a"
                " smaller network"
            )
        return data


def parameter_count(spec: PolicySpec, hidden: Sequence[int] = ()) -> int:
    """The weights and biases of a network with these hidden layers."""
    return sum(outputs * (inputs + 1) for outputs, inputs in _layers(spec, hidden))


def network_of(
    spec: PolicySpec,
    parameters: Array,
    hidden: Sequence[int] = (),
    activation: Activation = "tanh",
) -> PolicyNetwork:
    """The network whose weights and biases are `parameters` (parameter_count,), layer by layer."""
    if len(parameters) != parameter_count(spec, hidden):
        wanted = parameter_count(spec, hidden)
        raise ConfigError(f"policy: {len(parameters)} parameters; expected {wanted}")
    weights = []
    biases = []
    start = 0
    for outputs, inputs in _layers(spec, hidden):
        end = start + outputs * inputs
        weights.append(np.array(parameters[start:end], dtype=np.float64).reshape(outputs, inputs))
        biases.append(np.array(parameters[end : end + outputs], dtype=np.float64))
        start = end + outputs
    return PolicyNetwork(spec, tuple(weights), tuple(biases), activation)


def network_from_bytes(data: bytes) -> PolicyNetwork:
    """The network in the content of a file of `PolicyNetwork.to_bytes`.

    The file is a zip archive of numpy arrays: `spec`, `activation`, and `weight_i` and `bias_i` of
    each layer i. ConfigError if the file is too large, damaged or of another kind, and if the
    shapes of the arrays do not fit together.
    """
    import zlib  # few hosts run a policy
    from zipfile import BadZipFile, ZipFile

    if len(data) > MAX_BYTES:
        raise ConfigError(f"policy: {len(data)} bytes; expected {MAX_BYTES} or less")
    try:
        # 1. Bound the memory that unpacking takes.
        with ZipFile(io.BytesIO(data)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > _MAX_UNPACKED:
            raise ConfigError(
                f"policy: {unpacked} bytes unpacked; expected {_MAX_UNPACKED} or less"
            )
        # 2. Read the arrays; without pickle, which could run code.
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        spec = arrays.pop("spec").tobytes()
        activation = str(arrays.pop("activation"))
        layer_count, remainder = divmod(len(arrays), 2)
        if remainder:
            raise ValueError("a weight without its bias")
        # Only arrays of real numbers can be cast so.
        weights, biases = (
            tuple(
                arrays[f"{kind}_{layer}"].astype(np.float64, casting="same_kind")
                for layer in range(layer_count)
            )
            for kind in ("weight", "bias")
        )
    except (
        BadZipFile, EOFError, KeyError, MemoryError, NotImplementedError, OSError, RuntimeError,
        TypeError, ValueError, zlib.error,
    ) as error:  # fmt: skip
        raise ConfigError("policy: not a file of PolicyNetwork.to_bytes, or damaged") from error
    return PolicyNetwork(decode_spec(spec), weights, biases, activation)  # type: ignore[arg-type]


def to_text(network: PolicyNetwork) -> str:
    """The network's file in base64, in lines of 96 characters."""
    text = base64.b64encode(network.to_bytes()).decode()
    return "\n".join(text[start : start + 96] for start in range(0, len(text), 96))


def from_text(text: str) -> PolicyNetwork:
    """The network in the text of `to_text`; ConfigError as `network_from_bytes`."""
    try:
        data = base64.b64decode("".join(text.split()), validate=True)
    except ValueError as error:
        raise ConfigError("policy: the text is not base64; write it with to_text") from error
    return network_from_bytes(data)


def _layers(spec: PolicySpec, hidden: Sequence[int]) -> list[tuple[int, int]]:
    """(outputs, inputs) of each layer."""
    sizes = [spec.size, *hidden, spec.actions]
    return list(zip(sizes[1:], sizes[:-1], strict=True))
