"""`quadwalk identify`: fit a robot's joints to a log of them."""

from collections.abc import Sequence

from quadwalk.cli.arguments import parse
from quadwalk.identify.config import IdentifyConfig


def main(args: Sequence[str], prog: str = "quadwalk identify") -> None:
    """Fit a robot's joints to a log of them, or write targets for a recording."""
    config = parse(IdentifyConfig, args, prog)
    # Both take seconds to import.
    if config.targets is not None:
        from quadwalk.identify.targets import write_targets

        write_targets(config.targets, config.robot)
    else:
        from quadwalk.identify.identification import identify

        identify(config)
