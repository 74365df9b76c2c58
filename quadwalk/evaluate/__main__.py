"""`python -m quadwalk.evaluate`, which is also `eval.py`: judge a policy and write it down."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from quadwalk.cli import parse
from quadwalk.errors import UsageError, run_command


@dataclass(frozen=True)
class EvalConfig:
    """Roll a trained policy out, measure it, and write its episodes as MCAP files."""

    run: Annotated[str, tyro.conf.Positional] = "latest"  # its name or path, or "latest"
    episodes: int = 16  # how many, each from another start
    seconds: float = 20.0  # s, the time limit of an episode
    engine: str = "mjx"  # "mjx", or "mujoco": MuJoCo C, every shape colliding, converged solver
    seed: int = 0  # of the starts; the same seed gives the same episodes
    out: Path | None = None  # folder for the results; by default, a new one in the run's
    mcap: int | None = None  # write only so many episodes as MCAP; by default, all
    runs: Path = Path("runs")  # the folder that holds all runs

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise UsageError(f"--episodes is {self.episodes}; expected 1 or more")
        if not 0.0 < self.seconds <= 3600.0:
            raise UsageError(f"--seconds is {self.seconds}; expected more than 0, up to 3600")
        if self.engine not in ("mjx", "mujoco"):
            raise UsageError(f"--engine is {self.engine!r}; expected mjx or mujoco")
        if not 0 <= self.seed < 2**32:
            raise UsageError(f"--seed is {self.seed}; expected 0 to {2**32 - 1}")
        if self.mcap is not None and self.mcap < 0:
            raise UsageError(f"--mcap is {self.mcap}; expected 0 or more")


def main() -> None:
    """Parse the command line and evaluate."""
    config = parse(EvalConfig, sys.argv[1:], "eval.py")
    from quadwalk.evaluate.evaluation import evaluate

    evaluate(config)


if __name__ == "__main__":
    run_command(main)
