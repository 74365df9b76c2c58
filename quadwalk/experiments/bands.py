"""Learning curves of variants: of each the mean of its seeds, in the band from worst to best."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

History = Sequence[Mapping[str, Any]]

_PANELS = (
    ("eval/speed", "speed, m/s", 1.0),
    ("eval/fall_rate", "episodes that fell, %", 100.0),
    ("train/reward", "reward", 1.0),
)


def draw_bands(histories: Sequence[tuple[str, History]]) -> Figure:
    """Draw speed, falls and reward over steps; `histories` are (variant's name, rows of a run)."""
    figure = Figure(figsize=(13, 4.2), dpi=110, layout="constrained")
    panels: Any = figure.subplots(1, len(_PANELS))
    for name in dict.fromkeys(name for name, _ in histories):
        runs = [rows for variant, rows in histories if variant == name]
        for axes, (figure_name, title, factor) in zip(panels, _PANELS, strict=True):
            steps, low, mean, high = compute_band(runs, figure_name)
            (line,) = axes.plot(steps / 1e6, factor * mean, linewidth=1.8, label=name)
            axes.fill_between(
                steps / 1e6, factor * low, factor * high, color=line.get_color(), alpha=0.2, lw=0
            )
            axes.set_title(title, loc="left", fontsize=11)
            axes.set_xlabel("million steps")
            axes.grid(color="#e4e7eb", linewidth=0.8)
            axes.spines[["top", "right"]].set_visible(False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", frameon=False)
    return figure


def compute_band(
    runs: Sequence[History], name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return steps (n,), and there the lowest, mean and highest of `name`, as far as all came."""
    curves = []
    for rows in runs:
        curve = np.array([(row["steps"], row.get(name)) for row in rows], float).reshape(-1, 2)
        curves.append(curve[np.isfinite(curve[:, 1])])  # None is NaN
    if not all(map(len, curves)):
        nothing = np.zeros(0)
        return nothing, nothing, nothing, nothing
    end = min(curve[-1, 0] for curve in curves)
    steps = np.unique(np.concatenate([curve[:, 0] for curve in curves]))
    steps = steps[steps <= end]
    values = np.stack([np.interp(steps, *curve.T) for curve in curves])
    return steps, values.min(axis=0), values.mean(axis=0), values.max(axis=0)
