"""What uneven ground costs: physics steps of the fast engine over a field and on a flat floor.

    python benchmarks/ground.py [--envs 512] [--rounds 1000]

Feet alone touch, or knees too, or those and the trunk. The field is that of ten kinds at ten
levels, 88 x 88 m, and the robots stand all over it. Rounds alternate and are short, and the least
time of each counts: what else a machine does only ever adds to it.
"""

import dataclasses
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.shared import make_fast_step, make_parser, map_over_cores, measure_in_turn
from quadwalk.cores import count_cores
from quadwalk.learn.devices import set_up_devices
from quadwalk.physics.fast import make_model
from quadwalk.physics.model import Model, add_ground
from quadwalk.physics.motor import MotorConfig, PhysicsState, Stepping, make_motor
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.terrain.terrain import FLAT, make_terrain
from quadwalk.terrain.tiles import KINDS

STEPPING = Stepping(dt=0.004, substeps=1, iterations=4, line_search=1)


def main() -> None:
    """Print what a physics step costs on a field and on a flat floor, microseconds of a core."""
    parser = make_parser(__doc__)
    parser.add_argument("--envs", type=int, default=512)
    parser.add_argument("--steps", type=int, default=10, help="physics steps in a round")
    parser.add_argument("--rounds", type=int, default=1000)
    options = parser.parse_args()
    set_up_devices()

    quadruped = load_quadruped()
    terrain = make_terrain(dataclasses.replace(FLAT, kinds=tuple(KINDS)), leg=0.5)
    rng = np.random.default_rng(0)
    qpos = np.tile(quadruped.home, (options.envs, 1))
    places = [tile.middle for tile in terrain.tiles]
    qpos[:, :2] = np.resize(places, (options.envs, 2)) + rng.uniform(-3, 3, (options.envs, 2))
    raised = qpos + terrain.field.compute_height(qpos[:, :2])[:, None] * np.eye(19)[2]
    qvel = rng.normal(0, 0.5, (options.envs, 18))
    torques = jnp.asarray(rng.normal(0, 5, (options.envs, options.steps, 12)), jnp.float32)

    def make_measure(model: Model, qpos: np.ndarray) -> Callable[[], float]:
        program = map_over_cores(make_fast_step(model, STEPPING))
        state = PhysicsState(jnp.asarray(qpos, jnp.float32), jnp.asarray(qvel, jnp.float32))

        def measure() -> float:
            began = time.perf_counter()
            jax.block_until_ready(program(state, torques))
            return time.perf_counter() - began

        return measure

    measures = {}
    for contacts in ("feet", "knees", "body"):
        mj_model = quadruped.make_training_model(STEPPING.dt, 2, 3, contacts)
        model = make_model(mj_model, quadruped, make_motor(mj_model, quadruped, MotorConfig()))
        measures[f"{contacts}, flat floor"] = make_measure(model, qpos)
        measures[f"{contacts}, field"] = make_measure(add_ground(model, terrain.field), raised)
    least = {name: times.min() for name, times in measure_in_turn(measures, options.rounds).items()}
    print(f"{options.envs} robots, {count_cores()} cores, the least of {options.rounds} rounds")
    for name, seconds in least.items():
        ratio = seconds / least[name.replace("field", "flat floor")]
        cost = 1e6 * seconds / (options.envs * options.steps) * count_cores()
        print(f"{name:18}{cost:7.2f} microseconds of a core{ratio:7.2f} x flat")


if __name__ == "__main__":
    main()
