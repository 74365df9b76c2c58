"""Metrics of a training on Weights & Biases, only with `--log wandb`.

Sent are the settings and the rows of metrics: no code, no console output, no git, no machine.
`WANDB_MODE=offline` keeps them in runs/NAME/wandb, from where `wandb sync` sends them.
"""

from collections.abc import Mapping
from typing import Any

from quadwalk.cli.shell import import_extra
from quadwalk.errors import UserError
from quadwalk.runs.directory import Run, get_modified_time
from quadwalk.settings.serialize import flatten
from quadwalk.settings.training import TrainConfig

PROJECT = "quadwalk"  # WANDB_PROJECT is another


def check_wandb() -> None:
    """Raise `UserError` if wandb is not installed; ask for a key if there is none."""
    wandb = _import_wandb()
    try:
        wandb.login()
    except Exception as error:
        raise _make_error(error) from error


class WandbLog:
    """A run of Weights & Biases with the name of `run`; a resumed training continues it."""

    def __init__(self, run: Run, config: TrainConfig) -> None:
        wandb = _import_wandb()
        settings = {name: str(value) for name, value in flatten(config).items()}
        private: Any = wandb.Settings(
            console="off",
            disable_git=True,
            save_code=False,
            silent=True,
            x_disable_meta=True,
            x_disable_stats=True,
            x_save_requirements=False,
        )
        try:
            self._run: Any = wandb.init(
                project=PROJECT,
                name=run.name,
                id=_find_id(run),
                resume="allow",
                dir=str(run.path),
                config=settings,
                settings=private,
            )
            # Rows that a resumed training writes again are at the same steps.
            self._run.define_metric("*", step_metric="steps")
        except Exception as error:
            raise _make_error(error) from error

    def append(self, row: Mapping[str, Any]) -> None:
        """Log a row of metrics; `UserError` if wandb refuses it."""
        try:
            self._run.log({name: float(value) for name, value in row.items()})
        except Exception as error:
            raise _make_error(error) from error

    def close(self) -> None:
        self._run.finish()


def _import_wandb() -> Any:
    return import_extra("wandb", "--log wandb", "wandb")


def _find_id(run: Run) -> str | None:
    """Return the ID of the last training of `run`, from its folders wandb/[offline-]run-TIME-ID.

    None if there is none.
    """
    folders = sorted((run.path / "wandb").glob("*run-*-*"), key=get_modified_time)
    return folders[-1].name.rpartition("-")[2] if folders else None


def _make_error(error: Exception) -> UserError:
    return UserError(f"Weights & Biases: {error}")
