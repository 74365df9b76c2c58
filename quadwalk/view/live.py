"""A robot that lives: its policy and MuJoCo C, a control step at a time, changed while it runs."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.evaluate.loaded import LoadedRun
from quadwalk.evaluate.motion.forces import foot_forces, geom_ids
from quadwalk.evaluate.motion.kinematics import turned
from quadwalk.evaluate.simulate import Policy
from quadwalk.physics.model import Variation, vary_motor
from quadwalk.physics.motor import Physics, control_step
from quadwalk.physics.mujoco_c import varied_model
from quadwalk.task.env import MAX_SPEED, QuadrupedEnv
from quadwalk.task.episode.command import Command
from quadwalk.task.episode.conditions import Conditions, delayed, targets_needed
from quadwalk.task.episode.reset import nominal_start
from quadwalk.task.state import EnvState

MAX_LATENCY = 0.06  # s, that joint targets can be late
LYING = 2.0  # s on the ground after which a robot that fell stands up anew
_TIPPED = 1.0  # rad from upright; from there and beyond it lies
_LOW = 0.4  # of the standing height; lower than that it lies
_DIVERGED = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
# It steps one robot: how fast the program is matters less than how soon it is compiled.
_OPTIONS: dict[str, bool | int | str] = {"xla_backend_optimization_level": 0}


@dataclass(frozen=True)
class Settings:
    """What can be changed of floor, robot and sensors while it runs."""

    friction: float  # sliding friction of floor and feet
    payload: float = 0.0  # kg, in the trunk's centre of mass
    strength: float = 1.0  # factor of the motors' torque
    latency: float = 0.0  # s, of joint targets
    noise: float = 0.0  # level of the sensor noise; 1 is what the task states

    def variation(self) -> Variation:
        """How robot and floor differ from the model."""
        same = _number(1.0)
        return Variation(
            friction=_number(self.friction),
            trunk_mass=_number(self.payload),
            trunk_centre=np.zeros(3, np.float32),
            link_mass=np.ones(12, np.float32),
            strength=_number(self.strength),
            kp=same,
            kd=same,
            joint_friction=same,
            damping=same,
            armature=same,
        )


class LiveRobot:
    """One robot with its policy, in MuJoCo C with every collision shape.

    `command` (3,) is the velocity command: forward and lateral velocity in the frame of the
    heading, m/s, the latter to the left, and yaw rate, rad/s. All else is read from `data`,
    `foot_force` (4,) N, and the properties. `loaded` is a run loaded for the engine "mujoco". On
    ground that is not flat, `tile` is the index of the terrain's tile that it starts on.
    """

    def __init__(self, loaded: LoadedRun, seed: int = 0) -> None:
        self.env = loaded.env
        self.policy = loaded.policy
        self.name = loaded.run.name
        self.settings = Settings(friction=self.env.friction)
        self.command = np.zeros(3)
        self.foot_force = np.zeros(4)
        self._base = self.env.mj_model_of(self.env.quadruped)
        self.model, self._motor = self._base, self.env.motor
        self.data = mujoco.MjData(self._base)
        self._key = np.array([0, seed], np.uint32)
        self._no_frames = _empty_frames(self.env)
        self._think = _compiled(self.env)
        self._first_pose = nominal_start(self._base, self.env.quadruped, self.env.config.reset)
        self._feet = geom_ids(self._base, self.env.quadruped.feet)
        self.tile = 0
        self.reset()

    def reset(self) -> None:
        """Stand in the task's first pose, at rest, on the ground of its tile."""
        env, data = self.env, self.data
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = self._first_pose
        if env.terrain is not None:
            data.qpos[:2] = env.terrain.tiles[self.tile].start
            mujoco.mj_kinematics(self.model, data)
            data.qpos[2] += self._ground(data.geom_xpos[list(self._feet[1:]), :2]).max()
        mujoco.mj_forward(self.model, data)
        self.steps, self._fallen = 0, 0
        self.foot_force = np.zeros(4)
        self._action: Any = np.zeros(12, np.float32)
        self._frames: Any = self._no_frames
        kept = targets_needed(math.ceil(MAX_LATENCY / env.stepping.dt), env.stepping.substeps)
        self._targets: Any = np.tile(np.float32(env.robot.home_joints), (kept, 1))

    def change(self, **settings: float) -> None:
        """Change some of `settings`, with effect from the next step on."""
        self.settings = replace(self.settings, **settings)
        variation = self.settings.variation()
        self.model = varied_model(self._base, variation)
        self._motor = vary_motor(self.env.motor, variation)

    def push(self, forward: float, left: float) -> None:
        """Change the trunk's velocity in an instant, m/s along its heading and to its left."""
        self.data.qvel[:2] += turned((forward, left), self.heading)

    def step(self) -> None:
        """One control step. A robot that fell stands up anew after `LYING` seconds."""
        data = self.data
        thought = jax.device_get(self._think(self.policy.act, self.state()))
        self._frames, self._targets, self._action, obeyed = thought
        physics = Physics(data.qpos.copy(), data.qvel.copy(), None)  # type: ignore[arg-type]
        control_step(
            self._motor, self.env.stepping, physics, np.asarray(obeyed, float), self._advance
        )
        self.foot_force = foot_forces(self.model, data, self._feet)
        self.steps += 1
        diverged = np.abs(data.qvel).max() > MAX_SPEED or any(
            data.warning[kind].number
            for kind in _DIVERGED  # MuJoCo has begun anew, elsewhere
        )
        self._fallen = self._fallen + 1 if self.fell else 0
        if diverged or self._fallen * self.env.stepping.control_dt > LYING:
            self.reset()

    @property
    def time(self) -> float:
        """s, since it last stood up."""
        return self.steps * self.env.stepping.control_dt

    @property
    def heading(self) -> float:
        """rad, of the trunk's x axis from world x about world z."""
        w, x, y, z = self.data.qpos[3:7]
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    @property
    def velocity(self) -> np.ndarray:
        """(3,) what a command speaks of: forward and lateral m/s, yaw rate rad/s."""
        turning = self.data.qvel[3:6] @ self._up
        return np.array([*turned(self.data.qvel[:2], -self.heading), turning])

    @property
    def height(self) -> float:
        """m, of the trunk's origin above the ground straight below."""
        return float(self.data.qpos[2] - self._ground(self.data.qpos[:2]))

    @property
    def fell(self) -> bool:
        """Whether it lies on the ground, tipped over or with its trunk low."""
        low = self.height < _LOW * self.env.robot.home_height
        return bool(self._up[2] < math.cos(_TIPPED) or low)

    @property
    def _up(self) -> np.ndarray:
        """(3,) the world's vertical, body frame."""
        up = np.zeros(3)
        mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), self.data.qpos[3:7] * [1, -1, -1, -1])
        return up

    def _ground(self, points: np.ndarray) -> np.ndarray:
        """Its height (...), m, at `points` (..., 2), m."""
        terrain = self.env.terrain
        return np.zeros(points.shape[:-1]) if terrain is None else terrain.field.height_at(points)

    def _advance(self, state: Physics, torque: Any) -> Physics:
        """A physics step with joint torques (12,), Nm; `state` is where `data` is."""
        data = self.data
        data.qfrc_applied[6:] = torque
        mujoco.mj_step(self.model, data)
        return state._replace(qpos=data.qpos.copy(), qvel=data.qvel.copy())

    def state(self) -> EnvState:
        """What the task's functions read, of single precision: the compiled program's input."""
        data, settings = self.data, self.settings
        key, nothing = _number(self._key, np.uint32), _number(np.zeros(18))
        conditions = Conditions(
            variation=settings.variation(),
            delay=_number(settings.latency / self.env.stepping.dt),
            sensor_delay=None,
            push=nothing[:2],
            noise=_number(settings.noise),
            encoder=nothing[:12],
            tilt=nothing[:3],
            targets=self._targets,
            key=key,
        )
        commanded = self.env.config.command.given
        return EnvState(
            physics=Physics(_number(data.qpos), _number(data.qvel), nothing),
            last_action=self._action,
            steps=_number(self.steps, np.int32),
            command=Command(_number(self.command), key) if commanded else None,
            conditions=conditions,
            frames=self._frames,
            contact=_number(self.foot_force > 0.0, bool),
            tile=None if self.env.terrain is None else _number(self.tile, np.int32),
        )


def _number(value: Any, kind: Any = np.float32) -> Any:
    """A NumPy array for what is typed as JAX's, which a compiled program takes as well."""
    return np.asarray(value, kind)


def _empty_frames(env: QuadrupedEnv) -> np.ndarray | None:
    """Room for what was measured in earlier control steps; None if the policy sees only one."""
    parts = env.config.observation
    earlier = max(part.history for part in parts.values())
    return np.zeros((1 + earlier, env.noise_scale.size), np.float32) if earlier else None


def _compiled(env: QuadrupedEnv) -> Callable[[Policy, EnvState], tuple[Any, Any, Any, Any]]:
    """What happens in a control step before the physics, from the task's own functions.

    Policy and state to: the frames and joint targets to be kept, the action, and the joint
    targets (substeps, 12) obeyed in each physics step, rad.
    """

    def think(env: QuadrupedEnv, policy: Policy, state: EnvState) -> tuple[Any, Any, Any, Any]:
        state = env.with_frame(state)
        if state.frames is not None:
            before = jnp.where(state.steps == 0, state.frames[:1], state.frames)
            state = state._replace(frames=before)
        assert state.conditions is not None
        action = policy(env.observation(state))
        target = env.config.action(env.robot, action, state.qpos[7:])
        conditions, obeyed = delayed(state.conditions, target, env.stepping.substeps, state.steps)
        return state.frames, conditions.targets, action, obeyed

    return env.jit(think, compiler_options=_OPTIONS)
