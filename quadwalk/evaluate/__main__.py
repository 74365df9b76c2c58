"""`python -m quadwalk.evaluate`, which is also `eval.py`: judge a policy, or drive it."""

from quadwalk.process import run_command

if __name__ == "__main__":
    run_command("quadwalk.evaluate.__main__")

import sys
from collections.abc import Sequence

from quadwalk.cli import parse
from quadwalk.evaluate.options import EvalConfig


def main(args: Sequence[str] | None = None, prog: str = "eval.py") -> None:
    """Parse the command line, and evaluate or drive."""
    config = parse(EvalConfig, sys.argv[1:] if args is None else args, prog)
    if config.live:
        from quadwalk.view.drive import ViewConfig, drive

        drive(ViewConfig(config.run[0], config.browser, config.host, config.port, config.runs))
        return
    from quadwalk.evaluate.judge import evaluate

    evaluate(config)
