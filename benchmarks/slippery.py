"""Packaged policies on slippery floors, in the fast engine and in MuJoCo C.

    python benchmarks/slippery.py [--policies run walk drive] [--episodes 96]

Prints the rows of studies/results/slippery.json: for each friction the figure in the fast engine,
then in MuJoCo C. Each friction has the same starts.
"""

import json
from typing import Any

from benchmarks.shared import make_parser
from quadwalk.evaluation.load import load_run
from quadwalk.evaluation.sweep import Point, measure_points
from quadwalk.learn.devices import set_up_devices
from quadwalk.paths import PRETRAINED
from quadwalk.physics.engines import EngineName
from quadwalk.runs.directory import Run

FRICTIONS = (0.2, 0.3, 0.4, 0.8)
ENGINES: tuple[EngineName, ...] = ("fast", "mujoco")
SECONDS = 20.0
DIGITS = 3


def main() -> None:
    """Measure each policy at each friction in both engines, and print the rows."""
    parser = make_parser(__doc__)
    parser.add_argument("--policies", nargs="+", default=["run", "walk", "drive"])
    parser.add_argument("--episodes", type=int, default=96)
    options = parser.parse_args()
    set_up_devices()
    print(json.dumps([measure(name, options.episodes) for name in options.policies], indent=2))


def measure(name: str, episodes: int) -> dict[str, Any]:
    """Return the row of a packaged policy: its speed, or its velocity error where it has commands.

    There is a pair of numbers, m/s, for each friction: of the fast engine and of MuJoCo C.
    """
    points = [Point(friction=friction) for friction in FRICTIONS]
    columns = []
    for engine in ENGINES:
        loaded = load_run(Run(PRETRAINED / name), SECONDS, engine=engine)
        figure = "velocity_error" if loaded.env.config.command.active else "speed"
        results = measure_points(loaded, points, episodes, seed=0)
        columns.append([round(result[figure]["mean"], DIGITS) for result in results])
    label = ", m/s" if figure == "speed" else ", velocity error, m/s"
    return {"quantity": f"`{name}`{label}", "values": list(zip(*columns, strict=True))}


if __name__ == "__main__":
    main()
