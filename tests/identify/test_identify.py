"""Logs made in MuJoCo C, with noise and delay, by joints that are known."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.identification import Known, hang
from quadwalk.errors import UserError
from quadwalk.identify.__main__ import main
from quadwalk.identify.joint_log import read_log
from quadwalk.train.flags import parse_config
from quadwalk.train.robot import load_robot

KNOWN = Known(friction_speed=0.03, kp=27.0)


@pytest.fixture(scope="module")
def recorded(quadruped, tmp_path_factory) -> Path:
    """The log as a CSV, with a column more, in an order of its own."""
    file = tmp_path_factory.mktemp("logs") / "log.csv"
    time, position, _, target = hang(quadruped, KNOWN, seconds=8.0)
    names = [f"{what}_{joint}" for what in ("position", "target") for joint in quadruped.joints]
    rows = np.c_[np.zeros(len(time)), position, target, time]
    header = ",".join(["battery", *names, "time"])
    np.savetxt(file, rows, "%.6f", ",", header=header, comments="")
    return file


def test_known_joints_are_found_and_the_flags_train_them(recorded, quadruped):
    fit = ["armature", "friction", "damping", "delay", "kp"]
    command = [sys.executable, "-m", "quadwalk", "identify", str(recorded)]
    gains = ["--kp=25", f"--kd={KNOWN.kd}"]
    done = subprocess.run(
        [*command, *gains, "--fit", *fit],
        capture_output=True,
        text=True,
        env=os.environ | {"JAX_DISABLE_MOST_OPTIMIZATIONS": "0"},
    )
    assert done.returncode == 0, done.stderr
    out = recorded.with_name("log_identified")
    found = json.loads((out / "identified.json").read_text())
    for value in found["constants"]:
        true = np.ravel(getattr(KNOWN, value["constant"]))
        true = true[quadruped.joints.index(value["joints"][0])]
        assert value["found"] == pytest.approx(true, rel=0.05), value
        assert abs(value["found"] - true) < 2 * value["interval95"], value
        assert value["sure"]
    assert len(found["constants"]) == 12
    rest = found["rms_rad"]
    assert rest["found_fitted"] == pytest.approx(KNOWN.noise, rel=0.05)
    assert rest["found_held_out"] == pytest.approx(KNOWN.noise, rel=0.1)
    assert rest["described_held_out"] > 2 * KNOWN.noise
    assert (out / "fit.png").stat().st_size > 50_000

    flags = shlex.split(done.stdout.splitlines()[-1])
    config, _ = parse_config(flags[flags.index("train") + 1 :])
    robot = load_robot(config.robot)
    model = robot.training_model(0.004)
    assert model.dof_armature[6:] == pytest.approx(np.tile(KNOWN.armature, 4), rel=0.05)
    assert robot.friction == pytest.approx(np.tile(KNOWN.friction, 4), rel=0.05)
    low, high = config.env.randomization.latency
    assert low < KNOWN.delay < high
    assert config.env.motor.kp == pytest.approx(KNOWN.kp, rel=0.05)
    assert config.env.randomization.armature == (0.9, 1.1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rows: rows[:, :-1], "has no column time; expected time, and target_JOINT and"),
        (lambda rows: rows[:, 1:], "has no column position_FR_hip_joint; expected time"),
        (lambda rows: rows[:600], "has 3.0 s; expected 5 s or more"),
        (lambda rows: rows[:1], "has no row of numbers; expected 5 s or more"),
        (lambda rows: rows[::10], "has 20 angles a second; expected 40 or more"),
        (lambda rows: rows[[0, *range(1600, 0, -1)]], "its times of angles do not ascend"),
        (lambda rows: _set(rows, slice(1, None), 4, "0.7"), "position of FL_thigh_joint moves by"),
        (lambda rows: _set(rows, slice(1, None), 12, "0"), "the target of FR_hip_joint moves by"),
        (lambda rows: _set(rows, 7, 3, "nan"), "line 8: expected a finite number in every column"),
        (lambda rows: _set(rows, 7, 3, "off"), "line 8: expected a finite number in every column"),
    ],
)
def test_a_log_that_shows_nothing_is_one_line(recorded, quadruped, tmp_path, change, said):
    rows = np.genfromtxt(recorded, dtype="U40", delimiter=",")[:, 1:]
    file = tmp_path / "bad.csv"
    np.savetxt(file, change(np.char.rstrip(rows)), "%s", ",")
    with pytest.raises(UserError, match=f"^{file}.*{said}"):
        read_log(file, quadruped.joints)


def _set(rows: np.ndarray, row: object, column: int, text: str) -> np.ndarray:
    rows[row, column] = text
    return rows


@pytest.mark.parametrize(
    ("args", "said"),
    [
        ([], "expected either a log, or --targets FILE"),
        (["log.csv", "--fit", "kd", "damping"], "a log shows only their sum"),
        (["log.mcap"], "cannot read log.mcap: No such file or directory"),
        ([__file__, "--robot.urdf", "no.urdf"], "no.urdf: cannot be read"),
    ],
)
def test_what_cannot_be_is_one_line(args, said, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=said):
        main(args)


def test_targets_to_play_stay_within_limits(quadruped, tmp_path, capsys):
    main(["--targets", str(tmp_path / "targets.csv")])
    assert "play it on the robot on its stand" in capsys.readouterr().out
    header = (tmp_path / "targets.csv").read_text().splitlines()[0].split(",")
    assert header == ["time", *(f"target_{joint}" for joint in quadruped.joints)]
    rows = np.loadtxt(tmp_path / "targets.csv", delimiter=",", skiprows=1)
    time, targets = rows[:, 0], rows[:, 1:]
    assert np.all((targets > quadruped.lower) & (targets < quadruped.upper))
    speed = np.abs(np.gradient(targets, time, axis=0))
    assert speed.max() < 5.0
    assert speed[[0, -1]].max() < 0.01
    assert np.ptp(targets, axis=0).min() > 0.3
    assert targets[0] == pytest.approx(quadruped.home[7:], abs=1e-4)
