"""Joint targets to play on a robot on its stand, from which its joints can be identified."""

import csv
import io
from pathlib import Path

import numpy as np

from quadwalk.files import open_atomic
from quadwalk.robot.load import load_robot
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.training import RobotConfig

SECONDS = 30.0
RATE = 200  # targets a second
RAMP = 2.0  # s from the home pose to full motion, and back at the end
SWING = (0.25, 0.4, 0.4)  # rad from the home pose at most: hip, thigh, calf
_ROOM = 0.8  # share of the way to a joint's limits that is used at most
# Hz: slow enough for friction to show, fast enough for inertia. Each in all parts of the log.
_FREQUENCIES = np.geomspace(0.2, 5.0, 9)


def make_targets(quadruped: Quadruped) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,), s, and joint targets (n, 12), rad: sums of sines about the home pose."""
    time = np.arange(round(SECONDS * RATE) + 1) / RATE
    rng = np.random.default_rng(0)  # always the same
    phase = rng.uniform(0.0, 2 * np.pi, (len(_FREQUENCIES), 12))
    detuned = _FREQUENCIES[:, None] * rng.uniform(0.9, 1.1, (len(_FREQUENCIES), 12))
    waves = np.sin(2 * np.pi * detuned * time[:, None, None] + phase) / detuned
    shape = waves.sum(axis=1)
    home = quadruped.home[7:]
    room = _ROOM * np.minimum(quadruped.upper - home, home - quadruped.lower)
    shape *= np.minimum(np.tile(SWING, 4), room) / np.abs(shape).max(axis=0)
    ramp = np.clip(np.minimum(time, SECONDS - time) / RAMP, 0.0, 1.0)[:, None]
    return time, home + ramp**2 * (3 - 2 * ramp) * shape


def write_targets(path: Path, robot: RobotConfig) -> None:
    """Write the targets of `robot` as a CSV: `time` and `target_JOINT` of each joint."""
    quadruped = load_robot(robot)
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["time", *(f"target_{joint}" for joint in quadruped.joints)])
    for time, targets in zip(*make_targets(quadruped), strict=True):
        rows.writerow([f"{time:.3f}", *(f"{target:.5f}" for target in targets)])
    with open_atomic(path) as file:
        file.write(text.getvalue().encode())
    print(f"written to {path}: play it on the robot on its stand, slowly at first")
