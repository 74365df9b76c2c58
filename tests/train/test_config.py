import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadwalk.errors import UsageError, UserError
from quadwalk.task.config import EnvConfig, RewardConfig
from quadwalk.train import devices
from quadwalk.train.__main__ import parse_config
from quadwalk.train.runs.resume import changed_settings
from quadwalk.train.settings import PRESETS, PPOConfig, TrainConfig, from_dict, to_dict

ROOT = Path(__file__).parents[2]


def test_every_field_can_be_set_from_the_command_line():
    flags = ["--name", "x", "--steps", "5", "--seed", "3", "--envs", "64"]
    flags += ["--env.reward.forward", "2.5", "--env.actuation.no-speed-limit"]
    flags += ["--ppo.hidden", "32", "16", "--robot.urdf", "a/b.urdf"]
    config = parse_config(flags)
    assert (config.name, config.steps, config.seed, config.envs) == ("x", 5, 3, 64)
    assert config.env.reward.forward == 2.5
    assert config.env.actuation.speed_limit is False
    assert config.ppo.hidden == (32, 16)
    assert config.robot.urdf == Path("a/b.urdf")
    assert config.env.reward.fall == RewardConfig().fall


def test_the_defaults_are_the_run_preset():
    assert parse_config([]) == parse_config(["--preset", "run"]) == TrainConfig()


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_where_the_flags_start_and_comes_back_from_json(name):
    preset = PRESETS[name]
    assert preset.preset == name
    assert parse_config(["--preset", name]) == preset
    assert from_dict(TrainConfig, json.loads(json.dumps(to_dict(preset)))) == preset


@pytest.mark.parametrize(
    ("flags", "changed"),
    [
        ("--env.substeps 5", lambda env: env.substeps == 5 and env.episode_steps == 200),
        ("--env.episode-seconds 20", lambda env: env.episode_steps == 4800),
        ("--env.actuation.targets home", lambda env: env.actuation.targets == "home"),
        ("--env.actuation.step-limit None", lambda env: env.actuation.step_limit is None),
        ("--env.actuation.kp None", lambda env: env.actuation.kp is None),
        (
            "--env.actuation.thigh-bounds -0.5 1.5",
            lambda env: env.actuation.thigh_bounds == (-0.5, 1.5),
        ),
        ("--env.reward.movement 0", lambda env: env.reward.movement == 0.0),
        ("--env.observation body", lambda env: env.observation == "body"),
        ("--env.reset.pose 0 0.8 -1.6", lambda env: env.reset.pose == (0.0, 0.8, -1.6)),
    ],
)
def test_one_flag_changes_one_thing_of_a_preset(flags, changed):
    before, now = PRESETS["blog"], parse_config(["--preset", "blog", *flags.split()])
    assert changed(now.env)
    assert not changed(before.env)
    assert len(changed_settings(before, now)) == 1


def test_the_walk_preset_is_the_same_task_with_commands():
    walk = parse_config(["--preset", "walk"])
    assert walk == PRESETS["walk"]
    assert (walk.preset, walk.env.command.given, TrainConfig().env.command.given) == (
        "walk",
        True,
        False,
    )
    changed = parse_config(["--preset", "walk", "--env.command.turning", "-0.25", "2"])
    assert changed.env.command.turning == (-0.25, 2.0)
    assert changed.env.reward == walk.env.reward
    assert from_dict(TrainConfig, json.loads(json.dumps(to_dict(changed)))) == changed


finite = st.floats(allow_nan=False, allow_infinity=False)


@given(
    finite,
    st.integers(1, 9),
    st.lists(st.integers(1, 512), min_size=1).map(tuple),
    st.sampled_from(["feet", "body"]),
)
def test_a_configuration_comes_back_from_json_as_it_was(forward, substeps, hidden, contacts):
    config = TrainConfig(
        name=None,
        env=EnvConfig(reward=RewardConfig(forward=forward), substeps=substeps, contacts=contacts),
        ppo=PPOConfig(hidden=hidden),
    )
    assert from_dict(TrainConfig, json.loads(json.dumps(to_dict(config)))) == config


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"colour": 1}, "config.colour"),
        ({"steps": "many"}, "config.steps"),
        ({"steps": True}, "config.steps"),
        ({"env": {"substeps": 1.5}}, "config.env.substeps"),
        ({"env": {"contacts": 1}}, "config.env.contacts"),
        ({"env": {"contacts": "hands"}}, "env.contacts"),
        ({"env": 3}, "config.env"),
        ({"ppo": {"hidden": ["a"]}}, "config.ppo.hidden"),
        ({"env": {"reward": {"speed": 1.0}}}, "config.env.reward.speed"),
        ({"env": {"observation": 1}}, "config.env.observation"),
        ({"env": {"observation": "eyes"}}, "env.observation"),
        ({"env": {"actuation": {"targets": "all"}}}, "env.actuation.targets"),
        ({"env": {"actuation": {"hip_bounds": [1.0]}}}, "env.actuation.hip-bounds"),
        ({"env": {"command": {"forward": [1.0]}}}, "env.command.forward"),
        (
            {"env": {"observation": "world", "command": {"forward": [0.0, 1.0]}}},
            "tells of no command",
        ),
    ],
)
def test_a_foreign_configuration_is_refused_by_name(change, named):
    with pytest.raises(UsageError, match=named.replace(".", r"\.")):
        from_dict(TrainConfig, change)


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--foo", "1"], "--foo"),
        (["--steps", "many"], "--steps"),
        (["--steps", "0"], "--steps"),
        (["--envs", "-4"], "--envs"),
        (["--seed", "-1"], "--seed"),
        (["--preset", "fly"], "--preset"),
        (["--preset"], "--preset"),
        (["--env.gravity", "0"], "gravity"),
        (["--env.observation", "eyes"], "observation"),
        (["--env.actuation.targets", "all"], "targets"),
        (["--env.actuation.step-limit", "0"], "step-limit"),
        (["--env.actuation.effort", "-1"], "effort"),
        (["--env.actuation.calf-bounds", "1", "-1"], "calf-bounds"),
        (["--env.actuation.calf-bounds", "1"], "calf-bounds"),
        (["--env.reward.forwad", "2"], "--env.reward.forward"),
        (["--ppo.discount", "1.5"], "discount"),
        (["--ppo.hidden", "0"], "hidden"),
        (["--env.physics-dt", "1"], "physics-dt"),
        (["--env.command.forward", "1", "0"], "env.command.forward is (1.0, 0.0)"),
        (["--env.command.turning", "nan", "0"], "env.command.turning"),
        (["--env.command.seconds", "0"], "env.command.seconds"),
        (["--env.command.standing", "2"], "env.command.standing"),
        (["--env.command.sideways", "0", "inf"], "env.command.sideways"),
        (["--env.reward.follow-width", "0"], "env.reward.follow-width"),
        (["--env.contacts", "hands"], "env.contacts"),
    ],
)
def test_a_bad_flag_is_one_line_that_names_it(flags, named):
    with pytest.raises(UsageError) as caught:
        parse_config(flags)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("script", ["train.py", "eval.py"])
def test_the_scripts_end_a_usage_error_with_status_2_and_one_line(script):
    done = subprocess.run(
        [sys.executable, script, "--nonsense"], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_help_names_every_setting():
    done = subprocess.run(
        [sys.executable, "train.py", "--help"], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0
    for name in [field.name for field in dataclasses.fields(RewardConfig)]:
        assert f"--env.reward.{name.replace('_', '-')} " in done.stdout


@pytest.mark.parametrize(
    ("cores", "envs", "expected"),
    [(1, 2048, 1), (2, 2048, 2), (6, 2048, 4), (12, 2048, 8), (3, 96, 2), (4, 7, 1)],
)
def test_devices_are_the_most_that_share_the_work_evenly(monkeypatch, cores, envs, expected):
    monkeypatch.setattr(devices, "cpu_cores", lambda: cores)
    assert devices.device_count(envs, minibatches=4, judges=64) == expected


def test_a_resumed_configuration_is_the_runs_with_the_flags_given(tmp_path):
    run = tmp_path / "dog"
    run.mkdir()
    config = TrainConfig(name="dog", env=EnvConfig(substeps=3), seed=7)
    (run / "config.json").write_text(json.dumps({"config": to_dict(config)}))
    resumed = parse_config(["--runs", str(tmp_path), "--resume", "dog", "--ppo.entropy", "0.5"])
    assert (resumed.seed, resumed.env.substeps, resumed.ppo.entropy) == (7, 3, 0.5)
    assert resumed.robot == config.robot
    assert changed_settings(config, resumed) == [f"ppo.entropy: {PPOConfig().entropy} -> 0.5"]
    with pytest.raises(UsageError, match="--seed"):
        changed_settings(config, dataclasses.replace(resumed, seed=8))


@pytest.mark.parametrize("text", ["", "{", "[]", '{"config": {"steps": "x"}}', "{}"])
def test_a_damaged_configuration_is_one_line_that_names_the_file(tmp_path, text):
    (tmp_path / "dog").mkdir()
    (tmp_path / "dog" / "config.json").write_text(text)
    with pytest.raises(UserError, match=r"config\.json") as caught:
        parse_config(["--runs", str(tmp_path), "--resume", "dog"])
    assert "\n" not in str(caught.value)


def test_the_command_line_starts_without_jax():
    """Bad flags are told, and the first sign of progress is shown, before the slow imports."""
    code = (
        "import sys, quadwalk.train.loop, quadwalk.evaluate.evaluation;"
        "from quadwalk.train.__main__ import parse_config; parse_config([]);"
        "sys.exit(any(name in sys.modules for name in ('jax', 'mujoco', 'brax', 'matplotlib')))"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
