"""Draw the sessions of `sessions.py`: what each change did to the policy over the next steps.

python -m studies.desk.picture        # writes docs/desk-sessions.png
"""

import json
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from quadwalk.render.figures import INK, get_style, make_figure, save_figure, tidy
from studies.desk.sessions import RESULTS

OUT = Path(__file__).parents[2] / "docs" / "desk-sessions.png"
PANELS = (  # session, figure of its policies, factor to the unit, title, unit
    ("blog", "body_contact", 100.0, "blog: time on knees or trunk", "%"),
    ("blog", "height", 100.0, "blog: height of the trunk", "cm"),
    ("walk", "swing_height", 100.0, "walk: height of swings", "cm"),
    ("walk", "speed", 1.0, "walk: speed", "m/s"),
    ("run", "cost_of_transport", 1.0, "run: cost of transport", ""),
    ("run", "speed", 1.0, "run: speed", "m/s"),
)
COLUMNS = 2


def draw_panel(panel: Axes, session: dict[str, Any], figure: str, factor: float) -> None:
    """Draw a figure of a session's policies over steps, with a line at each change."""
    steps = [policy["steps"] / 1e6 for policy in session["policies"]]
    color, marker = get_style(0)
    values = [factor * policy[figure] for policy in session["policies"]]
    panel.plot(steps, values, color=color, marker=marker)
    for change in session["changes"]:
        panel.axvline(change["steps"] / 1e6, color=INK, linestyle="--", linewidth=0.8)
    panel.set(xlabel="steps, millions", xlim=(0, None), ylim=(0, None))


def main() -> None:
    """Draw the panels of the sessions that were measured, and write the picture."""
    results = json.loads(RESULTS.read_text())
    shown = [panel for panel in PANELS if panel[0] in results]
    rows = -(-len(shown) // COLUMNS)
    figure = make_figure((4.0 * COLUMNS, 2.8 * rows))
    panels = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for panel in panels[len(shown) :]:
        panel.set_axis_off()
    for panel, (name, metric, factor, title, unit) in zip(panels, shown, strict=False):
        draw_panel(panel, results[name], metric, factor)
        tidy(panel, title, unit)
    save_figure(figure, OUT)


if __name__ == "__main__":
    main()
