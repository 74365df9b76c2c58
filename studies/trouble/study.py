"""The curves of docs/trouble.md: a training with a fault, beside the same without it.

    python -m studies.trouble.study [--only usual costly] [--out docs]

Each training is 1.5 million steps of `sprint` with seed 1. Runs are kept in `--runs`: one that is
there is not trained again. Pictures go to `--out`. To see that it works:

    python -m studies.trouble.study --steps 1 --runs /tmp/runs --out /tmp
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from quadwalk.api import train
from quadwalk.cli.process import run_command
from quadwalk.render.figures import get_style, make_figure, save_figure, tidy
from quadwalk.runs.directory import Run
from quadwalk.runs.log import read_history

STEPS = 1_500_000
SEED = 1
USUAL = "usual"  # the training without a fault


class Panel(NamedTuple):
    """A metric as it is drawn."""

    key: str
    title: str
    unit: str = ""
    factor: float = 1.0


class Case(NamedTuple):
    """A training with a fault: settings by the names of their flags, and what shows it."""

    settings: dict[str, float]
    panels: Sequence[Panel]


SPEED = Panel("eval/speed", "speed", "m/s")
FALLS = Panel("eval/fall_rate", "episodes that fell", "%", 100.0)
REWARD = Panel("train/reward", "reward per step")
CASES = {
    "costly": Case({"env.reward.energy": -0.5}, (SPEED, FALLS, REWARD)),
    "still": Case(
        {"env.reward.energy": -1.0, "env.reward.alive": 3.0},
        (SPEED, FALLS, Panel("train/reward/energy", "energy, scaled")),
    ),
    "drowned": Case(
        {"env.reward.vertical": -20.0},
        (
            SPEED,
            Panel("train/reward/forward", "forward, scaled"),
            Panel("train/reward/vertical", "vertical, scaled"),
        ),
    ),
}


def train_case(name: str, steps: int, runs: Path) -> None:
    """Train the case `name`, unless its run is there."""
    if Run(runs / name).policy.exists():
        return
    settings = CASES[name].settings if name in CASES else {}
    train("sprint", steps=steps, seed=SEED, name=name, runs=runs, overrides=settings)


def draw_case(name: str, runs: Path, file: Path) -> None:
    """Draw the curves of the case `name` beside the usual ones."""
    case = CASES[name]
    flags = " ".join(f"--{flag} {value:g}" for flag, value in case.settings.items())
    figure = make_figure((9.0, 2.6), dpi=72)
    axes = figure.subplots(1, len(case.panels))
    for place, (run, label) in enumerate(((USUAL, USUAL), (name, flags))):
        rows = read_history(Run(runs / run))
        color, _ = get_style(place)
        steps = [row["steps"] / 1e6 for row in rows]
        for panel, panel_axes in zip(case.panels, axes, strict=True):
            values = [panel.factor * row[panel.key] for row in rows]
            panel_axes.plot(steps, values, color=color, label=label)
            tidy(panel_axes, panel.title, panel.unit, fontsize=9)
            panel_axes.set_xlabel("million steps", fontsize=8)
            panel_axes.tick_params(labelsize=8)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False, fontsize=9)
    save_figure(figure, file)


def main() -> None:
    """Train what is missing, and draw each case."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=[USUAL, *CASES], help="of the trainings")
    parser.add_argument("--steps", type=int, default=STEPS, help="of each training")
    parser.add_argument("--runs", type=Path, default=Path("runs/trouble"))
    parser.add_argument("--out", type=Path, default=Path("docs"))
    options = parser.parse_args()
    runs = options.runs.resolve()
    names = [USUAL, *(options.only or CASES)]
    for name in dict.fromkeys(names):
        train_case(name, options.steps, runs)
        if name != USUAL:
            draw_case(name, runs, options.out / f"trouble_{name}.png")


if __name__ == "__main__":
    run_command(main)
