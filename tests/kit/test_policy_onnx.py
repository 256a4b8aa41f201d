"""Networks of other libraries: what ONNX files give, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import ModelProto, TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from swarmd.core.errors import ConfigError
from swarmd.kit.observation import PolicySpec, ReadingPart, encode_spec
from swarmd.kit.policy_onnx import SPEC_PROPERTY, network_from_onnx
from swarmd.operator.cli.plugin import write_plugin

SPEC = PolicySpec((ReadingPart("a"), ReadingPart("b"), ReadingPart("c")))
FIRST, SECOND = np.arange(12.0).reshape(4, 3) / 10.0 - 0.4, np.arange(8.0).reshape(2, 4) / 7.0
BIASES = np.array([0.1, -0.2, 0.3, 0.0]), np.array([0.5, -0.5])


def model(nodes: list[Any], **arrays: Any) -> ModelProto:
    """A model from `x` to `y` with these nodes and weights, and the declaration."""
    floats = {name: np.asarray(one, dtype=np.float32) for name, one in arrays.items()}
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("x", 1, [1, 3])],
        [helper.make_tensor_value_info("y", 1, [1, 2])],
        [numpy_helper.from_array(one, name) for name, one in floats.items()],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(made, {SPEC_PROPERTY: encode_spec(SPEC).decode()})
    return made


def gemm(function: str) -> ModelProto:
    nodes = [
        helper.make_node("Gemm", ["x", "w0", "b0"], ["h"], transB=1),
        helper.make_node(function, ["h"], ["g"]),
        helper.make_node("Gemm", ["g", "w1", "b1"], ["z"]),
        helper.make_node("Tanh", ["z"], ["y"]),
    ]
    return model(nodes, w0=FIRST, b0=BIASES[0], w1=SECOND.T, b1=BIASES[1])


def matmul() -> ModelProto:
    nodes = [
        helper.make_node("MatMul", ["x", "w0"], ["h"]),
        helper.make_node("Add", ["b0", "h"], ["i"]),
        helper.make_node("Relu", ["i"], ["g"]),
        helper.make_node("MatMul", ["g", "w1"], ["z"]),
        helper.make_node("Identity", ["z"], ["q"]),
        helper.make_node("Tanh", ["q"], ["y"]),
    ]
    return model(nodes, w0=FIRST.T, b0=BIASES[0], w1=SECOND.T)


@pytest.mark.parametrize("made", [gemm("Tanh"), gemm("Relu"), matmul()], ids=["tanh", "relu", "mm"])
def test_acts_as_the_reference_of_onnx(made: ModelProto) -> None:
    network = network_from_onnx(made.SerializeToString())
    assert network.spec == SPEC
    for observation in np.random.default_rng(1).uniform(-1.0, 1.0, (5, 3)).astype(np.float32):
        wanted = ReferenceEvaluator(made).run(None, {"x": observation[None]})
        assert network.act(observation) == pytest.approx(np.asarray(wanted)[0, 0], abs=1e-6)


def test_a_plugin_holds_the_network_of_an_onnx_file(tmp_path: Path) -> None:
    file = tmp_path / "gather.onnx"
    file.write_bytes(gemm("Relu").SerializeToString())
    written, _ = write_plugin("gather", tmp_path, "movement", file)
    assert "PolicyPattern" in written.read_text()


def changed(kind: str) -> bytes:
    made = gemm("Tanh")
    nodes = made.graph.node
    match kind:
        case "declaration":
            del made.metadata_props[:]
        case "end":
            nodes[3].op_type = "Relu"
        case "Sigmoid":
            nodes[1].op_type = "Sigmoid"
        case "factor":
            nodes[0].attribute.append(helper.make_attribute("alpha", 2.0))
        case "chain":
            nodes[2].input[0] = "h"
        case "shape":
            made.graph.initializer[0].CopyFrom(
                numpy_helper.from_array(np.zeros((4, 5), dtype=np.float32), "w0")
            )
        case "file":
            weights = made.graph.initializer[0]
            weights.ClearField("raw_data")
            weights.data_location = TensorProto.EXTERNAL
            weights.external_data.add(key="location", value="secret")
        case "text":
            words = np.full((4, 3), "x", dtype=object)
            made.graph.initializer[0].CopyFrom(numpy_helper.from_array(words, "w0"))
        case "function":
            del nodes[1]
            nodes[1].input[0] = "h"
        case _:
            return b"\x00damaged"
    return bytes(made.SerializeToString())


@pytest.mark.parametrize(
    ("kind", "named"),
    [
        ("declaration", SPEC_PROPERTY),
        ("end", "Tanh"),
        ("Sigmoid", "Sigmoid"),
        ("factor", "Gemm"),
        ("chain", "chain"),
        ("shape", "5"),
        ("function", "layers"),
        ("damaged", "ONNX"),
        ("file", "another file"),
        ("text", "ONNX"),
    ],
)
def test_another_graph_is_one_line(
    kind: str, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("secret").write_bytes(FIRST.astype(np.float32).tobytes())
    with pytest.raises(ConfigError, match=named) as error:
        network_from_onnx(changed(kind))
    assert "\n" not in str(error.value)
