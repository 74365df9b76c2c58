"""Settings of a training run: what the command line sets and `config.json` keeps."""

import math
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from quadwalk.bounds import Bounds, Count, Natural, NotNegative, Positive, Seed, Settings, Share
from quadwalk.errors import UsageError
from quadwalk.files import resolve_path
from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.names import find_robot
from quadwalk.settings.environment import EnvConfig


@dataclass(frozen=True)
class RobotConfig(Settings, group="robot"):
    """The robot to train."""

    # the robot's URDF or MJCF, or its name in an installed package: go2
    urdf: Annotated[Path, tyro.conf.arg(aliases=["--robot.file"])] = ALIENGO_URDF
    mesh_dirs: tuple[Path, ...] = ()  # folders of mesh files, besides the URDF's own
    effort: Positive | None = None  # Nm, effort limit of motors for which the URDF has none
    speed: Positive | None = None  # rad/s, velocity limit of motors for which the URDF has none
    # replace an inertia that no body can have by the nearest valid one
    repair_inertia: bool = False
    fix: tuple[str, ...] = ()  # joints to fix, by name or pattern: a head, a lidar, an arm

    def __post_init__(self) -> None:
        super().__post_init__()
        # Here, so that a run's folder and its configuration know the file.
        object.__setattr__(self, "urdf", find_robot(self.urdf))


@dataclass(frozen=True)
class OtherRobotConfig(Settings, group="robot"):
    """Another robot than the run's, for a policy of the task universal."""

    # its URDF or MJCF, or its name in an installed package: go2; None: the run's robot
    urdf: Annotated[Path | None, tyro.conf.arg(aliases=["--robot.file"])] = None
    mesh_dirs: tuple[Path, ...] = ()  # folders of mesh files, besides the file's own
    effort: Positive | None = None  # Nm, effort limit of motors for which the file has none
    speed: Positive | None = None  # rad/s, velocity limit of motors for which the file has none
    # replace an inertia that no body can have by the nearest valid one
    repair_inertia: bool = False
    fix: tuple[str, ...] = ()  # joints to fix, by name or pattern: a head, a lidar, an arm

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.urdf is None and any(getattr(self, field.name) for field in fields(self)):
            raise UsageError("flags of --robot need --robot.urdf as well")

    def find(self) -> RobotConfig | None:
        """Return the robot that the flags name; None where they name none."""
        if self.urdf is None:
            return None
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        robot = RobotConfig(**values)
        folders = tuple(map(resolve_path, robot.mesh_dirs))
        return replace(robot, urdf=resolve_path(robot.urdf), mesh_dirs=folders)


@dataclass(frozen=True)
class PPOConfig(Settings, group="ppo"):
    """The learner: proximal policy optimization (Schulman et al. 2017, arXiv:1707.06347)."""

    eval_envs: Count  # additional environments of the deterministic policy, to evaluate it
    unroll: Count  # control steps of each environment in an iteration
    minibatches: Count  # minibatches in each pass over an iteration's data
    epochs: Count  # passes over an iteration's data
    learning_rate: Positive  # Adam's learning rate at the start
    # KL divergence of a policy update, which the learning rate adapts to
    desired_kl: Positive
    final_kl: Positive  # desired_kl decreases to this over the last `anneal_share` of the steps
    min_learning_rate: Positive  # lower bound of the learning rate
    max_learning_rate: Positive  # upper bound of the learning rate
    discount: Annotated[float, Bounds(0.0, 1.0, open="high")]  # weight of the next step's return
    gae_lambda: Share  # lambda of generalized advantage estimation
    clip_epsilon: Positive  # the probability ratio is clipped to 1 +- this
    init_std: Positive  # standard deviation of actions at the start, before the tanh
    entropy: NotNegative  # weight of the entropy bonus
    # the entropy bonus's weight decreases to this over the last `anneal_share` of the steps
    final_entropy: NotNegative
    value_coef: NotNegative  # weight of the value loss
    max_grad_norm: Positive  # gradients are scaled down to this norm
    reward_scale: Positive  # rewards are multiplied by this before learning
    # widths of the hidden layers of both networks
    hidden: Annotated[tuple[int, ...], Bounds(1, 100_000)]
    activation: str  # activation of the hidden layers, by its name in Brax: swish, relu, tanh, ...
    # use mirror-symmetric networks where the robot and all observations allow it
    symmetric: bool = False
    # probability of repeating the conditions of an episode that ended in a fall
    retry: Annotated[float, Bounds(0.0, 1.0, open="high")] = 0.0
    # last share of the steps, over which desired_kl and the entropy bonus decrease
    anneal_share: Annotated[float, Bounds(0.0, 1.0, open="low")] = 0.4
    # the trained policy samples actions whose standard deviation is large, as training does
    stochastic: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_learning_rate > self.max_learning_rate:
            raise UsageError(
                f"--ppo.min-learning-rate is {self.min_learning_rate}; expected at most "
                f"--ppo.max-learning-rate, {self.max_learning_rate}"
            )

    @property
    def std_scale(self) -> float:
        """The factor of softplus(output) with which an output of 0 gives `init_std`."""
        return self.init_std / math.log(2.0)


# For a run on a flat floor; 2048 environments on two cores.
PPO = PPOConfig(
    eval_envs=64,
    unroll=12,
    minibatches=4,
    epochs=2,
    learning_rate=1e-3,
    desired_kl=0.03,
    final_kl=0.01,
    min_learning_rate=1e-5,
    max_learning_rate=1e-2,
    discount=0.97,
    gae_lambda=0.95,
    clip_epsilon=0.2,
    init_std=0.35,
    entropy=0.005,
    final_entropy=0.001,
    value_coef=1.0,
    max_grad_norm=1.0,
    reward_scale=0.1,
    hidden=(128, 128, 128),
    activation="swish",
    symmetric=True,
)
# For uneven ground: a quarter fewer steps/s than with three layers of 128, and two thirds of the
# steps. It anneals early, since levels of difficulty rise little before.
PPO_UNEVEN = replace(PPO, discount=0.98, entropy=0.003, hidden=(256, 192, 128), anneal_share=0.8)


@dataclass(frozen=True)
class DistributedConfig(Settings, group="distributed"):
    """One training shared by several processes, usually one on each machine."""

    coordinator: str | None = None  # HOST:PORT at which process 0 waits for the others
    # how many processes there are; each is started by the same command with its own number
    processes: Count = 1
    process: Natural = 0  # number of this process; 0 writes the files and shows progress

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.coordinator is None:
            if self.processes != 1 or self.process != 0:
                raise UsageError("--distributed.coordinator is missing; expected HOST:PORT")
            return
        host, _, port = self.coordinator.rpartition(":")
        if not host or not port.isdecimal() or not 0 < int(port) < 65536:
            raise UsageError(
                f"--distributed.coordinator is {self.coordinator!r}; expected HOST:PORT"
            )
        if not 0 <= self.process < self.processes:
            raise UsageError(
                f"--distributed.process is {self.process}; expected 0 to {self.processes - 1}"
            )


Suite = Literal["course", "terrain", "commands", "standing"]  # as in quadwalk/evaluation/suites


@dataclass(frozen=True, kw_only=True)
class TrainConfig(Settings):
    """Teach a quadruped a task. Results go to runs/NAME/."""

    task: tyro.conf.Suppress[str]  # its name
    # what an evaluation also measures: success by terrain, following of commands, standing up;
    # course: nothing
    suite: Suite = "course"
    name: str | None = None  # the run's name; None: date, time and task
    runs: Path = Path("runs")  # the folder of all runs
    init: str | None = None  # a run, by name or path, whose networks this one begins with
    steps: Count  # control steps of all environments together
    minutes: Positive | None = None  # stop after so many minutes and save the policy
    seed: Seed = 0  # the same seed on the same machine gives the same numbers
    envs: Count | None = None  # environments stepped at once; None: 2048, or 8192 on a GPU
    # devices that share the environments; None: all GPUs, or one per CPU core
    devices: Count | None = None
    checkpoint_steps: Count  # control steps between checkpoints
    quiet: bool = False  # print only the result
    # where metrics go: the run's files alone, or Weights & Biases as well
    log: Literal["files", "wandb"] = "files"
    watch: bool = False  # show the newest policy live in a page of the browser
    # show the newest policy in a page, and change rewards and other numbers there while it trains
    desk: bool = False
    # a run, by name or path, whose changes at the desk are made again at the same iterations
    replay: str | None = None
    robot: RobotConfig = field(default_factory=RobotConfig)
    env: EnvConfig
    ppo: PPOConfig
    distributed: DistributedConfig = field(default_factory=DistributedConfig)


def set_files(
    config: TrainConfig, urdf: Path, mesh_dirs: tuple[Path, ...], heights: Path | None
) -> TrainConfig:
    """Return `config` with these files of robot, meshes and ground, by absolute paths."""
    folders = tuple(map(resolve_path, mesh_dirs))
    robot = replace(config.robot, urdf=resolve_path(urdf), mesh_dirs=folders)
    ground = replace(config.env.ground, file=heights and resolve_path(heights))
    return replace(config, robot=robot, env=replace(config.env, ground=ground))
