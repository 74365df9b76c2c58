"""Drive the robot with policy.onnx in MuJoCo C: python run_policy.py [--command 1 0 0] [--view].

Needs numpy, mujoco and onnxruntime, and controller.py, policy.onnx and robot.xml beside it. Where
getup.onnx is there too, that policy gets a fallen robot up.
"""

import argparse
import json
import time
from pathlib import Path

import mujoco
import numpy as np
from controller import Controller, read_list, to_matrix

TIMESTEP = 0.002  # s, of physics
# The robot has fallen when its trunk is tilted by more than this, or is lower than this share of
# its height at the start.
FALLEN_TILT = np.radians(60)
FALLEN_HEIGHT = 0.4
# It stands again when its trunk has been tilted by less, and been higher, for this long.
STANDING_TILT = np.radians(18)
STANDING_HEIGHT = 0.85
STANDING_TIME = 0.5  # s
COLUMNS = ("time", "qpos", "qvel", "obs", "action", "target", "command")


class Simulation:
    """The robot in MuJoCo C, driven by a policy, and by getup.onnx where it has fallen."""

    def __init__(self, folder: Path, command: list) -> None:
        self.driver = Controller(folder / "policy.onnx")
        self.riser = None
        if (folder / "getup.onnx").exists():
            self.riser = Controller(folder / "getup.onnx")
        self.controller = self.driver
        self.about = self.driver.about
        self.command = self.clip_command(command)

        self.period = float(self.about["control_period"])
        self.substeps = max(1, round(self.period / TIMESTEP))
        self.model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
        self.model.opt.timestep = self.period / self.substeps
        self.model.dof_frictionloss[:] = 0.0  # the controller's torque contains it
        self.data = mujoco.MjData(self.model)
        self.start = np.array(read_list(self.about["start_qpos"]), float)
        self.data.qpos[:] = self.start

        self.standing_time = 0.0  # s
        self.rises = 0
        self.rows: list[tuple] = []  # the values of COLUMNS in each control step

    def clip_command(self, command: list) -> np.ndarray:
        """Return `command` within the ranges of training; zeros for a policy without commands."""
        ranges = list(json.loads(self.about["command_ranges"]).values())
        if not ranges:
            return np.zeros(3)
        lower, upper = np.transpose(ranges)
        return np.clip(command, lower, upper)

    def get_pose(self) -> tuple:
        """Return the cosine of the trunk's tilt, and its height as a share of its first height."""
        cosine = to_matrix(self.data.qpos[3:7])[2, 2]
        height = self.data.qpos[2] / self.start[2]
        return cosine, height

    def has_fallen(self) -> bool:
        """Return True if the trunk leans beyond `FALLEN_TILT` or is below `FALLEN_HEIGHT`."""
        cosine, height = self.get_pose()
        return cosine < np.cos(FALLEN_TILT) or height < FALLEN_HEIGHT

    def choose_controller(self) -> None:
        """Switch to getup.onnx, if there, after a fall; back once the robot has stood a while."""
        if self.riser is None:
            return
        if self.controller is self.driver:
            if self.has_fallen():
                self.controller = self.riser
                self.riser.restart()
                self.standing_time = 0.0
            return
        cosine, height = self.get_pose()
        if cosine > np.cos(STANDING_TILT) and height > STANDING_HEIGHT:
            self.standing_time += self.period
        else:
            self.standing_time = 0.0
        if self.standing_time > STANDING_TIME:
            self.controller = self.driver
            self.driver.restart()
            self.rises += 1

    def step(self) -> None:
        """Take one control step and record it."""
        self.choose_controller()
        data = self.data
        start_time = data.time
        qpos = data.qpos.copy()
        qvel = data.qvel.copy()
        target = self.controller.compute_targets(qpos, qvel, self.command)
        obs = self.controller.obs
        if self.controller is self.riser:
            size = self.driver.session.get_inputs()[0].shape[1]
            obs = np.full(size, np.nan)  # policy.onnx observes nothing while the other one acts
        action = self.controller.action
        self.rows.append((start_time, qpos, qvel, obs, action, target, self.command))
        for _ in range(self.substeps):
            torque = self.controller.compute_torque(target, data.qpos, data.qvel)
            data.qfrc_applied[6:] = torque
            mujoco.mj_step(self.model, data)

    def save(self, file: str) -> None:
        """Write all recorded control steps to an NPZ file, an array for each name of COLUMNS."""
        columns: dict = {}
        for index, name in enumerate(COLUMNS):
            columns[name] = np.array([row[index] for row in self.rows])
        np.savez(file, **columns)

    def summarize(self, fell: bool) -> str:
        """Return a line with mean speed along x, time, drift to the left, and falls."""
        x, y = self.data.qpos[:2] - self.start[:2]
        seconds = self.data.time
        end = "no fall"
        if fell:
            end = "fell"
        elif self.rises == 1:
            end = "got up once"
        elif self.rises > 1:
            end = f"got up {self.rises} times"
        return (
            f"{self.about['robot']}, {self.about['task']}: {x / seconds:.3f} m/s along x "
            f"for {seconds:.2f} s, {y:.2f} m to the left, {end}"
        )


def parse_options() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--seconds", type=float, default=20.0)
    add("--command", type=float, nargs=3, default=[1, 0, 0], help="m/s ahead and left, rad/s left")
    add("--fallen", action="store_true", help="begin on its back, for getup.onnx")
    add("--view", action="store_true", help="show it in MuJoCo's viewer, in real time")
    add("--save", metavar="NPZ", help="write time, qpos, qvel, obs, action, target and command")
    return parser.parse_args()


def main() -> None:
    """Run the robot until the time is over, the viewer is closed, or it falls for good.

    A fall is for good without getup.onnx.
    """
    options = parse_options()
    simulation = Simulation(Path(__file__).resolve().parent, options.command)
    data = simulation.data
    if options.fallen:
        data.qpos[3:7] = 0, 1, 0, 0
    viewer = None
    if options.view:
        import mujoco.viewer  # only here: it needs a screen

        viewer = mujoco.viewer.launch_passive(simulation.model, data)

    began = time.time()
    fell = False
    while data.time < options.seconds - 1e-6 and not fell:
        if viewer is not None and not viewer.is_running():
            break
        simulation.step()
        fell = simulation.riser is None and simulation.has_fallen()
        if viewer is not None:
            viewer.sync()
            time.sleep(max(0.0, began + data.time - time.time()))

    print(simulation.summarize(fell))
    if options.save:
        simulation.save(options.save)


if __name__ == "__main__":
    main()
