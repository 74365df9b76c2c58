"""`quadwalk tune`: search settings of a task over many trainings."""

import sys
from collections.abc import Sequence

from quadwalk.command.line import parse
from quadwalk.command.process import run_command
from quadwalk.errors import UsageError
from quadwalk.tune.trials import TuneConfig


def main(args: Sequence[str] | None = None, prog: str = "quadwalk tune") -> None:
    config = parse(TuneConfig, sys.argv[1:] if args is None else args, prog)
    if not config.over:
        raise UsageError(
            f"no setting to search is given; expected: {prog} {config.task} "
            "--over env.reward.energy=-0.5:-0.01"
        )
    from quadwalk.tune.search import search

    search(config)


if __name__ == "__main__":
    run_command(main)
