"""The commands `quadwalk compare` and `quadwalk tune`.

The modules that do the work, which take seconds to import, are imported when the flags are right.
"""

import dataclasses
from collections.abc import Sequence

from quadwalk.cli.arguments import FIND_OPTIONS, parse
from quadwalk.errors import UsageError
from quadwalk.experiments.options import CompareConfig, TuneConfig


def compare(args: Sequence[str], prog: str = "quadwalk compare") -> None:
    """Train variants of the settings over several seeds, and evaluate them."""
    variants, options = split_variants(args)
    config = parse(CompareConfig, options, prog)
    if not variants:
        raise UsageError(
            "no variant is given; expected flags of training, those of a variant in one argument: "
            f'{prog} "" "--env.reward.energy -0.1"'
        )
    from quadwalk.experiments.comparison import compare_variants

    compare_variants(variants, config)


def split_variants(args: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the variants among `args`, and the rest: the command's options and their values."""
    flags = {f"--{field.name}" for field in dataclasses.fields(CompareConfig)}
    variants, options, takes_value = [], [], False
    for arg in args:
        is_flag = arg.partition("=")[0] in flags
        if takes_value or is_flag or arg in ("-h", "--help", FIND_OPTIONS):
            options.append(arg)
            takes_value = not takes_value and is_flag and "=" not in arg
        else:
            variants.append(arg)
    return variants, options


def tune(args: Sequence[str], prog: str = "quadwalk tune") -> None:
    """Search the settings of a task that make its policy best."""
    config = parse(TuneConfig, args, prog)
    if not config.over:
        raise UsageError(
            f"no setting to search is given; expected: {prog} {config.task} "
            "--over env.reward.energy=-0.5:-0.01"
        )
    from quadwalk.experiments.search import search_settings

    search_settings(config)
