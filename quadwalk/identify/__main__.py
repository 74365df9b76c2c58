"""`python -m quadwalk.identify`: fit a robot's joints to a log of them."""

from quadwalk.cli.process import run_command

if __name__ == "__main__":
    run_command("quadwalk.identify.__main__")

import sys
from collections.abc import Sequence

from quadwalk.cli.arguments import parse
from quadwalk.identify.config import IdentifyConfig


def main(args: Sequence[str] | None = None, prog: str = "python -m quadwalk.identify") -> None:
    config = parse(IdentifyConfig, sys.argv[1:] if args is None else args, prog)
    # Both take seconds to import.
    if config.targets is not None:
        from quadwalk.identify.excite import write_targets

        write_targets(config.targets, config.robot)
    else:
        from quadwalk.identify.identification import identify

        identify(config)
