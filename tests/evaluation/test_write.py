"""Runs evaluated, compared, evaluated by two engines, and swept, with a policy of a few numbers."""

import dataclasses
import functools
import gzip
import io
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from quadwalk.env.actions import about_home
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation import results as results_module
from quadwalk.evaluation import sweep, write
from quadwalk.evaluation.load import LoadedRun
from quadwalk.evaluation.mcap.foot_forces import add_foot_forces
from quadwalk.evaluation.metrics import (
    compute_mean_interval,
    compute_metrics,
    summarize_episodes,
    to_roll_pitch_yaw,
)
from quadwalk.evaluation.results import find_revision
from quadwalk.evaluation.rollout import simulate_episodes
from quadwalk.evaluation.suites import commands, gaits, standing, terrain
from quadwalk.evaluation.sweep import SWEEPS, Point, measure_points
from quadwalk.learn.acting import Policy
from quadwalk.robot.mjcf import write_xml
from quadwalk.runs.directory import Run
from quadwalk.settings.terms import ActionMap
from quadwalk.tasks import sprint
from tests.evaluation.conftest import read_records

EPISODES, SECONDS = 4, 0.5


@pytest.fixture(scope="module")
def loaded(quadruped, swaying, tmp_path_factory) -> LoadedRun:
    folder = tmp_path_factory.mktemp("runs") / "swaying"
    folder.mkdir()
    for name in ("policy.npz", "best.npz"):
        (folder / name).write_bytes(b"weights of " + name.encode())
    (folder / "robot.urdf").write_text(quadruped.urdf)
    # With a solver that converges, programs compiled apart stay close to each other.
    # The swaying is gentle enough for both engines to see the same.
    gentle = ActionMap(about_home, {"hip": 0.3, "thigh": 0.6, "calf": 0.6})
    short = dataclasses.replace(
        sprint.TASK.env, episode_seconds=SECONDS, solver_iterations=10, action=gentle
    )
    config, env = sprint.TASK, QuadrupedEnv(quadruped, short, "mjx")
    policy = Policy(swaying, config, quadruped.joints, env.policy_size, 1000)
    return LoadedRun(Run(folder), Run(folder).policy, policy, env, "0", b'{"seed": 0}')


@pytest.fixture(scope="module")
def evaluated(loaded, tmp_path_factory):
    """Return results of both engines, their folder, what was printed, and episodes by engine."""
    folder, stream, rollouts = tmp_path_factory.mktemp("evaluated"), io.StringIO(), {}

    def keep_rollouts(env, *rest):
        rollouts[env.engine] = list(simulate_episodes(env, *rest))
        return rollouts[env.engine]

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "120")
        patch.setattr(results_module, "simulate_episodes", keep_rollouts)
        patch.setattr(write, "make_console", lambda: Console(file=stream, width=200))
        results = write.write_evaluation(
            loaded.to_engine("mujoco"),
            folder,
            episodes=EPISODES,
            seed=1,
            cell_episodes=16,
            levels=3,
            recordings=1,
            video="none",
        )
    return results, folder, stream.getvalue(), rollouts


def test_both_engines_are_evaluated_from_the_same_starts(evaluated, loaded):
    results, folder, _, rollouts = evaluated
    assert json.loads((folder / "metrics.json").read_text()) == results
    assert (results["engine"], results["seed"]) == ("mujoco", 1)
    scales, weight = loaded.env.config.reward, loaded.env.robot.weight
    effort = np.asarray(loaded.env.motor.effort)
    first = [compute_metrics(rollout, scales, weight, effort) for rollout in rollouts["mjx"]]
    for name, figure in summarize_episodes(first).items():
        assert results["mjx_summary"][name] == pytest.approx(figure)
    speeds = [[episode["speed"] for episode in of] for of in (first, results["episodes"])]
    np.testing.assert_allclose(*speeds, atol=0.1)  # m/s: half a second after the same start
    change = np.mean(speeds[1]) - np.mean(speeds[0])
    difference = results["difference_to_mjx"]["speed"]
    assert difference["difference"] == pytest.approx(change)
    assert difference["percent"] == pytest.approx(100 * change / abs(np.mean(speeds[0])))


def test_only_what_is_asked_for_is_recorded(evaluated, loaded, quadruped):
    results, folder, output, _ = evaluated
    names = {path.name for path in folder.iterdir()}
    recordings = {"episode_000.mcap", "rerun.rbl"}
    assert names == {"metrics.json", "report.png", "film_strip.png", *recordings}
    assert "1 MCAP files" in output
    assert f"rerun {folder}/episode_000.rrd {folder}/rerun.rbl" in " ".join(output.split())
    metadata, attached = read_records(folder / "episode_000.mcap")
    record = metadata["quadwalk"]
    for name in ("run", "engine", "policy_sha256", "revision"):
        assert record[name] == results[name]
    assert json.loads(record["versions"])["mujoco"]
    assert json.loads(record["config"])["seed"] == 0
    assert attached["config.json"].data == b'{"seed": 0}'
    assert {"aliengo.urdf.gz", "aliengo.xml.gz", "foxglove_layout.json"} <= attached.keys()
    assert gzip.decompress(attached["aliengo.xml.gz"].data).decode() == write_xml(quadruped.spec)


def test_feet_carry_the_robot(evaluated, loaded):
    rollout = evaluated[3]["mjx"][0]
    assert rollout.foot_force is None
    force = add_foot_forces(rollout, loaded.env).foot_force
    # A foot that does not touch the floor carries nothing, and over time they carry the weight.
    assert np.all(force[~rollout.contact.astype(bool)] < 1.0)
    assert force.sum(axis=1).mean() == pytest.approx(loaded.env.robot.weight, rel=0.35)


@pytest.fixture
def beside(evaluated, tmp_path, monkeypatch, capsys):
    """Return beside(other): the comparison of `evaluated` with `other`, and the table's lines."""
    monkeypatch.setenv("COLUMNS", "120")

    def run(other: dict) -> tuple[dict, list[str]]:
        other["summary"] = summarize_episodes(other["episodes"])
        folders = [tmp_path / "first", tmp_path / "second"]
        labels, results = ["first", "second"], [evaluated[0], other]
        comparison = write.write_comparison(labels, folders, results, tmp_path)
        lines = capsys.readouterr().out.splitlines()
        return comparison, [" ".join(line.split()) for line in lines]

    return run


def test_runs_side_by_side(evaluated, beside, tmp_path):
    results, *_ = evaluated
    other = json.loads(json.dumps(results))
    for episode in other["episodes"]:
        episode["speed"] += 1.0
        episode["fell"] = False
        del episode["reward/yaw"]  # trained without that term
    comparison, lines = beside(other)
    assert json.loads((tmp_path / "comparison.json").read_text()) == comparison
    means = [run["summary"]["speed"]["mean"] for run in comparison["runs"]]
    assert means[1] == pytest.approx(means[0] + 1.0)
    (line,) = [line for line in lines if "speed along x" in line]
    assert all(f"{mean:.3f} ±" in line for mean in means)
    (line,) = [line for line in lines if line.startswith("│ yaw │")]
    assert "│ - │" in line
    assert {path.name for path in tmp_path.iterdir()} == {"comparison.json", "comparison.png"}


def test_a_run_with_commands_beside_one_without(evaluated, beside):
    results, *_ = evaluated
    commanded = json.loads(json.dumps(results))
    for number, episode in enumerate(commanded["episodes"]):
        for name in ("speed", "distance", "lateral_drift", "heading_error"):
            del episode[name]
        figures = {"velocity_error": 0.1 * number, "yaw_rate_error": None}
        episode |= {**figures, "path_speed": 1.0, "path": SECONDS}
    _, lines = beside(commanded)
    for row, first, second in (
        ("speed along x", f"{results['summary']['speed']['mean']:.3f} ±", "- │ m/s"),
        ("velocity error", "- │", "0.150 ±"),
        ("yaw rate error", "- │", "- │ rad/s"),
    ):
        (line,) = [line for line in lines if f"│ {row} │" in line]
        assert line.startswith(f"│ {row} │ {first}")
        assert f" │ {second}" in line


def test_without_perturbation_a_sweep_measures_what_an_evaluation_does(evaluated, loaded):
    rollouts = evaluated[3]["mujoco"]
    points = [Point(), Point(strength=80.0), Point(delay=40.0)]
    measured, *others = measure_points(loaded.to_engine("mujoco"), points, EPISODES, 1)
    for other in others:
        assert abs(other["speed"]["mean"] - measured["speed"]["mean"]) > 5e-3
    assert measured["success"] == 1 - np.mean([rollout.fell for rollout in rollouts])
    speeds = [
        (rollout.qpos[-1, 0] - rollout.qpos[0, 0]) / (rollout.steps * 0.02) for rollout in rollouts
    ]
    mean, half_width = compute_mean_interval(speeds)
    assert measured["speed"]["mean"] == pytest.approx(mean, abs=2e-4)
    assert measured["speed"]["ci95"] == pytest.approx(half_width, abs=2e-4)
    headings = [
        np.abs(to_roll_pitch_yaw(rollout.qpos[1:, 3:7])[:, 2]).mean() for rollout in rollouts
    ]
    heading = np.degrees(np.mean(headings))
    assert measured["heading_error"]["mean"] == pytest.approx(heading, rel=1e-3)


def test_a_sweep_is_a_table_of_one_thing_at_a_time(loaded, tmp_path, monkeypatch):
    def make_up_points(_, points, episodes, *rest):
        """Return success and speed of each point by its values, in place of simulated ones."""
        return [
            {
                "success": max(0.0, 1 - 0.5 * point.push - 0.02 * point.delay),
                "success_ci95": [0.0, 1.0],
                "speed": {"mean": 3.0 - point.push + (point.friction or 0), "ci95": 0.1},
            }
            for point in points
        ]

    monkeypatch.setattr(sweep, "measure_points", make_up_points)
    results = write.write_sweep(loaded, tmp_path, episodes=16, seed=0)
    assert json.loads((tmp_path / "sweep.json").read_text()) == results
    assert (tmp_path / "sweep.png").exists()
    assert list(results["sweeps"]) == list(SWEEPS)
    for name, sweep_of in results["sweeps"].items():
        values = [point["value"] for point in sweep_of["points"]]
        assert values == sorted(values) == list(SWEEPS[name][2])
        assert sweep_of["nominal"] in values
        (nominal,) = [p for p in sweep_of["points"] if p["value"] == sweep_of["nominal"]]
        assert {k: v for k, v in nominal.items() if k != "value"} == results["nominal"]
    pushes = results["sweeps"]["push"]["points"]
    assert [p["speed"]["mean"] for p in pushes] == [3.8 - p["value"] for p in pushes]


def run_git(folder: Path, *args: str) -> str:
    command = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=b", *args]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_the_revision_is_the_checkouts_commit(tmp_path):
    run_git(tmp_path, "init", "-q")
    assert find_revision(tmp_path).startswith("quadwalk ")  # nothing committed yet
    (tmp_path / "a").write_text("1")
    run_git(tmp_path, "add", "a")
    run_git(tmp_path, "commit", "-q", "-m", "first")
    commit = run_git(tmp_path, "rev-parse", "HEAD")
    assert find_revision(tmp_path) == f"git {commit}"
    run_git(tmp_path, "tag", "v1")
    assert find_revision(tmp_path) == f"git {commit}"
    (tmp_path / "a").write_text("2")
    assert find_revision(tmp_path) == f"git {commit}-dirty"


def test_without_git_or_a_checkout_the_version_stands_for_it(tmp_path, monkeypatch):
    inside = tmp_path / "package"  # of another project's checkout
    inside.mkdir()
    (tmp_path / ".git").mkdir()
    assert find_revision(inside).startswith("quadwalk ")
    assert find_revision(tmp_path).startswith("quadwalk ")  # not a valid one
    monkeypatch.setenv("PATH", str(inside))
    assert find_revision().startswith("quadwalk ")


def test_a_task_names_what_is_measured_of_it(loaded, tmp_path, monkeypatch):
    called: list[str] = []

    def replace(module, *names):
        for name in names:
            monkeypatch.setattr(module, name, functools.partial(record_call, name))

    def record_call(name, *_):
        called.append(name)
        return {}

    replace(terrain, "measure_terrain")
    replace(standing, "measure_standing", "print_standing")
    replace(gaits, "measure_gaits", "print_gaits", "draw_gaits")
    replace(commands, "measure_commands", "measure_changing", "print_commands", "draw_commands")
    monkeypatch.setattr(write, "save_figure", lambda *_: None)
    files = {}
    for suite in ("course", "terrain", "standing", "commands"):
        config = dataclasses.replace(loaded.policy.config, suite=suite)
        run = dataclasses.replace(loaded, policy=dataclasses.replace(loaded.policy, config=config))
        files[suite] = write._write_suite(
            run, tmp_path, {"gaits": []}, episodes=8, seed=0, levels=2
        )
    assert called == [
        *("measure_standing", "print_standing"),
        *("measure_commands", "measure_changing", "print_commands", "draw_commands"),
    ]
    # A task of uneven ground that was trained on a flat floor has no kinds of ground.
    assert files == {"course": [], "terrain": [], "standing": [], "commands": ["steering.png"]}
