"""Every URDF of PyPI's example-robot-data, where it is installed; else these tests are skipped."""

import mujoco
import numpy as np
import pytest

from quadwalk.robot.mjcf import Options, convert, write_xml
from quadwalk.robot.quadruped import legs_of, load_quadruped, with_motors
from quadwalk.robot.urdf import UrdfError, read_urdf

NO_MESHES = Options(meshes=False)
# Refused, for a reason that docs/zoo.md gives; True where --repair-inertia mends it.
REFUSED = {
    "alex_psyonic_hands": False,
    "allegro_left_hand": True,
    "allegro_right_hand": True,
    "pr2": True,
    "romeo": True,
    "romeo_laas_small": True,
    "romeo_small": True,
    "ur3": False,
}
# By folder: whether the knees of the hind legs point ahead.
QUADRUPEDS = {
    "a1_description": False,
    "anymal_b_simple_description": True,
    "anymal_c_simple_description": True,
    "b1_description": False,
    "go1_description": False,
    "go2_description": False,
    "hyq_description": True,
    "laikago_description": False,
    "solo_description": False,
}


def is_quadruped(file) -> bool:
    return file.parts[-3] in QUADRUPEDS and file.stem not in ("anymal-kinova", "b1-z1", "solo")


def test_converts_exactly_or_is_refused(pinocchio, zoo_urdf):
    if zoo_urdf.stem in REFUSED:
        with pytest.raises(UrdfError) as raised:
            read_urdf(zoo_urdf)
        assert ("--repair-inertia" in str(raised.value)) == REFUSED[zoo_urdf.stem]
        if not REFUSED[zoo_urdf.stem]:
            return
        convert(read_urdf(zoo_urdf, repair_inertia=True), options=NO_MESHES).spec.compile()
        return
    urdf = read_urdf(zoo_urdf)
    legs = legs_of(urdf, NO_MESHES) if is_quadruped(zoo_urdf) else ()
    xml = write_xml(convert(urdf, legs, NO_MESHES).spec)
    errors = pinocchio(urdf, mujoco.MjModel.from_xml_string(xml)).errors(10)
    assert max(errors.values()) < 1e-5, errors


def test_quadrupeds_are_recognised_and_nothing_else_is(zoo_urdf):
    if zoo_urdf.stem in REFUSED:
        pytest.skip("refused")
    urdf = read_urdf(zoo_urdf)
    if is_quadruped(zoo_urdf):
        with_motors(urdf, legs_of(urdf, NO_MESHES), NO_MESHES)
    else:
        with pytest.raises(UrdfError, match="a quadruped has four of three joints each"):
            legs_of(urdf, NO_MESHES)


def test_quadrupeds_stand_upright_on_their_feet(zoo_urdf):
    if not is_quadruped(zoo_urdf):
        pytest.skip("no quadruped")
    quadruped = load_quadruped(zoo_urdf, NO_MESHES)
    assert ((quadruped.lower <= quadruped.home[7:]) & (quadruped.home[7:] <= quadruped.upper)).all()
    model = quadruped.full_model()
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    mujoco.mj_kinematics(model, data)
    for i, leg in enumerate(quadruped.legs):
        thigh, calf = (model.joint(n).bodyid[0] for n in quadruped.joints[3 * i + 1 : 3 * i + 3])
        foot = data.site(quadruped.feet[i]).xpos
        # Under the thigh's joint, and the knee on the side that the structure says.
        assert abs(foot[0] - data.xpos[thigh, 0]) < 0.04
        ahead = leg[0] == "R" and QUADRUPEDS[zoo_urdf.parts[-3]]
        assert (data.xpos[calf, 0] > data.xpos[thigh, 0]) == ahead
    stiffness = 1.4 * model.body_subtreemass[0] * 9.81 * quadruped.home[2]
    while data.time < 2:
        away = quadruped.home[7:] - data.qpos[7:]
        torque = stiffness * (away - 0.025 * data.qvel[6:])
        data.ctrl = np.clip(torque, -quadruped.effort, quadruped.effort)
        mujoco.mj_step(model, data)
    assert data.qpos[2] > 0.85 * quadruped.home[2]
    assert data.qpos[3] > np.cos(np.radians(5) / 2)
