"""`python -m quadwalk.train`, which is also `train.py`: teach a quadruped to run."""

import sys
from collections.abc import Sequence

from quadwalk.cli import parse
from quadwalk.errors import UsageError, run_command
from quadwalk.train.config import PRESETS, TrainConfig


def parse_config(args: Sequence[str], prog: str = "train.py") -> TrainConfig:
    """The configuration that a command line asks for; `UsageError` for one that cannot be."""
    preset = "run"
    for flag, value in zip(args, [*args[1:], ""], strict=False):
        if flag == "--preset":
            preset = value
        elif flag.startswith("--preset="):
            preset = flag.partition("=")[2]
    if preset not in PRESETS:
        raise UsageError(f"--preset is {preset!r}; expected one of: {', '.join(PRESETS)}")
    return parse(TrainConfig, args, prog, default=PRESETS[preset])


def main() -> None:
    """Parse the command line and train."""
    config = parse_config(sys.argv[1:])
    # Imported late: bad flags are told, and the first sign of progress is shown, without JAX.
    from quadwalk.train.session import train

    train(config)


if __name__ == "__main__":
    run_command(main)
