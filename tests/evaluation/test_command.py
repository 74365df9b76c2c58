"""The commands `eval` and `sweep`: errors of one line, and the folders of results."""

import dataclasses
import datetime
import functools
from pathlib import Path
from types import SimpleNamespace

import pytest
import trimesh

from quadwalk.cli.arguments import parse
from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UsageError, UserError
from quadwalk.evaluation import command, write
from quadwalk.evaluation.command import EvalConfig, SweepConfig, call_eval, call_sweep
from quadwalk.evaluation.results import make_provenance
from quadwalk.paths import ALIENGO_URDF, PRETRAINED
from quadwalk.robot.load import load_robot
from quadwalk.runs.directory import Run, describe_origin, find_ready
from quadwalk.runs.resume import make_run
from quadwalk.settings.training import RobotConfig
from quadwalk.tasks import sprint
from tests.untrained import write_policy


@pytest.fixture
def runs(tmp_path) -> Path:
    """Return a folder of two runs that hold nothing yet."""
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.json").touch()
    return tmp_path


def read_error(runs: Path, *args: str, call=call_eval) -> str:
    """Return the exit status and the message of the error that these arguments raise."""
    with pytest.raises(UserError) as caught:
        call([*args, f"--runs={runs}"], "eval.py")
    assert (caught.type, caught.value.exit_status) in ((UsageError, 2), (UserError, 1))
    return f"{caught.value.exit_status}: {caught.value}"


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (["nobody"], "2: no run 'nobody': expected 'latest', a path, or one in "),
        (["first", "nobody"], "2: no run 'nobody'"),
        (["first", "first"], "2: 'first' and 'first' are the same run, "),
        (["second", "first", "latest"], "are the same run, "),
        (["first", "{runs}/second/../first"], "are the same run, "),
        (["--episodes=0"], "2: --episodes is 0; expected 1 or more"),
        (["--episodes=many"], "2: bad value for --episodes; expected INT"),
        (["--seconds=0"], "2: --seconds is 0.0; expected more than 0, up to 3600"),
        (["--seconds=nan"], "2: --seconds is nan"),
        (["--engine=ode"], "2: bad value for --engine; expected {fast,mjx,mujoco}"),
        (["--mcap=-1"], "2: --mcap is -1; expected 0 or more"),
        (["--seed=-1"], "2: --seed is -1; expected 0 to "),
        (["--video=avi"], "2: bad value for --video; expected {none,gif,mp4}"),
        (["--episods=3"], "2: unknown option --episods=3; did you mean '--episodes'?"),
        (["first", "--sweep", "--seed=1"], "quadwalk sweep first --seed=1 --runs="),
        (["first", "--view"], "2: eval.py has no --view; expected "),
        (["first", "--browser"], "quadwalk view first --browser --runs="),
    ],
)
def test_what_cannot_be_evaluated_is_one_line(runs, args, expected):
    assert expected in read_error(runs, *(arg.format(runs=runs) for arg in args))


def test_a_sweep_has_no_options_of_an_evaluation(runs):
    for option in ("--mcap=1", "--video=gif", "--randomized", "--levels=2"):
        assert "2: unknown option" in read_error(runs, option, call=call_sweep)
    assert "no run 'nobody'" in read_error(runs, "nobody", call=call_sweep)


def test_thousands_of_files_are_written_only_if_asked_for():
    assert EvalConfig(episodes=4096).recordings == 16
    assert EvalConfig(episodes=4096, mcap=4096).recordings == 4096


def test_before_any_training_the_packaged_policy_is_evaluated(tmp_path):
    run = find_ready(tmp_path / "none", EvalConfig().run[0], "run")
    assert run.path == PRETRAINED / "run"
    origin = describe_origin(tmp_path / "none", run)
    assert origin == f"{run.path}, which comes trained: no run in {tmp_path / 'none'} yet"
    assert describe_origin(tmp_path, Run(tmp_path / "mine")) == str(tmp_path / "mine")


def write_results(*args, **_) -> dict:
    """Stand in for functions that write results to the last folder among their arguments."""
    folder = [arg for arg in args if isinstance(arg, Path)][-1]
    (folder / "results").write_text("")
    return {}


@pytest.fixture
def without_simulation(monkeypatch):
    policy = SimpleNamespace(notes=())
    monkeypatch.setattr("quadwalk.evaluation.load.load_run", lambda *_: policy)
    for name in ("evaluation", "sweep", "comparison", "sweep_comparison"):
        monkeypatch.setattr(write, f"write_{name}", write_results)


@pytest.mark.parametrize("args", [[], ["second"]])
@pytest.mark.parametrize("call", [call_eval, call_sweep])
def test_a_folder_that_cannot_be_written_is_told_before_the_simulation(
    runs, args, call, without_simulation, monkeypatch
):
    (runs / "file").write_text("")
    out = runs / "file" / "out"
    line = read_error(runs, "first", *args, f"--out={out}", call=call)
    assert line == f"1: cannot write results to the folder {out}: Not a directory"

    def refuse(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    line = read_error(runs, "first", f"--out={runs / 'out'}", call=call)
    assert line == f"1: cannot write results to the folder {runs / 'out'}: No space left on device"


def test_a_policy_that_cannot_be_loaded_leaves_no_folder(runs):
    before = sorted(runs.rglob("*"))
    for args in (["first"], ["first", "second"], ["first", f"--out={runs / 'a' / 'b'}"]):
        for call in (call_eval, call_sweep):
            assert "policy.npz" in read_error(runs, *args, call=call)
            assert sorted(runs.rglob("*")) == before


@pytest.mark.parametrize("names", [("first",), ("first", "second")])
@pytest.mark.parametrize("kind", ["mjx", "sweep"])
def test_evaluations_of_the_same_second_have_folders_of_their_own(
    runs, monkeypatch, without_simulation, names, kind
):
    now = datetime.datetime(2026, 1, 2, 3, 4, 5)
    clock = SimpleNamespace(datetime=SimpleNamespace(now=lambda: now))
    monkeypatch.setattr(command, "datetime", clock)
    evaluate = functools.partial(command.evaluate_runs, EvalConfig(run=names, runs=runs))
    sweep = functools.partial(command.sweep_runs, SweepConfig(run=names, runs=runs))
    for _ in range(3):
        (sweep if kind == "sweep" else evaluate)()
    numbered = {f"2026-01-02_030405-{kind}{number}" for number in ("", "-2", "-3")}
    places = [runs / name / "eval" for name in names]
    for place in [*places, *[runs / "comparisons"] * (len(names) > 1)]:
        assert {path.name for path in place.iterdir()} == numbered
        assert len(list(place.glob("*/results"))) == 3


def test_an_evaluation_says_what_its_robot_lacks(tmp_path, monkeypatch, capsys):
    """Check a run whose trunk's mesh is no longer there."""
    box = '<box size="0.647 0.15 0.112"/>'
    trimesh.creation.box((0.647, 0.15, 0.112)).export(tmp_path / "trunk.stl")
    text = ALIENGO_URDF.read_text().replace(box, '<mesh filename="trunk.stl"/>')
    (tmp_path / "dog.urdf").write_text(text)
    config = RobotConfig(urdf=tmp_path / "dog.urdf")
    task = dataclasses.replace(sprint.TASK, robot=config, runs=tmp_path / "runs", name="dog")
    quadruped = load_robot(config)
    run = make_run(task, quadruped)
    write_policy(run.policy, QuadrupedEnv(quadruped, task.env), 0, task)
    (tmp_path / "trunk.stl").unlink()
    notes: list[str] = []

    def read_notes(loaded, *_, **__):
        notes.extend(make_provenance(loaded, 0)["notes"])

    monkeypatch.setattr(write, "write_evaluation", read_notes)
    command.evaluate_runs(parse(EvalConfig, ["dog", f"--runs={task.runs}"], "eval.py"))
    missing, other, *_ = notes
    assert missing == "dropped: collision meshes that were not found: trunk.stl"
    assert other.startswith(f"warning: {run.path} was trained on another robot")
    assert f"dog: {missing}\ndog: {other}\n" in capsys.readouterr().err
