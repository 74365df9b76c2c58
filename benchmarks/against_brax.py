"""Our training loop against Brax's `ppo.train`: learning curves on the quadruped, same settings.

    python benchmarks/against_brax.py [--steps 1500000] [--seeds 3] [--out against_brax.png]

Both start from the same networks and the same measure of the observations, learn with the same
settings (`brax_training.py` says what is left to differ), and are evaluated alike: the mean action,
fresh starts, what each episode brings until it ends.

Agreement: per seed, the mean over the curve's points (the start apart) is one number; the 99 %
interval of the difference, ours less Brax's (Student's t, paired, since a seed's start is the same
for both), holds zero. Its width is printed, since a wide one proves nothing.

Found, three seeds of 1.5 million steps: in the end 3.55 m/s (3.38 to 3.66) against Brax's 3.64
(3.58 to 3.71); over the curve -0.12 +- 1.11 m/s of 3.65 gained, at most 0.37 at a point. To see
that it works:

    python benchmarks/against_brax.py --steps 1 --envs 64 --seeds 2 --points 1
"""

import argparse
import dataclasses
from typing import TYPE_CHECKING

from quadwalk.learn.devices import set_up_devices
from quadwalk.tasks import sprint

if TYPE_CHECKING:
    import numpy as np


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=1_500_000, help="control steps of each run")
    parser.add_argument("--envs", type=int, default=2048)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--points", type=int, default=6, help="points of a curve")
    parser.add_argument("--out", default="against_brax.png")
    options = parser.parse_args()
    set_up_devices()
    import numpy as np
    from brax_training import compare, learning_curves

    from quadwalk.env.env import QuadrupedEnv
    from quadwalk.robot.quadruped import load_quadruped

    env = QuadrupedEnv(load_quadruped(), dataclasses.replace(sprint.TASK.env, episode_seconds=10.0))
    # Brax's stay the same throughout.
    config = dataclasses.replace(
        sprint.TASK.ppo, final_kl=sprint.TASK.ppo.desired_kl, final_entropy=sprint.TASK.ppo.entropy
    )
    batch = options.envs * config.unroll
    iterations = max(1, options.steps // batch // options.points) * options.points
    ours, brax = learning_curves(
        env, config, options.envs, iterations, options.points, options.seeds, 64, say=print
    )
    steps = np.linspace(0, iterations * batch, options.points + 1)
    print("\nmean of the seeds (least to most)")
    print(f"{'steps':>10} {'reward: ours':>22} {'Brax':>22} {'m/s: ours':>20} {'Brax':>20}")
    for i, count in enumerate(steps):
        cells = [
            f"{c[:, i, k].mean():.2f} ({c[:, i, k].min():.2f} to {c[:, i, k].max():.2f})"
            for k in (0, 1)
            for c in (ours, brax)
        ]
        print(f"{count:10,.0f} {cells[0]:>22} {cells[1]:>22} {cells[2]:>20} {cells[3]:>20}")
    for name, k in (("reward per step", 0), ("speed, m/s", 1)):
        found = compare(ours[..., k], brax[..., k])
        verdict = "agree" if found.holds else "DIFFER"
        print(
            f"{name}: mean over the curve, ours less Brax's {found.difference:+.3f} "
            f"+- {found.margin:.3f}, at most {found.largest:.3f} at a point, while learning gains "
            f"{found.gain:.3f}: the curves {verdict}"
        )
    _plot(steps, ours, brax, options.out)
    print(f"written to {options.out}")


def _plot(steps: "np.ndarray", ours: "np.ndarray", brax: "np.ndarray", path: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.5), layout="constrained")
    axes = figure.subplots(1, 2)
    for k, (ax, label) in enumerate(zip(axes, ("reward per step", "speed, m/s"), strict=True)):
        for name, curves, color in (("ours", ours, "C0"), ("Brax ppo.train", brax, "C1")):
            ax.plot(steps / 1e6, curves[..., k].T, color=color, alpha=0.3, linewidth=1)
            ax.plot(steps / 1e6, curves[..., k].mean(0), color=color, label=name)
        ax.set(xlabel="million control steps", ylabel=label)
        ax.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
