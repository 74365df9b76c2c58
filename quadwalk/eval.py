"""`eval.py`, which is also `quadwalk eval`: evaluate a policy, or drive it."""

from collections.abc import Sequence

from quadwalk.cli.arguments import parse
from quadwalk.evaluation.options import EvalConfig


def main(args: Sequence[str], prog: str = "eval.py") -> None:
    """Parse the command line, and evaluate or drive."""
    config = parse(EvalConfig, args, prog)
    # Either takes seconds to import.
    if config.live:
        from quadwalk.view.show import ViewConfig, drive

        own = {key: getattr(config, key) for key in ("policy", "browser", "host", "port", "runs")}
        drive(ViewConfig(config.run[0], **own))
    else:
        from quadwalk.evaluation.session import evaluate_runs

        evaluate_runs(config)
