"""`python -m quadwalk.train`, which is also `train.py`: teach a quadruped to run."""

import sys
from collections.abc import Sequence

from quadwalk.cli import parse
from quadwalk.errors import UsageError, run_command
from quadwalk.train.runs.resume import resumed_config
from quadwalk.train.settings import PRESETS, TrainConfig


def parse_config(args: Sequence[str], prog: str = "train.py") -> TrainConfig:
    """The configuration that a command line asks for; `UsageError` for one that cannot be."""
    # The flags that choose what all others change are looked at first.
    resume = _value(args, "--resume")
    if resume is not None:
        default = resumed_config(_value(args, "--runs") or TrainConfig.runs, resume)
        for flag in ("--preset", "--name", "--robot.urdf"):
            if _value(args, flag) is not None:
                raise UsageError(f"{flag} cannot be given with --resume: the run has its own")
        return parse(TrainConfig, args, prog, default=default)
    preset = _value(args, "--preset") or "run"
    if preset not in PRESETS:
        raise UsageError(f"--preset is {preset!r}; expected one of: {', '.join(PRESETS)}")
    return parse(TrainConfig, args, prog, default=PRESETS[preset])


def _value(args: Sequence[str], flag: str) -> str | None:
    """The value of `flag` among `args`, None if it is not there."""
    for arg, following in zip(args, [*args[1:], ""], strict=False):
        if arg == flag:
            return following
        if arg.startswith(f"{flag}="):
            return arg.partition("=")[2]
    return None


def main() -> None:
    """Parse the command line and train."""
    config = parse_config(sys.argv[1:])
    # Imported late: bad flags are told, and the first sign of progress is shown, without JAX.
    from quadwalk.train.loop import train

    train(config)


if __name__ == "__main__":
    run_command(main)
