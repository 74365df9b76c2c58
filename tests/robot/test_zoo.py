"""Every URDF of PyPI's example-robot-data."""

import mujoco
import pytest

from benchmarks.pinocchio_oracle import Pinocchio
from quadwalk.robot.mjcf import Options, convert, write_xml
from quadwalk.robot.quadruped import legs_of, load_quadruped, with_motors
from quadwalk.robot.urdf import UrdfError, read_urdf
from tests.robot import zoo
from tests.robot.robots import check_dynamics, stays_up

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


@zoo.each(zoo.FILES)
def test_converts_exactly_or_is_refused(urdf):
    if urdf.stem in REFUSED:
        with pytest.raises(UrdfError) as raised:
            read_urdf(urdf)
        assert ("--repair-inertia" in str(raised.value)) == REFUSED[urdf.stem]
        if REFUSED[urdf.stem]:
            convert(read_urdf(urdf, repair_inertia=True), options=NO_MESHES).spec.compile()
        return
    read = read_urdf(urdf)
    if urdf in zoo.QUADRUPEDS:
        legs = legs_of(read, NO_MESHES)
        feet = {f"position of {leg.foot_name}" for leg in legs}
        check_dynamics(read, convert(read, legs, NO_MESHES).spec, feet)
        return
    xml = write_xml(convert(read, options=NO_MESHES).spec)
    errors = Pinocchio(read, mujoco.MjModel.from_xml_string(xml)).errors(10)
    assert max(errors.values()) < 1e-5, errors


@zoo.each([file for file in zoo.FILES if file.stem not in REFUSED])
def test_quadrupeds_are_recognized_and_nothing_else_is(urdf):
    read = read_urdf(urdf)
    if urdf in zoo.QUADRUPEDS:
        with_motors(read, legs_of(read, NO_MESHES), NO_MESHES)
    else:
        with pytest.raises(UrdfError, match="a quadruped has four of three joints each"):
            legs_of(read, NO_MESHES)


@zoo.each(zoo.QUADRUPEDS)
def test_quadrupeds_stand_upright_on_their_feet(urdf):
    quadruped = load_quadruped(urdf, NO_MESHES)
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
        ahead = leg[0] == "R" and zoo.KNEES_AHEAD[urdf.parts[-3]]
        assert (data.xpos[calf, 0] > data.xpos[thigh, 0]) == ahead
    stays_up(quadruped, 2, 0.85)
