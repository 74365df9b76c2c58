"""A search of settings: an Optuna study asks for trainings, and a file keeps their values."""

import collections
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quadwalk.api import evaluate
from quadwalk.cli.arguments import split_words
from quadwalk.cli.shell import import_extra, make_command
from quadwalk.errors import UsageError, UserError, suggest
from quadwalk.evaluation.metrics import METRICS, get_mean
from quadwalk.experiments.job import Job, fix_sizes
from quadwalk.experiments.options import TuneConfig
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import Outcome, run_jobs
from quadwalk.files import hold_file, make_folder, open_atomic, resolve_path
from quadwalk.learn.flags import parse_config
from quadwalk.progress.metrics import SCORED, compute_score, get_scored_figure
from quadwalk.runs.directory import Run
from quadwalk.runs.log import Row, read_metrics
from quadwalk.runs.policy import load_score
from quadwalk.settings.serialize import change_settings, flatten
from quadwalk.settings.training import TrainConfig

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution

MARKS = 12  # times that a learning curve is compared with the others'
WARM_UP = MARKS // 4  # before which none is stopped
STARTUP = 4  # trials that all others' curves are compared with, at least
LISTED = 10  # trials in the table
# What makes a search: more trials, or other cores, are the same search.
_SAME = ("task", "over", "flags", "steps", "seed", "objective", "episodes", "prune")
_FORMS = "NAME=LOW:HIGH, NAME=LOW:HIGH:log or NAME=VALUE,VALUE,..."
_DIGITS = 4  # of a value that is searched: so many a flag repeats exactly


def search_settings(config: TuneConfig) -> None:
    """Search, print the best, and write them beside the study."""
    base = make_base(config)
    check_objective(config.objective, base)
    space = read_space(config.over, base)
    place = make_place(config)
    folder = resolve_path(config.runs / (config.name or base.task))
    make_folder(folder, "the folder of the search")
    message = f"{folder} is being searched by another process; expected its end, or another --name"
    with hold_file(folder / "lock", message):
        search = Search(config, base, space, folder)
        for outcome in run_jobs(search.ask_jobs(), place, search.left, search.watch):
            search.tell(outcome)
        text = search.format_table()
        with open_atomic(folder / "tune.md") as file:
            file.write(f"{text}\n".encode())
    print(text)


def make_base(config: TuneConfig) -> TrainConfig:
    """Return the training that all trials are, except for the settings that are searched."""
    base, _ = parse_config([config.task, *split_words(config.flags)], "quadwalk train")
    return replace(base, steps=config.steps or base.steps, seed=config.seed)


def check_objective(name: str, base: TrainConfig) -> None:
    """Raise a `UsageError` for an objective that evaluations of the task do not have."""
    absent = {"velocity_error", "yaw_rate_error", "path_speed", "path"}
    if base.env.command.active:
        absent = {"speed", "distance", "lateral_drift", "heading_error"}
    figures = [figure.name for figure in METRICS if figure.name not in absent]
    names = ["score", "fall_rate", *figures]
    if name not in names:
        raise UsageError(
            f"--objective is {name!r}; expected for {base.task} one of: {', '.join(names)}"
            f"{suggest(name, names)}"
        )


def is_better_low(objective: str) -> bool:
    """Return True for an objective of which less is better."""
    low = {figure.name for figure in METRICS if figure.worst.__name__ == "max"}
    return objective in {"fall_rate", *low}


def measure_objective(run: Run, objective: str, episodes: int) -> float:
    """Return the objective of a run's last policy."""
    if objective == "score":
        return load_score(run.policy)[1]
    figure = evaluate(run, episodes=episodes, engine="mujoco").summary[objective]
    return figure if isinstance(figure, float) else get_mean(figure)


def read_space(texts: Sequence[str], config: TrainConfig) -> dict[str, "BaseDistribution"]:
    """Return the distribution of each setting that `--over` names, by its name as in flags.

    Raises a `UsageError` for a name that `config` lacks, a value that it cannot have, and a name
    that comes twice.
    """
    settings = flatten(config)
    space: dict[str, BaseDistribution] = {}
    for text in texts:
        name, _, values = text.partition("=")
        name = name.strip().removeprefix("--").replace("-", "_")
        if name not in settings:
            name = name.removesuffix(".scale")  # a reward is its scale
        if name not in settings:
            raise UsageError(
                f"--over {text}: there is no setting {name!r}{suggest(name, settings)}"
            )
        if name in space:
            raise UsageError(f"--over names {name} twice; expected each setting once")
        space[name], ends = _parse_values(text, values, settings[name])
        for value in ends:
            change_settings(config, {name: value})
    return space


def _parse_values(text: str, values: str, present: Any) -> tuple["BaseDistribution", list[Any]]:
    """Parse the `values` of one `--over`; return their distribution, and its choices or its ends.

    `values` is "VALUE,VALUE,...", "LOW:HIGH" or "LOW:HIGH:log". A setting whose `present` value
    is an integer gets integers between whole ends. `text` is all of `--over`, for the `UsageError`.
    """
    distributions = import_extra("optuna", "tune", "tune").distributions
    if "," in values:
        choices = [_to_number(value) for value in values.split(",")]
        return distributions.CategoricalDistribution(choices), choices
    parts = values.split(":")
    log = parts[2:] == ["log"]
    try:
        low, high = map(float, parts[: -1 if log else None])
    except ValueError:
        raise UsageError(f"--over {text}; expected {_FORMS}") from None
    if not low < high or (log and low <= 0.0):
        raise UsageError(f"--over {text}; expected LOW below HIGH, and above 0 with log")
    if isinstance(present, int) and low.is_integer() and high.is_integer():
        ends = [int(low), int(high)]
        return distributions.IntDistribution(*ends, log=log), ends
    return distributions.FloatDistribution(low, high, log=log), [low, high]


def _to_number(text: str) -> Any:
    """Return a choice as a number if it is one."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def round_values(params: Mapping[str, Any]) -> dict[str, Any]:
    """Return a trial's values, floats rounded to `_DIGITS`, so that flags repeat them exactly."""
    return {
        name: float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
        for name, value in params.items()
    }


class Search:
    """A study on the disk and its trials; made anew, it resumes where it was."""

    def __init__(
        self, config: TuneConfig, base: TrainConfig, space: Mapping[str, Any], folder: Path
    ) -> None:
        self._config = config
        self._base = base
        self._space = dict(space)
        self._folder = folder
        self._low = is_better_low(config.objective)
        self._optuna: Any = import_extra("optuna", "tune", "tune")
        self._states = self._optuna.trial.TrialState
        self._study = self._open_study()
        self._trials: dict[str, Any] = {}
        self._pruned: set[str] = set()

    def _open_study(self) -> Any:
        """Open the study or make it; `UserError` if its file is damaged or of another search."""
        optuna, path = self._optuna, self._folder / "study.db"
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        try:
            study = optuna.create_study(
                storage=f"sqlite:///{path}",
                study_name="tune",
                load_if_exists=True,
                direction="minimize" if self._low else "maximize",
                pruner=optuna.pruners.MedianPruner(STARTUP, WARM_UP),
            )
        except Exception as error:  # SQLAlchemy's, of many kinds
            raise UserError(f"{path} cannot be used as a study: {error}") from error
        settings = {name: value for name, value in asdict(self._config).items() if name in _SAME}
        settings["over"] = list(settings["over"])
        before = study.user_attrs.get("settings", settings)
        for name, value in settings.items():
            if before[name] != value:
                raise UserError(
                    f"{self._folder} has a search with --{name} {before[name]}; expected the same, "
                    "or another --name"
                )
        study.set_user_attr("settings", settings)
        # Its own sequence of numbers after each start: else it would draw the same again.
        seed = self._config.seed + len(study.trials)
        study.sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=2 * STARTUP)
        return study

    @property
    def left(self) -> int:
        """Number of trials to go: those asked for minus those done, failed or pruned."""
        finished = sum(trial.state.is_finished() for trial in self._study.trials)
        return max(0, self._config.trials - finished)

    def ask_jobs(self) -> Iterator[Job]:
        """Yield the jobs of trials that an earlier call left unfinished, then those of new ones.

        Each new trial is sampled when it is asked for, from all outcomes until then.
        """
        for frozen in self._study.get_trials(states=[self._states.RUNNING]):
            trial = self._optuna.trial.Trial(self._study, frozen._trial_id)
            if frozen.params.keys() == self._space.keys():
                yield self._make_job(trial)
            else:  # killed while its settings were written
                self._study.tell(trial, state=self._states.FAIL)
        while len(self._study.trials) < self._config.trials:
            yield self._make_job(self._study.ask(self._space))

    def _make_job(self, trial: Any) -> Job:
        """Return the training of an Optuna trial, and the measurement of its objective."""
        name = f"trial_{trial.number:03d}"
        self._trials[name] = trial
        config = change_settings(self._base, round_values(trial.params))
        config = replace(config, name=name, runs=self._folder)
        measure = partial(
            measure_objective, objective=self._config.objective, episodes=self._config.episodes
        )
        return Job(fix_sizes(config, self._config), measure)

    def watch(self, job: Job, row: Row) -> bool:
        """Report the score at the marks of a learning curve; return True to stop the trial."""
        trial = self._trials[job.name]
        mark = int(MARKS * row["steps"] / job.config.steps)
        if not 0 < mark < MARKS or mark in self._study.trials[trial.number].intermediate_values:
            return False
        figures = list(map(get_scored_figure, read_metrics(job.run)[-SCORED:]))
        score = compute_score(figures, row["eval/fall_rate"])
        trial.report(-score if self._low else score, mark)
        if self._config.prune and trial.should_prune():
            self._pruned.add(job.name)
        return job.name in self._pruned

    def tell(self, outcome: Outcome) -> None:
        """Write the outcome of a trial to the study, unless Ctrl-C interrupted the trial.

        The next `quadwalk tune` resumes it.
        """
        trial = self._trials[outcome.job.name]
        if outcome.job.name in self._pruned:
            self._study.tell(trial, state=self._states.PRUNED)
        elif outcome.error is None:
            self._study.tell(trial, outcome.value)
        elif not outcome.stopped:
            self._study.tell(trial, state=self._states.FAIL)

    def format_table(self) -> str:
        """Return the best trials as Markdown, and the commands that train with the best."""
        states = collections.Counter(trial.state.name.lower() for trial in self._study.trials)
        count = ", ".join(f"{number} {name}" for name, number in sorted(states.items()))
        trials = self._study.get_trials(states=[self._states.COMPLETE])
        trials.sort(key=lambda trial: trial.value, reverse=not self._low)
        lines = [
            f"| trial | {self._config.objective} | {' | '.join(self._space)} |",
            "|" + "---|" * (2 + len(self._space)),
        ]
        for trial in trials[:LISTED]:
            values = round_values(trial.params)
            cells = [trial.number, f"{trial.value:.3f}", *(values[name] for name in self._space)]
            lines.append(f"| {' | '.join(map(str, cells))} |")
        lines += ["", f"{len(self._study.trials)} trials: {count}"]
        if trials:
            lines += self._format_commands(round_values(trials[0].params))
        return "\n".join(lines)

    def _format_commands(self, values: Mapping[str, Any]) -> list[str]:
        """Return lines with the commands that train with `values` and compare them, for a shell."""
        task = [self._config.task, *split_words(self._config.flags)]
        flags = [f"--{name.replace('_', '-')}={value}" for name, value in values.items()]
        usual, best = shlex.join(task), shlex.join([*task, *flags])
        return [
            f"train the best      {make_command('train', *task, *flags)}",
            f"on fresh seeds      {make_command('compare', usual, best, '--seeds', '3')}",
            f"all trials          {self._folder}",
        ]
