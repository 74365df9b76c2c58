"""What a second engine says of the same policy from the same starts."""

from typing import Any

from rich.console import Console
from rich.table import Table

from quadwalk.evaluate.summary import FIGURES, falls_text, figure_text


def engine_differences(mjx: dict[str, Any], mujoco: dict[str, Any]) -> dict[str, Any]:
    """Of falls and each figure's mean in two summaries, MuJoCo C's less MJX's.

    `difference` in the figure's own unit (of `fall_rate`, a share), `percent` of the size of MJX's;
    None where one of the two has no figure, or MJX's is 0.
    """
    means = {name: (_mean(mjx[name]), _mean(mujoco[name])) for name, _, _ in FIGURES if name in mjx}
    return {
        name: _difference(first, second)
        for name, (first, second) in {
            "fall_rate": (mjx["fall_rate"], mujoco["fall_rate"]),
            **means,
        }.items()
    }


def print_engines(mjx: dict[str, Any], mujoco: dict[str, Any]) -> None:
    """Both summaries side by side, and the differences, on standard output."""
    table = Table(title="MuJoCo C against MJX, the same starts", title_justify="left")
    for heading in ("", "MJX", "MuJoCo C", "difference", "of MJX's", "unit"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    differences = engine_differences(mjx, mujoco)
    change = f"{100 * differences['fall_rate']['difference']:+.1f}"
    table.add_row("falls", falls_text(mjx), falls_text(mujoco), change, "", "%")
    for name, heading, unit in FIGURES:
        if name not in differences:
            continue
        found = differences[name]
        change = "-" if found["difference"] is None else f"{found['difference']:+.3f}"
        percent = "-" if found["percent"] is None else f"{found['percent']:+.1f} %"
        both = (figure_text(mjx[name]), figure_text(mujoco[name]))
        table.add_row(heading, *both, change, percent, unit)
    Console().print(table)


def _mean(figure: dict[str, Any] | None) -> float | None:
    return None if figure is None else figure["mean"]


def _difference(first: float | None, second: float | None) -> dict[str, float | None]:
    if first is None or second is None:
        return {"difference": None, "percent": None}
    change = second - first
    return {"difference": change, "percent": 100 * change / abs(first) if first else None}
