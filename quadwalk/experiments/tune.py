"""`quadwalk tune`: search the settings of a task that make its policy best."""

from collections.abc import Sequence

from quadwalk.cli.arguments import parse
from quadwalk.errors import UsageError
from quadwalk.experiments.options import TuneConfig


def main(args: Sequence[str], prog: str = "quadwalk tune") -> None:
    """Run the command."""
    config = parse(TuneConfig, args, prog)
    if not config.over:
        raise UsageError(
            f"no setting to search is given; expected: {prog} {config.task} "
            "--over env.reward.energy=-0.5:-0.01"
        )
    from quadwalk.experiments.search import search_settings

    search_settings(config)
