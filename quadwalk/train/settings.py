"""Configuration of a training run: what the command line sets and `config.json` keeps."""

import dataclasses
import math
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from quadwalk.errors import UsageError
from quadwalk.paths import ALIENGO_URDF
from quadwalk.task.config import (
    ActuationConfig,
    CommandConfig,
    EnvConfig,
    ResetConfig,
    RewardConfig,
    TerminationConfig,
)


@dataclass(frozen=True)
class RobotConfig:
    """The robot to train."""

    urdf: Path = ALIENGO_URDF  # its description
    mesh_dirs: tuple[Path, ...] = ()  # folders of its mesh files, besides the URDF's


@dataclass(frozen=True)
class PPOConfig:
    """The learner: proximal policy optimisation (Schulman et al. 2017, arXiv:1707.06347)."""

    eval_envs: int = 64  # evaluation environments beside the others, without action noise
    unroll: int = 12  # control steps of each environment in an iteration
    minibatches: int = 4  # the iteration's data is cut into so many
    epochs: int = 2  # passes over the data
    learning_rate: float = 1e-3  # Adam's, at the start
    desired_kl: float = 0.03  # the learning rate adapts to keep the policy's change near this
    final_kl: float = 0.01  # over the last 40 % of the steps that falls to this: it settles
    min_learning_rate: float = 1e-5
    max_learning_rate: float = 1e-2
    discount: float = 0.97
    gae_lambda: float = 0.95  # of generalised advantage estimation
    clip: float = 0.2  # of the probability ratio
    noise: float = 0.35  # standard deviation of actions at the start, before the tanh
    entropy: float = 0.01  # weight of the entropy bonus
    final_entropy: float = 0.001  # over the last 40 % of the steps that falls to this
    value: float = 1.0  # weight of the value loss
    max_grad_norm: float = 1.0
    reward_scale: float = 0.1  # rewards are multiplied by this before learning
    hidden: tuple[int, ...] = (128, 128, 128)  # hidden layers of policy and value network
    activation: str = "swish"

    def __post_init__(self) -> None:
        for name in ("eval_envs", "unroll", "minibatches", "epochs"):
            if getattr(self, name) < 1:
                raise UsageError(f"ppo.{name} is {getattr(self, name)}; expected 1 or more")
        if not 0.0 <= self.discount < 1.0:
            raise UsageError(f"ppo.discount is {self.discount}; expected 0 to less than 1")
        if self.learning_rate <= 0.0:
            raise UsageError(f"ppo.learning-rate is {self.learning_rate}; expected more than 0")
        if not self.hidden or min(self.hidden) < 1:
            raise UsageError(f"ppo.hidden is {self.hidden}; expected positive layer sizes")


@dataclass(frozen=True)
class DistributedConfig:
    """One training shared by several processes, as a rule one on each machine."""

    coordinator: str | None = None  # HOST:PORT at which process 0 waits for the others
    processes: int = 1  # how many there are; the same command starts each, but for its number
    process: int = 0  # the number of this one; 0 writes the files and shows the progress

    def __post_init__(self) -> None:
        if self.coordinator is None:
            if self.processes != 1 or self.process != 0:
                raise UsageError("--distributed.coordinator is missing; expected HOST:PORT")
            return
        host, _, port = self.coordinator.rpartition(":")
        if not host or not port.isdecimal() or not 0 < int(port) < 65536:
            raise UsageError(
                f"--distributed.coordinator is {self.coordinator!r}; expected HOST:PORT"
            )
        if self.processes < 1:
            raise UsageError(f"--distributed.processes is {self.processes}; expected 1 or more")
        if not 0 <= self.process < self.processes:
            raise UsageError(
                f"--distributed.process is {self.process}; expected 0 to {self.processes - 1}"
            )


@dataclass(frozen=True)
class TrainConfig:
    """Teach a quadruped to run. Results go to runs/NAME/."""

    preset: str = "run"  # the task to start from; every other flag changes it
    name: str | None = None  # of the run; by default, date, time and preset
    resume: str | None = None  # go on with this run, by its name or path, or with the "latest"
    runs: Path = Path("runs")  # the folder that holds all runs
    steps: int = 21_000_000  # control steps, of all environments together
    minutes: float | None = None  # end after so long, with the policy saved
    seed: int = 0  # the same seed on the same machine gives the same numbers
    envs: int | None = None  # stepped at once; by default 2048, or 8192 on an accelerator
    devices: int | None = None  # to share them; by default all accelerators, or one per CPU core
    checkpoint_steps: int = 2_000_000  # control steps between checkpoints
    quiet: bool = False  # print the result only
    robot: RobotConfig = field(default_factory=RobotConfig)
    env: EnvConfig = field(default_factory=EnvConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    distributed: DistributedConfig = field(default_factory=DistributedConfig)

    def __post_init__(self) -> None:
        for name in ("steps", "envs", "devices", "checkpoint_steps"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise UsageError(f"--{name.replace('_', '-')} is {value}; expected 1 or more")
        if self.minutes is not None and self.minutes <= 0:
            raise UsageError(f"--minutes is {self.minutes}; expected more than 0")
        if not 0 <= self.seed < 2**32:
            raise UsageError(f"--seed is {self.seed}; expected 0 to {2**32 - 1}")


# The task of the blog post that this project started from, as PyBullet had it: 1000 control steps
# of one physics step each, from the same start, rewarded for the way made along x.
#
# kp and kd stand for PyBullet's position control (see `gains` in physics/motor.py), with the
# largest whole kd that is stable: on random targets and without a limit of torque the joints'
# speeds are bounded up to kd 6.5, and no longer at 7.5. By the inertia that a joint of the
# AlienGo's has with its legs in the air, 6.9 is the end.
_BLOG = TrainConfig(
    preset="blog",
    steps=10_000_000,
    checkpoint_steps=1_000_000,
    env=EnvConfig(
        gravity=9.8,
        physics_dt=1.0 / 240.0,
        substeps=1,
        episode_seconds=1000.0 / 240.0,
        observation="world",
        contacts="body",
        actuation=ActuationConfig(
            kp=144.0,
            kd=6.0,
            targets="range",
            step_limit=0.5,
            effort=44.4,
            speed_limit=False,
            joint_friction=False,
        ),
        reward=RewardConfig(
            forward=0.0,
            fall=0.0,
            yaw=0.0,
            energy=0.0,
            alive=0.0,
            lateral=0.0,
            offset=0.0,
            vertical=0.0,
            tilt=0.0,
            turning=0.0,
            action_rate=0.0,
            progress=50.0,
            inclined=-10.0,
            heading=-0.01,
            movement=-0.01,
        ),
        termination=TerminationConfig(
            tilt=None, roll_pitch=math.pi / 2, height=None, base_height=0.05, clearance=None
        ),
        reset=ResetConfig(
            pose=(0.0, math.pi / 4, -math.pi / 2),
            height=0.4,
            yaw=0.0,
            tilt=0.0,
            offset=0.0,
            joints=0.0,
            velocity=0.0,
            joint_velocity=0.0,
        ),
    ),
    envs=1024,
    # At 240 steps a second what an action brings shows many steps later.
    ppo=PPOConfig(unroll=32, discount=0.99, gae_lambda=0.98, entropy=0.0, final_entropy=0.0),
)

_WALK = TrainConfig(
    preset="walk",
    steps=6_000_000,
    checkpoint_steps=1_000_000,
    env=EnvConfig(
        command=CommandConfig(forward=(-0.5, 1.5), sideways=(-0.5, 0.5), turning=(-1.0, 1.0)),
        reward=RewardConfig(
            follow=1.0,
            follow_turning=0.5,
            drag=-0.3,
            trot=0.5,
            energy=-0.3,
            fall=-10.0,
            vertical=-0.5,
            tilt=-0.5,
            turning=-0.05,
            action_rate=-0.3,
            forward=0.0,
            yaw=0.0,
            alive=0.0,
            lateral=0.0,
            offset=0.0,
        ),
    ),
)

PRESETS = {"run": TrainConfig(), "walk": _WALK, "blog": _BLOG}


def to_dict(config: Any) -> dict[str, Any]:
    """A configuration as JSON data."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, tuple):
            return [plain(item) for item in value]
        return str(value) if isinstance(value, Path) else value

    return plain(dataclasses.asdict(config))


def flatten(config: Any, prefix: str = "") -> dict[str, Any]:
    """Every setting of a configuration, by its name with dots: "env.actuation.kp"."""
    flat: dict[str, Any] = {}
    for each in dataclasses.fields(config):
        value = getattr(config, each.name)
        if dataclasses.is_dataclass(value):
            flat |= flatten(value, f"{prefix}{each.name}.")
        else:
            flat[prefix + each.name] = value
    return flat


def from_dict(cls: type, data: Any, where: str = "config") -> Any:
    """The configuration that `to_dict` wrote; `UsageError` names what does not fit."""
    if not isinstance(data, dict):
        raise UsageError(f"{where} is {data!r}; expected a group of settings")
    hints = typing.get_type_hints(cls)
    for key in data:
        if key not in hints:
            raise UsageError(f"{where}.{key} is not a setting of this version")
    values = {key: _restore(hints[key], value, f"{where}.{key}") for key, value in data.items()}
    return cls(**values)


def _restore(hint: Any, value: Any, where: str) -> Any:
    if dataclasses.is_dataclass(hint):
        return from_dict(hint, value, where)  # type: ignore[arg-type]
    if isinstance(hint, types.UnionType):
        if value is None and type(None) in hint.__args__:
            return None
        hint = next(option for option in hint.__args__ if option is not type(None))
    origin = typing.get_origin(hint) or hint
    if origin is typing.Literal:  # of strings: the class itself checks which
        origin = hint = str
    if origin is tuple and isinstance(value, list):
        return tuple(_restore(hint.__args__[0], item, where) for item in value)
    if origin is Path and isinstance(value, str):
        return Path(value)
    if origin is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, origin) or (isinstance(value, bool) and origin is not bool):
        raise UsageError(f"{where} is {value!r}; expected {getattr(hint, '__name__', hint)}")
    return value
