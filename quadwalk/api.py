"""The package from Python, as a notebook uses it: make, train, evaluate, compare, load_policy."""

import html
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from quadwalk.cli.arguments import make_console
from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UsageError
from quadwalk.evaluation.load import load_run
from quadwalk.evaluation.results import Evaluation, evaluate_policy
from quadwalk.learn import acting, loop
from quadwalk.learn.acting import Policy
from quadwalk.learn.devices import set_up_devices
from quadwalk.robot.load import load_robot
from quadwalk.runs.directory import Run, find_any_run
from quadwalk.runs.resume import read_config_to_replay, read_config_to_resume
from quadwalk.settings.serialize import change_settings
from quadwalk.settings.training import OtherRobotConfig, RobotConfig, TrainConfig
from quadwalk.task_files import load_task

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Overrides = Mapping[str, Any]


def make(
    task: str | Path | TrainConfig = "run",
    robot: str | Path | None = None,
    overrides: Overrides | None = None,
) -> QuadrupedEnv:
    """Make the environment of a task, a Brax `Env` whose `reset` and `step` are pure functions.

    Args:
        task: the name of one of quadwalk's, the path of a file of your own, or a `TrainConfig`.
        robot: a URDF or MJCF, or the name of a robot in an installed package; other settings of
            the robot, such as limits, stay.
        overrides: settings by the names of their flags, {"env.reward.energy": -0.5}.
    """
    config = _make_config(task, robot, overrides)
    set_up_devices()
    return QuadrupedEnv(load_robot(config.robot), config.env)


def train(
    task: str | Path | TrainConfig | None = None,
    *,
    robot: str | Path | None = None,
    resume: str | Path | Run | None = None,
    init: str | Path | Run | None = None,
    replay: str | Path | Run | None = None,
    runs: str | Path | None = None,
    overrides: Overrides | None = None,
    watch: Callable[[dict[str, float]], object] | None = None,
    on_iteration: loop.OnIteration | None = None,
    **settings: Any,
) -> Run:
    """Train, show how it goes, and return the run, whose folder holds everything.

    Args:
        task: as for `make`; by default the task called "run".
        robot: as for `make`.
        resume: a run, its name or path, or "latest", to resume; without task, robot and init.
        init: a run, its name or path, to begin with the networks of.
        replay: a run, its name or path, whose changes at the desk are made again.
        runs: the folder of all runs, "runs" unless another is given.
        overrides: settings by the names of their flags, {"env.reward.energy": -0.5}.
        watch: called with the metrics of each iteration.
        on_iteration: called with each `DeskIteration`; may return numbers to change (docs/desk.md).
        settings: those of `TrainConfig` itself, such as steps, minutes, seed, name, quiet.
    """
    changes = {**settings, **(overrides or {})}
    if init is not None:
        changes["init"] = str(init.path if isinstance(init, Run) else init)
    previous = None
    if replay is not None:
        if task is not None or robot is not None or resume is not None or init is not None:
            raise UsageError("replay uses its run's own task; expected no task, resume or init")
        config = change_settings(read_config_to_replay(_find_run(replay, runs)), changes)
    elif resume is None:
        if runs is not None:
            changes["runs"] = Path(runs)
        config = _make_config(task or "run", robot, changes)
    else:
        if task is not None or robot is not None:
            raise UsageError("resume uses the task and robot of its run; expected neither")
        if "init" in changes:
            raise UsageError("resume uses its run's own networks; expected no init")
        previous = _find_run(resume, runs)
        config = change_settings(read_config_to_resume(previous), changes)
    run = loop.train(config, previous, watch, on_iteration)
    assert run is not None  # one process
    return run


def evaluate(
    run: str | Path | Run = "latest",
    *,
    robot: str | Path | None = None,
    episodes: int = 16,
    seconds: float = 20.0,
    engine: Literal["mjx", "mujoco", "fast"] = "mjx",
    seed: int = 0,
    policy: Literal["last", "best"] = "last",
    randomized: bool = False,
    runs: str | Path | None = None,
) -> Evaluation:
    """Roll a run's policy out from fresh starts, without noise, and measure its episodes.

    Args:
        run: a run, its name or path, or "latest".
        robot: as for `make`, another robot than the run's, for a run of the task universal.
        episodes: how many, each from another start.
        seconds: the time limit of an episode.
        engine: "mjx", MuJoCo C with every shape colliding ("mujoco"), or the trained one ("fast").
        seed: chooses the starts and the ground; the same seed gives the same episodes.
        policy: the run's last, or that of its best checkpoint.
        randomized: sample each episode's conditions as training does.
        runs: the folder of all runs, "runs" unless another is given.
    """
    if engine not in ("mjx", "mujoco", "fast"):
        raise UsageError(f"engine is {engine!r}; expected mjx, mujoco or fast")
    if policy not in ("last", "best"):
        raise UsageError(f"policy is {policy!r}; expected last or best")
    if episodes < 1 or seconds <= 0.0:
        raise UsageError(f"episodes is {episodes} and seconds {seconds}; expected more than 0")
    run = _find_run(run, runs)
    set_up_devices()
    other = _find_robot(robot)
    loaded = load_run(run, seconds, policy, engine, randomized, seed, robot=other)
    for note in loaded.notes:
        make_console().print(f"{run.name}: {note}")
    return evaluate_policy(loaded, episodes, seed)


def compare(results: Mapping[str, Evaluation]) -> "Figure":
    """Print evaluations side by side, each under its name, and return their figures as plots.

    Raises `UsageError` unless their episodes are the same: by number, time limit and seed.
    """
    from quadwalk.evaluation.report.comparison import draw_comparison, print_comparison

    tables = [result.results for result in results.values()]
    starts = {(table["summary"]["episodes"], table["seconds"], table["seed"]) for table in tables}
    if len(starts) != 1:
        raise UsageError(
            "compare was given evaluations of other episodes, seconds or seeds; "
            "expected one or more that agree in these"
        )
    print_comparison(list(results), tables)
    return draw_comparison(list(results), tables)


def load_policy(run: str | Path | Run = "latest") -> Policy:
    """Load the last policy of a run, or a policy file; `policy.act(observation)` is its action."""
    set_up_devices()
    if isinstance(run, str | Path) and Path(run).suffix == ".npz":
        return acting.load_policy(Path(run))
    return acting.load_policy(_find_run(run, None).policy)


class Page:
    """A page that a notebook shows: the robot runs in the browser, wherever the kernel is."""

    def __init__(self, html: str, height: int) -> None:
        self.html, self.height = html, height

    def _repr_html_(self) -> str:
        """Return the page in a frame, as IPython asks for it."""
        content = html.escape(self.html)
        style = f"width: 100%; height: {self.height}px; border: 0"
        return f'<iframe srcdoc="{content}" style="{style}" allow="gamepad"></iframe>'


def play(
    run: str | Path | Run = "latest",
    *,
    robot: str | Path | None = None,
    runs: str | Path | None = None,
    height: int = 520,
) -> Page:
    """Return a page in which the robot of a run is driven; a notebook's cell shows it.

    Args:
        run: a run, its name or path, or "latest".
        robot: as for `evaluate`.
        runs: the folder of all runs, "runs" unless another is given.
        height: of the page, pixels.
    """
    from quadwalk.web import robots, site  # onnx: no other needs it

    files = robots.make_files([_find_run(run, runs)], "last", robot=_find_robot(robot))
    return Page(site.to_single_file(files).decode(), height)


def _make_config(
    task: str | Path | TrainConfig, robot: str | Path | None, overrides: Overrides | None
) -> TrainConfig:
    config = task if isinstance(task, TrainConfig) else load_task(task)
    if robot is not None:
        config = change_settings(config, {"robot.urdf": str(robot)})
    return change_settings(config, overrides or {})


def _find_run(run: str | Path | Run, runs: str | Path | None) -> Run:
    """Return a run by its name, its path or "latest"; raise `UserError` where there is none."""
    return run if isinstance(run, Run) else find_any_run(runs or TrainConfig.runs, str(run))


def _find_robot(robot: str | Path | None) -> RobotConfig | None:
    """Return the settings of the robot of a file, or of that name in an installed package."""
    return OtherRobotConfig(urdf=None if robot is None else Path(robot)).find()
