"""The command line: flags, tasks, runs to resume, and what is refused."""

import dataclasses
import json
import re
from pathlib import Path

import pytest

from quadwalk.errors import UsageError, UserError
from quadwalk.learn.flags import parse_config
from quadwalk.runs.resume import list_changes, read_config
from quadwalk.settings.serialize import change_settings, to_dict
from quadwalk.settings.training import TrainConfig
from quadwalk.task_files import load_task
from quadwalk.tasks import list_tasks, sprint, walk


def parse(*flags: str) -> TrainConfig:
    return parse_config(flags)[0]


def test_every_field_can_be_set_from_the_command_line():
    flags = ["--name", "x", "--steps", "5", "--seed", "3", "--envs", "64"]
    flags += ["--env.reward.forward", "2.5", "--env.reward.forward.max-speed", "3"]
    flags += ["--env.motor.no-speed-limit", "--env.action.thigh", "0.5"]
    flags += ["--ppo.hidden", "32", "16", "--robot.urdf", "a/b.urdf"]
    config = parse(*flags)
    assert (config.name, config.steps, config.seed, config.envs) == ("x", 5, 3, 64)
    assert config.env.reward["forward"].scale == 2.5
    assert config.env.reward["forward"].params == {"max_speed": 3.0}
    assert config.env.motor.speed_limit is False
    assert config.env.action.params == {"hip": 0.3, "thigh": 0.5, "calf": 0.9}
    assert config.ppo.hidden == (32, 16)
    assert config.robot.urdf == Path("a/b.urdf")
    assert config.env.reward["fall"] == load_task("run").env.reward["fall"]


@pytest.mark.parametrize("args", [["walk"], ["--preset", "walk"], ["--preset=walk"]])
def test_the_task_comes_first_or_by_its_flag_of_before(args):
    config, previous = parse_config([*args, "--seed", "3"])
    assert (config.task, config.seed, previous) == ("walk", 3, None)


@pytest.mark.parametrize("name", list_tasks())
def test_a_task_is_where_the_flags_start(name):
    assert parse(name) == load_task(name)
    assert parse() == load_task("run")


@pytest.mark.parametrize(
    ("flags", "changed"),
    [
        ("blog --env.substeps 5", lambda env: env.substeps == 5 and env.episode_steps == 200),
        ("blog --env.episode-seconds 20", lambda env: env.episode_steps == 4800),
        ("blog --env.action.step-limit 1", lambda env: env.action.params["step_limit"] == 1.0),
        ("blog --env.motor.kp None", lambda env: env.motor.kp is None),
        ("blog --env.reward.movement 0", lambda env: env.reward["movement"].scale == 0.0),
        (
            "blog --env.termination.low.height 0",
            lambda env: env.termination["low"].params["height"] == 0,
        ),
        ("blog --env.reset.pose 0 0.8 -1.6", lambda env: env.reset.pose == (0.0, 0.8, -1.6)),
        ("walk --env.command.yaw-rate -0.25 2", lambda env: env.command.yaw_rate == (-0.25, 2.0)),
    ],
)
def test_one_flag_changes_one_thing_of_a_task(flags, changed):
    task, *words = flags.split()
    before, now = load_task(task), parse(task, *words)
    assert changed(now.env)
    assert not changed(before.env)
    assert len(list_changes(before, now)) == 1


@pytest.mark.parametrize(
    "flags",
    [
        *("--foo 1", "--steps many", "--steps 0", "--envs -4", "--seed -1", "--env.gravity 0"),
        *("--env.engine bullet", "--env.motor.effort -1", "--env.reward.forward fast"),
        *("--ppo.discount 1.5", "--ppo.anneal-share 0", "--ppo.hidden 0", "--env.physics-dt 1"),
        *("--env.command.yaw-rate nan 0", "--env.command.seconds 0"),
        *("--env.randomization.push-seconds 0", "--env.randomization.margin 1.5"),
        *("--env.randomization.push 0.5 0", "--env.command.standing 2"),
        *("--env.command.lateral 0 inf", "--env.contacts hands"),
    ],
)
def test_a_bad_flag_is_refused_by_its_name(flags):
    flag = flags.split()[0]
    with pytest.raises(UsageError, match=re.escape(flag.lstrip("-"))):
        parse_config(flags.split())


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["fly"], "no task 'fly'"),
        (["fly.py"], "cannot read the task"),
        ([""], "no task ''"),
        (["run", "--preset", "walk"], "the task is named twice, as 'run' and by --preset"),
        (["--preset"], "no task ''"),
        (["walk", "--resume", "latest"], "task 'walk' with --resume"),
        (["--name", "-x"], "--name=-x"),
        (["--env.reward.forwad", "2"], "--env.reward.forward"),
        (["--env.command.forward", "1", "0"], "env.command.forward is (1.0, 0.0)"),
        (["--env.reward.energy", "nan"], "--env.reward.energy is nan; expected a finite number"),
        (["--env.reward.forward.max-speed", "inf"], "--env.reward.forward.max-speed is inf"),
        (["--env.action.hip", "nan"], "--env.action.hip is nan"),
        (["--env.motor.kp", "nan"], "--env.motor.kp is nan; expected 0 or more, or None"),
        (["--env.observation.joint-vel.noise", "-1"], "--env.observation.joint-vel.noise is -1.0"),
        (["--env.reset.pose", "0", "nan", "0"], "--env.reset.pose is (0.0, nan, 0.0)"),
        (["--env.episode-seconds", "1e12"], "--env.episode-seconds is 1000000000000.0"),
        (["--env.ground.border", "inf"], "--env.ground.border is inf; expected at most 1e+12 m"),
        (["sprint", "--env.randomization.friction", "0", "1"], "randomization.enabled"),
        (["--steps", "12345678901234567890123"], "--steps is 12345678901234567890123"),
        (["--minutes", "nan"], "--minutes is nan"),
        (["--ppo.clip-epsilon", "nan"], "--ppo.clip-epsilon is nan; expected more than 0"),
        (["--ppo.min-learning-rate", "0.5"], "at most --ppo.max-learning-rate, 0.01"),
        (["--robot.effort", "0"], "--robot.effort is 0"),
        (["--robot.speed", "0"], "--robot.speed is 0"),
        (["--distributed.processes=2"], "--distributed.coordinator"),
        (["--distributed.process=1"], "--distributed.coordinator"),
        (["--distributed.coordinator=here", "--distributed.processes=2"], "HOST:PORT"),
        (["--distributed.coordinator=here:0", "--distributed.processes=2"], "HOST:PORT"),
        (["--distributed.coordinator=a:1", "--distributed.processes=0"], "--distributed.processes"),
        (["--distributed.coordinator=a:1", "--distributed.process=1"], "--distributed.process"),
    ],
)
def test_a_bad_flag_is_one_line_that_names_it(flags, message):
    with pytest.raises(UsageError, match=re.escape(message)):
        parse_config(flags)


def test_help_shows_the_numbers_of_the_task(capsys):
    with pytest.raises(SystemExit) as caught:
        parse_config(["walk", "--help-all"])
    assert caught.value.code == 0
    help_text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for name, term in walk.TASK.env.reward.items():
        flag = f"--env.reward.{name.replace('_', '-')} FLOAT "
        assert f"(default: {term.scale})" in help_text[help_text.index(flag) :][:200]
    assert "--env.reward.forward " not in help_text


def write_run(folder: Path, content: str) -> None:
    folder.mkdir()
    (folder / "config.json").write_text(content)


def test_a_resumed_configuration_is_the_runs_with_the_flags_given(tmp_path):
    config = change_settings(sprint.TASK, {"name": "dog", "env.substeps": 3, "seed": 7})
    content = {"config": to_dict(config), "versions": {"quadwalk": "0.2.0"}}
    write_run(tmp_path / "dog", json.dumps(content))
    flags = ["--runs", str(tmp_path), "--resume", "dog", "--ppo.entropy", "0.5"]
    resumed, previous = parse_config(flags)
    assert previous.path == tmp_path / "dog"
    assert (resumed.seed, resumed.env.substeps, resumed.ppo.entropy) == (7, 3, 0.5)
    assert resumed.robot.urdf == tmp_path / "dog" / "robot.urdf"
    config = read_config(previous)
    assert list_changes(config, resumed) == ["ppo.entropy: 0.01 -> 0.5"]
    with pytest.raises(UsageError, match="--seed"):
        list_changes(config, dataclasses.replace(resumed, seed=8))


OLD = """{"config": {"preset": "run", "env": {"reward": {"forward": 1.0}}},
"versions": {"quadwalk": "0.1.0"}}"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        *((text, r"config\.json") for text in ("", "{", "[]", '{"config": {"steps": "x"}}', "{}")),
        (OLD, r"is of quadwalk 0\.1\.0 or before"),
    ],
)
def test_a_configuration_that_is_damaged_or_too_old_is_one_line(tmp_path, text, message):
    write_run(tmp_path / "dog", text)
    with pytest.raises(UserError, match=message):
        parse_config(["--runs", str(tmp_path), "--resume", "dog"])
