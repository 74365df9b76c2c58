# /// script
# requires-python = "==3.11.*"
# dependencies = ["pybullet==3.2.7", "stable-baselines3>=2.7,<3"]
#
# [tool.uv]
# no-build = true
# ///
"""The blog post that quadwalk started from: its task in PyBullet, its learner; for `versus.py`.

Its AlienGo is that of `pybullet_data`; a control step is one physics step of 1/240 s. Four
processes (SubprocVecEnv) step it, Stable-Baselines3's PPO learns with its defaults. The last
PyBullet that is no source has a wheel for Python 3.11: this script needs no part of quadwalk, and
has packages of its own, which the comment above names to `uv run --script`.

For each line read it learns from one rollout of 4 x 2048 steps, and prints "turn", the steps, how
many seconds they simulate and how many they took. It prints one such line more when it is ready.
"""

import sys
import time
from typing import Any

import gymnasium
import numpy as np
import pybullet
import pybullet_data
from pybullet_utils.bullet_client import BulletClient
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import SubprocVecEnv

PROCESSES = 4

DT = 1.0 / 240.0  # s, PyBullet's default step
EPISODE_STEPS = 1000
START = (0.0, 0.0, 0.4)  # m
START_POSE = np.tile([0.0, np.pi / 4.0, -np.pi / 2.0], 4)  # rad: hip, thigh, calf
LOWER = np.tile([-1.2217, -1.0, -2.77507], 4)  # rad, target at action -1
UPPER = np.tile([1.2217, 1.0, -0.645772], 4)  # rad, target at action 1
REACH = 0.5  # rad, how far from its joint a target may be
TORQUE = 44.4  # Nm


class PyBulletTask(gymnasium.Env):
    """Observes base pose and velocity and joint angles and speeds; is rewarded for moving along x.

    The post clears its memory of the joints' last positions only when it is made; here each
    episode starts with those of its start.
    """

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (37,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (12,), np.float32)

    def __init__(self) -> None:
        self._bullet = BulletClient(pybullet.DIRECT)
        self._bullet.setAdditionalSearchPath(pybullet_data.getDataPath())
        self._bullet.setGravity(0.0, 0.0, -9.8)
        self._bullet.loadURDF("plane.urdf")
        self._robot = self._bullet.loadURDF("aliengo/aliengo.urdf", START)
        infos = [
            self._bullet.getJointInfo(self._robot, i)
            for i in range(self._bullet.getNumJoints(self._robot))
        ]
        self._joints = [info[0] for info in infos if info[2] == pybullet.JOINT_REVOLUTE]
        assert len(self._joints) == 12

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        """Start an episode, each at the same pose; return its first observation (37,), and {}."""
        super().reset(seed=seed)
        self._bullet.resetBasePositionAndOrientation(self._robot, START, (0.0, 0.0, 0.0, 1.0))
        self._bullet.resetBaseVelocity(self._robot, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        for joint, angle in zip(self._joints, START_POSE, strict=True):
            self._bullet.resetJointState(self._robot, joint, angle, 0.0)
        self._x, self._angles, self._steps = 0.0, START_POSE, 0
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Take one physics step to joint targets: `action` (12,), -1 to 1, from `LOWER` to `UPPER`.

        Targets are at most `REACH` from the joints' angles. Returns observation (37,), reward,
        whether it fell, whether time is up, and {}.
        """
        target = LOWER + (np.asarray(action, float) + 1.0) / 2.0 * (UPPER - LOWER)
        target = np.clip(target, self._angles - REACH, self._angles + REACH)
        self._bullet.setJointMotorControlArray(
            self._robot,
            self._joints,
            pybullet.POSITION_CONTROL,
            targetPositions=target,
            forces=[TORQUE] * 12,
        )
        self._bullet.stepSimulation()
        self._steps += 1
        before_x, before_angles = self._x, self._angles
        observation = self._observe()
        self._x, self._angles = float(observation[0]), observation[13:25].astype(float)
        roll, pitch, yaw = self._bullet.getEulerFromQuaternion(observation[3:7])
        tilt = max(abs(roll), abs(pitch))
        reward = (
            50.0 * (self._x - before_x)
            - 10.0 * (tilt > np.pi / 4.0)
            - 0.01 * abs(yaw)
            - 0.01 * float(np.abs(self._angles - before_angles).sum())
        )
        fell = bool(tilt > np.pi / 2.0 or observation[2] < 0.05)
        return observation, reward, fell, self._steps >= EPISODE_STEPS, {}

    def _observe(self) -> np.ndarray:
        """Return base pose and velocity, joint angles and speeds, as one array (37,).

        The first seven are position, m, and quaternion, xyzw. Six velocities follow, linear and
        angular in world axes, then 12 angles and 12 speeds; m, rad and s.
        """
        position, quaternion = self._bullet.getBasePositionAndOrientation(self._robot)
        linear, angular = self._bullet.getBaseVelocity(self._robot)
        states = self._bullet.getJointStates(self._robot, self._joints)
        angles, speeds = [state[0] for state in states], [state[1] for state in states]
        return np.array([*position, *quaternion, *linear, *angular, *angles, *speeds], np.float32)


def main() -> None:
    """Train once, then once more for each line of standard input, and print how long it took.

    Each time PPO collects one rollout and learns from it. The module says what is printed.
    """
    model = PPO("MlpPolicy", SubprocVecEnv([PyBulletTask] * PROCESSES), device="cpu", seed=0)
    steps = PROCESSES * model.n_steps
    ready = False
    while not ready or sys.stdin.readline():
        began = time.perf_counter()
        model.learn(steps, reset_num_timesteps=False)
        print("turn", steps, steps * DT, time.perf_counter() - began, flush=True)
        ready = True


if __name__ == "__main__":
    main()
