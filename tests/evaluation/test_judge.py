"""Runs judged, compared, judged by two engines, and swept, with a policy of a few numbers."""

import dataclasses
import gzip
import hashlib
import io
import json

import jax
import numpy as np
import pytest
from rich.console import Console

from quadwalk.env.actions import about_home
from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UserError
from quadwalk.evaluation import evaluation as measuring
from quadwalk.evaluation import loaded as loading
from quadwalk.evaluation.grids import sweep as sweeping
from quadwalk.evaluation.grids.sweep import SWEEPS, Point, measure_points
from quadwalk.evaluation.judge import compare, judge, sweep
from quadwalk.evaluation.loaded import LoadedRun, load_run
from quadwalk.evaluation.motion.forces import with_foot_forces
from quadwalk.evaluation.motion.kinematics import roll_pitch_yaw
from quadwalk.evaluation.options import EvalConfig
from quadwalk.evaluation.simulate import simulate_episodes
from quadwalk.evaluation.statistics import mean_interval
from quadwalk.evaluation.summary import engine_differences, episode_figures, summarize
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
def judged(loaded, tmp_path_factory):
    """By both engines: what was returned, the folder, what was said, and MJX's episodes."""
    out, said, kept = tmp_path_factory.mktemp("judged"), io.StringIO(), {}

    def keeping(env, *rest):
        kept[env.engine] = list(simulate_episodes(env, *rest))
        return kept[env.engine]

    config = EvalConfig(episodes=EPISODES, seconds=SECONDS, engine="mujoco", seed=1, mcap=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "120")
        patch.setattr(measuring, "simulate_episodes", keeping)
        results = judge(loaded.in_engine("mujoco"), config, out, Console(file=said, width=200))
    return results, out, said.getvalue(), kept["mjx"]


def test_both_engines_are_judged_from_the_same_starts(judged, loaded):
    results, out, _, rollouts = judged
    assert json.loads((out / "metrics.json").read_text()) == results
    assert (results["engine"], results["seed"]) == ("mujoco", 1)
    scales, weight = loaded.env.config.reward, loaded.env.robot.weight
    effort = np.asarray(loaded.env.motor.effort)
    first = [episode_figures(rollout, scales, weight, effort) for rollout in rollouts]
    for name, figure in summarize(first).items():
        assert results["mjx_summary"][name] == pytest.approx(figure)
    speeds = [[episode["speed"] for episode in of] for of in (first, results["episodes"])]
    np.testing.assert_allclose(*speeds, atol=0.1)  # m/s: half a second after the same start
    change = np.mean(speeds[1]) - np.mean(speeds[0])
    difference = results["difference_to_mjx"]["speed"]
    assert difference["difference"] == pytest.approx(change)
    assert difference["percent"] == pytest.approx(100 * change / abs(np.mean(speeds[0])))


def test_differences_of_what_is_not_there_or_zero():
    figure, names = {"mean": 2.0}, ("speed", "distance", "duration", "energy_per_meter")
    mjx = {**dict.fromkeys(names, figure), "fall_rate": 0.0, "energy_per_meter": None}
    mujoco = {**{name: {"mean": 1.5} for name in names}, "fall_rate": 0.25}
    found = engine_differences(mjx, mujoco)
    assert found["fall_rate"] == {"difference": 0.25, "percent": None}
    assert found["energy_per_meter"] == {"difference": None, "percent": None}
    assert found["speed"] == {"difference": -0.5, "percent": -25.0}


def test_only_what_is_asked_for_is_recorded(judged, loaded, quadruped):
    results, out, said, _ = judged
    names = {path.name for path in out.iterdir()}
    recordings = {"episode_000.mcap", "rerun.rbl"}
    assert names == {"metrics.json", "report.png", "film_strip.png", *recordings}
    assert "1 MCAP files" in said
    assert f"rerun {out}/episode_000.rrd {out}/rerun.rbl" in " ".join(said.split())
    metadata, attached = read_records(out / "episode_000.mcap")
    record = metadata["quadwalk"]
    for name in ("run", "engine", "policy_sha256", "revision"):
        assert record[name] == results[name]
    assert json.loads(record["versions"])["mujoco"]
    assert json.loads(record["config"])["seed"] == 0
    assert attached["config.json"].data == b'{"seed": 0}'
    assert {"aliengo.urdf.gz", "aliengo.xml.gz", "foxglove_layout.json"} <= attached.keys()
    assert gzip.decompress(attached["aliengo.xml.gz"].data).decode() == write_xml(quadruped.spec)


def test_feet_carry_the_robot(judged, loaded):
    rollout = judged[3][0]
    assert rollout.foot_force is None
    force = with_foot_forces(rollout, loaded.env).foot_force
    # A foot that does not touch the floor carries nothing, and over time they carry the weight.
    assert np.all(force[~rollout.contact.astype(bool)] < 1.0)
    assert force.sum(axis=1).mean() == pytest.approx(loaded.env.robot.weight, rel=0.35)


@pytest.fixture
def beside(judged, tmp_path, monkeypatch, capsys):
    """beside(other): what was judged, compared with `other`, and the lines of the table."""
    monkeypatch.setenv("COLUMNS", "120")

    def run(other: dict) -> tuple[dict, list[str]]:
        other["summary"] = summarize(other["episodes"])
        folders = [tmp_path / "first", tmp_path / "second"]
        comparison = compare(["first", "second"], folders, [judged[0], other], tmp_path, Console())
        lines = capsys.readouterr().out.splitlines()
        return comparison, [" ".join(line.split()) for line in lines]

    return run


def test_runs_side_by_side(judged, beside, tmp_path):
    results, *_ = judged
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


def test_a_run_with_commands_beside_one_without(judged, beside):
    results, *_ = judged
    told = json.loads(json.dumps(results))
    for number, episode in enumerate(told["episodes"]):
        for name in ("speed", "distance", "lateral_drift", "heading_error"):
            del episode[name]
        figures = {"velocity_error": 0.1 * number, "yaw_rate_error": None}
        episode |= {**figures, "path_speed": 1.0, "path": SECONDS}
    _, lines = beside(told)
    for row, first, second in (
        ("speed along x", f"{results['summary']['speed']['mean']:.3f} ±", "- │ m/s"),
        ("velocity error", "- │", "0.150 ±"),
        ("yaw rate error", "- │", "- │ rad/s"),
    ):
        (line,) = [line for line in lines if f"│ {row} │" in line]
        assert line.startswith(f"│ {row} │ {first}")
        assert f" │ {second}" in line


def test_without_perturbation_a_sweep_measures_what_an_evaluation_does(judged, loaded):
    rollouts = judged[3]
    points = [Point(), Point(strength=80.0), Point(delay=40.0)]
    measured, *others = measure_points(loaded, points, EPISODES, 1)
    for other in others:
        assert abs(other["speed"]["mean"] - measured["speed"]["mean"]) > 5e-3
    assert measured["success"] == 1 - np.mean([rollout.fell for rollout in rollouts])
    speeds = [
        (rollout.qpos[-1, 0] - rollout.qpos[0, 0]) / (rollout.steps * 0.02) for rollout in rollouts
    ]
    mean, half_width = mean_interval(speeds)
    assert measured["speed"]["mean"] == pytest.approx(mean, abs=2e-4)
    assert measured["speed"]["ci95"] == pytest.approx(half_width, abs=2e-4)
    headings = [np.abs(roll_pitch_yaw(rollout.qpos[1:, 3:7])[:, 2]).mean() for rollout in rollouts]
    heading = np.degrees(np.mean(headings))
    assert measured["heading_error"]["mean"] == pytest.approx(heading, rel=1e-3)


def test_a_sweep_is_a_table_of_one_thing_at_a_time(loaded, tmp_path, monkeypatch):
    def made_up(_, points, episodes, *rest):
        """Success and speed of each point by its values, in place of simulated ones."""
        return [
            {
                "success": max(0.0, 1 - 0.5 * point.push - 0.02 * point.delay),
                "success_ci95": [0.0, 1.0],
                "speed": {"mean": 3.0 - point.push + (point.friction or 0), "ci95": 0.1},
            }
            for point in points
        ]

    monkeypatch.setattr(sweeping, "measure_points", made_up)
    config = EvalConfig(sweep=True, seconds=SECONDS)
    results = sweep(loaded, config, tmp_path, Console(quiet=True))
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


def test_the_last_policy_is_judged_or_the_best(loaded, monkeypatch):
    monkeypatch.setattr(loading, "load_policy", lambda path: loaded.policy)
    for which, file in [("last", loaded.run.policy), ("best", loaded.run.best)]:
        found = load_run(loaded.run, SECONDS, which)
        assert (found.file, found.config) == (file, None)
        assert found.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()


def test_a_configuration_that_cannot_be_read_is_one_line(loaded, monkeypatch, tmp_path):
    monkeypatch.setattr(loading, "load_policy", lambda path: loaded.policy)
    run = Run(tmp_path)
    run.policy.write_bytes(b"weights")
    run.config.mkdir()
    with pytest.raises(UserError) as caught:
        load_run(run, SECONDS)
    assert str(caught.value) == f"cannot read {run.config}: Is a directory"


def test_a_policy_of_another_robot_is_one_line(loaded, monkeypatch):
    joints = tuple(f"{name}_of_another" for name in loaded.policy.joints)
    for change in ({"joints": joints}, {"observation_size": 48}):
        policy = dataclasses.replace(loaded.policy, **change)
        monkeypatch.setattr(loading, "load_policy", lambda path, policy=policy: policy)
        with pytest.raises(UserError, match="was trained on another robot than"):
            load_run(loaded.run, SECONDS)
    assert jax.tree.leaves(loaded.policy.act)  # its weights are arguments, not constants
