"""The search: Optuna picks settings, jobs train them, and a file keeps what came out."""

import collections
import contextlib
import json
import shlex
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from quadwalk.api import evaluate
from quadwalk.command.line import split_words
from quadwalk.command.shell import as_typed, extra
from quadwalk.errors import UsageError, UserError, meant
from quadwalk.evaluate.statistics import figure_mean
from quadwalk.evaluate.summary import FIGURES
from quadwalk.files import atomic_write, lock, make_folder, read_bytes, real_path
from quadwalk.jobs.job import Job, sized
from quadwalk.jobs.news import Row
from quadwalk.jobs.runner import Outcome, place_of, run_jobs
from quadwalk.settings.serialize import with_settings
from quadwalk.settings.training import TrainConfig
from quadwalk.train.flags import parse_config
from quadwalk.train.progress.metrics import SCORED, score, scored_figure
from quadwalk.train.runs.directory import Run, write_json_atomic
from quadwalk.train.runs.policy import load_score
from quadwalk.tune.space import Dimension, as_flags, dimensions, rounded
from quadwalk.tune.trials import TuneConfig

MARKS = 12  # times that a learning curve is compared with the others'
WARM_UP = MARKS // 4  # before which none is stopped
STARTUP = 4  # trials that all others' curves are compared with, at least
LISTED = 10  # trials in the table
# What makes a search: more trials, or other cores, are the same search.
_SAME = ("task", "over", "flags", "steps", "seed", "objective", "episodes", "prune")


def search(config: TuneConfig) -> None:
    """Search, print the best, and write them beside the study."""
    base = _base(config)
    space = dimensions(config.over, base)
    _check_objective(config.objective, base)
    place = place_of(config)
    folder = real_path(config.runs / (config.name or base.task))
    with lock_folder(folder):
        search = Search(config, base, space, folder)
        jobs = search.jobs()
        for outcome in run_jobs(jobs, place, search.left, search.watch):
            search.tell(outcome)
        text = search.table()
        with atomic_write(folder / "tune.md") as file:
            file.write(f"{text}\n".encode())
    print(text)


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Make a search's folder and keep it for this process; `UserError` if another one has it.

    The system takes the lock back when the process ends, however it ends.
    """
    make_folder(folder, "the folder of the search")
    with open(folder / "lock", "ab") as file:
        if lock(file) is False:
            raise UserError(
                f"{folder} is being searched by another process; expected its end, or another "
                "--name"
            )
        yield


def _base(config: TuneConfig) -> TrainConfig:
    """The training that all trials are, but for what is searched."""
    found, _ = parse_config([config.task, *split_words(config.flags)], "quadwalk train")
    return replace(found, steps=config.steps or found.steps, seed=config.seed)


def _check_objective(name: str, base: TrainConfig) -> None:
    known = ["score", "fall_rate", *(figure.name for figure in FIGURES)]
    absent = {"velocity_error", "yaw_rate_error", "path_speed", "path"}
    if base.env.command.given:
        absent = {"speed", "distance", "lateral_drift", "heading_error"}
    known = [each for each in known if each not in absent]
    if name not in known:
        raise UsageError(
            f"--objective is {name!r}; expected for {base.task} one of: {', '.join(known)}"
            f"{meant(name, known)}"
        )


def _less_is_better(objective: str) -> bool:
    worst = {figure.name: figure.worst for figure in FIGURES}
    return objective == "fall_rate" or getattr(worst.get(objective), "__name__", "") == "max"


def measured(run: Run, objective: str, episodes: int) -> float:
    """How good a run's last policy is."""
    if objective == "score":
        return load_score(run.policy)[1]
    figure = evaluate(run, episodes=episodes, engine="mujoco").summary[objective]
    return figure if isinstance(figure, float) else figure_mean(figure)


class Search:
    """A study on the disk and its trials; made anew, it goes on where it was."""

    def __init__(
        self, config: TuneConfig, base: TrainConfig, space: list[Dimension], folder: Path
    ) -> None:
        self._config, self._base, self._space, self.folder = config, base, space, folder
        self._less = _less_is_better(config.objective)
        self._keep_settings()
        self._optuna, self._study = self._open()
        self._trials: dict[str, Any] = {}
        self._speeds: dict[str, collections.deque[float]] = {}
        self._pruned: set[str] = set()

    def _keep_settings(self) -> None:
        """Write what is searched, or `UserError` if the folder has another search."""
        path = self.folder / "tune.json"
        now = {name: value for name, value in asdict(self._config).items() if name in _SAME}
        now["over"] = list(now["over"])
        if path.exists():
            kept = json.loads(read_bytes(path))
            for name, value in now.items():
                if kept.get(name) != value:
                    raise UserError(
                        f"{self.folder} has a search with --{name} {kept.get(name)}; expected "
                        "the same, or another --name"
                    )
            return
        write_json_atomic(path, now)

    def _open(self) -> tuple[Any, Any]:
        optuna = extra("optuna", "tune", "tune")
        refused = extra("sqlalchemy.exc", "tune", "tune").DatabaseError
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        path = self.folder / "study.db"
        try:
            storage = optuna.storages.RDBStorage(f"sqlite:///{path}")
            study = optuna.create_study(
                storage=storage,
                study_name="tune",
                load_if_exists=True,
                direction="minimize" if self._less else "maximize",
                pruner=optuna.pruners.MedianPruner(STARTUP, WARM_UP),
            )
        except refused as error:
            reason = str(error.orig or error)
            raise UserError(f"{path} cannot be used as a study: {reason}") from None
        # Its own sequence of numbers after each start: else it would draw the same again.
        seed = self._config.seed + len(study.trials)
        study.sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=2 * STARTUP)
        return optuna, study

    @property
    def left(self) -> int:
        """Trials that are not finished."""
        finished = sum(trial.state.is_finished() for trial in self._study.trials)
        return max(0, self._config.trials - finished)

    def jobs(self) -> Iterator[Job]:
        """Those that a kill left, then new ones, each with what is known by then."""
        asked = {each.name: each.distribution() for each in self._space}
        for found in self._study.trials:
            if not found.state.is_finished():
                trial = self._optuna.trial.Trial(self._study, found._trial_id)
                if found.params.keys() == asked.keys():
                    yield self._job(trial)
                else:  # killed while its settings were written
                    self._study.tell(trial, state=self._optuna.trial.TrialState.FAIL)
        while len(self._study.trials) < self._config.trials:
            yield self._job(self._study.ask(asked))

    def _job(self, trial: Any) -> Job:
        name = f"trial_{trial.number:03d}"
        self._trials[name] = trial
        self._speeds[name] = collections.deque(maxlen=SCORED)
        config = with_settings(self._base, rounded(trial.params))
        own = replace(config, name=name, runs=self.folder)
        objective, episodes = self._config.objective, self._config.episodes
        judge = partial(measured, objective=objective, episodes=episodes)
        return Job(sized(own, self._config), judge)

    def watch(self, job: Job, row: Row) -> bool:
        """Note how the learning curve goes; whether the trial is to be stopped."""
        trial, speeds = self._trials[job.name], self._speeds[job.name]
        before = row["steps"] - job.config.envs * job.config.ppo.unroll  # type: ignore[operator]
        speeds.append(scored_figure(row))
        mark, last = (int(MARKS * steps / job.config.steps) for steps in (row["steps"], before))
        if mark == last or job.name in self._pruned or mark >= MARKS:
            return False
        now = score(speeds, row["eval/fall_rate"])
        # A trial that goes on from a checkpoint has been there before.
        known = self._study._storage.get_trial(trial._trial_id).intermediate_values
        if mark not in known:
            trial.report(-now if self._less else now, mark)
        if self._config.prune and trial.should_prune():
            self._pruned.add(job.name)
            return True
        return False

    def tell(self, outcome: Outcome) -> None:
        state, trial = self._optuna.trial.TrialState, self._trials[outcome.job.name]
        if outcome.job.name in self._pruned:
            self._study.tell(trial, state=state.PRUNED)
        elif outcome.error is not None:
            self._study.tell(trial, state=state.FAIL)
        elif not outcome.stopped:  # otherwise the next call resumes it
            self._study.tell(trial, outcome.value)

    def table(self) -> str:
        """The best trials as Markdown, how many there were, and what trains the best."""
        states = collections.Counter(trial.state.name.lower() for trial in self._study.trials)
        count = ", ".join(f"{n} {name}" for name, n in sorted(states.items()))
        done = self._optuna.trial.TrialState.COMPLETE
        complete = [trial for trial in self._study.trials if trial.state == done]
        complete.sort(key=lambda trial: trial.value, reverse=not self._less)
        names = [each.name for each in self._space]
        lines = [
            f"| trial | {self._config.objective} | {' | '.join(names)} |",
            "|" + "---|" * (2 + len(names)),
        ]
        for trial in complete[:LISTED]:
            values = rounded(trial.params)
            cells = [f"{trial.number}", f"{trial.value:.3f}", *(str(values[n]) for n in names)]
            lines.append(f"| {' | '.join(cells)} |")
        lines += ["", f"{len(self._study.trials)} trials: {count}"]
        return "\n".join([*lines, *(self._commands(complete[0]) if complete else [])])

    def _commands(self, best: Any) -> list[str]:
        own = split_words(self._config.flags)
        flags = as_flags(best.params)
        usual = shlex.join([self._config.task, *own])
        return [
            f"train the best      {as_typed('train', self._config.task, *own, *flags)}",
            "on fresh seeds      "
            + as_typed("compare", usual, f"{usual} {shlex.join(flags)}", "--seeds", "3"),
            f"all trials          {self.folder}",
        ]
