"""A policy as an ONNX graph: normalizer, network and action map, from `obs` to joint targets.

The input is laid out as Isaac Lab, mjlab and unitree_rl_lab do: one part of the observation after
another, each with its history from the oldest step to the newest. The graph puts it in the order
that the policy was trained on. The batch is one, which unitree_rl_lab's runtime expects, and
`actions` is the first output, the one that it reads.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UserError
from quadwalk.export.joint_targets import JointTargets
from quadwalk.learn.acting import SURE, phases
from quadwalk.learn.networks import MIN_STD, divisors
from quadwalk.settings.training import PPOConfig

OPSET = 17
IR_VERSION = 8  # that of the opset, so that older runtimes read it: ONNX Runtime 1.12 and later

# Activations by their names in Brax, as ONNX operators one after another; `x *` is a product with
# the activation's input.
ACTIVATIONS = {
    "linear": (),
    "relu": ("Relu",),
    "tanh": ("Tanh",),
    "sigmoid": ("Sigmoid",),
    "elu": ("Elu",),
    "celu": ("Celu",),
    "selu": ("Selu",),
    "softplus": ("Softplus",),
    "swish": ("Sigmoid", "x *"),
    "silu": ("Sigmoid", "x *"),
}


@dataclass(frozen=True)
class Weights:
    """What a policy learned: its normalizer and its layers."""

    mean: np.ndarray  # (n,)
    std: np.ndarray  # (n,) of what varied, else 1
    layers: list[tuple[np.ndarray, np.ndarray]]  # kernel (in, out) and bias (out,) of each
    activation: str  # of all layers but the last
    # the last layer's other half, which gives the noise's spread, and its scale; None: no noise
    noise: tuple[np.ndarray, np.ndarray, float] | None = None

    @classmethod
    def of(cls, act: Any, config: PPOConfig) -> "Weights":
        """Those of `Policy.act`; the last layer gives the 12 means of the actions alone."""
        normalizer, params = act.args
        found = [params["params"][f"hidden_{k}"] for k in range(len(params["params"]))]
        layers = [(np.asarray(layer["kernel"]), np.asarray(layer["bias"])) for layer in found]
        (kernel, kernel_std), (bias, bias_std) = (np.split(x, 2, axis=-1) for x in layers[-1])
        layers[-1] = kernel, bias
        noise = (kernel_std, bias_std, config.std_scale) if config.stochastic else None
        spread = np.asarray(divisors(normalizer))
        return cls(np.asarray(normalizer.mean), spread, layers, config.activation, noise)


def input_labels(env: QuadrupedEnv) -> list[str]:
    """A name for each number of the input `obs`; `gravity_x[-2]` is of two steps before."""
    return [
        f"{label}[-{ago}]" if ago else label
        for name, labels in env.sensors.part_names.items()
        for ago in range(env.config.observation[name].history, -1, -1)
        for label in labels
    ]


def input_order(env: QuadrupedEnv) -> np.ndarray:
    """(n,) where in the input `obs` each number stands of the observation trained on."""
    place = {label: index for index, label in enumerate(input_labels(env))}
    return np.array([place[label] for label in env.sensors.names], np.int64)


def build_model(
    weights: Weights, order: np.ndarray, targets: JointTargets, metadata: Mapping[str, str]
) -> onnx.ModelProto:
    """The policy as an ONNX model.

    Inputs: `obs` (1, n), and, where targets depend on them, `joint_pos` (1, 12), rad. Outputs:
    `actions` (1, 12) in [-1, 1] and `joint_targets` (1, 12), rad. All are float32.
    """
    if weights.activation not in ACTIVATIONS:
        raise UserError(
            f"the activation {weights.activation!r} cannot be exported; expected one of "
            f"{', '.join(ACTIVATIONS)}"
        )
    graph = _Graph()
    x = graph.add("Gather", "obs", graph.constant("order", order), axis=1)
    x = graph.add("Sub", x, graph.constant("mean", weights.mean))
    x = seen = graph.add("Div", x, graph.constant("std", weights.std))
    for index, (kernel, bias) in enumerate(weights.layers):
        y = x
        for operator in ACTIVATIONS[weights.activation] if index else ():
            y = graph.add("Mul", x, y) if operator == "x *" else graph.add(operator, y)
        names = [graph.constant(f"{kind}_{index}", v) for kind, v in (("w", kernel), ("b", bias))]
        x = graph.add("Gemm", y, *names)
    if weights.noise is not None:
        x = graph.add("Add", x, _noise(graph, weights, y, seen))
    actions = graph.add("Tanh", x, name="actions")
    x = graph.add("Mul", actions, graph.constant("scale", targets.scale))
    x = graph.add("Add", x, graph.constant("offset", targets.offset))
    x = graph.add("Max", x, graph.constant("lower", targets.lower))
    last = "joint_targets" if targets.reach is None else ""
    x = graph.add("Min", x, graph.constant("upper", targets.upper), name=last)
    inputs = {"obs": len(order)}
    if targets.reach is not None:
        inputs["joint_pos"] = 12
        reach = graph.constant("reach", targets.reach)
        x = graph.add("Max", x, graph.add("Sub", "joint_pos", reach))
        graph.add("Min", x, graph.add("Add", "joint_pos", reach), name="joint_targets")
    return graph.model(inputs, {"actions": 12, "joint_targets": 12}, metadata)


def _noise(graph: "_Graph", weights: Weights, y: str, seen: str) -> str:
    """What `acting.make_policy` adds to the means; `y` is the input of the last layer."""
    assert weights.noise is not None
    kernel, bias, scale = weights.noise
    names = graph.constant("w_std", kernel), graph.constant("b_std", bias)
    x = graph.add("Softplus", graph.add("Gemm", y, *names))
    x = graph.add("Add", x, graph.constant("least", np.array([MIN_STD])))
    std = graph.add("Mul", x, graph.constant("std_scale", np.array([scale])))
    unsure = graph.add("Greater", std, graph.constant("sure", np.array([SURE])))
    x = graph.constant("phases", phases(len(weights.mean), len(bias)))
    x = graph.add("Sin", graph.add("MatMul", seen, x))
    x = graph.add("Mul", x, graph.constant("root", np.sqrt([2.0])))
    return graph.add("Where", unsure, graph.add("Mul", std, x), graph.constant("none", np.zeros(1)))


class _Graph:
    """Nodes and constants, collected."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, name: str, value: np.ndarray) -> str:
        kind = np.int64 if value.dtype == np.int64 else np.float32
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value, kind), name))
        return name

    def add(self, operator: str, *inputs: str, name: str = "", **attributes: Any) -> str:
        name = name or f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], name, **attributes))
        return name

    def model(
        self, inputs: dict[str, int], outputs: dict[str, int], metadata: Mapping[str, str]
    ) -> onnx.ModelProto:
        given, found = (
            [
                helper.make_tensor_value_info(n, TensorProto.FLOAT, [1, size])
                for n, size in x.items()
            ]
            for x in (inputs, outputs)
        )
        graph = helper.make_graph(self.nodes, "policy", given, found, initializer=self.constants)
        model = helper.make_model(
            graph,
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
            producer_name="quadwalk",
        )
        helper.set_model_props(model, dict(metadata))
        onnx.checker.check_model(model, full_check=True)
        return model
