"""The commands `quadwalk eval` (`eval.py`) and `quadwalk sweep`: options, runs, and folders."""

import dataclasses
import datetime
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from quadwalk.bounds import Bounds, Count, Few, Natural, Seed, Settings
from quadwalk.cli.arguments import make_console, parse
from quadwalk.cli.shell import make_command
from quadwalk.errors import UsageError, UserError
from quadwalk.files import get_os_reason
from quadwalk.runs import directory
from quadwalk.runs.directory import Run
from quadwalk.settings.training import OtherRobotConfig

if TYPE_CHECKING:
    from quadwalk.evaluation.load import LoadedRun
    from quadwalk.evaluation.rollout import Command
    from quadwalk.terrain.terrain import GroundConfig

# Options that `eval.py` had, and the command that does this now.
_MOVED = {"--sweep": "sweep", "--view": "view", "--browser": "view"}


@dataclass(frozen=True)
class RunsConfig(Settings):
    """What evaluations and sweeps have in common."""

    # names or paths of runs, or "latest"; run, walk, drive, getup and others come trained
    run: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[RUN ...]")] = (
        "latest",
    )
    episodes: Count = 16  # how many, each from another start
    # s, the time limit of an episode
    seconds: Annotated[float, Bounds(0.0, 3600.0, open="low", unit="s")] = 20.0
    # what steps the physics: mjx; mujoco, MuJoCo C with every shape colliding and a converged
    # solver; or fast, the engine trained in
    engine: Literal["fast", "mjx", "mujoco"] = "mjx"
    policy: Literal["last", "best"] = "last"  # the run's last, or that of its best checkpoint
    seed: Seed = 0  # of the starts and the ground; the same seed gives the same episodes
    # folder for the results; None: a new one in the run's
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    runs: Path = Path("runs")  # folder that holds all runs
    robot: OtherRobotConfig = field(default_factory=OtherRobotConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.run:
            raise UsageError("no run; expected names or paths of runs, or nothing")


@dataclass(frozen=True)
class SweepConfig(RunsConfig):
    """Measure the share of episodes without a fall as conditions vary.

    Friction, mass, motors, gains, delays, pushes and sensor noise vary one by one, and all at once.
    The sweeps of several runs are drawn together.
    """

    episodes: Count = 16  # how many at each point of the sweep, each from another start


@dataclass(frozen=True)
class EvalConfig(RunsConfig):
    """Roll a trained policy out, measure it, and write its episodes as MCAP files.

    Several runs are evaluated from the same starts and compared.
    """

    # each episode under conditions drawn as in training: friction, loads, motors, delays, noise,
    # pushes; otherwise the robot is as its model says and nothing disturbs it
    randomized: bool = False
    # kind of ground, such as rough, blocks or stairs_up, in place of the task's; flat: a flat floor
    ground: str | None = None
    # m, height of that kind's steps and blocks, or amplitude of its roughness; None: by the leg's
    # length
    ground_height: Annotated[float | None, Bounds(0.0, 1.0, unit="m")] = None
    # m/s forward, m/s to the left, rad/s: the velocity command of every episode; None: each draws
    # its own
    command: tuple[float, float, float] | None = None
    # episodes of each cell of the task's suite: of each kind of terrain at each difficulty; of each
    # four commands, in MuJoCo C; of each condition under which a robot stands up, in MuJoCo C; 0:
    # without them, as with `ground` or `command`
    cell_episodes: Natural = 16
    levels: Few = 3  # difficulties of terrain, evenly from the least trained on to the greatest
    mcap: Natural | None = None  # of the episodes, how many to write as MCAP; None: the first 16
    video: Literal["none", "gif", "mp4"] = "none"  # 3 s of it running; mp4 needs ffmpeg

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.command is not None and not any(self.command):
            raise UsageError("--command is 0 0 0; expected a velocity that is not 0")
        if self.ground_height is not None and self.ground in (None, "flat"):
            raise UsageError("--ground-height has no --ground; expected one, such as rough")

    @property
    def is_special(self) -> bool:
        """True for one command or another ground, for which there is no suite."""
        return self.command is not None or self.ground is not None

    @property
    def recordings(self) -> int:
        """The most episodes to write as MCAP: each takes a third of a second and 1 MB."""
        return 16 if self.mcap is None else self.mcap


def call_eval(args: Sequence[str], prog: str) -> None:
    """Run `quadwalk eval` with the options `args`.

    Raises `UsageError` for a flag of an old version that is a command now.
    """
    for flag, command in _MOVED.items():
        if flag in args:
            others = [arg for arg in args if arg not in ("--sweep", "--view")]
            raise UsageError(f"{prog} has no {flag}; expected {make_command(command, *others)}")
    evaluate_runs(parse(EvalConfig, args, prog))


def call_sweep(args: Sequence[str], prog: str) -> None:
    """Run `quadwalk sweep` with the options `args`."""
    sweep_runs(parse(SweepConfig, args, prog))


def evaluate_runs(config: EvalConfig) -> dict[str, Any]:
    """Evaluate as `config` says; return the content of metrics.json or comparison.json."""
    ground = None if config.ground is None else _make_ground(config)
    runs, loaded = _load_runs(config, config.randomized, ground, config.command)
    folders, together = _make_folders(config, runs, config.engine)
    from quadwalk.evaluation import write  # late, since it takes seconds

    results = [
        write.write_evaluation(
            policy,
            folder,
            episodes=config.episodes,
            seed=config.seed,
            cell_episodes=0 if config.is_special else config.cell_episodes,
            levels=config.levels,
            recordings=config.recordings,
            video=config.video,
        )
        for policy, folder in zip(loaded, folders, strict=True)
    ]
    if together is None:
        return results[0]
    return write.write_comparison(_label_runs(runs), folders, results, together)


def sweep_runs(config: SweepConfig) -> dict[str, Any]:
    """Sweep as `config` says; return the content of sweep.json or comparison.json."""
    runs, loaded = _load_runs(config, randomized=False)
    folders, together = _make_folders(config, runs, "sweep")
    from quadwalk.evaluation import write  # late, since it takes seconds

    results = [
        write.write_sweep(policy, folder, config.episodes, config.seed)
        for policy, folder in zip(loaded, folders, strict=True)
    ]
    if together is None:
        return results[0]
    return write.write_sweep_comparison(_label_runs(runs), results, together)


def _make_ground(config: EvalConfig) -> "GroundConfig":
    """Return the ground that `config` names: one large tile about the start."""
    from quadwalk.terrain.terrain import FLAT  # late, since it takes seconds
    from quadwalk.terrain.tiles import KINDS

    kind, height = config.ground, config.ground_height
    if kind == "flat":
        return FLAT
    if kind is None or kind not in KINDS:
        raise UsageError(f"--ground is {kind!r}; expected one of: {', '.join(KINDS)}")
    ground = dataclasses.replace(
        FLAT,
        kinds=(kind,),
        levels=1,
        difficulty=(1.0, 1.0),
        tile=(44.0, 44.0),
        step=height,
        block=height,
        roughness=height,
    )
    return ground.make_unseen(config.seed)


def _load_runs(
    config: RunsConfig,
    randomized: bool,
    ground: "GroundConfig | None" = None,
    command: "Command | None" = None,
) -> tuple[list[Run], list["LoadedRun"]]:
    """Find and load all runs before the first is simulated, so that a bad one fails at once."""
    runs, robot = _find_runs(config), config.robot.find()
    # On stderr: what is printed on stdout is the result alone.
    console = make_console()
    origins = [directory.describe_origin(config.runs, run) for run in runs]
    console.print(f"evaluating {', '.join(origins)}")

    # Late, since they take seconds.
    from quadwalk.learn.devices import set_up_devices

    set_up_devices()
    from quadwalk.evaluation.load import load_run

    loaded = [
        load_run(
            run,
            config.seconds,
            config.policy,
            config.engine,
            randomized,
            config.seed,
            ground,
            command,
            robot,
        )
        for run in runs
    ]
    for policy in loaded:
        for note in policy.notes:
            console.print(f"{policy.run.name}: {note}")
    return runs, loaded


def _find_runs(config: RunsConfig) -> list[Run]:
    """Return the runs that `config` names; `UsageError` for one not there, or named twice."""
    runs: list[Run] = []
    for name in config.run:
        run = directory.find_ready(config.runs, name, "run")
        for other, other_name in zip(runs, config.run, strict=False):
            if other.path.resolve() == run.path.resolve():
                raise UsageError(
                    f"{other_name!r} and {name!r} are the same run, {run.path}; expected others to "
                    "compare it with"
                )
        runs.append(run)
    return runs


def _label_runs(runs: list[Run]) -> list[str]:
    """Return the label of each run in a comparison: its name, or its path if names are equal."""
    names = [run.name for run in runs]
    return [run.name if names.count(run.name) == 1 else str(run.path) for run in runs]


def _make_folders(config: RunsConfig, runs: list[Run], kind: str) -> tuple[list[Path], Path | None]:
    """Make a folder for the results of each run and, for several runs, one of a comparison."""
    if config.out is not None:
        together = _make_folder(config.out)
        if len(runs) == 1:
            return [together], None
        labels = [label.strip("/").replace("/", "_") for label in _label_runs(runs)]
        return [_make_folder(together / label) for label in labels], together
    name = f"{datetime.datetime.now():%Y-%m-%d_%H%M%S}-{kind}"
    places = [directory.get_results_folder(config.runs, run) / "eval" for run in runs]
    folders = [_make_folder(place / name, new=True) for place in places]
    if len(runs) == 1:
        return folders, None
    return folders, _make_folder(config.runs / "comparisons" / name, new=True)


def _make_folder(folder: Path, new: bool = False) -> Path:
    """Make `folder` and return its path.

    If it is to be `new` and exists, take the first name of `generate_names` that does not. Raises
    `UserError` if nothing can be written in it: better now than after the simulation.
    """
    try:
        if new:
            names = directory.generate_names(folder.name)
            folder = next(filter(_is_made, map(folder.with_name, names)))
        else:
            folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise UserError(
            f"cannot write results to the folder {folder}: {get_os_reason(error)}"
        ) from error
    return folder


def _is_made(folder: Path) -> bool:
    """Make `folder`; return False if it exists, even if another process makes it at this moment."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        return False
    return True
