"""What a policy of the real world withstands and one of an ideal world does not.

    python -m studies.robustness.study [--episodes 64] [--sprint runs/sprint]

Sweeps the packaged `run` and a run of `sprint`, trained here unless `--sprint` names one, in the
fast engine: one condition at a time, and everything at once. Results go to `--out`.
notebooks/05_real_world.ipynb and benchmarks/pictures.py show them. To see that it works:

    python -m studies.robustness.study --steps 1 --episodes 2 --seconds 1 --out /tmp/a.json
"""

import argparse
import json
import tempfile
from pathlib import Path

from quadwalk.api import train
from quadwalk.cli.process import run_command
from quadwalk.evaluation.command import SweepConfig, sweep_runs
from quadwalk.files import open_atomic
from quadwalk.paths import PRETRAINED

RESULTS = Path(__file__).parent / "results.json"


def main() -> None:
    """Sweep the packaged `run` and a run of `sprint` over all conditions; write the results."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--episodes", type=int, default=64, help="at each point")
    parser.add_argument("--seconds", type=float, default=20.0, help="of an episode, at most")
    parser.add_argument("--sprint", type=Path, help="a run of sprint (default: train one)")
    parser.add_argument("--steps", type=int, help="of its training (default: the task's)")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sprint = options.sprint
        if sprint is None:
            steps = {} if options.steps is None else {"steps": options.steps}
            sprint = train("sprint", name="sprint", runs=folder, **steps).path
        results = sweep_runs(
            SweepConfig(
                run=(str(PRETRAINED / "run"), str(sprint)),
                episodes=options.episodes,
                seconds=options.seconds,
                engine="fast",
                out=Path(folder) / "sweep",
            )
        )
    for result, name in zip(results["runs"], ("run", "sprint"), strict=True):
        result["run"] = name
    with open_atomic(options.out) as file:
        file.write(json.dumps(results).encode() + b"\n")
    print(f"written to {options.out}")


if __name__ == "__main__":
    run_command(main)
