"""How high ground is, by MuJoCo's own rays."""

import mujoco
import numpy as np


def heights_by_rays(model: mujoco.MjModel, points: np.ndarray) -> list[float]:
    """m, of the heightfield that a model's floor is, at `points` (n, 2), m."""
    data = mujoco.MjData(model)
    data.qpos[2] = 10.0  # out of the way
    mujoco.mj_kinematics(model, data)
    floor, down = model.geom("floor").id, np.array([0.0, 0.0, -1.0])
    return [
        5.0 - mujoco.mj_rayHfield(model, data, floor, np.array([*point, 5.0]), down, None)
        for point in points
    ]
