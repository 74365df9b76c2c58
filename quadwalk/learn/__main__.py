"""`quadwalk train`, which is also `train.py`: teach a quadruped a task."""

from quadwalk.cli.process import run_command

if __name__ == "__main__":
    run_command("quadwalk.learn.__main__")

import sys
from collections.abc import Sequence

from rich.console import Console


def main(args: Sequence[str] | None = None, prog: str = "train.py") -> None:
    # Tasks are functions of JAX, which takes a second to import: a terminal shows at once that
    # something goes on.
    with Console(stderr=True).status("loading"):
        from quadwalk.learn.flags import parse_config

        config, previous = parse_config(sys.argv[1:] if args is None else args, prog)
        from quadwalk.learn.loop import train  # not before: --help and errors need none of it

    train(config, previous)
