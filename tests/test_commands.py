"""The command `quadwalk`: what it lists, and how it answers a name that it does not know."""

import json
import subprocess

import pytest

import quadwalk
from quadwalk.cli import main
from quadwalk.errors import UsageError, UserError
from quadwalk.runs.directory import claim, create_run
from quadwalk.tasks import list_tasks
from quadwalk.web import view
from tests.programs import python


@pytest.fixture
def call(capsys):
    def call(*arguments: object) -> str:
        main.call_command(list(map(str, arguments)))
        return capsys.readouterr().out

    return call


def test_version_help_and_tasks(call):
    assert call("--version") == f"quadwalk {quadwalk.__version__}\n"
    assert call() == call("--help")
    for name in ("train", "eval", "view", "demo", "runs", "tasks", "terrain", "doctor"):
        assert f"  {name} " in call("--help")
    assert [line.split()[0] for line in call("tasks").splitlines()] == sorted(list_tasks())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["trian"], "no command 'trian'; .*; did you mean 'train'?"),
        (["train", "wlak"], "^no task 'wlak'; .*; did you mean 'walk'?"),
        (["--print-completion", "tcsh"], "--print-completion tcsh: expected bash or zsh"),
        (["train", "walk", "--stepz", "1"], r"mean '--steps'\? \(.* --help-all lists all\)"),
        # Not the first of those that contain it, which is --checkpoint-steps.
        (["train", "--step", "5"], r"unknown option --step; did you mean '--steps'\? "),
        (["nan"], r"missing: file \(quadwalk nan --help lists all\)"),
        (["view", "rogh"], "no run 'rogh': .*rough, run.* come trained; did you mean 'rough'?"),
        (["eval", "wlak"], "no run 'wlak': .*; did you mean 'walk'?"),
        (["runs", "show"], "show: expected one or more runs"),
        (["runs", "list", "walk"], "list walk: expected list alone"),
    ],
)
def test_what_is_meant_is_said_in_one_line(call, words, message):
    with pytest.raises(UsageError, match=message):
        call(*words)


def test_help_of_training_fits_a_screen(call):
    for flag in ("-h", "--help"):
        lines = call("train", "walk", flag).splitlines()
        assert len(lines) < 40
        assert max(map(len, lines)) <= 100
        assert all(any(line.startswith(f"  {name} ") for line in lines) for name in list_tasks())


def test_help_of_training_imports_no_jax():
    code = "import sys; from quadwalk.cli import main; main.call_command(['train', '--help'])"
    done = python("-c", f"{code}; assert not {{'jax', 'mujoco', 'tyro'}} & sys.modules.keys()")
    assert done.returncode == 0, done.stderr


def test_bash_completes_commands_flags_and_choices(call):
    script = call("--print-completion", "bash")
    for typed, completed in (
        ("tr", ["train"]),
        ("train walk --env.motor.kp 3 --env.reward.ener", ["--env.reward.energy"]),
        ("eval --engine m", ["mjx", "mujoco"]),
        ("robot dog.urdf --mesh-d", ["--mesh-dirs"]),
        ("compare --see", ["--seeds"]),
    ):
        words = f"COMP_WORDS=(quadwalk {typed}) COMP_CWORD={len(typed.split())}"
        line = f"{script}\n{words}; _tyro_quadwalk; echo ${{COMPREPLY[@]}}"
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True)
        assert (done.stdout.split(), done.stderr) == (completed, ""), typed


def test_the_demo_drives_a_packaged_policy(call, monkeypatch):
    configs = []
    monkeypatch.setattr(view, "view", configs.append)
    call("demo", "--port", "8090")
    assert (configs[0].run, configs[0].port) == ("drive", 8090)
    call("demo", "my_dog.urdf", "--port", "8090")
    assert (configs[1].run, str(configs[1].robot.urdf)) == ("universal", "my_dog.urdf")
    call("demo", "my_dog.urdf", "--run", "many")
    assert (configs[2].run, str(configs[2].robot.urdf)) == ("many", "my_dog.urdf")
    with pytest.raises(UsageError, match="--run without a robot"):
        call("demo", "--run", "many")


def test_runs_are_listed_shown_and_removed(call, tmp_path):
    assert call("runs", "--runs", tmp_path) == f"no run in {tmp_path} yet\n"
    config = json.dumps({"config": {"task": "walk"}}).encode()
    for name in ("first", "second"):
        create_run(tmp_path, name, files={"config.json": config})
    errors = '{"steps": 9, "eval/speed": -0.03, "eval/velocity_error": 0.25}\n'
    (tmp_path / "second" / "metrics.jsonl").write_text(errors)
    metrics = '{"steps": 1}\n{"steps": 24576, "eval/speed": 1.25, "eval/fall_rate": 0.5}\n'
    (tmp_path / "first" / "metrics.jsonl").write_text(metrics + '{"steps": 4')
    rows = call("runs", "--runs", tmp_path).splitlines()
    (first,) = (row for row in rows if " first " in row)
    assert [cell.strip() for cell in first.split("│")[1:-2]] == [
        *("first", "walk", "24,576", "1.25 m/s", "50.0")
    ]
    (second,) = (row for row in rows if " second " in row)
    assert second.split("│")[4].strip() == "0.25 m/s off the command"
    assert json.loads(call("runs", "show", "first", "--runs", tmp_path))["config"]["task"] == "walk"
    with pytest.raises(UsageError, match="no run 'third'"):
        call("runs", "remove", "first", "third", "--runs", tmp_path)
    assert (tmp_path / "first").exists()
    run = quadwalk.runs.directory.Run(tmp_path / "first")
    with claim(run), pytest.raises(UserError, match="is being trained by another process"):
        call("runs", "remove", "first", "--runs", tmp_path)
    assert call("runs", "remove", "first", "--runs", tmp_path) == f"removed {run.path}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["second"]
