"""Every URDF of PyPI's example-robot-data."""

import mujoco
import pytest

from benchmarks.pinocchio_oracle import Pinocchio
from quadwalk.robot.mjcf import Options, convert, write_xml
from quadwalk.robot.quadruped import find_quadruped, load_quadruped
from quadwalk.robot.report import UrdfError
from quadwalk.robot.urdf import read_urdf
from tests.robot import zoo
from tests.robot.robots import check_dynamics, check_stands, make_data, measure_knees

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


@zoo.repeat_for(zoo.FILES)
def test_converts_exactly_as_a_quadruped_or_not_or_is_refused(urdf):
    if urdf.stem in REFUSED:
        with pytest.raises(UrdfError) as raised:
            read_urdf(urdf)
        assert ("--robot.repair-inertia" in str(raised.value)) == REFUSED[urdf.stem]
        if REFUSED[urdf.stem]:
            convert(read_urdf(urdf, repair_inertia=True), options=NO_MESHES).spec.compile()
        return
    read = read_urdf(urdf)
    if urdf in zoo.QUADRUPEDS:
        faced, legs = find_quadruped(read, NO_MESHES)
        assert faced.text == read.text  # they have x ahead and z up
        feet = {f"position of {leg.foot_name}" for leg in legs}
        check_dynamics(read, convert(read, legs, NO_MESHES).spec, feet)
        return
    with pytest.raises(UrdfError, match="a quadruped has four of three joints each"):
        find_quadruped(read, NO_MESHES)
    xml = write_xml(convert(read, options=NO_MESHES).spec)
    errors = Pinocchio(read, mujoco.MjModel.from_xml_string(xml)).compute_errors(10)
    assert max(errors.values()) < 1e-5, errors


@zoo.repeat_for(zoo.QUADRUPEDS)
def test_quadrupeds_stand_upright_on_their_feet(urdf):
    quadruped = load_quadruped(urdf, NO_MESHES)
    assert ((quadruped.lower <= quadruped.home[7:]) & (quadruped.home[7:] <= quadruped.upper)).all()
    data = make_data(quadruped.make_full_model(), quadruped.home)
    # Feet under the thighs' joints, and knees on the side that the structure says.
    for thigh, foot in zip(quadruped.joints[1::3], quadruped.feet, strict=True):
        assert abs(data.site(foot).xpos[0] - data.joint(thigh).xanchor[0]) < 0.04
    for leg, ahead in measure_knees(quadruped).items():
        assert (ahead > 0) == (leg[0] == "R" and zoo.KNEES_AHEAD[urdf.parts[-3]])
    check_stands(quadruped, 2, 0.85)
