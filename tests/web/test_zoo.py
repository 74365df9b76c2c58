"""Published robots with meshes: light enough for a phone, and the page's MuJoCo loads them."""

import gzip

import mujoco

from quadwalk.robot.mjcf import write_xml
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.web.decimate import MOST_FACES, decimate_visuals
from tests.robot import zoo


@zoo.repeat_for(zoo.QUADRUPEDS, "a1", "go2", "hyq")
def test_a_published_robot_loads_in_the_page(urdf, run_node, tmp_path):
    spec, _ = decimate_visuals(load_quadruped(urdf).spec)
    file = tmp_path / "robot.xml"
    file.write_text(write_xml(spec))
    assert len(gzip.compress(file.read_bytes())) < 600_000
    (sizes,) = run_node({"models": [str(file)]})
    model = mujoco.MjModel.from_xml_path(str(file))
    assert sizes["nq"] == model.nq == 19
    assert sizes["ngeom"] == model.ngeom
    visuals = {geom.meshname for geom in spec.geoms if not geom.contype}
    faces = sum(len(mesh.userface) // 3 for mesh in spec.meshes if mesh.name in visuals)
    assert faces <= MOST_FACES
