"""Settings of a training run: what the command line sets and `config.json` keeps."""

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from quadwalk.errors import UsageError
from quadwalk.paths import ALIENGO_URDF
from quadwalk.task.config import EnvConfig


@dataclass(frozen=True)
class RobotConfig:
    """The robot to train."""

    urdf: Path = ALIENGO_URDF  # its description
    mesh_dirs: tuple[Path, ...] = ()  # folders of its mesh files, besides the URDF's
    effort: float | None = None  # Nm, of motors that the URDF gives no effort limit
    speed: float | None = None  # rad/s, of motors that the URDF gives no velocity limit
    repair_inertia: bool = False  # replace an inertia that no body can have by the nearest valid

    def __post_init__(self) -> None:
        for name in ("effort", "speed"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise UsageError(f"--robot.{name} is {value}; expected more than 0")


@dataclass(frozen=True)
class PPOConfig:
    """The learner: proximal policy optimisation (Schulman et al. 2017, arXiv:1707.06347)."""

    eval_envs: int  # environments beside the others that act without noise: how good it is
    unroll: int  # control steps of each environment in an iteration
    minibatches: int  # the iteration's data is cut into so many
    epochs: int  # passes over the data
    learning_rate: float  # Adam's, at the start
    desired_kl: float  # the learning rate adapts to keep the policy's change near this
    final_kl: float  # desired_kl falls to this over the share `settle` of the steps, the last
    min_learning_rate: float  # the learning rate's lower bound
    max_learning_rate: float  # the learning rate's upper bound
    discount: float  # weight of the next step's return
    gae_lambda: float  # of generalised advantage estimation
    clip: float  # how far the probability ratio may be from 1
    noise: float  # standard deviation of actions at the start, before the tanh
    entropy: float  # weight of the entropy bonus
    final_entropy: float  # the entropy bonus' weight falls to this, as desired_kl does
    value: float  # weight of the value loss
    max_grad_norm: float  # gradients are scaled down to this norm
    reward_scale: float  # rewards are multiplied by this before learning
    hidden: tuple[int, ...]  # hidden layers of policy and value network
    activation: str  # of the hidden layers, by its name in Brax: swish, relu, tanh, ...
    # share of the falls after which the next episode is under the same conditions once more: so
    # what is hard to bear is met more often
    retry: float = 0.0
    settle: float = 0.4  # share of the steps, the last, over which the policy settles

    def __post_init__(self) -> None:
        for name in ("eval_envs", "unroll", "minibatches", "epochs"):
            if getattr(self, name) < 1:
                raise UsageError(
                    f"ppo.{name.replace('_', '-')} is {getattr(self, name)}; expected 1 or more"
                )
        if not 0.0 <= self.discount < 1.0:
            raise UsageError(f"ppo.discount is {self.discount}; expected 0 to less than 1")
        if self.learning_rate <= 0.0:
            raise UsageError(f"ppo.learning-rate is {self.learning_rate}; expected more than 0")
        if not 0.0 <= self.retry < 1.0:
            raise UsageError(f"ppo.retry is {self.retry}; expected 0 to less than 1")
        if not 0.0 < self.settle <= 1.0:
            raise UsageError(f"ppo.settle is {self.settle}; expected more than 0, up to 1")
        if not self.hidden or min(self.hidden) < 1:
            raise UsageError(f"ppo.hidden is {self.hidden}; expected positive layer sizes")


@dataclass(frozen=True)
class DistributedConfig:
    """One training shared by several processes, usually one on each machine."""

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


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Teach a quadruped a task. Results go to runs/NAME/."""

    task: tyro.conf.Suppress[str]  # its name
    name: str | None = None  # name of the run; None: date, time and task
    runs: Path = Path("runs")  # folder that holds all runs
    steps: int  # control steps, of all environments together
    minutes: float | None = None  # stop after so long, with the policy saved
    seed: int = 0  # the same seed on the same machine gives the same numbers
    envs: int | None = None  # environments stepped at once; None: 2048, or 8192 on a GPU
    devices: int | None = None  # devices that share them; None: all GPUs, or one per CPU core
    checkpoint_steps: int  # control steps between checkpoints
    quiet: bool = False  # print the result only
    watch: bool = False  # show the newest policy live in a page of the browser meanwhile
    robot: RobotConfig = field(default_factory=RobotConfig)
    env: EnvConfig
    ppo: PPOConfig
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
