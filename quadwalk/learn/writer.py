"""The files that a training writes, also where the disk refuses for a time."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from quadwalk.brax import NestedMeanStd
from quadwalk.errors import UserError
from quadwalk.learn import nan
from quadwalk.learn.prepare import Training
from quadwalk.runs import checkpoint
from quadwalk.runs.changes import describe_changes
from quadwalk.runs.directory import Run, delete_checkpoints_after, prune_checkpoints
from quadwalk.runs.log import MetricsLog, read_history
from quadwalk.runs.policy import SavedValue, load_score, save_policy
from quadwalk.runs.wandb import WandbLog
from quadwalk.settings.serialize import to_dict

KEPT_CHECKPOINTS = 3
CURVE_SECONDS = 30.0  # the learning curve is drawn anew this often...
CURVE_SHARE = 0.02  # ...or as often as takes this share of the time, if that is less often


class RunWriter:
    """Writes a run's files while it trains; a context manager.

    A failed write is reported once, through `warn`. Training continues, what was there stays as
    it was, and the next call tries again.
    """

    def __init__(self, training: Training, run: Run, warn: Callable[[str], None]) -> None:
        """Drop rows of metrics beyond the state that `training` begins with."""
        self.run = run
        self.saved: int | None = training.steps or None  # steps behind the last checkpoint
        self.best: tuple[int, float] | None = None  # steps and score of the best policy
        self.targets: tuple[int, ...] = ()  # steps behind the checkpoints that an undo goes back to
        self._training = training
        self._warn = warn
        self._refused: dict[str, str] = {}
        self._told_of_nan = False
        self._draw_at = time.monotonic() + CURVE_SECONDS
        self._log = MetricsLog(run, resume_at=training.steps if training.resumed else None)
        self._wandb = WandbLog(run, training.config) if training.config.log == "wandb" else None
        if run.best.exists():
            self._try_to_write("best", self._read_best)

    def __enter__(self) -> "RunWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self._log.close()
        if self._wandb is not None:
            self._wandb.close()

    def log_iteration(self, row: dict[str, float], nan_step: Any, seconds: float) -> None:
        """Log an iteration's `row`, keep its `NanStep`, if any, and draw the curve now and then."""
        pace = row["steps"] / seconds
        timing = {"time/elapsed": seconds, "time/steps_per_second": pace}
        self._try_to_write("metrics", lambda: self._log.append(row, timing))
        if (wandb := self._wandb) is not None:
            self._try_to_write("wandb", lambda: wandb.append({**row, **timing}))
        if nan_step.flag > 0:
            self._try_to_write("nan", lambda: self._keep_nan_step(nan_step, int(row["steps"])))
        if time.monotonic() > self._draw_at:
            self.draw_curve()

    def _keep_nan_step(self, nan_step: Any, steps: int) -> None:
        """Save the step that gave NaN to the run's folder `nan`; warn the first time."""
        config = self._training.config
        path = nan.keep(self.run, nan_step.before, nan_step.action, config, steps)
        if path is not None and not self._told_of_nan:
            self._warn(f"a step gave NaN: its episode ended, and {path} keeps it")
            self._told_of_nan = True

    def draw_curve(self) -> None:
        """Draw the learning curve, and plan when to draw it next."""
        # Matplotlib: a third of a second that the first iteration does not wait for.
        from quadwalk.progress.curves import RANDOMIZED, save_learning_curve

        run, start = self.run, time.monotonic()
        best = self.best[0] if self.best else None
        note = RANDOMIZED if self._training.config.env.randomization.enabled else ""
        self._try_to_write(
            "curve",
            lambda: save_learning_curve(read_history(run), run.learning_curve, best, note),
        )
        now = time.monotonic()
        self._draw_at = now + max(CURVE_SECONDS, (now - start) / CURVE_SHARE)

    def save(self, state: Any, steps: int, seconds: float) -> bool:
        """Save policy, best policy and checkpoint; return True if all went well."""
        training, score = self._training, self._training.metrics.score
        metadata = {
            "kind": "checkpoint",
            "config": to_dict(training.config),
            "steps": steps,
            "seconds": seconds,
            "metrics": training.metrics.get_state(),
            "mirrors": training.networks.mirrors,
        }

        def save_checkpoint() -> None:
            self._log.sync()  # a checkpoint counts on the rows before it
            checkpoint.save(self.run.locate_checkpoint(steps), state, metadata)

        # The policies first: they are small and most valuable, should the disk be full.
        saved = self.publish(state, steps)
        if steps and (self.best is None or score > self.best[1]):  # before that there is no score
            if self._try_to_write("best", lambda: self._save_policy(self.run.best, state, steps)):
                self.best = steps, score
            else:
                saved = False
        if self._try_to_write("checkpoint", save_checkpoint):
            self.saved = steps
            others = (*self.targets, *([self.best[0]] if self.best else []))
            prune_checkpoints(
                self.run, KEPT_CHECKPOINTS, also=[*map(self.run.locate_checkpoint, others)]
            )
        else:
            saved = False
        return saved

    def go_back(self, steps: int) -> None:
        """Drop all that was written after `steps` control steps, where training goes back to.

        The policy that was the best until then may be gone: the next one that is saved is the best.
        """
        self._log.close()
        self._log = MetricsLog(self.run, resume_at=steps)
        delete_checkpoints_after(self.run, steps)
        self.saved = steps
        if self.best is not None and self.best[0] > steps:
            self.best = None

    def publish(self, state: Any, steps: int) -> bool:
        """Save only the newest policy, for a viewer; return True if that went well."""
        return self._try_to_write(
            "policy", lambda: self._save_policy(self.run.policy, state, steps)
        )

    @property
    def trouble(self) -> str:
        """The error of the oldest write that is still refused; "" if there is none."""
        return next(iter(self._refused.values()), "")

    def _save_policy(self, path: Path, state: Any, steps: int) -> None:
        """Save the policy in `state`, after `steps` of training, to `path`."""
        training, networks, learner = self._training, self._training.networks, state.learner
        statistics = NestedMeanStd(learner.normalizer.mean, learner.normalizer.std)
        save_policy(
            path,
            *networks.to_plain(statistics, learner.params.policy),
            training.config,
            training.quadruped.joints,
            steps,
            training.metrics.score,
            describe_changes(training.start, training.config),
            SavedValue(statistics, networks.to_plain_value(learner.params.value)),
        )

    def _read_best(self) -> None:
        """Read steps and score of the best policy so far from its file."""
        self.best = load_score(self.run.best)

    def _try_to_write(self, what: str, write: Callable[[], Any]) -> bool:
        """Call `write`; return False where it is refused, and report that once."""
        try:
            write()
        except UserError as error:
            if what not in self._refused:
                self._warn(f"warning: {error}; training continues and will retry")
            self._refused[what] = str(error)
            return False
        if self._refused.pop(what, None):
            self._warn(f"{what}: written again")
        return True
