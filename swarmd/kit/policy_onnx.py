"""A policy in an ONNX file, as libraries for learning export it, made into our network.

The graph is a chain of dense layers: Gemm, or MatMul and Add, with Tanh or Relu between them and
Tanh at the end. The declaration of the observation is in the model's property `swarmd_spec`. The
package `onnx` reads the file on the operator's machine; robots get the network and need no onnx.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.values import Array
from swarmd.kit.observation import PolicySpec, decode_spec
from swarmd.kit.policy_network import MAX_BYTES, Activation, PolicyNetwork

MAX_ONNX_BYTES = 8 * MAX_BYTES
SPEC_PROPERTY = "swarmd_spec"
"""The model's property that holds `encode_spec(spec)` as text."""


def network_from_onnx(data: bytes) -> PolicyNetwork:
    """The policy network in the content of an ONNX file: a chain of dense layers.

    PluginError without the package onnx. ConfigError for a damaged file, a missing declaration of
    the observation, or a graph that is no chain of dense layers; the text names the first node that
    does not fit.
    """
    try:
        import onnx  # of an extra that few have
        from onnx import numpy_helper
    except ModuleNotFoundError as error:
        text = "policy: this needs onnx, which is not installed; run: pip install 'swarmd[onnx]'"
        raise PluginError(text) from error
    if len(data) > MAX_ONNX_BYTES:
        raise ConfigError(f"policy: {len(data)} bytes; expected {MAX_ONNX_BYTES} or less")
    try:
        model = onnx.load_model_from_string(data)
        tensors = model.graph.initializer
        # Weights in another file are not read: onnx would read any file of the working folder, and
        # the policy is then sent to robots.
        is_whole = all(t.data_location != onnx.TensorProto.EXTERNAL for t in tensors)
        values = {t.name: _floats(numpy_helper.to_array(t)) for t in tensors if is_whole}
    except Exception as error:  # protobuf and onnx have errors of their own for damaged files
        raise ConfigError("policy: not an ONNX file, or damaged") from error
    if not is_whole:
        raise ConfigError("policy: weights are in another file; export the model as one file")
    properties = {entry.key: entry.value for entry in model.metadata_props}
    if SPEC_PROPERTY not in properties:
        raise ConfigError(
            f"policy: the model has no property {SPEC_PROPERTY!r}; set it to encode_spec(spec)"
        )
    return _network(decode_spec(properties[SPEC_PROPERTY].encode()), model.graph, values)


def _network(spec: PolicySpec, graph: Any, values: dict[str, Array]) -> PolicyNetwork:
    """The network of an ONNX graph; `values`: its weights by name. ConfigError as above."""
    inputs = [value.name for value in graph.input if value.name not in values]
    outputs = [value.name for value in graph.output]
    if len(inputs) != 1 or len(outputs) != 1:
        raise ConfigError(f"policy: inputs {inputs}, outputs {outputs}; expected one of each")
    matrices, biases, functions, last_output = _layers_of(graph.node, values, inputs[0])
    if last_output != outputs[0] or not functions or functions[-1] != "Tanh":
        raise ConfigError("policy: the graph does not end in Tanh, which bounds the actions")
    # All layers before the last must end in the same function, which the network calls its
    # activation. A network of one layer has no such function.
    inner_functions = {function.lower() for function in functions[:-1]} or {"tanh"}
    if len(inner_functions) > 1 or len(functions) != len(matrices):
        raise ConfigError(f"policy: layers end in {functions}; expected one of Tanh or Relu each")
    activation: Activation = "relu" if inner_functions == {"relu"} else "tanh"
    return PolicyNetwork(spec, tuple(matrices), tuple(biases), activation)


def _layers_of(
    nodes: Any, values: dict[str, Array], input_name: str
) -> tuple[list[Array], list[Array], list[str], str]:
    """The layers of a graph whose nodes form a chain from the input `input_name`.

    `nodes`: of ONNX, in the order of evaluation. `values`: the constants by name. Returns the
    weights (outputs, inputs), biases (outputs,) and functions ("Tanh", "Relu") of the layers, and
    the name of the last output. ConfigError for the first node that does not fit.
    """
    weights: list[Array] = []
    biases: list[Array] = []
    functions: list[str] = []
    next_input = input_name  # the name of the value that the next node must take
    for node in nodes:
        attributes = {attribute.name: attribute for attribute in node.attribute}
        constants = [values[source] for source in node.input if source in values]
        if next_input not in node.input or len(node.output) != 1:
            raise ConfigError(f"policy: node {node.op_type} {node.name!r} leaves the chain")
        has_open_layer = len(weights) == len(functions) + 1  # a layer without its function yet
        match node.op_type, [constant.ndim for constant in constants]:
            case "Gemm", [2, 1] if node.input[0] == next_input and _is_plain(attributes):
                # The weights have the shape (inputs, outputs), with transB (outputs, inputs).
                is_transposed = "transB" in attributes and attributes["transB"].i == 1
                weights.append(constants[0] if is_transposed else constants[0].T)
                biases.append(constants[1])
            case "MatMul", [2] if node.input[0] == next_input:
                weights.append(constants[0].T)
                biases.append(np.zeros(len(weights[-1])))
            case "Add", [1] if has_open_layer:
                biases[-1] = biases[-1] + constants[0]
            case ("Tanh" | "Relu") as function, [] if has_open_layer:
                functions.append(function)
            case "Identity", []:
                pass
            case op_type, _:
                raise ConfigError(
                    f"policy: node {op_type} {node.name!r}; expected dense layers (Gemm, or MatMul"
                    " and Add) with Tanh or Relu"
                )
        next_input = node.output[0]
    return weights, biases, functions, next_input


def _is_plain(attributes: dict[str, Any]) -> bool:
    """True for a Gemm without factors whose first input is not transposed."""
    factors = [attributes[name].f for name in ("alpha", "beta") if name in attributes]
    is_transposed = "transA" in attributes and attributes["transA"].i
    return all(factor == 1.0 for factor in factors) and not is_transposed


def _floats(values: Any) -> Array:
    return np.array(values, dtype=np.float64)
