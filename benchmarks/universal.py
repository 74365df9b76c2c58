"""Robots that a policy of many bodies has not met: does it drive them, with no training at all?

    python benchmarks/universal.py RUN FILE... [--episodes 64] [--markdown FILE]

A row for each URDF or MJCF, such as those of docs/zoo.md; without FILE the robot of the run, which
may be a `drive`. Episodes of 20 s in MuJoCo C with every shape colliding and everything drawn;
commands change as in training, and a fall is one of the trunk. A run of `universal_getup` is asked
for the share of random poses from which the robot gets up. The last column says what of the robot
is beyond the bodies trained on. To see that it works: --episodes 2.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np

from benchmarks.shared import format_row, make_parser
from quadwalk.cli.process import run_command
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.nearness import list_figures
from quadwalk.env.terminations import TRUNK_FALLS
from quadwalk.errors import UserError
from quadwalk.evaluation.load import load_run
from quadwalk.evaluation.results import evaluate_policy
from quadwalk.evaluation.rollout import GROUP, roll_out_paths
from quadwalk.evaluation.suites.commands import LONG, to_changing_run
from quadwalk.evaluation.suites.standing import check_standing, to_standing_run
from quadwalk.evaluation.sweep import Point, reset_at_points
from quadwalk.learn.acting import load_policy
from quadwalk.learn.devices import set_up_devices
from quadwalk.runs.directory import Run, find_any_run
from quadwalk.settings.training import OtherRobotConfig, RobotConfig

# Of run, file (None: the robot of the run) and episodes, the cells.
Measure: TypeAlias = Callable[[Run, Path | None, int], list[str]]

HEADS = (
    "no fall, %",
    "velocity error, m/s",
    "yaw rate error, rad/s",
    "fastest command, m/s",
    "beyond the bodies trained on",
)
STANDING_SECONDS = (2.0, 4.0, 6.0)  # after the start, when a robot that gets up is checked
STANDING_HEADS = (
    *(f"stands after {seconds:g} s, %" for seconds in STANDING_SECONDS),
    "with everything drawn, after 4 s, %",
    "beyond the bodies trained on",
)


def make_row(
    run: Run, file: Path | None, episodes: int, measure: Measure, heads: Sequence[str]
) -> str:
    """Evaluate the policy of `run` on the robot of a file or its own; return the table's row."""
    name = "/".join(file.parts[-3:]) if file else run.path.name
    try:
        return format_row([name, *measure(run, file, episodes)])
    except UserError as error:
        return format_row([name, f"refused: {error}", *[""] * len(heads)])


def find_robot(file: Path | None) -> RobotConfig | None:
    """Return the robot of a file; None for that of the run."""
    return OtherRobotConfig(urdf=file).find() if file else None


def drive_robot(run: Run, file: Path | None, episodes: int) -> list[str]:
    """Drive the robot of a file, or that of `run`, by its policy; return cells, mass first.

    Raises `UserError` for a file that is refused.
    """
    loaded = load_run(run, LONG, robot=find_robot(file))
    loaded = to_changing_run(loaded, termination=TRUNK_FALLS)
    results = evaluate_policy(loaded, episodes, seed=0, keep=0).episodes
    falls = np.mean([episode["fell"] for episode in results])
    errors = [
        np.nanmean([np.nan if episode[key] is None else episode[key] for episode in results])
        for key in ("velocity_error", "yaw_rate_error")
    ]
    env = loaded.env
    return [
        f"{env.robot.mass:.1f}",
        f"{100 * (1 - falls):.1f}",
        *(f"{error:.2f}" for error in errors),
        f"{env.config.command.forward[1]:.1f}",
        describe_excess(env),
    ]


def get_robot_up(run: Run, file: Path | None, episodes: int) -> list[str]:
    """Get the robot of a file, or that of `run`, up from random poses; return cells, mass first.

    Raises `UserError` for a file that is refused.
    """
    loaded = to_standing_run(load_run(run, max(STANDING_SECONDS), robot=find_robot(file)))
    env = loaded.env
    points = [Point(), Point(everything=1.0)]
    starts = reset_at_points(env, points, episodes, seed=0)
    stands = np.zeros((len(points) * episodes, len(STANDING_SECONDS)), bool)
    for number, _, poses in roll_out_paths(env, loaded.policy.act, starts, GROUP):
        stands[number] = check_standing(env, poses, STANDING_SECONDS)
    of_model, of_everything = 100 * stands.reshape(len(points), episodes, -1).mean(axis=1)
    return [
        f"{env.robot.mass:.1f}",
        *(f"{share:.1f}" for share in of_model),
        f"{of_everything[STANDING_SECONDS.index(4.0)]:.1f}",
        describe_excess(env),
    ]


def describe_excess(env: QuadrupedEnv) -> str:
    """Return what of the robot is beyond the bodies trained on; "" for a policy of one robot."""
    if env.config.unit_leg is None:
        return ""
    return ", ".join(figure.excess for figure in list_figures(env) if figure.excess)


def main() -> None:
    """Evaluate a policy on the robots of all files; print the table."""
    parser = make_parser(__doc__)
    add = parser.add_argument
    add("run", help="name or path of a run: universal, universal_getup, drive")
    add("files", nargs="*", type=Path, metavar="FILE", help="URDF or MJCF of a quadruped")
    add("--episodes", type=int, default=64)
    add("--runs", type=Path, default=Path("runs"), help="folder that holds all runs")
    add("--markdown", type=Path, metavar="FILE", help="where the table goes")
    options = parser.parse_args()
    set_up_devices()
    run = find_any_run(options.runs, options.run)
    gets_up = load_policy(run.policy).config.suite == "standing"
    measure = get_robot_up if gets_up else drive_robot
    heads = STANDING_HEADS if gets_up else HEADS
    lines = [format_row(["robot", "kg", *heads]), format_row(["---"] * (2 + len(heads)))]
    print("\n".join(lines), flush=True)
    for file in options.files or [None]:
        lines.append(make_row(run, file, options.episodes, measure, heads))
        print(lines[-1], flush=True)
    if options.markdown:
        options.markdown.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    run_command(main)
