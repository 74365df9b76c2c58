"""`quadwalk compare`: train variants of the settings over several seeds, and evaluate them."""

from collections.abc import Sequence

from quadwalk.cli.arguments import parse
from quadwalk.errors import UsageError
from quadwalk.experiments.options import CompareConfig, split_variants


def main(args: Sequence[str], prog: str = "quadwalk compare") -> None:
    """Run the command."""
    variants, options = split_variants(args)
    config = parse(CompareConfig, options, prog)
    if not variants:
        raise UsageError(
            "no variant is given; expected flags of training, those of a variant in one argument: "
            f'{prog} "" "--env.reward.energy -0.1"'
        )
    from quadwalk.experiments.comparison import compare_variants

    compare_variants(variants, config)
