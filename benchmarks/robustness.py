"""What a policy of the real world takes and one of an ideal world does not, as a picture.

    python benchmarks/robustness.py [--episodes 128] [--runs runs/robustness]

Trains `run` and `sprint`, each for as many control steps as `run` has by default, from one seed,
unless the folder has them, and sweeps both in the fast engine: one thing at a time, and everything
at once. The sweeps' results go to the folder `sweep` beside the runs, their picture also to
docs/robustness.png.
"""

import argparse
import shutil
from pathlib import Path

from quadwalk.evaluate.options import EvalConfig
from quadwalk.evaluate.session import evaluate_runs
from quadwalk.tasks.run import TASK
from quadwalk.train.flags import parse_config
from quadwalk.train.loop import train

PICTURE = Path(__file__).parent.parent / "docs" / "robustness.png"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--episodes", type=int, default=128, help="at each point")
    parser.add_argument("--steps", type=int, default=TASK.steps, help="of each training")
    parser.add_argument("--runs", type=Path, default=Path("runs/robustness"))
    options = parser.parse_args()
    names = ("run", "sprint")
    for name in names:
        if not (options.runs / name / "policy.npz").exists():
            flags = [name, "--name", name, "--runs", str(options.runs)]
            config, _ = parse_config([*flags, "--steps", str(options.steps)])
            train(config)
    out = options.runs / "sweep"
    evaluate_runs(
        EvalConfig(
            run=tuple(str(options.runs / name) for name in names),
            episodes=options.episodes,
            engine="fast",
            sweep=True,
            out=out,
        )
    )
    shutil.copyfile(out / "sweep.png", PICTURE)


if __name__ == "__main__":
    main()
