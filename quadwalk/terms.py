"""The terms of tasks: the public place from which a task file imports them.

`rewards`, `observations`, `terminations` and `actions` are modules with the package's functions and
groups of terms. A term is one of these functions, or one of your own, with its numbers.
"""

from quadwalk.env import actions, observations, rewards, terminations
from quadwalk.env.reflections import AXIAL, FEET, JOINTS, LATERAL, LINKS, SCALAR, VECTOR, mirrors
from quadwalk.env.state import EnvState, RobotConstants, Step, needs_strides
from quadwalk.settings.terms import ActionMap, Observation, Reward, Termination

__all__ = [
    "AXIAL",
    "FEET",
    "JOINTS",
    "LATERAL",
    "LINKS",
    "SCALAR",
    "VECTOR",
    "ActionMap",
    "EnvState",
    "Observation",
    "Reward",
    "RobotConstants",
    "Step",
    "Termination",
    "actions",
    "mirrors",
    "needs_strides",
    "observations",
    "rewards",
    "terminations",
]
