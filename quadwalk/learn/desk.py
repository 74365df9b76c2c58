"""The desk: a task's numbers are changed while its training runs.

Programs have the numbers as arguments (`quadwalk.env.numbers`), so a change takes effect in the
next iteration without compiling. All changes are in desk.jsonl (`quadwalk.runs.changes`). The
checkpoint before each is what an undo goes back to: it loads that, and training goes on as if the
change had never been. A page sends what to change, and shows what there is.
"""

import dataclasses
import queue
import reprlib
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.numbers import get_numbers, list_numbers
from quadwalk.errors import UsageError, UserError, suggest
from quadwalk.files import open_atomic
from quadwalk.learn.desk_messages import make_iteration_message, make_state_message
from quadwalk.learn.ppo import Iteration, TrainState
from quadwalk.learn.prepare import Training, match_metrics, restore, set_numbers
from quadwalk.learn.recipe import format_flags, format_task, list_available_terms
from quadwalk.learn.writer import RunWriter
from quadwalk.progress.display import Progress
from quadwalk.progress.watch import Page
from quadwalk.runs.changes import (
    STEPS,
    Change,
    apply_change,
    find_last,
    list_standing,
    write_changes,
)
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import TrainConfig

MOST_UNDOS = 10  # changes before which a checkpoint stays
_METRIC = "reward/"  # before a term's name in the metrics of a step
_POLL = 0.2  # s between looks for the end of a pause


@dataclass(frozen=True)
class DeskIteration:
    """An iteration of a training, as `on_iteration` gets it."""

    iteration: int  # iterations done
    steps: int  # control steps done
    row: dict[str, float]  # its metrics
    scales: dict[str, float]  # of the reward's terms
    numbers: dict[str, float]  # all that can be changed, such as env.reward.energy.scale


OnIteration = Callable[[DeskIteration], Mapping[str, float] | None]


class Desk:
    """The desk of one training: changes its numbers, undoes changes, and tells a page of them."""

    def __init__(
        self,
        training: Training,
        writer: RunWriter,
        progress: Progress,
        stop: threading.Event,
        page: Page | None = None,
        on_iteration: OnIteration | None = None,
    ) -> None:
        """Resume at the state of `training`; changes in desk.jsonl after it are made again."""
        assert training.changes is not None
        self._training, self._writer, self._progress = training, writer, progress
        self._stop, self._page, self._on_iteration = stop, page, on_iteration
        self._lines = list(training.changes)
        # Of the length, all hold from the beginning.
        later = [change for change in self._standing if change.steps > training.steps]
        self._pending = [change for change in later if change.name != STEPS]
        self._state: Literal["training", "paused", "compiling", "ended"] = "training"
        self._programs = {tuple(training.config.env.reward): (training.env, training.iterate)}
        self._keep_targets()
        progress.set_total(training.config.steps)
        self._send_state()

    @property
    def numbers(self) -> dict[str, float]:
        """The present value of each number that can be changed, by its name."""
        config = self._training.config
        names = [number.name for number in list_numbers(self._make_program(config).env)]
        return get_numbers(config.env, names)

    @property
    def iteration(self) -> int:
        """Iterations done."""
        return self._training.steps // self._training.batch

    def update(self, is_over: Callable[[], bool]) -> float:
        """Make the changes that are due, and wait while paused; return the seconds of the pause."""
        while self._pending and self._pending[0].steps <= self._training.steps:
            self._make(self._pending.pop(0), is_new=False)
            self._send_state()
        start, was_paused = time.monotonic(), False
        while not is_over():
            message = self._get_message()
            if message is not None:
                self._handle(message)
            elif self._state != "paused":
                break
            was_paused |= self._state == "paused"
        return time.monotonic() - start if was_paused else 0.0

    def report(self, row: dict[str, float]) -> None:
        """Report an iteration to the page and to `on_iteration`; change what the latter returns."""
        training = self._training
        self._send(make_iteration_message(self.iteration, training.steps, training.seconds, row))
        if self._on_iteration is None:
            return
        scales = {name: term.scale for name, term in training.config.env.reward.items()}
        view = DeskIteration(self.iteration, training.steps, row, scales, self.numbers)
        for name, value in (self._on_iteration(view) or {}).items():
            self._try_to(partial(self.set_number, name, value))

    def end(self) -> None:
        """Report to the page that training has ended."""
        self._state = "ended"
        self._send_state()

    def set_number(self, name: str, value: Any) -> None:
        """Change a number from the next iteration on; `UserError` for one that it cannot be."""
        numbers = self.numbers
        if f"{name}.scale" in numbers:  # a term's flag is its scale
            name = f"{name}.scale"
        if name not in numbers:
            raise UsageError(f"no number {name!r} at the desk{suggest(name, numbers)}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise UsageError(f"{name} is {reprlib.repr(value)}; expected a number")
        if value != numbers[name]:
            self._commit(name, numbers[name], value)

    def add_term(self, name: str) -> None:
        """Add a term of the package to the reward: compile the programs anew, and go on."""
        available = list_available_terms(self._training.config)
        if name not in available:
            raise UsageError(f"no term {name!r} to add{suggest(name, available)}")
        self._commit(f"env.reward.{name}", None, to_dict(available[name]))

    def set_total(self, steps: Any) -> None:
        """Train for more control steps in all than planned; annealing keeps its plan."""
        present = self._training.config.steps
        if isinstance(steps, bool) or not isinstance(steps, int) or steps <= present:
            raise UsageError(f"steps is {reprlib.repr(steps)}; expected more than {present}")
        self._commit(STEPS, present, steps)

    def undo(self) -> None:
        """Go back to before the last change; training goes on as if it had never been."""
        self._check_repeated()
        training, run, last = self._training, self._writer.run, find_last(self._standing)
        if last is None:
            raise UserError("there is no change to undo")
        path = run.locate_checkpoint(last.steps)
        if not path.exists():
            raise UserError(f"{path} is gone; expected one of the last {MOST_UNDOS} changes")
        config = training.start
        for change in self._standing:
            config = config if change is last else apply_change(config, change)
        program = self._get_program(config)
        before = training.config, training.state
        self._use(config, *program)
        try:
            restore(training, path)
        except UserError:
            training.state = before[1]
            self._use(before[0], *self._get_program(before[0]))
            raise
        # Checkpoints first: were it killed between, training would resume before the change.
        self._writer.go_back(training.steps)
        line = dataclasses.replace(last, old=last.new, new=last.old, undo=True)
        self._write([*self._lines, line])
        self._writer.publish(training.state, training.steps)
        self._keep_targets()
        self.note(f"{last.name}: back to {training.steps:,} steps, before its change")

    def take_back(self, error: UserError) -> bool:
        """Take back the last change, which led to `error`; return True if that went well."""
        if self._pending or find_last(self._standing) is None:
            return False
        self.note(str(error), error=True)
        is_back = self._try_to(self.undo)
        self._send_state()
        return is_back

    def note(self, text: str, error: bool = False) -> None:
        """Say a line, in the page too."""
        self._progress.say(text)
        self._send({"type": "note", "text": text, "error": error})

    @property
    def _standing(self) -> list[Change]:
        return list_standing(self._lines)

    def _commit(self, name: str, old: Any, new: Any) -> None:
        """Make a change, and write it down."""
        self._check_repeated()
        self._make(Change(self.iteration, self._training.steps, name, old, new))

    def _check_repeated(self) -> None:
        if self._pending:
            iteration = self._pending[-1].iteration
            raise UserError(f"earlier changes are made again until iteration {iteration}")

    def _make(self, change: Change, is_new: bool = True) -> None:
        """Make a change after the checkpoint that an undo goes back to; `UserError` if it cannot.

        In that case nothing changes.
        """
        training, writer = self._training, self._writer
        config = apply_change(training.config, change)
        program = self._get_program(config)
        is_saved = change.name == STEPS or writer.saved == training.steps
        is_saved = is_saved or writer.save(training.state, training.steps, training.seconds)
        if is_new and not is_saved:
            raise UserError(f"{change.name} is not changed: {writer.trouble}")
        if is_new:
            self._write([*self._lines, change])
        self._use(config, *program)
        self._keep_targets()

    def _write(self, lines: list[Change]) -> None:
        write_changes(self._writer.run, lines)
        self._lines = lines

    def _use(self, config: TrainConfig, env: QuadrupedEnv, iterate: Iteration) -> None:
        """Train with the numbers of `config` from now on, in the program for its terms."""
        training = self._training
        program = self._make_program(config)
        iterate.set_env(set_numbers(env, program, config))
        training.config, training.env, training.iterate = config, env, iterate
        training.metrics.rewards = config.env.reward
        training.state = _match_terms(training.state, config)
        self._progress.set_total(config.steps)

    def _get_program(self, config: TrainConfig) -> tuple[QuadrupedEnv, Iteration]:
        """Return the environment with the terms of `config`, and its compiled programs."""
        training, key = self._training, tuple(config.env.reward)
        if key in self._programs:
            return self._programs[key]
        state, self._state = self._state, "compiling"
        self._send_state()
        self._progress.show_phase("compiling", 25.0)
        try:
            program = self._make_program(config)
            env = type(training.env)(training.quadruped, program.env)
            iterate = training.make_iteration(set_numbers(env, program, config))
            iterate.trace(_match_terms(training.state, config))
            iterate.compile()
        finally:
            self._state = state
        self._programs[key] = env, iterate
        return env, iterate

    def _make_program(self, config: TrainConfig) -> TrainConfig:
        """Return the settings that a program is made for: the start's, with the terms added."""
        start = self._training.start
        reward = {**config.env.reward, **start.env.reward}
        return dataclasses.replace(start, env=dataclasses.replace(start.env, reward=reward))

    def _keep_targets(self) -> None:
        """Keep the checkpoints that an undo may go back to."""
        changes = [change for change in self._standing if change.name != STEPS]
        self._writer.targets = tuple(change.steps for change in changes[-MOST_UNDOS:])

    def _get_message(self) -> dict[str, Any] | None:
        """Return the next message of the page, None without one; wait a moment while paused."""
        is_paused = self._state == "paused"
        if self._page is None:
            return None
        try:
            return self._page.messages.get(block=is_paused, timeout=_POLL)
        except queue.Empty:
            return None

    def _handle(self, message: Mapping[str, Any]) -> None:
        """Handle a message of the page; where it cannot be done, say why in a line."""
        name, term = str(message.get("name")), str(message.get("term"))
        actions: dict[Any, Callable[[], object]] = {
            "set": lambda: self.set_number(name, message.get("value")),
            "add": lambda: self.add_term(term),
            "undo": self.undo,
            "pause": lambda: self._set_state("paused"),
            "go": lambda: self._set_state("training"),
            "stop": self._stop.set,
            "total": lambda: self.set_total(message.get("value")),
            "flags": self._send_flags,
            "save": lambda: self._save_task(str(message.get("file"))),
        }
        action = actions.get(str(message.get("type")))
        if action is not None:
            self._try_to(action)
            self._send_state()

    def _try_to(self, action: Callable[[], object]) -> bool:
        """Call `action`; return False, and say why in a line, where it raises a `UserError`."""
        try:
            action()
        except UserError as error:
            self.note(str(error), error=True)
            return False
        return True

    def _set_state(self, state: Literal["training", "paused"]) -> None:
        self._state = state

    def _send_flags(self) -> None:
        text = format_flags(self._training.config, self._writer.run)
        self._send({"type": "text", "kind": "flags", "text": text, "file": None})

    def _save_task(self, file: str) -> None:
        """Write a task file with the present numbers into the folder that training runs in."""
        path = Path(file)
        if path.name != file or not path.stem.isidentifier() or path.suffix != ".py":
            raise UsageError(f"the file is {file!r}; expected a name such as my_task.py")
        if path.exists():
            raise UsageError(f"{path} exists; expected another name")
        text = format_task(self._training.config, self._writer.run, path.stem)
        with open_atomic(path) as stream:
            stream.write(text.encode())
        message = {"type": "text", "kind": "task", "text": text, "file": str(path.resolve())}
        self._send(message)

    def _send(self, message: Mapping[str, Any]) -> None:
        if self._page is not None:
            self._page.send(message)

    def _send_state(self) -> None:
        """Send the page all that it shows of the desk."""
        if self._page is None:
            return
        training, changes = self._training, self._standing
        message = make_state_message(
            training.start, training.config, self._make_program(training.config), changes
        )
        now = {
            "iteration": self.iteration,
            "steps": training.steps,
            "state": self._state,
            "can_undo": not self._pending and find_last(changes) is not None,
        }
        self._send({**message, **now})


def _match_terms(state: TrainState, config: TrainConfig) -> TrainState:
    """Return `state` with a metric for each term of the reward."""
    others = [name for name in state.workers.envs.metrics if not name.startswith(_METRIC)]
    return match_metrics(state, [*others, *(f"{_METRIC}{name}" for name in config.env.reward)])
