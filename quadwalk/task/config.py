"""Configuration of the environment: frozen dataclasses, one per concern, units in the comments."""

import math
from dataclasses import dataclass, field
from typing import Literal

from quadwalk.errors import UsageError


@dataclass(frozen=True)
class ActuationConfig:
    """How an action in [-1, 1] becomes joint torque."""

    # The joint controller's gains. By default they follow from the robot, so that a light one is
    # held as firmly as a heavy one: 120 Nm/rad and 3 Nm s/rad for the AlienGo.
    kp: float | None = None  # Nm/rad, position gain; by default weight * home height * 1.4
    kd: float | None = None  # Nm s/rad, velocity gain; by default kp * 0.025 s
    # Joint targets lie about the home pose, or between bounds ("range") with action 0 halfway.
    targets: Literal["home", "range"] = "home"
    hip_range: float = 0.3  # rad, how far action 1 moves a hip's target from the home pose
    thigh_range: float = 0.9  # rad, the same for a thigh
    calf_range: float = 0.9  # rad, the same for a calf
    hip_bounds: tuple[float, float] = (-1.2217, 1.2217)  # rad, a hip's target at action -1 and 1
    thigh_bounds: tuple[float, float] = (-1.0, 1.0)  # rad, a thigh's
    calf_bounds: tuple[float, float] = (-2.77507, -0.645772)  # rad, a calf's
    step_limit: float | None = None  # rad, how far from its joint a control step's target may be
    effort: float | None = None  # Nm, every motor's largest torque; by default the robot's own
    speed_limit: bool = True  # torque falls to zero at the motor's speed limit
    joint_friction: bool = True  # Coulomb friction of the joints

    def __post_init__(self) -> None:
        if self.targets not in ("home", "range"):
            raise UsageError(f"env.actuation.targets is {self.targets!r}; expected home or range")
        for name in ("hip_bounds", "thigh_bounds", "calf_bounds"):
            bounds = getattr(self, name)
            if len(bounds) != 2 or not bounds[0] < bounds[1]:
                flag = f"env.actuation.{name.replace('_', '-')}"
                raise UsageError(f"{flag} is {bounds}; expected the lower and the upper bound, rad")
        for name in ("step_limit", "effort"):
            value = getattr(self, name)
            if value is not None and value <= 0.0:
                flag = f"env.actuation.{name.replace('_', '-')}"
                raise UsageError(f"{flag} is {value}; expected more than 0, or None")


@dataclass(frozen=True)
class RewardConfig:
    """Scale of each reward term; a term with scale 0 is not computed."""

    forward: float = 1.0  # per m/s along world x, up to max_speed
    fall: float = -10.0  # once, when an episode ends by a fall
    yaw: float = -0.6  # per rad of heading away from world x, up to 1
    energy: float = -0.02  # per m/s of mechanical power over weight
    alive: float = 0.5  # per step
    lateral: float = -0.3  # per m/s sideways (world y), up to 1
    offset: float = -0.3  # per m away from the line y = 0, up to 1
    vertical: float = -0.3  # per (m/s)^2 up or down, up to 1
    tilt: float = -0.5  # per squared sine of the trunk's tilt
    turning: float = -0.1  # per rad/s of roll and pitch rate, up to 4
    action_rate: float = -0.1  # per mean squared change of the action
    follow: float = 0.0  # of 1 where the trunk's velocity is as commanded
    follow_turning: float = 0.0  # of 1 where it turns as fast as commanded
    drag: float = 0.0  # per m/s at which feet move along the floor or too close above it, up to 2
    trot: float = 0.0  # of 1 where diagonal feet are together on the floor or off it, but not all
    # The blog post's task has these four and no others.
    progress: float = 0.0  # per m along world x in the step
    inclined: float = 0.0  # per step with roll or pitch beyond 45 degrees
    heading: float = 0.0  # per rad of heading away from world x, without bound
    movement: float = 0.0  # per rad that joints moved in the step, all together
    max_speed: float = 7.0  # m/s, where forward reward ends
    follow_width: float = 0.5  # m/s and rad/s, an error that leaves 1/e of the reward to follow
    swing_height: float = 0.06  # m, from which on a moving foot is high enough

    def __post_init__(self) -> None:
        for name in ("follow_width", "swing_height"):
            if not getattr(self, name) > 0.0:
                flag = name.replace("_", "-")
                raise UsageError(
                    f"env.reward.{flag} is {getattr(self, name)}; expected more than 0"
                )


@dataclass(frozen=True)
class TerminationConfig:
    """When an episode ends by a fall; what is None ends none."""

    tilt: float | None = 1.0  # rad, angle between the trunk's and the world's z axis
    roll_pitch: float | None = None  # rad, the same of roll and of pitch, each for itself
    height: float | None = 0.45  # of the home height: the trunk's origin lower than this is a fall
    base_height: float | None = None  # m, in place of that share or beside it
    clearance: float | None = 0.0  # m, any shape but a foot lower than this touches the floor


@dataclass(frozen=True)
class ResetConfig:
    """How much a fresh start differs from the home pose: each drawn uniformly from +-value."""

    # In place of the home pose and of the lowest foot just on the floor:
    pose: tuple[float, float, float] | None = None  # rad, every leg's hip, thigh and calf
    height: float | None = None  # m, of the trunk's origin
    yaw: float = 0.3  # rad
    tilt: float = 0.1  # rad, roll and pitch
    offset: float = 0.3  # m, along y
    joints: float = 0.2  # rad
    velocity: float = 0.5  # m/s and rad/s, trunk
    joint_velocity: float = 0.5  # rad/s
    forward: float = 0.0  # m/s, forward speed drawn from 0 to this


@dataclass(frozen=True)
class CommandConfig:
    """The velocity that the robot is told to have, drawn uniformly from these (low, high).

    In the frame of its heading. By default it is told nothing, and runs along world x.
    """

    forward: tuple[float, float] = (0.0, 0.0)  # m/s
    sideways: tuple[float, float] = (0.0, 0.0)  # m/s, to the left
    turning: tuple[float, float] = (0.0, 0.0)  # rad/s, to the left
    standing: float = 0.1  # share of commands that are to stand still
    seconds: float = 5.0  # s, after which another command is drawn

    def __post_init__(self) -> None:
        for name in ("forward", "sideways", "turning"):
            value = getattr(self, name)
            if len(value) != 2 or not -math.inf < value[0] <= value[1] < math.inf:
                raise UsageError(f"env.command.{name} is {value}; expected a low and a high end")
        if not 0.0 <= self.standing <= 1.0:
            raise UsageError(f"env.command.standing is {self.standing}; expected 0 to 1")
        if not 0.0 < self.seconds < math.inf:
            raise UsageError(f"env.command.seconds is {self.seconds}; expected more than 0")

    @property
    def given(self) -> bool:
        """Whether the robot is told anything at all."""
        return any((*self.forward, *self.sideways, *self.turning))


@dataclass(frozen=True)
class EnvConfig:
    """The task: a quadruped runs along world x as fast as it can, or moves as it is told."""

    observation: Literal["body", "world"] = "body"  # what the policy sees, and in which frame
    gravity: float = 9.81  # m/s^2
    physics_dt: float = 0.004  # s, one physics step
    substeps: int = 5  # physics steps in a control step
    episode_seconds: float = 20.0  # s, the time limit
    solver_iterations: int = 2  # Newton iterations of the contact solver (benchmarks/accuracy.py)
    line_search_iterations: int = 3
    contacts: Literal["feet", "body"] = "feet"  # what touches the floor; body: also knees, trunk
    actuation: ActuationConfig = field(default_factory=ActuationConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    termination: TerminationConfig = field(default_factory=TerminationConfig)
    reset: ResetConfig = field(default_factory=ResetConfig)
    command: CommandConfig = field(default_factory=CommandConfig)

    def __post_init__(self) -> None:
        if self.observation not in ("body", "world"):
            raise UsageError(f"env.observation is {self.observation!r}; expected body or world")
        if self.observation == "world" and self.command.given:
            raise UsageError("env.observation is world, which tells of no command; expected body")
        if self.gravity <= 0.0:
            raise UsageError(f"env.gravity is {self.gravity}; expected more than 0 m/s^2")
        if not 1e-4 <= self.physics_dt <= 0.02:
            raise UsageError(f"env.physics-dt is {self.physics_dt}; expected 0.0001 to 0.02 s")
        if self.substeps < 1:
            raise UsageError(f"env.substeps is {self.substeps}; expected 1 or more")
        if self.solver_iterations < 1 or self.line_search_iterations < 1:
            raise UsageError("env.solver-iterations and env.line-search-iterations: 1 or more")
        if self.contacts not in ("feet", "body"):
            raise UsageError(f"env.contacts is {self.contacts!r}; expected feet or body")
        if self.episode_steps < 1:
            raise UsageError(
                f"env.episode-seconds is {self.episode_seconds}; expected at least one control "
                f"step ({self.control_dt:g} s)"
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
