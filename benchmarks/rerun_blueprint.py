"""Write assets/rerun.rbl, the layout that recordings have in Rerun.

    python benchmarks/rerun_blueprint.py

Rerun's own library writes it, which users need not have installed: the file comes with the package.
It fits the recordings of every robot, for it names topics and fields that all of them have.
"""

from typing import Any

import rerun
from rerun import blueprint
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from quadwalk.evaluation.mcap.messages import WORLD
from quadwalk.evaluation.mcap.write import RERUN_APPLICATION, RERUN_BLUEPRINT
from quadwalk.render.figures import LEG_COLORS

TIMELINE = "message_log_time"
LEGS = ("FR", "FL", "RR", "RL")
GRAY = "#808080"
SPEEDS = {
    "/base_velocity": {
        "body_x": ("forward", LEG_COLORS[3]),
        "body_y": ("left", LEG_COLORS[2]),
    },
    "/command": {
        "forward": ("forward, commanded", GRAY),
        "lateral": ("left, commanded", GRAY),
    },
}
REWARDS = {"/reward": {"total": ("total", GRAY)}}
FEET = {
    "/contacts": {f"{leg}_force": (leg, color) for leg, color in zip(LEGS, LEG_COLORS, strict=True)}
}
MESSAGES = {
    "/base_velocity": "quadwalk.BaseVelocity",
    "/command": "quadwalk.Command",
    "/reward": "quadwalk.Reward",
    "/contacts": "quadwalk.Contacts",
}
Plotted = dict[str, dict[str, tuple[str, str]]]  # topic: field: name and color


def make_blueprint() -> blueprint.Blueprint:
    """Return the layout: a view that follows the robot beside speed, rewards and footfalls."""
    robot = blueprint.Spatial3DView(
        name="robot",
        contents="/**",
        spatial_information=blueprint.SpatialInformation(target_frame=WORLD),
        eye_controls=blueprint.EyeControls3D(tracking_entity="/pose"),
    )
    # About the time that is shown, so that footfalls are seen apart.
    boundary = blueprint.TimeRangeBoundary.cursor_relative
    window = blueprint.VisibleTimeRange(
        TIMELINE, start=boundary(seconds=-2.0), end=boundary(seconds=1.0)
    )
    plots = blueprint.Vertical(
        plot("speed, m/s", SPEEDS),
        plot("reward per step", REWARDS),
        plot("footfalls: force on each foot, N", FEET, time_ranges=window),
    )
    return blueprint.Blueprint(
        blueprint.Horizontal(robot, plots, column_shares=[3, 2]),
        blueprint.TimePanel(
            timeline=TIMELINE, state="collapsed", play_state="playing", loop_mode="all"
        ),
        blueprint.SelectionPanel(state="hidden"),
        blueprint.BlueprintPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def plot(name: str, plotted: Plotted, **options: Any) -> blueprint.TimeSeriesView:
    """Return a view, called `name`, that plots fields of messages.

    Rerun does not plot them of itself. `options` are those of the view.
    """
    overrides: dict[Any, Any] = {
        topic: [make_line(topic, field, *look) for field, look in fields.items()]
        for topic, fields in plotted.items()
    }
    return blueprint.TimeSeriesView(
        name=name, contents=list(plotted), overrides=overrides, **options
    )


def make_line(topic: str, field: str, name: str, color: str) -> blueprint.Visualizer:
    """Return the line of one field of the messages of a topic, with its name and color #rrggbb."""
    source = VisualizerComponentMapping(
        "Scalars:scalars",
        ComponentSourceKind.SourceComponent,
        source_component=f"{MESSAGES[topic]}:message",
        selector=f".{field}",
    )
    rgb = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
    return rerun.SeriesLines(names=name, colors=rgb).visualizer(mappings=[source])


if __name__ == "__main__":
    make_blueprint().save(RERUN_APPLICATION, RERUN_BLUEPRINT)
    print(f"written to {RERUN_BLUEPRINT}")
