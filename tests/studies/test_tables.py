"""The tables of the pages: made from studies/results, and the figures there from evaluations."""

import json
import math
import subprocess

import pytest

from quadwalk.errors import UserError
from quadwalk.runs.directory import Run
from studies import figures, measure, policies, tables


@pytest.mark.parametrize("page", tables.PAGES, ids=lambda page: page.name)
def test_a_page_shows_the_figures_of_the_results(page):
    text = page.read_text()
    assert tables.update(text) == text, "expected: python -m studies.tables"
    assert (
        text.count("<!-- table:") == text.count("<!-- end -->") == len(tables.MARKED.findall(text))
    )


def test_each_table_is_on_a_page_and_each_result_in_a_table():
    text = "".join(page.read_text() for page in tables.PAGES)
    assert {name for name, _ in tables.MARKED.findall(text)} == set(tables.TABLES)
    names = {path.stem for path in tables.RESULTS.glob("*.json")}
    assert names == {*tables.QUANTITIES, *tables.COLUMNS, "minutes"}
    for name in names:
        fields = ["policy", "commit", "machine", "command", "date", "figures"]
        assert list(tables.load_result(name)) == fields


def test_a_cell_is_empty_without_a_figure_and_a_quantity_without_any_is_left_out():
    rows = [{"name": "a", "x": 1.25, "n": 12345, "few": [1.0, None]}, {"name": "b", "few": []}]
    assert tables.list_rows(rows, {"x": "{x:.1f}", "n": "{n:,}"}) == (
        "| x | n |\n|---|---|\n| 1.2 | 12 345 |\n| | |"
    )
    quantities = {"few": "{few:.1f}", "x of {n}": "{x:.2f} m", "y": "{y}"}
    assert tables.list_quantities(rows, quantities) == (
        "| quantity | a | b |\n|---|---|---|\n| few | 1.0, - | |\n| x of 12345 | 1.25 m | |"
    )
    assert tables.format_span([{"x": 10.0}, {"x": 9.0}, {}], "{x:.0f}") == "9 to 10"
    assert tables.format_span([{"x": 9.01}, {"x": 9.0}], "{x:.0f}") == "9"


def test_a_page_with_an_unknown_table_is_refused():
    with pytest.raises(UserError, match="no table 'nothing'; expected one of: run, walk"):
        tables.update("<!-- table: nothing -->\n<!-- end -->\n")


def make_cell(command, velocity=0.0, yaw_rate=0.0, success=1.0):
    """Return a cell of the suite "commands" that misses its command by so much."""
    means = {"forward": command[0], "yaw_rate": 0.01}
    means |= {"velocity_error": velocity, "yaw_rate_error": yaw_rate}
    cell = {name: {"mean": value, "ci95": 0.0} for name, value in means.items()}
    return {"command": list(command), "success": success, **cell}


def test_a_command_is_followed_within_its_bound():
    # At 2 m/s and 1 rad/s the bounds are 0.2 m/s and 0.15 rad/s.
    assert figures.compute_error_share(make_cell((2.0, 0.0, 1.0), 0.1, 0.15)) == pytest.approx(1.0)
    assert figures.compute_error_share(make_cell((2.0, 0.0, 1.0), 0.3, 0.03)) == pytest.approx(1.5)
    fallen = make_cell((2.0, 0.0, 0.0)) | {"velocity_error": None}
    assert figures.compute_error_share(fallen) == math.inf


SUMMARY = {"episodes": 32, "fall_rate": 1 / 32} | {name: {"mean": 0.5} for name in figures.COURSE}
GAIT = dict.fromkeys(figures.GAIT, 0.25)
FEET = dict.fromkeys(
    ("stride_frequency", "duty_factor", "swing_height_p10", "slip", "cost_of_transport"), 2.0
)
ORIGIN = {"revision": "git 0123456789abcdef-dirty", "date": "2026-11-28"}
STILL = {"moved": {"mean": 0.003}, "most": 0.005}
STEERING = {
    "episodes": 16,
    "cells": [
        make_cell((-1.0, 0.0, 0.0)), make_cell((4.5, 0.0, 0.0), 0.65), make_cell((1.0, 0.0, 1.0))
    ],
    "standing": STILL,
    "standing_without_creep": STILL,
    "responses": [{"time": 1.0}, {"time": 2.0}, {"time": None}],
    "changing": {"episodes": 1024, "success": 0.99, "success_ci95": [0.98, 0.995]},
}  # fmt: skip
STANDING = {
    "episodes": 1024,
    "conditions": [
        {"name": "model", "standing_2s": 0.9, "standing_3s": 0.95, "standing_6s": 1.0}
    ],
}  # fmt: skip
LEVELS = [k / 6 for k in range(7)]
GROUND = {
    "episodes": 64,
    "kinds": ["stairs_up", "waves"],
    "difficulties": LEVELS,
    "cells": [
        {
            "kind": kind,
            "difficulty": level,
            "success": 1.0 - level / 2 if kind == "waves" else 1.0,
            "arrived": 0.5,
            "velocity_error": {"mean": 0.1},
        }
        for kind in ("stairs_up", "waves")
        for level in LEVELS
    ],
}
SWEEP = {
    "engine": "fast", "episodes": 128,
    "sweeps": {
        "friction": {"points": [{"value": 0.2, "success": 0.75}]},
        "everything": {"points": [{"value": 1.5, "success": 0.5}]},
        "push": {"points": [{"value": 1.5, "success": 1.0}]},
    },
    **ORIGIN,
}  # fmt: skip


def make_metrics(engine="mujoco", randomized=False, **suites):
    """Return the content of a metrics.json."""
    content = {"engine": engine, "randomized": randomized, "summary": SUMMARY, **ORIGIN}
    return {**content, "typical_episode": GAIT, **suites}


GAITS = [{"command": [0.3 * k, 0.0, 0.0], **FEET} for k in range(1, 16)]
EVALUATIONS = [
    make_metrics(gaits=GAITS, steering=STEERING),
    make_metrics("fast", standing=STANDING),
    make_metrics(randomized=True, ground=GROUND),
    SWEEP,
]  # fmt: skip


@pytest.fixture
def run(tmp_path):
    """Return a run that began with another one."""
    for name, init, seconds in (("first", None, 60.0), ("run", tmp_path / "first", 600.0)):
        folder = tmp_path / name
        folder.mkdir()
        config = {"steps": 30_000_000, "devices": 2, "init": init and str(init)}
        (folder / "config.json").write_text(json.dumps({"config": config}))
        lines = [{"time/elapsed": 1.0}, {"time/elapsed": seconds}]
        (folder / "timing.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return Run(tmp_path / "run")


def test_evaluations_and_a_training_give_every_quantity_of_the_tables(run):
    row = {"name": "a", "commit": "c", "machine": "m", **figures.read_figures(run, EVALUATIONS)}
    for quantities in tables.QUANTITIES.values():
        for name, template in quantities.items():
            assert tables.fill(template, row), template
            assert tables.fill(name, row), name
    assert row["training"] == {
        "steps": 30_000_000, "minutes": 10.0, "steps_per_second": 50_000, "cores": 2,
        "first_minutes": 1.0,
    }  # fmt: skip
    assert (row["mujoco"]["falls"], row["mujoco"]["no_fall"]) == (1, 96.875)
    steering = row["steering"]
    assert (steering["followed"], steering["commands"]) == (2, 3)
    assert steering["largest_error"] == pytest.approx(2.0)
    assert (steering["worst"], steering["worst_errors"]) == ([4.5, 0.0], [0.65, 0.0])
    assert steering["stand"] == pytest.approx([3.0, 5.0])
    assert row["ground"]["kinds"]["waves"] == pytest.approx([75.0, 200 / 3, 50.0])
    assert row["ground"]["success"] == pytest.approx([87.5, 250 / 3, 75.0])
    assert row["sweep"]["with_a_fall"] == 2
    conditions = tables.list_conditions([row])
    assert [tables.fill(cell, row) for cell in conditions.values()] == ["90.0, 95.0, 100.0"]


def test_a_result_has_the_commands_of_its_evaluations():
    result = policies.make_result("walk", [], EVALUATIONS)
    assert result["commit"] == "0123456"
    evaluate = "python eval.py RUN --engine"
    assert result["command"] == [
        "python train.py walk --seed N",
        f"{evaluate} mujoco --episodes 32 --cell-episodes 64",
        f"{evaluate} fast --episodes 32 --cell-episodes 1024",
        f"{evaluate} mujoco --randomized --episodes 32 --cell-episodes 64 --levels 7",
        "quadwalk sweep RUN --engine fast --episodes 128",
    ]


def test_a_task_s_commands_evaluate_the_run(run, tmp_path, monkeypatch):
    calls = []

    def record(call, **_):
        calls.append(call[1:])
        return subprocess.CompletedProcess(call, len(calls) // 3)  # the third one fails

    monkeypatch.setattr(subprocess, "run", record)
    with pytest.raises(UserError, match=r"no figures of .*run: .* sweep .* failed"):
        policies.evaluate("walk", run, tmp_path)
    path, runs = str(run.path), ["--runs", str(tmp_path)]
    assert calls[0][:2] == ["eval.py", path]
    assert calls[2][:4] == ["-m", "quadwalk", "sweep", path]
    assert all(call[-2:] == runs for call in calls)


def test_figures_are_rounded_and_strict_json():
    assert policies.round_figures({"a": [0.123456, math.inf], "n": 12345}) == {
        "a": [0.1235, None], "n": 12345,
    }  # fmt: skip


def test_the_packaged_policy_is_recognized_and_a_run_without_an_evaluation_named(tmp_path):
    packaged = Run(policies.PRETRAINED / "walk")
    assert policies.name_column("walk", packaged).endswith(", packaged")
    assert not policies.is_packaged("drive", packaged)
    with pytest.raises(UserError, match="walk was not evaluated; expected the same command"):
        policies.read_evaluations(packaged, tmp_path)


def test_the_pace_of_a_training_is_that_after_its_first_half_minute(run):
    rows = [(10, 10.0), (100, 30.0), (250, 60.0)]  # 5 steps/s after 30 s
    lines = [json.dumps({"steps": steps, "time/elapsed": seconds}) for steps, seconds in rows]
    run.timing.write_text("\n".join(lines))
    assert measure.compute_pace(run) == pytest.approx(5.0)
    run.timing.write_text(lines[0])
    assert measure.compute_pace(run) == pytest.approx(1.0)
