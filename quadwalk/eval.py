"""`eval.py`, which is also `quadwalk eval`: evaluate a policy, or drive it."""

import sys
from collections.abc import Sequence

from quadwalk.cli.arguments import parse
from quadwalk.evaluation.options import EvalConfig


def main(args: Sequence[str] | None = None, prog: str = "eval.py") -> None:
    """Parse the command line, and evaluate or drive."""
    config = parse(EvalConfig, sys.argv[1:] if args is None else args, prog)
    # Either takes seconds to import.
    if config.live:
        from quadwalk.view.show import ViewConfig, drive

        own = {key: getattr(config, key) for key in ("policy", "browser", "host", "port", "runs")}
        drive(ViewConfig(config.run[0], **own))
    else:
        from quadwalk.evaluation.session import evaluate_runs

        evaluate_runs(config)
