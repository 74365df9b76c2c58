"""What is asked for on the command line and cannot be: one line each, before anything is done."""

import dataclasses
import datetime
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import trimesh

from quadwalk.cli.arguments import parse
from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UsageError, UserError
from quadwalk.evaluation import session
from quadwalk.evaluation.options import EvalConfig
from quadwalk.evaluation.recording.provenance import provenance, revision
from quadwalk.evaluation.session import evaluate_runs
from quadwalk.learn.prepare import make_run
from quadwalk.paths import ALIENGO_URDF, PRETRAINED
from quadwalk.robot.load import load_robot
from quadwalk.runs.directory import Run, describe_origin, find_ready
from quadwalk.settings.training import RobotConfig
from quadwalk.tasks import sprint
from tests.view.conftest import write_policy


@pytest.fixture
def runs(tmp_path) -> Path:
    """A folder of two runs that hold nothing yet."""
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.json").touch()
    return tmp_path


def said(runs: Path, *args: str) -> str:
    """The error of these arguments."""
    with pytest.raises(UserError) as caught:
        evaluate_runs(parse(EvalConfig, [*args, f"--runs={runs}"], "eval.py"))
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
        (["first", "second", "--view"], "2: 2 runs with --view; expected one"),
        (["--sweep", "--mcap=1"], "2: --mcap has no effect with --sweep"),
        (["--sweep", "--video=gif"], "2: --video has no effect with --sweep"),
        (["--sweep", "--view"], "2: --view has no effect with --sweep"),
        (["first", "--view", "--port=99999"], "2: --port is 99999; expected 0 to 65535"),
        (["--swep"], "2: unknown option --swep; did you mean --sweep?"),
    ],
)
def test_what_cannot_be_asked_is_one_line(runs, args, expected):
    assert expected in said(runs, *(arg.format(runs=runs) for arg in args))


def test_thousands_of_files_are_written_only_if_asked_for():
    assert EvalConfig(episodes=4096).recordings == 16
    assert EvalConfig(episodes=4096, mcap=4096).recordings == 4096


def test_before_any_training_the_packaged_policy_is_evaluated(tmp_path):
    run = find_ready(tmp_path / "none", EvalConfig().run[0], "run")
    assert run.path == PRETRAINED / "run"
    said = describe_origin(tmp_path / "none", run)
    assert said == f"{run.path}, which comes trained: no run in {tmp_path / 'none'} yet"
    assert describe_origin(tmp_path, Run(tmp_path / "mine")) == str(tmp_path / "mine")


@pytest.mark.parametrize("args", [[], ["--sweep"], ["second"]])
def test_a_folder_that_cannot_be_written_is_told_before_the_simulation(runs, args):
    (runs / "file").write_text("")
    line = said(runs, "first", *args, f"--out={runs / 'file' / 'out'}")
    assert line == f"1: cannot write results to the folder {runs / 'file' / 'out'}: Not a directory"


def test_a_folder_that_takes_no_file(runs, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.NamedTemporaryFile", full)
    line = said(runs, "first", f"--out={runs / 'out'}")
    assert line == f"1: cannot write results to the folder {runs / 'out'}: No space left on device"


def test_what_fails_leaves_no_folder(runs):
    before = sorted(runs.rglob("*"))
    for args in (["first"], ["first", "second"], ["--sweep"], [f"--out={runs / 'a' / 'b'}"]):
        assert "policy.npz" in said(runs, *args)
        assert sorted(runs.rglob("*")) == before
    (runs / "mine").mkdir()
    said(runs, "first", f"--out={runs / 'mine'}")
    assert (runs / "mine").is_dir()


@pytest.mark.parametrize("names", [("first",), ("first", "second")])
@pytest.mark.parametrize("kind", ["mjx", "sweep"])
def test_evaluations_of_the_same_second_have_folders_of_their_own(runs, monkeypatch, names, kind):
    now = datetime.datetime(2026, 1, 2, 3, 4, 5)
    clock = SimpleNamespace(datetime=SimpleNamespace(now=lambda: now))

    def written(*args):
        """In place of all that writes results: to the folder among its arguments."""
        (out,) = (arg for arg in args if isinstance(arg, Path))
        (out / "results").write_text("")

    nothing = SimpleNamespace(notes=())
    monkeypatch.setattr(session, "datetime", clock)
    monkeypatch.setattr("quadwalk.evaluation.loaded.load_run", lambda *_: nothing)
    for name in ("judge", "sweep", "compare", "compare_sweeps"):
        monkeypatch.setattr(f"quadwalk.evaluation.judge.{name}", written)
    for _ in range(3):
        evaluate_runs(EvalConfig(run=names, runs=runs, sweep=kind == "sweep"))
    numbered = {f"2026-01-02_030405-{kind}{number}" for number in ("", "-2", "-3")}
    places = [runs / name / "eval" for name in names]
    for place in [*places, *[runs / "comparisons"] * (len(names) > 1)]:
        assert {path.name for path in place.iterdir()} == numbered
        assert len(list(place.glob("*/results"))) == 3


def test_an_evaluation_says_what_its_robot_lacks(tmp_path, monkeypatch, capsys):
    """One whose trunk's mesh is no longer there, which the run was trained with."""
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
    monkeypatch.setattr(
        "quadwalk.evaluation.judge.judge",
        lambda loaded, *_: notes.extend(provenance(loaded, 0)["notes"]),
    )
    evaluate_runs(EvalConfig(run=("dog",), runs=task.runs))
    said = capsys.readouterr().err
    missing, other, *_ = notes
    assert missing == "dropped: collision meshes that were not found: trunk.stl"
    assert other.startswith(f"warning: {run.path} was trained on another robot")
    assert f"dog: {missing}\ndog: {other}\n" in said


def test_the_command_ends_with_the_errors_status(runs):
    command = [sys.executable, "-m", "quadwalk", "eval", "nobody", f"--runs={runs}"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: no run 'nobody'")
    assert done.stderr.count("\n") == 1


def git(folder: Path, *args: str) -> str:
    command = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=b", *args]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_the_revision_is_the_checkouts_commit(tmp_path):
    git(tmp_path, "init", "-q")
    assert revision(tmp_path).startswith("quadwalk ")  # nothing committed yet
    (tmp_path / "a").write_text("1")
    git(tmp_path, "add", "a")
    git(tmp_path, "commit", "-q", "-m", "first")
    commit = git(tmp_path, "rev-parse", "HEAD")
    assert revision(tmp_path) == f"git {commit}"
    git(tmp_path, "tag", "v1")
    assert revision(tmp_path) == f"git {commit}"
    (tmp_path / "a").write_text("2")
    assert revision(tmp_path) == f"git {commit}-dirty"


def test_without_git_or_a_checkout_the_version_stands_for_it(tmp_path, monkeypatch):
    inside = tmp_path / "package"  # of another project's checkout
    inside.mkdir()
    (tmp_path / ".git").mkdir()
    assert revision(inside).startswith("quadwalk ")
    assert revision(tmp_path).startswith("quadwalk ")  # not a valid one
    monkeypatch.setenv("PATH", str(inside))
    assert revision().startswith("quadwalk ")
