"""`quadwalk terrain -o PNG`: draw every kind of terrain at several difficulties."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from quadwalk.cli.arguments import ArgumentParser
from quadwalk.errors import UsageError
from quadwalk.paths import ALIENGO_URDF
from quadwalk.terrain.terrain import FLAT
from quadwalk.terrain.tiles import KINDS


def main(argv: Sequence[str], prog: str = "quadwalk terrain") -> None:
    """Draw as `argv` says; `prog` is the command's name."""
    parser = ArgumentParser(prog=prog, description="Draw every kind of terrain.")
    add = parser.add_argument
    add("-o", "--out", type=Path, metavar="PNG", required=True, help="file to write")
    add("--kinds", nargs="+", metavar="KIND", help=f"some of: {', '.join(KINDS)}")
    add("--levels", type=int, default=1, help="difficulties, evenly up to 1")
    add("--seed", type=int, default=0, help="of all that is random")
    add("--robot.urdf", type=Path, default=ALIENGO_URDF, help="robot whose legs set the sizes")
    given = parser.parse_args(argv)
    try:
        kinds = tuple(given.kinds or (kind for kind in KINDS if kind != "flat"))
        config = dataclasses.replace(FLAT, kinds=kinds, levels=given.levels, seed=given.seed)
        config = dataclasses.replace(config, difficulty=(1.0 / given.levels, 1.0))
    except UsageError as error:
        raise UsageError(str(error).replace(f"--{FLAT.group}.", "--")) from None
    from quadwalk.terrain.picture import save_kinds  # and with it all that reads a URDF

    save_kinds(config, vars(given)["robot.urdf"], given.out)
