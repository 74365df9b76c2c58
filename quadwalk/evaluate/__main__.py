"""`python -m quadwalk.evaluate`, which is also `eval.py`: judge a policy and write it down."""

import sys

from quadwalk.cli import parse
from quadwalk.errors import run_command
from quadwalk.evaluate.options import EvalConfig


def main() -> None:
    """Parse the command line and evaluate."""
    config = parse(EvalConfig, sys.argv[1:], "eval.py")
    from quadwalk.evaluate.evaluation import evaluate

    evaluate(config)


if __name__ == "__main__":
    run_command(main)
