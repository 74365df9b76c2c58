"""A policy as an ONNX graph: normalizer, network and action map, from `obs` to joint targets.

The input is laid out as Isaac Lab, mjlab and unitree_rl_lab do: one part of the observation after
another, each with its history from the oldest step to the newest. The graph puts it in the order
that the policy was trained on. The batch is one, which unitree_rl_lab's runtime expects, and
`actions` is the first output, the one that it reads.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.state import RobotConstants
from quadwalk.errors import UserError
from quadwalk.learn.acting import make_phases
from quadwalk.learn.distribution import MIN_STD, SURE
from quadwalk.learn.statistics import compute_scale
from quadwalk.settings.terms import ActionMap
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

_SAMPLES = 1000  # random actions that an action map is checked on
_TOLERANCE = 1e-5  # rad


@dataclass(frozen=True)
class JointTargets:
    """An action map as numbers: joint targets are clip(offset + matrix @ action, lower, upper)."""

    matrix: np.ndarray  # (12, 12) rad per unit of action
    offset: np.ndarray  # (12,) rad
    lower: np.ndarray  # (12,) rad; -inf: no limit
    upper: np.ndarray  # (12,) rad; inf: no limit

    def __call__(self, action: np.ndarray) -> np.ndarray:
        """Return the targets (..., 12), rad, of actions (..., 12)."""
        return np.clip(self.offset + action @ self.matrix.T, self.lower, self.upper)

    @property
    def scale(self) -> np.ndarray | None:
        """(12,) rad per unit of action, where each joint has its own; None where some share one."""
        scale = np.diag(self.matrix)
        return scale if np.array_equal(self.matrix, np.diag(scale)) else None


def find_joint_targets(action_map: ActionMap, robot: RobotConstants) -> JointTargets:
    """Return the numbers that define `action_map`, checked with random actions.

    Raises `UserError` for a map that is no clipped linear function of the action, or depends on the
    joints' angles: no file format for policies can state it.
    """

    def compute(action: jax.Array, joints: jax.Array) -> jax.Array:
        return action_map(robot, action, joints)

    home = jnp.asarray(robot.home_joints, jnp.float32)
    offset = np.asarray(compute(jnp.zeros(12), home))
    matrix = np.asarray(jax.jacobian(compute)(jnp.zeros(12), home))

    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (_SAMPLES, 12)).astype(np.float32)
    joints = rng.uniform(robot.lower, robot.upper, (_SAMPLES, 12)).astype(np.float32)
    expected = jax.jit(jax.vmap(compute))(actions, joints)
    unlimited = np.full(12, np.inf)
    for lower, upper in ((robot.lower, robot.upper), (-unlimited, unlimited)):
        targets = JointTargets(matrix, offset, lower, upper)
        if np.max(np.abs(targets(actions) - expected)) < _TOLERANCE:
            return targets
    raise UserError(
        f"the action map {action_map.function.__name__} cannot be exported; expected joint targets "
        "that are clip(offset + matrix @ action), within the joints' limits or without any"
    )


@dataclass(frozen=True)
class Weights:
    """What a policy learned: its normalizer and its layers."""

    mean: np.ndarray  # (n,)
    std: np.ndarray  # (n,) of what varied, else 1
    layers: list[tuple[np.ndarray, np.ndarray]]  # kernel (in, out) and bias (out,) of each
    activation: str  # of all layers but the last
    # the last layer's other half, which gives the noise's spread, and its scale; None: no noise
    noise: tuple[np.ndarray, np.ndarray, float] | None = None


def extract_weights(act: Any, config: PPOConfig) -> Weights:
    """Return normalizer and layers of a policy as NumPy arrays; `act` is a `Policy.act`.

    The last layer gives only the 12 means of the actions; the layer for their noise is apart.
    """
    normalizer, params = act.args
    layers = []
    for number in range(len(params["params"])):
        layer = params["params"][f"hidden_{number}"]
        layers.append((np.asarray(layer["kernel"]), np.asarray(layer["bias"])))
    kernel, bias = layers.pop()
    kernel, kernel_std = np.split(kernel, 2, axis=-1)
    bias, bias_std = np.split(bias, 2, axis=-1)
    layers.append((kernel, bias))
    noise = (kernel_std, bias_std, config.std_scale) if config.stochastic else None
    std = np.asarray(compute_scale(normalizer))
    return Weights(np.asarray(normalizer.mean), std, layers, config.activation, noise)


def list_inputs(env: QuadrupedEnv) -> list[str]:
    """Return a name for each number of the graph's input; `gravity_x[-2]` is two steps old."""
    return [
        f"{name}[-{age}]" if age else name
        for part, names in env.sensors.part_names.items()
        for age in range(env.config.observation[part].history, -1, -1)
        for name in names
    ]


def compute_input_order(env: QuadrupedEnv) -> np.ndarray:
    """Return for each number of the observation trained on its index in the graph's input, (n,)."""
    places = {name: index for index, name in enumerate(list_inputs(env))}
    return np.array([places[name] for name in env.sensors.names], np.int64)


def build_model(
    weights: Weights, order: np.ndarray, targets: JointTargets, metadata: Mapping[str, str]
) -> onnx.ModelProto:
    """Return the policy as an ONNX model.

    `order` is that of `compute_input_order`. The input is `obs` (1, n). The outputs are `actions`
    (1, 12) in [-1, 1] and `joint_targets` (1, 12), rad. All are float32.
    """
    if weights.activation not in ACTIVATIONS:
        raise UserError(
            f"the activation {weights.activation!r} cannot be exported; expected one of "
            f"{', '.join(ACTIVATIONS)}"
        )
    graph = _Graph()
    x = graph.add("Gather", "obs", graph.add_constant("order", order), axis=1)
    x = graph.add("Sub", x, graph.add_constant("mean", weights.mean))
    normalized = graph.add("Div", x, graph.add_constant("std", weights.std))
    x = normalized
    for index, (kernel, bias) in enumerate(weights.layers):
        hidden = _add_activation(graph, x, weights.activation) if index else x
        names = graph.add_constant(f"w_{index}", kernel), graph.add_constant(f"b_{index}", bias)
        x = graph.add("Gemm", hidden, *names)
    if weights.noise is not None:
        x = graph.add("Add", x, _add_noise(graph, weights, hidden, normalized))
    actions = graph.add("Tanh", x, name="actions")
    if targets.scale is not None:
        x = graph.add("Mul", actions, graph.add_constant("scale", targets.scale))
    else:
        x = graph.add("MatMul", actions, graph.add_constant("matrix", targets.matrix.T))
    x = graph.add("Add", x, graph.add_constant("offset", targets.offset))
    x = graph.add("Max", x, graph.add_constant("lower", targets.lower))
    graph.add("Min", x, graph.add_constant("upper", targets.upper), name="joint_targets")
    return graph.to_model({"obs": len(order)}, {"actions": 12, "joint_targets": 12}, metadata)


def _add_activation(graph: "_Graph", x: str, activation: str) -> str:
    """Add an activation of the output `x` to the graph; return the name of its output."""
    y = x
    for operator in ACTIVATIONS[activation]:
        y = graph.add("Mul", x, y) if operator == "x *" else graph.add(operator, y)
    return y


def _add_noise(graph: "_Graph", weights: Weights, hidden: str, normalized: str) -> str:
    """Add nodes that compute the noise of actions before tanh; return the name of their output.

    A policy acts with noise where it is unsure, and without elsewhere (`acting.make_policy`). The
    noise is a function of the observation, the same in every runtime. `hidden` and `normalized` are
    names of outputs: the input of the last layer, and the normalized observation.
    """
    assert weights.noise is not None
    kernel, bias, scale = weights.noise
    names = graph.add_constant("w_std", kernel), graph.add_constant("b_std", bias)
    x = graph.add("Softplus", graph.add("Gemm", hidden, *names))
    x = graph.add("Add", x, graph.add_constant("least", np.array([MIN_STD])))
    std = graph.add("Mul", x, graph.add_constant("std_scale", np.array([scale])))
    unsure = graph.add("Greater", std, graph.add_constant("sure", np.array([SURE])))
    x = graph.add_constant("phases", make_phases(len(weights.mean), len(bias)))
    x = graph.add("Sin", graph.add("MatMul", normalized, x))
    x = graph.add("Mul", x, graph.add_constant("root", np.sqrt([2.0])))
    noise = graph.add("Mul", std, x)
    return graph.add("Where", unsure, noise, graph.add_constant("none", np.zeros(1)))


class _Graph:
    """The nodes and constants of a graph that is being built."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def add_constant(self, name: str, value: np.ndarray) -> str:
        """Add a constant, of int64 or else float32; return its name."""
        kind = np.int64 if value.dtype == np.int64 else np.float32
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value, kind), name))
        return name

    def add(self, operator: str, *inputs: str, name: str = "", **attributes: Any) -> str:
        """Add a node and return the name of its output."""
        name = name or f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], name, **attributes))
        return name

    def to_model(
        self, inputs: dict[str, int], outputs: dict[str, int], metadata: Mapping[str, str]
    ) -> onnx.ModelProto:
        """Return the graph as an ONNX model, checked; `inputs` and `outputs` map names to sizes n.

        Each is a tensor (1, n) of float32.
        """
        graph = helper.make_graph(
            self.nodes,
            "policy",
            [_declare(name, size) for name, size in inputs.items()],
            [_declare(name, size) for name, size in outputs.items()],
            initializer=self.constants,
        )
        model = helper.make_model(
            graph,
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
            producer_name="quadwalk",
        )
        helper.set_model_props(model, dict(metadata))
        onnx.checker.check_model(model, full_check=True)
        return model


def _declare(name: str, size: int) -> onnx.ValueInfoProto:
    """Return the declaration of an input or output (1, `size`) of float32."""
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size])
