"""`quadwalk terrain -o PNG`: draw every kind of terrain at several difficulties."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from quadwalk.bounds import Few, Seed, Settings
from quadwalk.cli.arguments import parse
from quadwalk.errors import UsageError
from quadwalk.settings.training import RobotConfig
from quadwalk.terrain.terrain import FLAT
from quadwalk.terrain.tiles import KINDS


@dataclass(frozen=True)
class TerrainConfig(Settings):
    """Draw every kind of terrain, with a robot on it."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]  # PNG to write
    # kinds of terrain; by default all but flat
    kinds: tuple[str, ...] = tuple(kind for kind in KINDS if kind != "flat")
    levels: Few = 1  # difficulties, evenly up to 1
    seed: Seed = 0  # of all that is random
    robot: RobotConfig = field(default_factory=RobotConfig)  # its legs set the sizes


def main(args: Sequence[str], prog: str = "quadwalk terrain") -> None:
    """Draw terrain as the arguments say."""
    config = parse(TerrainConfig, args, prog)
    try:
        ground = dataclasses.replace(
            FLAT,
            kinds=config.kinds,
            levels=config.levels,
            seed=config.seed,
            difficulty=(1.0 / config.levels, 1.0),
        )
    except UsageError as error:
        raise UsageError(str(error).replace(f"--{FLAT.group}.", "--")) from None
    # All that reads a robot and draws takes seconds to import.
    from quadwalk.render.images import save_png
    from quadwalk.robot.load import load_robot
    from quadwalk.terrain.picture import draw_kinds

    save_png(draw_kinds(ground, load_robot(config.robot)), config.out)
