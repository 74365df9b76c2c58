"""Loading a run's policy with its robot and environment, to evaluate, drive or export it."""

import dataclasses
import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.nearness import describe_robot
from quadwalk.env.terminations import TRUNK_FALLS
from quadwalk.errors import UserError
from quadwalk.evaluation.rollout import Command
from quadwalk.files import hash_file, read_bytes
from quadwalk.learn.acting import Policy, load_policy, make_policy
from quadwalk.learn.one_robot import (
    Translation,
    make_one_robot_config,
    to_one_robot,
    translate_observations,
)
from quadwalk.physics.engines import EngineName
from quadwalk.robot.load import load_robot
from quadwalk.robot.quadruped import Quadruped
from quadwalk.runs.directory import Run
from quadwalk.runs.resume import compare_robot
from quadwalk.settings.environment import (
    NO_RANDOMIZATION,
    PHYSICS,
    REAL_WORLD,
    EnvConfig,
    RandomizationConfig,
)
from quadwalk.settings.terms import Termination
from quadwalk.settings.training import RobotConfig
from quadwalk.terrain.terrain import GroundConfig

PUSH_SECONDS = 5.0  # one push in each


def describe_desk(policy: Policy) -> str:
    """Return a line with the settings that were changed while the policy was trained."""
    parts = (f"{name} {x['start']} -> {x['now']}" for name, x in policy.changed.items())
    return f"changed at the desk: {', '.join(parts)}"


@dataclass(frozen=True)
class LoadedRun:
    """A policy and the environment to roll it out in."""

    run: Run
    file: Path  # that the policy was read from
    policy: Policy
    env: QuadrupedEnv
    sha256: str  # of that file
    config: bytes | None = None  # of the run's config.json; None: it has none
    # lines on its robot: what was left out or assumed, and that it is not the one trained on
    notes: tuple[str, ...] = ()

    def to_mujoco(self, **changes: Any) -> "LoadedRun":
        """Return the same policy and robot in MuJoCo C, with `changes` of the settings in `env`."""
        config = dataclasses.replace(self.env.config, **changes)
        env = QuadrupedEnv(self.env.quadruped, config, "mujoco")
        return dataclasses.replace(self, env=env)

    def to_engine(self, engine: EngineName) -> "LoadedRun":
        """Return the same policy, robot and settings in another engine."""
        return dataclasses.replace(self, env=self.env.to_engine(engine))

    def load_level_robot(self) -> Quadruped:
        """Return the robot without uneven ground, which is among the shapes of that in `env`."""
        if self.env.terrain is None:
            return self.env.quadruped
        return load_robot(self.policy.config.robot)

    def to_one_robot(self) -> "LoadedRun":
        """Return the same policy as one of its robot alone, if it is one of many bodies.

        Then it observes in meters, seconds and radians, without a description of the body.
        """
        if self.env.config.unit_leg is None:
            return self
        env, translation = _make_one_robot_env(self.env)
        statistics, params = self.policy.act.args  # type: ignore[attr-defined]
        params, statistics = to_one_robot(params, statistics, translation)
        policy = dataclasses.replace(
            self.policy,
            act=make_policy(self.policy.config.ppo, statistics, params),
            observation_size=env.policy_size,
        )
        return dataclasses.replace(self, env=env, policy=policy)

    def has_same_robot(self, other: "LoadedRun") -> bool:
        """Return True if both robots have the same joints, masses and control period."""
        env, other_env = self.env, other.env
        return (
            env.quadruped.joints == other_env.quadruped.joints
            and np.array_equal(env.mj_model.body_mass, other_env.mj_model.body_mass)
            and math.isclose(env.config.control_dt, other_env.config.control_dt)
        )


@functools.lru_cache(maxsize=8)
def _make_one_robot_env(many: QuadrupedEnv) -> tuple[QuadrupedEnv, Translation]:
    """Return the environment of one robot for one of many bodies, and what the latter observes."""
    one = QuadrupedEnv(many.quadruped, make_one_robot_config(many.config), many.engine)
    return one, translate_observations(many, one, "observation")


def find_robot_for(run: Run, loaded: LoadedRun) -> RobotConfig | None:
    """Return the robot of `loaded` if the policy of `run` is one of many bodies; else None.

    So `load_run` gets both policies for the same robot, if they can have it.
    """
    is_of_many = load_policy(run.policy).config.env.unit_leg is not None
    return loaded.policy.config.robot if is_of_many else None


def find_training_ranges(config: EnvConfig) -> RandomizationConfig:
    """Return the ranges of a task's domain randomization; `REAL_WORLD` where it had none."""
    ranges = config.randomization
    return REAL_WORLD if ranges == NO_RANDOMIZATION else ranges


def make_evaluation_ranges(config: EnvConfig, enabled: bool) -> RandomizationConfig:
    """Return the ranges of the training's randomization, without margin and ideal episodes.

    One push comes in each `PUSH_SECONDS`, whatever training had, so that runs compare. If not
    `enabled`, nothing is randomized.
    """
    return dataclasses.replace(
        find_training_ranges(config),
        enabled=enabled,
        push_seconds=PUSH_SECONDS,
        margin=0.0,
        ideal=0.0,
    )


def make_unseen_ground(trained: GroundConfig, seed: int, levels: int = 3) -> GroundConfig:
    """Return ground like that of training, from random numbers that training never draws.

    Each kind of tile is there once at each of `levels` difficulties. Unequal `seed` give unequal
    ground. A flat floor or a field from a file stays as it is.
    """
    if trained.flat or trained.file is not None:
        return dataclasses.replace(trained, curriculum=False)
    kinds = tuple(dict.fromkeys(trained.kinds))
    return dataclasses.replace(
        trained.make_unseen(seed), kinds=kinds, levels=levels, curriculum=False, confined=False
    )


def _choose_falls(trained: EnvConfig, ground: GroundConfig) -> dict[str, Termination]:
    """Return what is a fall in an evaluation on `ground`, of a policy of the settings `trained`.

    Where shins may touch the ground only the trunk counts: on edges that training did not have, and
    for robots whose shins end so close to the floor that they brush it at each bend of a knee.
    """
    is_new_ground = trained.ground.flat and not ground.flat
    may_touch = is_new_ground or trained.unit_leg is not None
    return TRUNK_FALLS if trained.termination and may_touch else trained.termination


def load_run(
    run: Run,
    seconds: float,
    which: str = "last",
    engine: EngineName = "mjx",
    randomized: bool = False,
    seed: int = 0,
    ground: GroundConfig | None = None,
    command: Command | None = None,
    robot: RobotConfig | None = None,
) -> LoadedRun:
    """Load the "last" or "best" policy of `run` for episodes of up to `seconds` in `engine`.

    Without `randomized` the robot is that of its model and nothing disturbs it. With it, each
    episode samples from the `make_evaluation_ranges`. A velocity command holds for a whole episode,
    so that the episode has one gait; it is `command` (forward and lateral velocity, m/s, and yaw
    rate, rad/s), or drawn from the training ranges. The ground is `ground`, or `make_unseen_ground`
    of `seed`. A policy of a flat floor falls on uneven ground only if its trunk touches it, and so
    does a policy of many bodies.

    A policy of many bodies may drive another `robot` than the run's. Raises `UserError` where
    policy or robot cannot be read, or do not match.
    """
    file = run.best if which == "best" else run.policy
    policy, sha256 = load_policy(file), hash_file(file)
    # Read before the simulation, not after it for the recordings, so that an error comes at once.
    config_json = read_bytes(run.config) if run.config.exists() else None
    trained = policy.config.env
    if robot is not None:
        if trained.unit_leg is None:
            raise UserError(
                f"--robot.urdf: {run.path} drives the robot that it was trained on; expected a run "
                "of the task universal, or a training: train.py TASK --init RUN --robot.urdf FILE"
            )
        policy = dataclasses.replace(policy, config=dataclasses.replace(policy.config, robot=robot))
    quadruped = load_robot(policy.config.robot)
    commands = dataclasses.replace(trained.command, seconds=seconds, soonest=None, margin=0.0)
    if command is not None:
        if not trained.command.active:
            raise UserError(f"{file} follows no velocity command; expected a task with commands")
        commands = commands.hold_at(*command)
    if ground is None:
        ground = make_unseen_ground(trained.ground, seed)
    config = dataclasses.replace(
        trained,
        episode_seconds=seconds,
        # The two iterations of earlier runs grip too well on slippery floors.
        solver_iterations=max(trained.solver_iterations, PHYSICS["solver_iterations"]),
        command=commands,
        randomization=make_evaluation_ranges(trained, randomized),
        ground=ground,
        termination=_choose_falls(trained, ground),
    )
    env = QuadrupedEnv(quadruped, config, engine)
    has_its_robot = robot is not None or quadruped.joints == policy.joints
    if not has_its_robot or env.policy_size != policy.observation_size:
        raise UserError(
            f"{file} was trained on another robot than {run.urdf}: it has joints "
            f"{', '.join(policy.joints)} and {policy.observation_size} observations"
        )
    gains = [env.gains_note] if env.gains_note else []
    changes = [describe_desk(policy)] if policy.changed else []
    differences = compare_robot(run, quadruped) if robot is None else ()
    table = () if robot is None else describe_robot(env)
    notes = (*quadruped.notes, *differences, *gains, *changes, *table)
    return LoadedRun(run, file, policy, env, sha256, config_json, notes)
