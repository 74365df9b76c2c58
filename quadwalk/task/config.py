"""Configuration of the environment: frozen dataclasses, one per concern, units in the comments.

None has defaults: what a task is made of stands in the task's own file (`quadwalk/tasks`).
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Literal

from quadwalk.errors import UsageError
from quadwalk.ground.terrain import FLAT, GroundConfig
from quadwalk.physics.motor import MotorConfig, Stepping
from quadwalk.task.terms import ActionMap, Observation, Reward, Termination

Range = tuple[float, float] | None

SIGHT = "height_scan"  # the observation that the blind do without


@dataclass(frozen=True)
class ResetConfig:
    """How much a fresh start differs from the home pose: each drawn uniformly from +-value."""

    # in place of the home pose: hip, thigh and calf of every leg, rad
    pose: tuple[float, float, float] | None
    height: float | None  # m, of the trunk's origin; None: the lowest foot just on the floor
    yaw: float  # rad
    tilt: float  # rad, roll and pitch
    offset: float  # m, along y
    joints: float  # rad
    velocity: float  # m/s and rad/s, trunk
    joint_velocity: float  # rad/s
    forward: float  # m/s, forward speed drawn from 0 to this


@dataclass(frozen=True)
class CommandConfig:
    """The velocity command: drawn uniformly from these (low, high), in the frame of the heading."""

    forward: tuple[float, float]  # m/s
    lateral: tuple[float, float]  # m/s, to the left
    yaw_rate: tuple[float, float]  # rad/s, to the left
    standing: float  # share of commands that are to stand still
    seconds: float  # s, after which another command is drawn
    straight: float = 0.0  # share of commands that are neither lateral nor to turn

    def __post_init__(self) -> None:
        for name in ("forward", "lateral", "yaw_rate"):
            value = getattr(self, name)
            if len(value) != 2 or not -math.inf < value[0] <= value[1] < math.inf:
                flag = f"env.command.{name.replace('_', '-')}"
                raise UsageError(f"{flag} is {value}; expected a low and a high end")
        for name in ("standing", "straight"):
            share = getattr(self, name)
            if not 0.0 <= share <= 1.0:
                raise UsageError(f"env.command.{name} is {share}; expected 0 to 1")
        if self.standing + self.straight > 1.0:
            raise UsageError(
                f"env.command.standing and straight are {self.standing} and {self.straight}; "
                "expected a sum of at most 1"
            )
        if not 0.0 < self.seconds < math.inf:
            raise UsageError(f"env.command.seconds is {self.seconds}; expected more than 0")

    @property
    def given(self) -> bool:
        """Whether there are commands at all."""
        return any((*self.forward, *self.lateral, *self.yaw_rate))


# Of a task without commands: the robot runs along world x.
NO_COMMAND = CommandConfig(
    forward=(0.0, 0.0), lateral=(0.0, 0.0), yaw_rate=(0.0, 0.0), standing=0.0, seconds=5.0
)


@dataclass(frozen=True)
class RandomisationConfig:
    """What differs from episode to episode: drawn uniformly from (low, high); None: not at all."""

    enabled: bool  # False: nothing does
    friction: Range  # sliding friction of floor and feet
    trunk_mass: Range  # added to the trunk, as a share of the robot's mass
    trunk_centre: Range  # its centre of mass's shift along each axis, share of the home height
    link_mass: Range  # factor, of each link of the legs
    strength: Range  # factor of the motors' torque
    kp: Range  # factor
    kd: Range  # factor
    joint_friction: Range  # factor
    damping: Range  # factor, of the joints
    armature: Range  # factor
    encoder: Range  # rad, of each joint angle's measurement
    imu_tilt: Range  # rad, of the IMU about each axis
    latency: Range  # s, of joint targets
    sensor_latency: Range  # s
    noise: Range  # level; 1 is what the observations state
    push: Range  # size of a push to any side, as a share of sqrt(gravity * home height)
    push_seconds: float = 5.0  # s: one push in each
    # While training, each end of a range is so much farther from the model's value, unless that is
    # into the range. An evaluation leaves it out: what is judged lies within what was learnt.
    margin: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.push_seconds < math.inf:
            flag = "--env.randomisation.push-seconds"
            raise UsageError(f"{flag} is {self.push_seconds}; expected more than 0")
        if not 0.0 <= self.margin <= 1.0:
            flag = "--env.randomisation.margin"
            raise UsageError(f"{flag} is {self.margin}; expected 0 to 1")
        ranges = {field.name for field in fields(self)} - {"enabled", "push_seconds", "margin"}
        for name in sorted(ranges):
            value = getattr(self, name)
            if value is None:
                continue
            flag = f"--env.randomisation.{name.replace('_', '-')}"
            if len(value) != 2 or not -math.inf < value[0] <= value[1] < math.inf:
                raise UsageError(f"{flag} is {value}; expected a low and a high end, or None")
            if name in ("latency", "sensor_latency", "friction", "push") and value[0] < 0.0:
                raise UsageError(f"{flag} is {value}; expected no less than 0")


# Of a task in an ideal world.
NO_RANDOMISATION = RandomisationConfig(
    enabled=False,
    friction=None,
    trunk_mass=None,
    trunk_centre=None,
    link_mass=None,
    strength=None,
    kp=None,
    kd=None,
    joint_friction=None,
    damping=None,
    armature=None,
    encoder=None,
    imu_tilt=None,
    latency=None,
    sensor_latency=None,
    noise=None,
    push=None,
)


@dataclass(frozen=True)
class EnvConfig:
    """The environment: physics, motors, and the task in it."""

    engine: Literal["fast", "mjx"]  # what steps the physics: quadwalk's own equations, or MJX
    gravity: float  # m/s^2
    physics_dt: float  # s, one physics step
    substeps: int  # physics steps in a control step
    solver_iterations: int  # Newton iterations of the contact solver (benchmarks/accuracy.py)
    line_search_iterations: int  # of each Newton iteration
    # what touches the floor; knees: they too; body: those and the trunk
    contacts: Literal["feet", "knees", "body"]
    episode_seconds: float  # s, the time limit
    motor: MotorConfig
    action: ActionMap
    observation: dict[str, Observation]  # what the policy sees
    critic: dict[str, Observation]  # what the value network sees besides, undisturbed
    reward: dict[str, Reward]
    termination: dict[str, Termination]
    reset: ResetConfig
    command: CommandConfig
    randomisation: RandomisationConfig
    # A run from before there was any other ground does not state it.
    ground: GroundConfig = FLAT
    # the robot has no camera: the observation `height_scan` is for the value network alone
    blind: bool = False

    def __post_init__(self) -> None:
        if self.gravity <= 0.0:
            raise UsageError(f"env.gravity is {self.gravity}; expected more than 0 m/s^2")
        if not 1e-4 <= self.physics_dt <= 0.02:
            raise UsageError(f"env.physics-dt is {self.physics_dt}; expected 0.0001 to 0.02 s")
        for name in ("substeps", "solver_iterations", "line_search_iterations"):
            if getattr(self, name) < 1:
                flag = f"env.{name.replace('_', '-')}"
                raise UsageError(f"{flag} is {getattr(self, name)}; expected 1 or more")
        for name, choices in (("engine", ("fast", "mjx")), ("contacts", ("feet", "knees", "body"))):
            if getattr(self, name) not in choices:
                raise UsageError(
                    f"env.{name} is {getattr(self, name)!r}; expected {' or '.join(choices)}"
                )
        if self.blind and SIGHT not in {**self.observation, **self.critic}:
            raise UsageError(f"env.blind: the task has no observation {SIGHT} to do without")
        if self.episode_steps < 1:
            raise UsageError(
                f"env.episode-seconds is {self.episode_seconds}; expected at least one control "
                f"step ({self.control_dt:g} s)"
            )

    @property
    def as_seen(self) -> "EnvConfig":
        """The same with each observation where it belongs: with what the blind do not see moved."""
        if not self.blind or SIGHT not in self.observation:
            return self
        seen = {name: part for name, part in self.observation.items() if name != SIGHT}
        critic = {**self.critic, SIGHT: self.observation[SIGHT]}
        return replace(self, observation=seen, critic=critic)

    @property
    def stepping(self) -> Stepping:
        """The physics steps of a control step."""
        return Stepping(
            self.physics_dt, self.substeps, self.solver_iterations, self.line_search_iterations
        )

    @property
    def control_dt(self) -> float:
        """Seconds of one control step."""
        return self.physics_dt * self.substeps

    @property
    def episode_steps(self) -> int:
        """Control steps in a full episode."""
        return round(self.episode_seconds / self.control_dt)

    @property
    def command_steps(self) -> int:
        """Control steps that a command stays."""
        return max(round(self.command.seconds / self.control_dt), 1)

    @property
    def push_steps(self) -> int:
        """Control steps of which one has a push."""
        return max(round(self.randomisation.push_seconds / self.control_dt), 1)
