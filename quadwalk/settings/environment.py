"""Configuration of the environment: frozen dataclasses, one per concern, units in the comments.

Values that tasks share have names here. A task (`quadwalk/tasks`) names them and states its own.
"""

import math
from dataclasses import MISSING, dataclass, fields, replace
from typing import Annotated, Any, Literal

import jax

from quadwalk.bounds import Bounds, Few, NotNegative, Positive, Seconds, Seed, Settings, Share
from quadwalk.errors import UsageError
from quadwalk.physics.motor import MotorConfig, Stepping
from quadwalk.settings.terms import ActionMap, Observation, Reward, Termination
from quadwalk.terrain.terrain import FLAT, GroundConfig

Pair = tuple[float, float]
Range = Annotated[Pair, Bounds(-100.0, 100.0, ordered=True)] | None
Loads = Annotated[Pair, Bounds(-1.0, 100.0, open="low", ordered=True)] | None
Sizes = Annotated[Pair, Bounds(0.0, 100.0, ordered=True)] | None
Delays = Annotated[Pair, Bounds(0.0, 1.0, unit="s", ordered=True)] | None

_LONGEST = 40  # characters of a term's name, which is also a flag, a label and a heading
COMMANDED = ("forward", "lateral", "yaw_rate")  # the numbers of a velocity command
SIGHT = "height_scan"  # the observation that a blind policy lacks


@dataclass(frozen=True)
class ResetConfig(Settings, group="env.reset"):
    """Random starts about the home pose: each number is sampled uniformly from +-value."""

    # rad, hip, thigh and calf of every leg; None: the home pose
    pose: tuple[float, float, float] | None
    height: float | None  # m, of the trunk's origin; None: the lowest foot touches the floor
    yaw: NotNegative  # rad, heading
    tilt: NotNegative  # rad, roll and pitch
    offset: NotNegative  # m, along y
    joints: NotNegative  # rad, joint angles
    velocity: NotNegative  # m/s and rad/s, of the trunk
    joint_velocity: NotNegative  # rad/s
    forward: float  # m/s, forward speed, sampled from 0 to this
    # sample any orientation instead of yaw and tilt; without a height, the robot's lowest part
    # touches the floor
    tumbled: bool = False


# From the home pose, near the line y = 0 and nearly along it.
HOME_RESET = ResetConfig(
    pose=None,
    height=None,
    yaw=0.3,
    tilt=0.1,
    offset=0.3,
    joints=0.2,
    velocity=0.5,
    joint_velocity=0.5,
    forward=0.0,
)


@dataclass(frozen=True)
class CommandConfig(Settings, group="env.command"):
    """The velocity command, sampled uniformly from (low, high), in the heading frame."""

    forward: Annotated[Pair, Bounds(ordered=True)]  # m/s
    lateral: Annotated[Pair, Bounds(ordered=True)]  # m/s, to the left
    yaw_rate: Annotated[Pair, Bounds(ordered=True)]  # rad/s, to the left
    standing: Share  # share of commands that are zero
    seconds: Seconds  # s, until the next command
    straight: Share = 0.0  # share of commands without lateral velocity and yaw rate
    spot: Share = 0.0  # share of commands to turn on the spot: without a velocity
    slow: Share = 0.0  # share of commands that are a fifth of one drawn as the others
    still: NotNegative = 0.0  # m/s and rad/s, commands below both are to stand
    # s, shortest time until the next command, sampled from this to `seconds`; None: `seconds`
    soonest: Seconds | None = None
    # m/s, forward speed from which on the lateral range is zero, after it has shrunk; None: it
    # stays
    lateral_until: Positive | None = None
    # m/s^2, limit of a command's centripetal acceleration; half of the floor's grip is another;
    # rewards limit the yaw rate of a robot that is faster, too; None: no limit
    turning: Positive | None = None
    # m/s^2, rate at which the command that rewards count approaches a new one; None: at once
    acceleration: Positive | None = None
    # m, leg length for which the velocities hold; others get the same Froude numbers; None: all
    leg: Positive | None = None
    # with `leg`: largest forward velocity, as a share of the thigh motors' swing speed of a foot;
    # None: no limit
    swing: Share | None = None
    margin: Share = 0.0  # training samples from ranges that are wider by this share

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.soonest is not None and self.soonest > self.seconds:
            raise UsageError(
                f"--env.command.soonest is {self.soonest}; expected at most --env.command.seconds, "
                f"{self.seconds}"
            )
        if self.standing + self.straight + self.spot + self.slow > 1.0:
            raise UsageError(
                f"--env.command.standing is {self.standing}, --env.command.straight "
                f"{self.straight}, --env.command.spot {self.spot} and --env.command.slow "
                f"{self.slow}; expected a sum of at most 1"
            )

    def scale_to(self, leg: float, foot_speed: float) -> "CommandConfig":
        """Return the command for legs of `leg`, m, whose motors swing a foot at `foot_speed`, m/s.

        Velocities grow with the square root of the length, yaw rates fall with it; accelerations
        stay.
        """
        if self.leg is None:
            return self
        factor, _, slower = self.compute_scale(leg, foot_speed)
        until = self.lateral_until
        return replace(
            self,
            forward=_scale(self.forward, factor),
            lateral=_scale(self.lateral, factor),
            yaw_rate=_scale(self.yaw_rate, slower),
            still=round(self.still * factor, 3),
            lateral_until=None if until is None else round(until * factor, 3),
            leg=None,
        )

    def compute_scale(self, leg: float, foot_speed: float) -> tuple[float, float, float]:
        """Return by what a command's three numbers grow with legs of `leg`, m, see `scale_to`."""
        if self.leg is None:
            return 1.0, 1.0, 1.0
        faster = factor = math.sqrt(leg / self.leg)
        fastest = max(map(abs, self.forward))
        if self.swing is not None and fastest > 0.0:
            factor = min(faster, self.swing * foot_speed / fastest)
        return factor, factor, 1.0 / faster

    def hold_at(
        self, forward: float, lateral: float = 0.0, yaw_rate: float = 0.0
    ) -> "CommandConfig":
        """Return the same with every command at these velocities, m/s and rad/s, for any robot."""
        return replace(
            self,
            forward=(forward, forward),
            lateral=(lateral, lateral),
            yaw_rate=(yaw_rate, yaw_rate),
            standing=0.0,
            spot=0.0,
            slow=0.0,
            still=0.0,
            straight=0.0,
            lateral_until=None,
            turning=None,
            leg=None,
        )

    @property
    def active(self) -> bool:
        """True if velocities are commanded: some range is not 0, or may change in a program."""
        ends = (*self.forward, *self.lateral, *self.yaw_rate)
        return any(is_on(end) for end in ends)


def is_on(number: Any) -> bool:
    """Return True if a number of a command is not 0, or may change in a program."""
    return isinstance(number, jax.Array) or bool(number)


def _scale(ends: Pair, factor: float) -> Pair:
    """Return both ends of a range times `factor`, rounded."""
    low, high = ends
    return round(low * factor, 3), round(high * factor, 3)


# For a task without commands: the robot runs along world x.
NO_COMMAND = CommandConfig(
    forward=(0.0, 0.0), lateral=(0.0, 0.0), yaw_rate=(0.0, 0.0), standing=0.0, seconds=5.0
)


@dataclass(frozen=True)
class RandomizationConfig(Settings, group="env.randomization"):
    """Domain randomization: each episode's numbers, sampled from (low, high); None: the model's."""

    enabled: bool  # False: nothing is randomized
    friction: Sizes  # sliding friction of floor and feet
    trunk_mass: Loads  # mass added to the trunk, as a share of the robot's mass
    # shift of the trunk's center of mass along each axis, as a share of the home height
    trunk_center: Range
    link_mass: Sizes  # factor of the mass of each leg link
    strength: Sizes  # factor of the motors' torque
    kp: Sizes  # factor of the position gain
    kd: Sizes  # factor of the velocity gain
    joint_friction: Sizes  # factor of the joints' Coulomb friction
    damping: Sizes  # factor of the joints' damping
    armature: Sizes  # factor of the rotors' inertia
    encoder: Range  # rad, offset of each measured joint angle
    imu_tilt: Range  # rad, rotation of the IMU about each axis
    latency: Delays  # s, delay of joint targets
    sensor_latency: Delays  # s, delay of sensors
    noise: Sizes  # level of sensor noise; level 1 is that of the observations
    push: Sizes  # size of a push in any direction, as a share of sqrt(gravity * home height)
    push_seconds: Seconds = 5.0  # s; one push in each such period
    # training widens each range by this share of its ends' distance from the model's value;
    # evaluations do not
    margin: Share = 0.0
    # share of training episodes without randomization, for ranges that begin at the model's values;
    # evaluations leave it out
    ideal: Share = 0.0


# Conditions outside of a simulator: loads of -2 to 5 kg on an AlienGo, pushes up to 1 m/s.
REAL_WORLD = RandomizationConfig(
    enabled=True,
    friction=(0.3, 1.25),
    trunk_mass=(-0.09, 0.22),
    trunk_center=(-0.08, 0.08),
    link_mass=(0.9, 1.1),
    strength=(0.8, 1.1),
    kp=(0.8, 1.2),
    kd=(0.8, 1.2),
    joint_friction=(0.5, 1.5),
    damping=(0.5, 1.5),
    armature=(0.8, 1.2),
    encoder=(-0.02, 0.02),
    imu_tilt=(-0.02, 0.02),
    latency=(0.0, 0.02),
    sensor_latency=(0.0, 0.01),
    noise=(0.0, 1.0),
    push=(0.0, 0.525),
    push_seconds=2.5,
    margin=0.15,
)

# An ideal world: no ranges, and the defaults of all else.
_NO_RANGES: dict[str, Any] = {
    f.name: None for f in fields(RandomizationConfig) if f.default is MISSING
}
NO_RANDOMIZATION = RandomizationConfig(**_NO_RANGES | {"enabled": False})


# Control at 50 Hz over physics steps of 4 ms. Fewer than four Newton iterations grip too well on
# floors of friction below 0.4 (benchmarks/accuracy.py). Episodes of 20 s; the robot's own motors.
PHYSICS: dict[str, Any] = {
    "engine": "fast",
    "gravity": 9.81,
    "physics_dt": 0.004,
    "substeps": 5,
    "solver_iterations": 4,
    "line_search_iterations": 1,
    "contacts": "feet",
    "episode_seconds": 20.0,
    "motor": MotorConfig(),
}


@dataclass(frozen=True)
class BodiesConfig(Settings, group="env.bodies"):
    """Bodies of training: each episode has one of them (`quadwalk/robot/bodies.py`)."""

    number: Annotated[int, Bounds(0, 4096)] = 0  # how many; 0: the robot alone
    seed: Seed = 0  # the same seed gives the same bodies


@dataclass(frozen=True)
class EnvConfig(Settings, group="env"):
    """The environment: physics, motors, and the task."""

    engine: Literal["fast", "mjx"]  # physics engine: quadwalk's own equations (fast) or MJX
    gravity: Annotated[float, Bounds(0.0, 1000.0, open="low", unit="m/s^2")]  # m/s^2
    physics_dt: Annotated[float, Bounds(1e-4, 0.02, unit="s")]  # s, one physics step
    substeps: Few  # physics steps in a control step
    solver_iterations: Few  # Newton iterations of the contact solver (benchmarks/accuracy.py)
    line_search_iterations: Few  # line search iterations of each Newton iteration
    # parts that touch the floor: feet; and knees; and lower corners of the trunk (body); and its
    # upper corners and hips (all)
    contacts: Literal["feet", "knees", "body", "all"]
    episode_seconds: Seconds  # s, time limit of an episode
    motor: MotorConfig
    action: ActionMap
    observation: dict[str, Observation]  # of the policy and the value network
    critic: dict[str, Observation]  # privileged, of the value network alone, undisturbed
    reward: dict[str, Reward]
    termination: dict[str, Termination]
    reset: ResetConfig
    command: CommandConfig
    randomization: RandomizationConfig
    # Runs of early versions do not state it.
    ground: GroundConfig = FLAT
    # m, leg length to which terms scale every robot, by Froude number, with joints that turn alike;
    # None: each robot as it is
    unit_leg: Positive | None = None
    # robots to train with in place of one; evaluations are of the robot itself
    bodies: BodiesConfig = BodiesConfig()
    # hide the observation `height_scan` from the policy; the value network keeps it
    blind: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_terms()
        if self.blind and SIGHT not in {**self.observation, **self.critic}:
            raise UsageError(
                f"--env.blind: the task has no observation {SIGHT}; expected a task with one"
            )
        if self.unit_leg is not None and not self.ground.flat:
            raise UsageError("--env.unit-leg needs a level floor; expected no --env.ground")
        if self.bodies.number and (self.engine != "fast" or not self.ground.flat):
            raise UsageError("--env.bodies.number needs --env.engine fast and a level floor")
        if self.episode_steps < 1:
            raise UsageError(
                f"--env.episode-seconds is {self.episode_seconds}; expected at least one control "
                f"step ({self.control_dt:g} s)"
            )

    def _check_terms(self) -> None:
        """Raise `UsageError` for a term of a wrong kind, name or number."""
        for kind, group, terms in (
            (ActionMap, "env", {"action": self.action}),
            (Observation, "env.observation", self.observation),
            (Observation, "env.critic", self.critic),
            (Reward, "env.reward", self.reward),
            (Termination, "env.termination", self.termination),
        ):
            if not terms and group == "env.observation":
                raise UsageError(f"{group} is empty; expected one or more")
            for name, term in terms.items():
                if not name.isidentifier() or len(name) > _LONGEST:
                    raise UsageError(
                        f"{group}: a term cannot be called {name[:_LONGEST]!r}; expected at most "
                        f"{_LONGEST} letters, digits and _, not beginning with a digit"
                    )
                if not isinstance(term, kind):
                    raise UsageError(f"{group}.{name} is {term!r}; expected {kind.__name__}(...)")
                term.check_numbers(f"{group}.{name}")

    @property
    def effective(self) -> "EnvConfig":
        """These settings; with a blind policy, only the critic observes `height_scan`."""
        if not self.blind or SIGHT not in self.observation:
            return self
        observation = {name: part for name, part in self.observation.items() if name != SIGHT}
        critic = {**self.critic, SIGHT: self.observation[SIGHT]}
        return replace(self, observation=observation, critic=critic)

    @property
    def stepping(self) -> Stepping:
        """Number, length and solver settings of the physics steps in a control step."""
        return Stepping(
            self.physics_dt, self.substeps, self.solver_iterations, self.line_search_iterations
        )

    @property
    def control_dt(self) -> float:
        """Seconds of one control step."""
        return self.physics_dt * self.substeps

    @property
    def episode_steps(self) -> int:
        """Control steps in an episode that lasts until its time limit."""
        return round(self.episode_seconds / self.control_dt)

    @property
    def steps_per_push(self) -> int:
        """Interval of pushes, in control steps: one of each so many, at random, has a push."""
        return max(round(self.randomization.push_seconds / self.control_dt), 1)
