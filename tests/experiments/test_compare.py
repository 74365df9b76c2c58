"""`quadwalk compare`: the variants that it takes, its table and its curves."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from quadwalk.errors import UserError
from quadwalk.experiments import comparison
from quadwalk.experiments.commands import compare, split_variants
from quadwalk.experiments.comparison import compute_band, draw_bands, plan_training
from quadwalk.experiments.job import Job, open_run
from quadwalk.experiments.options import TuneConfig
from quadwalk.experiments.places import ThisMachine
from quadwalk.experiments.runner import Outcome
from quadwalk.experiments.search import make_base
from quadwalk.files import resolve_path
from quadwalk.learn.flags import parse_config
from quadwalk.paths import PRETRAINED
from quadwalk.progress.metrics import SPEED
from quadwalk.runs.directory import create_run, find_any_run
from quadwalk.runs.resume import read_config
from quadwalk.tasks import run, walk
from tests.experiments.conftest import BATCH, TINY
from tests.test_task_files import OWN_TASK

ROWS = [{"steps": 10, "eval/speed": 1.0}, {"steps": 20, "eval/speed": 3.0}]
WITH_COMMANDS = [{**row, "eval/velocity_error": 0.5} for row in ROWS]


def test_an_argument_that_is_no_option_is_a_variant():
    args = ["", "--ppo.entropy 0.003", "walk", "--seeds", "2", "--cores=2", "--steps"]
    variants, options = split_variants([*args, "64"])
    assert variants == ["", "--ppo.entropy 0.003", "walk"]
    assert options == ["--seeds", "2", "--cores=2", "--steps", "64"]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ([], "no variant is given"),
        (["", "--seeds", "0"], "--seeds is 0; expected 1 or more"),
        (["--ppo.entropi 1"], "unknown option --ppo.entropi"),
        (["--robot.urdf 'my dog.urdf"], "has a quote or a backslash that is not closed"),
        (["--init nothing"], "no run 'nothing'"),
        (["", "--episodes", "many"], "bad value for --episodes"),
        (["", "--ppo.entropy 0.1", "--ppo.entropy=0.1"], "two are the same"),
        (["", "--seed 3"], "--seed is in the variant '--seed 3'"),
        (["", "--gpus", "1"], "--gpus is 1 without --cluster"),
        (["", "--cores", "4096"], "--cores is 4096; expected at most"),
        (["", "--cluster", "nowhere"], "--cluster is 'nowhere'; expected HOST:PORT, auto or local"),
        (["", "--robot.urdf no.urdf"], "no.urdf"),
    ],
)
def test_what_cannot_be_compared_is_said_before_anything_is_trained(
    args, message, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ThisMachine, "submit", pytest.fail)
    with pytest.raises(UserError, match=re.escape(message)):
        compare(args)


def test_the_band_of_seeds_goes_as_far_as_all_of_them():
    other = [{"steps": 12, "eval/speed": 5.0}, {"steps": 16, "eval/speed": 7.0}]
    missing = {"steps": 14, "eval/speed": math.nan}
    steps, low, mean, high = compute_band([ROWS, [*other[:1], missing, *other[1:]]], SPEED)
    np.testing.assert_allclose(steps, [10, 12, 16])
    np.testing.assert_allclose(low, [1.0, 1.4, 2.2])
    np.testing.assert_allclose(high, [5.0, 5.0, 7.0])
    np.testing.assert_allclose(mean, (low + high) / 2)
    assert len(compute_band([ROWS, []], SPEED)[0]) == 0


def test_every_variant_has_a_curve_of_what_its_task_is_about():
    figure = draw_bands([("a", ROWS), ("a", ROWS), ("b", WITH_COMMANDS)])
    assert [axes.get_title("left") for axes in figure.axes] == [
        "Speed, m/s", "Velocity error, m/s", "Episodes that fell, %", "Reward"
    ]  # fmt: skip
    for axes, lengths in zip(figure.axes, [(2, 2), (0, 2), (0, 0), (0, 0)], strict=True):
        assert tuple(len(line.get_xdata()) for line in axes.lines) == lengths


@pytest.fixture
def trainings(monkeypatch, tmp_path):
    """Replace trainings and evaluations by made-up metrics and figures, without processes.

    Trainings of variants with "entropy" in their names fail. The folder of the runs is returned.
    """

    def run_jobs(jobs, place, count):
        for job in jobs:
            run = job.run
            run.path.mkdir(parents=True)
            run.metrics.write_text("".join(json.dumps(row) + "\n" for row in ROWS))
            if "entropy" in job.name:
                yield Outcome(job, None, "the weights are no longer finite")
            else:
                yield Outcome(job, job.evaluate(run))

    def evaluate(run, episodes, engine="mjx"):
        commanded = "walk" in run.name
        seed = int(run.name[-1])
        mean = {"mean": 2.0 + seed, "ci95": None}
        names = ["path_speed", "velocity_error", "yaw_rate_error"]
        names = names if commanded else ["speed", "distance", "lateral_drift", "heading_error"]
        gait = SimpleNamespace(
            gait="trot",
            swing_height=np.array([0.05, 0.06, math.nan, 0.07]),
            slip_share=np.array([math.nan, 0.02 if seed == 0 else math.nan]),
            torque_peak=np.array([0.9, 1.0]),
            joint_speed_peak=np.array([0.5]),
            action_rate=20.0,
        )
        speeds = [{names[0]: speed} for speed in (2.0, 2.0, 0.1)]
        summary = {"fall_rate": 0.25, **dict.fromkeys(names, mean)}
        return SimpleNamespace(summary=summary, episodes=speeds, gait=gait)

    monkeypatch.setattr(comparison, "run_jobs", run_jobs)
    monkeypatch.setattr(comparison, "evaluate", evaluate)
    return tmp_path / "runs"


def test_a_row_for_each_run_a_file_for_all_and_a_picture(trainings, capsys):
    compare(["", "walk", "--seeds", "2", "--steps", "64", "--runs", str(trainings)])
    lines = capsys.readouterr().out.splitlines()
    table_lines = (trainings / "compare.md").read_text().splitlines()
    assert table_lines == lines[:6]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table_lines]
    heads, rows = cells[0], [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]
    assert heads[:2] == ["flags", "seed"]
    assert [(row["flags"], row["seed"]) for row in rows] == [
        ("`defaults`", "0"), ("`defaults`", "1"), ("`walk`", "0"), ("`walk`", "1")
    ]  # fmt: skip
    assert rows[1]["m/s"] == rows[1]["m/s in C"] == "3.00"
    assert (rows[0]["falls"], rows[0]["slow"], rows[0]["off, m/s"]) == ("25.0%", "1", "-")
    assert (rows[2]["off, m/s"], rows[2]["drift"], rows[2]["slow"]) == ("2.000", "-", "-")
    assert rows[2]["swing, cm"] == "0.0"  # a foot that never left the floor
    assert [row["slip"] for row in rows] == ["2.0%", "-", "2.0%", "-"]  # of no steps there is none
    results = json.loads((trainings / "compare.json").read_text())
    assert [result["figures"]["slip"] for result in results] == [0.02, None, 0.02, None]
    assert [result["run"] for result in results] == [
        "default_64_s0", "default_64_s1", "walk_64_s0", "walk_64_s1"
    ]  # fmt: skip
    assert (trainings / "compare.png").stat().st_size > 1000


def test_a_training_that_fails_is_said_at_the_end_and_the_others_are_written(trainings, capsys):
    flags = "--ppo.entropy 0.003"
    with pytest.raises(UserError, match=r"ppo.entropy.*_s0: the weights are no longer finite"):
        compare([flags, "", "--seeds", "1", "--steps", "64", "--runs", str(trainings)])
    (result,) = json.loads((trainings / "compare.json").read_text())
    assert result["run"] == "default_64_s0"
    assert "default" in capsys.readouterr().out


def test_a_variant_is_trained_with_its_flags_and_seed(tmp_path):
    flags = "--ppo.entropy 0.003"
    config = plan_training(flags, 2, None, tmp_path)
    usual, _ = parse_config(flags.split())
    assert (config.ppo, config.env, config.steps) == (usual.ppo, usual.env, usual.steps)
    assert (config.seed, config.runs) == (2, tmp_path)


def test_a_variant_is_read_as_a_shell_reads_it(tmp_path):
    urdf = tmp_path / "my dog.urdf"
    urdf.touch()
    config = plan_training(f"walk --robot.urdf '{urdf}'", 0, None, tmp_path)
    assert config.robot.urdf == urdf
    assert create_run(tmp_path, config.name).name == config.name
    # Quotes that change nothing make no other run.
    names = [
        plan_training(f"--ppo.entropy {text}", 0, None, tmp_path).name for text in ("1", "'1'")
    ]
    assert names == ["ppo.entropy-1_full_s0"] * 2


def test_the_run_to_begin_with_is_the_one_that_a_training_alone_finds(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("runs", "runs/compare", "runs/tune/run"):
        create_run(folder, "source", files={"config.json": b"{}"})
    for folder in ("runs/compare", "runs/tune/run"):
        create_run(folder, "drive", files={"config.json": b"{}"})
    for name, path in (("source", tmp_path / "runs/source"), ("drive", PRETRAINED / "drive")):
        flags = f"--init {name}"
        alone, _ = parse_config(flags.split())
        compared = plan_training(flags, 0, None, resolve_path(Path("runs/compare")))
        searched = replace(make_base(TuneConfig(flags=flags)), runs=Path("runs/tune/run"))
        for config in (alone, compared, searched):
            assert find_any_run(config.runs, config.init).path == path
        saved = read_config(open_run(Job(compared, pytest.fail)))
        assert find_any_run(saved.runs, saved.init).path == path
    # A packaged run is found where the package is elsewhere.
    there = find_any_run("runs", "/opt/quadwalk/assets/pretrained/drive")
    assert there.path == PRETRAINED / "drive"


def test_a_run_is_known_again_until_its_task_file_or_its_source_changes(tmp_path):
    tiny = f"--devices=2 --steps={BATCH} --runs={tmp_path / 'runs'} --name=own {TINY}".split()

    def plan(folder: str, rate: float, *flags: str) -> Job:
        (tmp_path / folder).mkdir(exist_ok=True)
        file = tmp_path / folder / "own.py"
        file.write_text(OWN_TASK.replace("return 1.0", f"return {rate}"))
        return Job(parse_config([str(file), *tiny, *flags])[0], pytest.fail)

    run = open_run(plan("a", 1.0))
    assert open_run(plan("b", 1.0)) == run
    for other in (plan("c", 2.0), plan("a", 1.0, "--init=run")):
        with pytest.raises(UserError, match="other settings; remove it"):
            open_run(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("--env.reward.energy -0.1", "--env.reward.energy 0.1"),
        ("walk --env.substeps 4" + 9 * " --ppo.entropy 0.1",
         "walk --env.substeps 4" + 9 * " --ppo.entropy 0.1" + " --ppo.clip-epsilon 0.1"),
        ("--robot.urdf a/b.urdf", "--robot.urdf a-b.urdf"),
        (run.__file__, walk.__file__),
    ],
)  # fmt: skip
def test_variants_that_differ_have_names_that_do_and_that_a_run_can_have(one, other, tmp_path):
    names = {plan_training(flags, 0, None, tmp_path).name for flags in (one, other)}
    assert {create_run(tmp_path, name).name for name in names} == names
    assert len(names) == 2
