"""`quadwalk view`, which is also `eval.py --view`: drive a trained policy live."""

from quadwalk.cli.process import run_command

if __name__ == "__main__":
    run_command("quadwalk.view.__main__")

import sys
from collections.abc import Sequence

from quadwalk.cli.arguments import parse
from quadwalk.view.show import ViewConfig, drive


def main(args: Sequence[str] | None = None, prog: str = "quadwalk view") -> None:
    drive(parse(ViewConfig, sys.argv[1:] if args is None else args, prog))
