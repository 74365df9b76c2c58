"""What a change of settings gives: train each over several seeds and judge it in both engines.

    python benchmarks/recipe.py "" "--ppo.entropy 0.003" "--ppo.epochs 3" [--steps 4000000]

Each argument holds the flags of one variant, "" the defaults. Runs are kept in `--runs`, named by
flags, steps and seed: one that is there already is not trained again, so a stopped benchmark goes
on where it was. The rows printed are Markdown, for `benchmarks/recipe.md`; the gait's are those of
each run's typical episode in MuJoCo C. An episode less than half as fast as the median is counted
as slow: such a robot stands, or limps.
"""

import argparse
import itertools
import json
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
COLUMNS = (
    "seed",
    "m/s",
    "falls",
    "slow",
    "drift",
    "heading",
    "m/s in C",
    "falls in C",
    "gait",
    "swing, cm",
    "slip",
    "torque",
    "joint speed",
    "action rate, 1/s",
)


def name_of(flags: str, steps: int | None, seed: int) -> str:
    """A run's name."""
    words = re.sub(r"[^\w.]+", "-", flags).strip("-") or "default"
    return f"{words}_{steps or 'full'}_s{seed}"


def train(flags: str, steps: int | None, seed: int, runs: Path, devices: int | None) -> Path:
    """The run of these flags and seed, trained if it has not been."""
    run = runs / name_of(flags, steps, seed)
    if (run / "policy.npz").exists():
        arguments = ["--resume", str(run)]  # nothing to do for one that is complete
    else:
        arguments = ["--name", run.name, "--seed", str(seed), *flags.split()]
        arguments += ["--steps", str(steps)] if steps else []
        arguments += ["--devices", str(devices)] if devices else []
    script(["train.py", "--runs", str(runs), "--quiet", *arguments])
    return run


def judge(run: Path, episodes: int) -> dict[str, Any]:
    """What eval.py says of a run in both engines."""
    out = run / f"recipe_{episodes}"
    if not (out / "metrics.json").exists():
        options = f"--episodes {episodes} --mcap 0 --engine mujoco --out {out}"
        script(["eval.py", str(run), *options.split()])
    return json.loads((out / "metrics.json").read_text())


def script(command: list[str]) -> None:
    done = subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")


def row(seed: int, found: dict[str, Any]) -> list[str]:
    """The cells of one run."""
    mjx, c, gait = found["mjx_summary"], found["summary"], found["typical_episode"]
    slow = sum(e["speed"] < 0.5 * c["speed"]["median"] for e in found["episodes"])

    def largest(name: str) -> float:
        return max(v for k, v in gait.items() if k.startswith(name + ".") and v is not None)

    swing = min(v or 0.0 for k, v in gait.items() if k.startswith("swing_height."))
    return [
        str(seed),
        f"{mjx['speed']['mean']:.2f}",
        f"{mjx['fall_rate']:.1%}",
        str(slow),
        f"{mjx['lateral_drift']['mean'] / mjx['distance']['mean']:.1%}",
        f"{mjx['heading_error']['mean']:.1f}°",
        f"{c['speed']['mean']:.2f}",
        f"{c['fall_rate']:.1%}",
        str(gait["gait"]),
        f"{100 * swing:.1f}",
        f"{largest('slip_share'):.1%}",
        f"{largest('torque_peak'):.0%}",
        f"{largest('joint_speed_peak'):.0%}",
        f"{gait['action_rate']:.1f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("variants", nargs="+", help="flags of train.py, as one argument each")
    parser.add_argument("--steps", type=int, help="control steps; by default train.py's")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--runs", type=Path, default=Path("runs/recipe"))
    parser.add_argument("--at-once", type=int, default=1, help="runs; if several, one core each")
    options = parser.parse_args()

    print("| flags | " + " | ".join(COLUMNS) + " |")
    print("|" + "---|" * (len(COLUMNS) + 1))

    def line(variant: tuple[str, int]) -> str:
        flags, seed = variant
        devices = 1 if options.at_once > 1 else None
        run = train(flags, options.steps, seed, options.runs.resolve(), devices)
        cells = row(seed, judge(run, options.episodes))
        return f"| `{flags or 'defaults'}` | " + " | ".join(cells) + " |"

    with ThreadPoolExecutor(options.at_once) as pool:
        for found in pool.map(line, itertools.product(options.variants, range(options.seeds))):
            print(found, flush=True)


if __name__ == "__main__":
    main()
