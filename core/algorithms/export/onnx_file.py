"""Writes `policy.onnx`: the policy without its noise as a graph of standard operations.

Written with ONNX's own library; decision 15 says why no exporter traces it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from core.algorithms.export.contract import as_text
from core.algorithms.export.network import NotExportable, PolicyLayer, PolicyNetwork

# The versions of 2021, which runtimes of phones and robots read, too.
_OPSET, _IR_VERSION = 15, 8
# A file of Protocol Buffers holds 2 GiB.
_MOST_BYTES = 2**31 - 2**20
NO_METADATA: Mapping[str, str] = {}


class Graph:
    """Nodes and constants, gathered in the order of evaluation; values are known by their names."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, name: str, value: NDArray[np.float32] | Sequence[float] | float) -> str:
        self.constants.append(numpy_helper.from_array(np.asarray(value, np.float32), name))
        return name

    def places(self, name: str, value: Sequence[int]) -> str:
        """Indices for `Gather`."""
        self.constants.append(numpy_helper.from_array(np.asarray(value, np.int64), name))
        return name

    def add(self, operation: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """The name of the operation's output."""
        name = output or f"{operation.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operation, inputs, [name], name=name, **attributes))
        return name


def onnx_file(
    network: PolicyNetwork, about: Mapping[str, Any], metadata: Mapping[str, str] = NO_METADATA
) -> bytes:
    """`observation` [batch, observation_size] ↦ `action` [batch, action_size], both float32.

    The contract is the metadata `about`, as JSON text; metadata: more. Equal networks give equal bytes.
    Raises NotExportable where the network does not fit into a file.
    """
    graph = Graph()
    add_policy(graph, network, "observation")
    inputs = [array("observation", network.observation_size)]
    metadata = {**metadata, "about": as_text(about)}
    return model_file(graph, inputs, [array("action", network.action_size)], metadata)


def add_policy(graph: Graph, network: PolicyNetwork, observation: str) -> None:
    """The value `action`, by the network. Raises NotExportable where the network does not fit into a file."""
    if network.size_bytes > _MOST_BYTES:
        raise NotExportable(f"its network has {network.size_bytes:,} bytes, and an ONNX file holds 2 GiB")
    values = _normalized(graph, network, observation)
    if network.encoder:
        seen, others = (
            graph.add("Gather", values, graph.places(name, numbers), axis=1)
            for name, numbers in (("encoded", network.encoded), ("not_encoded", network.not_encoded))
        )
        latent = _means(graph, seen, network.encoder, network.activation, "encoder_")
        values = graph.add("Concat", latent, others, axis=1)
    location = _means(graph, values, network.layers, network.activation)
    graph.add("Tanh", location, output="action")


def model_file(
    graph: Graph, inputs: Sequence[Any], outputs: Sequence[Any], metadata: Mapping[str, str]
) -> bytes:
    """A checked file of the graph. inputs, outputs: made by `array`."""
    model = helper.make_model(
        helper.make_graph(graph.nodes, "policy", inputs, outputs, graph.constants),
        producer_name="gaitway",
        opset_imports=[helper.make_opsetid("", _OPSET)],
        ir_version=_IR_VERSION,
    )
    helper.set_model_props(model, dict(metadata))
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString(deterministic=True)


def array(name: str, size: int) -> Any:
    """An input or output, float32 [batch, size]."""
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size])


def _normalized(graph: Graph, network: PolicyNetwork, observation: str) -> str:
    centred = graph.add("Sub", observation, graph.constant("observation_mean", network.mean))
    deviations = graph.add("Div", centred, graph.constant("observation_std", network.std))
    if network.max_abs is None:
        return deviations
    bounds = (graph.constant("least", -network.max_abs), graph.constant("most", network.max_abs))
    return graph.add("Clip", deviations, *bounds)


def _means(
    graph: Graph, values: str, layers: Sequence[PolicyLayer], activation: str, prefix: str = ""
) -> str:
    """The first half of the last layer's outputs; the other half are deviations."""
    for number, layer in enumerate(layers):
        is_last = number == len(layers) - 1
        wanted = slice(len(layer.bias) // 2) if is_last else slice(None)
        kernel = graph.constant(f"{prefix}kernel_{number}", layer.kernel[:, wanted])
        bias = graph.constant(f"{prefix}bias_{number}", layer.bias[wanted])
        values = graph.add("Gemm", values, kernel, bias)
        if not is_last:
            values = ACTIVATIONS[activation](graph, values)
    return values


def _one(operation: str, **attributes: Any) -> Callable[[Graph, str], str]:
    """An activation that is a single operation."""
    return lambda graph, x: graph.add(operation, x, **attributes)


def _swish(graph: Graph, x: str) -> str:
    return graph.add("Mul", x, graph.add("Sigmoid", x))


def _gelu(graph: Graph, x: str) -> str:
    """x/2 · (1 + tanh(√(2/π) (x + 0.044715 x³))), as `jax.nn.gelu` has it unless it is told otherwise."""

    def number(value: float) -> str:
        return graph.constant(f"number_{len(graph.constants)}", value)

    cube = graph.add("Mul", x, graph.add("Mul", x, x))
    inner = graph.add("Add", x, graph.add("Mul", cube, number(0.044715)))
    bent = graph.add("Tanh", graph.add("Mul", inner, number(math.sqrt(2 / math.pi))))
    share = graph.add("Mul", graph.add("Add", bent, number(1.0)), number(0.5))
    return graph.add("Mul", x, share)


# By Brax's names. The attributes are the values that `jax.nn` has.
ACTIVATIONS: Mapping[str, Callable[[Graph, str], str]] = {
    "swish": _swish,
    "relu": _one("Relu"),
    "tanh": _one("Tanh"),
    "elu": _one("Elu", alpha=1.0),
    "gelu": _gelu,
    "leaky_relu": _one("LeakyRelu", alpha=0.01),
    "selu": _one("Selu", alpha=1.6732632423543772848170429916717, gamma=1.0507009873554804934193349852946),
    "sigmoid": _one("Sigmoid"),
    "softplus": _one("Softplus"),
}
