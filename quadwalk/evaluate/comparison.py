"""Several runs, judged from the same starts, side by side."""

from pathlib import Path
from typing import Any

from rich.console import Console

from quadwalk.evaluate.report.console import print_comparison
from quadwalk.evaluate.report.panels import draw_comparison
from quadwalk.evaluate.report.plots import save_figure
from quadwalk.train.runs.directory import write_json_atomic


def compare(
    labels: list[str],
    folders: list[Path],
    results: list[dict[str, Any]],
    out: Path,
    console: Console,
) -> dict[str, Any]:
    """Print and write the comparison of runs called `labels`; return what comparison.json holds.

    `results` are their metrics, as `judge` returns them, which it has written to `folders`.
    """
    common = {name: results[0][name] for name in ("engine", "seed", "seconds", "revision")}
    runs = [
        {
            "name": label,
            "folder": str(folder),
            **{name: result[name] for name in ("training_steps", "policy_sha256", "summary")},
            "typical_episode": result["typical_episode"],
        }
        for label, folder, result in zip(labels, folders, results, strict=True)
    ]
    comparison = {**common, "runs": runs}
    print_comparison(comparison)
    write_json_atomic(out / "comparison.json", comparison)
    save_figure(draw_comparison(labels, results), out / "comparison.png")
    console.print(f"written to {out}: comparison.json, comparison.png")
    return comparison
