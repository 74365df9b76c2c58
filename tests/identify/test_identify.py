"""Logs made in MuJoCo C, with noise and delay, by joints that are known."""

import dataclasses
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.identification import LogSetup, record_log
from quadwalk.errors import UserError
from quadwalk.identify import identification
from quadwalk.identify.cli import main
from quadwalk.identify.config import IdentifyConfig
from quadwalk.identify.fit import (
    OF_URDF,
    OFFSETS,
    SETTLE,
    Fit,
    Parameters,
    Value,
    compute_intervals,
)
from quadwalk.identify.identification import describe
from quadwalk.identify.log import find_pieces, read_log
from quadwalk.identify.results import is_sure
from quadwalk.identify.simulation import Joints, make_simulator
from quadwalk.learn.flags import parse_config
from quadwalk.robot.load import load_robot

KNOWN = LogSetup(friction_speed=0.03, kp=27.0, offset=(0.02, -0.03, 0.05))


@pytest.fixture(scope="module")
def recorded(quadruped, tmp_path_factory) -> Path:
    """Write the log to a CSV with one column more, in an order of its own; return the file."""
    file = tmp_path_factory.mktemp("logs") / "log.csv"
    time, position, _, target, *_ = record_log(quadruped, KNOWN, seconds=9.0)
    names = [f"{what}_{joint}" for what in ("position", "target") for joint in quadruped.joints]
    rows = np.c_[np.zeros(len(time)), position, target, time]
    header = ",".join(["battery", *names, "time"])
    np.savetxt(file, rows, "%.6f", ",", header=header, comments="")
    return file


@pytest.fixture
def rewrite(recorded, tmp_path):
    """Return a function that writes the log without `battery`, changed, and returns the file.

    Its arguments are the change of the rows of text, the delimiter and the decimal sign.
    """

    def write(change=lambda rows: rows, delimiter=",", decimal=".") -> Path:
        rows = np.char.rstrip(np.genfromtxt(recorded, dtype="U40", delimiter=",")[:, 1:])
        rows = change(rows)
        if decimal != ".":
            rows[1:] = np.char.replace(rows[1:], ".", decimal)
        np.savetxt(tmp_path / "changed.csv", rows, "%s", delimiter)
        return tmp_path / "changed.csv"

    return write


def _without(rows: np.ndarray, start: int, end: int) -> np.ndarray:
    return np.delete(rows, slice(start, end), axis=0)


def _set(rows: np.ndarray, row: object, column: int, text: str) -> np.ndarray:
    rows[row, column] = text
    return rows


def _scale(rows: np.ndarray, columns: object, factor: float) -> np.ndarray:
    rows[1:, columns] = np.char.mod("%.6f", factor * rows[1:, columns].astype(float))
    return rows


def _swap(rows: np.ndarray, first: int, second: int) -> np.ndarray:
    rows[1:, [first, second]] = rows[1:, [second, first]]
    return rows


def test_known_joints_are_found_across_a_gap_and_the_flags_train_them(rewrite, quadruped):
    fit = ["armature", "friction", "damping", "delay", "kp"]
    log = rewrite(lambda rows: _without(_scale(rows, -1, 1000.0), 801, 1001), ";", ",")
    command = [sys.executable, "-m", "quadwalk", "identify", str(log)]
    gains = ["--kp=25", f"--kd={KNOWN.kd}"]
    done = subprocess.run(
        [*command, *gains, "--fit", *fit],
        capture_output=True,
        text=True,
        env=os.environ | {"JAX_DISABLE_MOST_OPTIMIZATIONS": "0"},
    )
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    assert "its times are read as milliseconds" in done.stderr
    assert "a gap of 1.00 s before line 802" in " ".join(done.stderr.split())
    out = log.with_name("changed_identified")
    results = json.loads((out / "identified.json").read_text())
    true_constants = dataclasses.asdict(KNOWN) | {"target_offset": KNOWN.offset}
    covered = 0
    for value in results["constants"]:
        true = np.ravel(true_constants[value["constant"]])
        true = true[quadruped.joints.index(value["joints"][0]) % 3 if len(true) > 1 else 0]
        error = abs(value["found"] - true)
        covered += error < value["interval95"]
        assert error < 2 * value["interval95"], value
        if value["constant"] != "offset":
            assert value["found"] == pytest.approx(true, rel=0.05), value
            assert value["sure"], value
    assert len(results["constants"]) == 36
    assert covered >= 31  # of 36 at 95 %, but for one case in 1000
    rest = results["rms_rad"]
    assert rest["found_fitted"] == pytest.approx(KNOWN.noise, rel=0.05)
    assert rest["found_held_out"] == pytest.approx(KNOWN.noise, rel=0.1)
    assert rest["described_held_out"] > 2 * KNOWN.noise
    assert max(results["unexplained"].values()) < 0.02
    assert (out / "fit.png").stat().st_size > 50_000

    flags = shlex.split(done.stdout.splitlines()[-1])
    config, _ = parse_config(flags[flags.index("train") + 1 :])
    robot = load_robot(config.robot)
    model = robot.make_training_model(0.004)
    assert model.dof_armature[6:] == pytest.approx(np.tile(KNOWN.armature, 4), rel=0.05)
    assert robot.friction == pytest.approx(np.tile(KNOWN.friction, 4), rel=0.05)
    low, high = config.env.randomization.latency
    assert low < KNOWN.delay < high
    assert config.env.motor.kp == pytest.approx(KNOWN.kp, rel=0.05)
    assert config.env.randomization.armature == (0.9, 1.1)


@pytest.mark.parametrize("shared", [True, False])
def test_simulation_is_mujocos_with_offsets_on_both_sides_of_a_gap(quadruped, shared):
    setup = dataclasses.replace(KNOWN, noise=0.0, shared=shared)
    log = record_log(quadruped, setup, seconds=2.0)
    rows = np.r_[0:150, 210:400]
    log = log._replace(time=log.time[rows], position=log.position[rows])
    model, joints = describe(quadruped, IdentifyConfig(Path("log.csv"), kp=setup.kp, kd=setup.kd))
    target_offset = np.tile(setup.offset, 4) * (not shared)
    joints = joints._replace(
        **{name: np.tile(getattr(setup, name), 4) for name in (*OF_URDF, "offset")},
        delay=np.full(12, setup.delay),
        friction_speed=np.full(12, setup.friction_speed),
        target_offset=target_offset,
    )
    angles = make_simulator(model, log)(Joints(*(value[:, None] for value in joints)))[:, :, 0]
    error = np.abs(angles - log.position)
    settle = round(SETTLE / (log.time[1] - log.time[0]))
    assert error[settle:150].max() < 4e-4
    assert error[150 + settle :].max() < 4e-4


def test_one_simulation_shows_the_constants_of_all_legs(quadruped):
    log = record_log(quadruped, KNOWN, seconds=1.0)
    model, joints = describe(quadruped, IdentifyConfig(Path("log.csv"), kp=KNOWN.kp, kd=KNOWN.kd))
    single = [(joint,) for joint in range(12)]
    parameters = Parameters(joints, ["armature", "offset", "delay"], single)
    candidates = parameters.make_candidates(parameters.start / parameters.scale)
    assert candidates.armature.shape == (12, 1 + 3 + 3 + 1)
    simulate = make_simulator(model, log)
    jacobian = parameters.compute_jacobian(simulate(candidates))
    alone = Joints(*(np.repeat(value[:, None], 8, axis=1) for value in joints))
    changes = [("armature", 4), ("armature", 8), ("offset", 0), ("offset", 11)]
    for column, (name, joint) in enumerate(changes, start=1):
        place = parameters.places.index((name, (joint,)))
        getattr(alone, name)[joint, column] += 1e-4 * parameters.scale[place]
    angles = simulate(alone)
    for column, (name, joint) in enumerate(changes, start=1):
        place = parameters.places.index((name, (joint,)))
        derivative = (angles[:, :, column] - angles[:, :, 0]) / 1e-4
        np.testing.assert_allclose(jacobian[:, :, place], derivative, atol=1e-9)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """Check errors that are alike within a block, and few blocks."""
    rng = np.random.default_rng(0)
    block = np.repeat(np.arange(12), 40)
    jacobian = rng.standard_normal((480, 6)) + rng.standard_normal((12, 6))[block]
    inverse = np.linalg.pinv(jacobian)
    hits = []
    for _ in range(400):
        error = rng.standard_normal(480) + 0.5 * rng.standard_normal(12)[block]
        change = inverse @ error
        interval = compute_intervals(jacobian, error - jacobian @ change, block)
        hits.append(np.abs(change) < interval)
    assert np.mean(hits) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda rows: rows, ""),
        (lambda rows: _swap(rows, 0, 3), "; its angles follow target_FL_hip_joint: are columns.*"),
        (lambda rows: _scale(rows, 0, -1.0), "; its angles move against its target: .*"),
    ],
)
def test_a_fit_that_explains_little_is_sure_of_nothing_and_writes_no_urdf(
    rewrite, quadruped, tmp_path, monkeypatch, capsys, change, cause
):
    log_file = rewrite(change)
    log = read_log(log_file, quadruped.joints)
    _, joints = describe(quadruped, IdentifyConfig(log_file))
    values = [Value("friction", (0, 3, 6, 9), 0.4, 8.9, 0.005)]
    values += [Value(name, (joint,), 0, 0.02, 0) for joint in range(12) for name in OFFSETS]
    fit = Fit(
        values=tuple(values),
        described=joints,
        before=log.position,
        after=log.position + 0.1,
        fitted=np.full(len(log.time), True),
        held_out=np.full(len(log.time), False),
        unexplained=np.array([0.6] + [0.1] * 11),
    )
    monkeypatch.setattr(identification, "fit_log", lambda *_: fit)
    (tmp_path / "robot.urdf").write_text("of an earlier fit")
    message = f"leaves 60% of the motion of FR_hip_joint, so no URDF .* every joint{cause}$"
    with pytest.raises(UserError, match=message):
        main([str(log_file), "-o", str(tmp_path)])
    assert not (tmp_path / "robot.urdf").exists()
    assert "train" not in capsys.readouterr().out
    results = json.loads((tmp_path / "identified.json").read_text())
    assert not any(value["sure"] for value in results["constants"])
    assert results["flags"] == []
    explains = dataclasses.replace(fit, unexplained=np.full(12, 0.1))
    assert all(is_sure(explains, value) for value in values)


@pytest.mark.parametrize(
    ("delimiter", "decimal"), [(",", "."), (";", ","), (";", "."), ("\t", ",")]
)
@pytest.mark.parametrize(("factor", "unit"), [(1.0, ""), (1e3, "milli"), (1e9, "nano")])
def test_separators_decimals_and_units_of_time_are_read(
    rewrite, recorded, quadruped, delimiter, decimal, factor, unit
):
    expected = read_log(recorded, quadruped.joints)
    file = rewrite(lambda rows: _scale(rows, -1, factor), delimiter, decimal)
    log = read_log(file, quadruped.joints)
    np.testing.assert_allclose(log.time, expected.time, atol=1e-9)
    assert np.array_equal(log.position, expected.position)
    assert np.array_equal(log.target, expected.target)
    assert log.notes == ((f"its times are read as {unit}seconds",) if unit else ())


def test_gaps_are_named_and_short_pieces_dropped(rewrite, quadruped):
    def cut(rows: np.ndarray) -> np.ndarray:
        return _without(_without(rows, 1101, 1301), 801, 1001)  # leaves 0.5 s between

    log = read_log(rewrite(cut), quadruped.joints)
    (note,) = log.notes
    assert note.startswith("has 2 gaps, the longest of 1.00 s before line 802; each piece of 1 s")
    assert [log.time[piece.start] for piece in find_pieces(log.time)] == [0.0, 6.5]
    assert len(log.time) == 1800 - 500


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[:, :-1], "has no column time; expected time, and target_JOINT and"),
        (lambda rows: rows[:, 1:], "has no column position_FR_hip_joint; expected time"),
        (lambda rows: rows[:600], "has 3.0 s; expected 5 s or more"),
        (lambda rows: rows[:1], "has no row of numbers; expected 5 s or more"),
        (lambda rows: rows[::10], "has 20 angles a second; expected 40 or more"),
        (lambda rows: rows[::100], "has 2 angles a second; expected 40 or more"),
        (lambda rows: rows[[0, *range(1600, 0, -1)]], "line 3: its times of angles do not ascend"),
        (lambda rows: _set(rows, slice(1, None), 4, "0.7"), "position of FL_thigh_joint moves by"),
        (lambda rows: _set(rows, slice(1, None), 12, "0"), "the target of FR_hip_joint moves by"),
        (lambda rows: _set(rows, 7, 3, "nan"), "line 8: expected a finite number in every column"),
        (lambda rows: _set(rows, 7, 3, "off"), "line 8: expected a finite number in every column"),
        (
            lambda rows: _set(rows, slice(700, 1000), 4, "0.7"),
            "line 701: the position of FL_thigh_joint stays at 0.7000 rad for 1.5 s in which its t",
        ),
        (
            lambda rows: _set(rows, slice(700, 1000), 16, rows[700, 16]),
            "line 701: the target of FL_thigh_joint stays at .* rad for 1.5 s in which its pos",
        ),
        (
            lambda rows: _scale(rows, slice(0, 24), 57.2957795),
            "line 2: the position of FR_thigh_joint is 44.* rad, beyond its limits of -2.09 and 4.1"
            "9; .* these look like degrees",
        ),
        (
            lambda rows: _scale(rows, slice(12, 24), 57.2957795),
            "line 2: the target of FR_thigh_joint is 45.84 rad, .* these look like degrees",
        ),
        (
            lambda rows: _set(rows, slice(900, 905), 2, f"{float(rows[900, 2]) + 2 * np.pi:.6f}"),
            "line 901: the position of FR_calf_joint jumps by 2 pi",
        ),
        (
            lambda rows: _set(rows, slice(900, 905), 14, f"{float(rows[900, 14]) + 6.28:.6f}"),
            "line 901: the target of FR_calf_joint jumps by 2 pi",
        ),
        (
            lambda rows: _set(rows, 900, 1, "0"),
            "line 901: the position of FR_thigh_joint jumps by [01].[0-9]+ rad; expected 50 rad/s",
        ),
    ],
)
def test_a_log_that_shows_nothing_is_one_line(rewrite, quadruped, change, message):
    file = rewrite(change)
    with pytest.raises(UserError, match=f"^{file}.*{message}"):
        read_log(file, quadruped.joints, quadruped.lower, quadruped.upper)


def test_decimal_commas_between_commas_are_named(rewrite, quadruped):
    file = rewrite(decimal=",")
    message = "line 2: has 50 values for 25 columns; expected decimal points, or semicolons between"
    with pytest.raises(UserError, match=message):
        read_log(file, quadruped.joints)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ([], "expected either a log, or --targets FILE"),
        (["log.csv", "--fit", "kd", "damping"], "a log shows only their sum"),
        (["log.mcap"], "cannot read log.mcap: No such file or directory"),
        ([__file__, "--robot.urdf", "no.urdf"], "no.urdf: cannot be read"),
    ],
)
def test_what_cannot_be_is_one_line(args, message, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=message):
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
