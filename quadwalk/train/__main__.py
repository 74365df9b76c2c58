"""`python -m quadwalk.train`, which is also `train.py`: teach a quadruped a task."""

import sys
from collections.abc import Sequence

from quadwalk.process import run_command


def main(args: Sequence[str] | None = None, prog: str = "train.py") -> None:
    """Parse the command line and train."""
    from rich.console import Console

    # Tasks are functions of JAX, which takes a second to import: a terminal shows at once that
    # something goes on.
    with Console(stderr=True).status("loading"):
        from quadwalk.train.flags import parse_config
        from quadwalk.train.loop import train

        config, previous = parse_config(sys.argv[1:] if args is None else args, prog)
    train(config, previous)


if __name__ == "__main__":
    run_command(main)
