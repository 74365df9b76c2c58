"""A robot that lives: its policy and MuJoCo C, a control step at a time, changed while it runs."""

import math
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.env.command import Command
from quadwalk.env.env import MAX_SPEED, QuadrupedEnv
from quadwalk.env.randomization import EpisodeRandomization, delayed, targets_needed
from quadwalk.env.reset import nominal_start
from quadwalk.env.robot_arrays import STANDING_HEIGHT, STANDING_TILT
from quadwalk.env.state import EnvState
from quadwalk.evaluation.load import LoadedRun
from quadwalk.evaluation.mcap.foot_forces import compute_foot_forces, find_floor_and_feet
from quadwalk.evaluation.metrics import rotate_planar
from quadwalk.evaluation.rollout import ActionFunction
from quadwalk.learn.acting import Policy as TrainedPolicy
from quadwalk.physics.model import RobotRandomization, randomize_motor
from quadwalk.physics.motor import Motor, PhysicsState, run_control_step
from quadwalk.physics.mujoco_c import randomize_model

MAX_LATENCY = 0.06  # s, that joint targets can be late
LYING = 2.0  # s on the ground after which a robot that fell is put on its feet
RISING = 10.0  # s that a policy has to get up before it is put on its feet
STEADY = 0.5  # s that it must stand before it drives on
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
    payload: float = 0.0  # kg, in the trunk's center of mass
    strength: float = 1.0  # factor of the motors' torque
    latency: float = 0.0  # s, of joint targets
    noise: float = 0.0  # level of the sensor noise; 1 is what the task states

    def variation(self) -> RobotRandomization:
        """How robot and floor differ from the model."""
        same = _number(1.0)
        return RobotRandomization(
            friction=_number(self.friction),
            trunk_mass=_number(self.payload),
            trunk_center=np.zeros(3, np.float32),
            link_mass=np.ones(12, np.float32),
            strength=_number(self.strength),
            kp=same,
            kd=same,
            joint_friction=same,
            damping=same,
            armature=same,
        )


class _Mind:
    """A policy with its task, and what it remembers of earlier control steps."""

    def __init__(self, loaded: LoadedRun) -> None:
        self.env, self.policy = loaded.env, loaded.policy
        self.think = jax.jit(_think, compiler_options=_OPTIONS)
        earlier = max(part.history for part in self.env.config.observation.values())
        size = self.env.sensors.noise_scale.size
        # Room for what was measured in earlier control steps; None if the policy sees only one.
        self._no_frames = np.zeros((1 + earlier, size), np.float32) if earlier else None
        self.begin()

    def begin(self) -> None:
        env = self.env
        self.steps = 0
        self.action: Any = np.zeros(12, np.float32)
        self.frames: Any = self._no_frames
        kept = targets_needed(math.ceil(MAX_LATENCY / env.stepping.dt), env.stepping.substeps)
        self.targets: Any = np.tile(np.float32(env.robot.home_joints), (kept, 1))


class LiveRobot:
    """One robot with its policy, in MuJoCo C with every collision shape.

    `command` (3,) is the velocity command: forward and lateral velocity in the frame of the
    heading, m/s, the latter to the left, and yaw rate, rad/s. All else is read from `data`,
    `foot_force` (4,) N, and the properties. `loaded` is a run loaded for the engine "mujoco". On
    ground that is not flat, `tile` is the index of the terrain's tile that it starts on. Where it
    has fallen the policy of `getup`, a run of the same robot, gets it up.
    """

    def __init__(self, loaded: LoadedRun, seed: int = 0, getup: LoadedRun | None = None) -> None:
        self.env = loaded.env
        self._driver, self._riser = _Mind(loaded), None if getup is None else _Mind(getup)
        self.name = loaded.run.name
        self.settings = Settings(friction=self.env.friction)
        self.command = np.zeros(3)
        self.foot_force = np.zeros(4)
        self._base = self.env.mj_model_of(self.env.quadruped)
        self.model = self._base
        self._variation: RobotRandomization | None = None  # None: nothing was changed
        self.data = mujoco.MjData(self._base)
        self._key = np.array([0, seed], np.uint32)
        self._first_pose = nominal_start(self._base, self.env.quadruped, self.env.config.reset)
        self._feet = find_floor_and_feet(self._base, self.env.quadruped.feet)
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
        self.steps, self._fallen, self._standing = 0, 0, 0
        self.foot_force = np.zeros(4)
        self._take_over(self._driver)

    def prepare(self) -> None:
        """Compile what its policies need, so that no step waits for it, and reset."""
        for mind in filter(None, (self._driver, self._riser)):
            self._take_over(mind)
            self.step()
        self.reset()

    def _take_over(self, mind: _Mind) -> None:
        self._mind = mind
        mind.begin()

    @property
    def policy(self) -> TrainedPolicy:
        """The policy that drives."""
        return self._driver.policy

    @policy.setter
    def policy(self, policy: TrainedPolicy) -> None:
        self._driver.policy = policy

    @property
    def _motor(self) -> Motor:
        """The motors, with the gains of the policy that acts."""
        motor = self._mind.env.motor
        return motor if self._variation is None else randomize_motor(motor, self._variation)

    @property
    def rising(self) -> bool:
        return self._mind is self._riser

    def change(self, **settings: float) -> None:
        """Change some of `settings`, with effect from the next step on."""
        self.settings = replace(self.settings, **settings)
        self._variation = self.settings.variation()
        self.model = randomize_model(self._base, self._variation)

    def push(self, forward: float, left: float) -> None:
        """Change the trunk's velocity in an instant, m/s along its heading and to its left."""
        self.data.qvel[:2] += rotate_planar((forward, left), self.heading)

    def throw(self) -> None:
        """A push that throws it over."""
        self.push(0.0, 3.5)
        self.data.qvel[3] -= 12.0  # rad/s

    def step(self) -> None:
        """One control step. A robot that fell gets up, or is put on its feet after `LYING` s."""
        data, mind = self.data, self._mind
        thought = jax.device_get(mind.think(mind.env, mind.policy.act, self.state()))
        mind.frames, mind.targets, mind.action, applied_target = thought
        physics = PhysicsState(data.qpos.copy(), data.qvel.copy())
        run_control_step(
            self._motor,
            self.env.stepping,
            physics,
            np.asarray(applied_target, float),
            self._advance,
        )
        self.foot_force = compute_foot_forces(self.model, data, self._feet)
        self.steps += 1
        mind.steps += 1
        diverged = np.abs(data.qvel).max() > MAX_SPEED or any(
            data.warning[kind].number
            for kind in _DIVERGED  # MuJoCo has begun anew, elsewhere
        )
        dt = self.env.stepping.control_dt
        self._fallen = self._fallen + 1 if self.fell or self.rising else 0
        upright = self._up[2] > math.cos(STANDING_TILT)
        stands = upright and self.height > STANDING_HEIGHT * self.env.robot.home_height
        self._standing = self._standing + 1 if stands else 0
        if diverged or self._fallen * dt > (RISING if self._riser else LYING):
            self.reset()
        elif self._riser and self.fell and not self.rising:
            self._take_over(self._riser)
        elif self.rising and self._standing * dt > STEADY:
            self._take_over(self._driver)

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
        return np.array([*rotate_planar(self.data.qvel[:2], -self.heading), turning])

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

    def _advance(self, state: PhysicsState, torque: Any) -> PhysicsState:
        """A physics step with joint torques (12,), Nm; `state` is where `data` is."""
        data = self.data
        data.qfrc_applied[6:] = torque
        mujoco.mj_step(self.model, data)
        return state._replace(qpos=data.qpos.copy(), qvel=data.qvel.copy())

    def state(self) -> EnvState:
        """What the task's functions read, of single precision: the compiled program's input."""
        data, settings = self.data, self.settings
        key, nothing = _number(self._key, np.uint32), _number(np.zeros(18))
        conditions = EpisodeRandomization(
            variation=settings.variation(),
            delay=_number(settings.latency / self.env.stepping.dt),
            sensor_delay=None,
            push=nothing[:2],
            noise=_number(settings.noise),
            encoder=nothing[:12],
            tilt=nothing[:3],
            targets=self._mind.targets,
            key=key,
        )
        mind = self._mind
        commanded = mind.env.config.command.active
        return EnvState(
            physics=PhysicsState(_number(data.qpos), _number(data.qvel)),
            last_action=mind.action,
            steps=_number(mind.steps, np.int32),
            command=Command(_number(self.command), key) if commanded else None,
            conditions=conditions,
            frames=mind.frames,
            contact=_number(self.foot_force > 0.0, bool),
            tile=None if mind.env.terrain is None else _number(self.tile, np.int32),
        )


def _number(value: Any, kind: Any = np.float32) -> Any:
    """A NumPy array for what is typed as JAX's, which a compiled program takes as well."""
    return np.asarray(value, kind)


def _think(env: QuadrupedEnv, policy: ActionFunction, state: EnvState) -> tuple[Any, Any, Any, Any]:
    """What happens in a control step before the physics, from the task's own functions.

    The frames and joint targets to be kept, the action, and the joint targets (substeps, 12)
    obeyed in each physics step, rad.
    """
    state = env.sensors.measure(env.robot, state)
    if state.frames is not None:
        before = jnp.where(state.steps == 0, state.frames[:1], state.frames)
        state = state._replace(frames=before)
    assert state.conditions is not None
    action = policy(env.sensors.observe(env.robot, state))
    target = env.config.action(env.robot, action, state.qpos[7:])
    substeps = env.stepping.substeps
    conditions, applied_target = delayed(state.conditions, target, substeps, state.steps)
    return state.frames, conditions.targets, action, applied_target
