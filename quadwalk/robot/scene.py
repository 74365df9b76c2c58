"""Parts of a model besides a robot's links: sky, light, floor, home pose, spheres for training."""

from typing import Literal

import mujoco
import numpy as np

from quadwalk.robot.structure.legs import LEGS

HOME = "home"  # the keyframe: joints in the standing pose, the lowest point just on the ground

# Rubber feet on asphalt or carpet slide at 0.6 to 1.0 of the load; MuJoCo takes the larger of two
# shapes' friction, so that floor and robot both state it.
FRICTION = 0.8

# Contacts settle within this, s, half of MuJoCo's default, under which the feet of a robot at 4 m/s
# sink 2 cm into the floor at each landing. It must be at least two physics steps.
CONTACT_TIME = 0.01

# The physics of training lets one sphere of each kind of each leg touch the floor. Besides the
# feet, these stand for what else meets it: knees, the trunk's lower and upper corners, hips.
SPHERE_NAMES = tuple(
    tuple(f"{kind}_{leg}" for leg in LEGS) for kind in ("knee", "corner", "top", "hip")
)
# What touches the floor, besides the feet, by the setting `env.contacts`.
Contacts = Literal["feet", "knees", "body", "all"]
TOUCHING: dict[Contacts, int] = {"feet": 0, "knees": 1, "body": 2, "all": 4}  # first kinds
# Groups of geoms; MuJoCo's viewer hides 3 and above.
VISUAL_GROUP, COLLISION_GROUP, SPHERE_GROUP = 2, 3, 4
CORNER_RADIUS = 0.01  # m
LEAN = np.radians(60)  # of a calf from the vertical; standing robots have some 45 degrees


# A small shadow map around the robot, lit from nearly overhead: a wide or slanted one speckles the
# floor with its own shadow. OpenGL moves shadows down by a share of the depth that is drawn. At
# MuJoCo's zfar of 50 that is too little for the floor; the haze begins where it did.
# Feet have sliding friction alone: small and hard, they hardly resist torsion and rolling.
_SCENE = f"""\
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002"/>
  <size nuser_jnt="1"/>
  <visual>
    <headlight ambient="0.35 0.35 0.35" diffuse="0.45 0.45 0.45" specular="0.1 0.1 0.1"/>
    <rgba haze="0.75 0.82 0.9 1"/>
    <global offwidth="1920" offheight="1080"/>
    <quality shadowsize="4096"/>
    <map shadowclip="0.6" zfar="80" haze="0.55"/>
  </visual>
  <default>
    <default class="visual">
      <geom contype="0" conaffinity="0" group="{VISUAL_GROUP}"/>
    </default>
    <default class="collision">
      <geom group="{COLLISION_GROUP}" rgba="0.9 0.3 0.3 0.5"
        friction="{FRICTION} 0.005 0.0001" solref="{CONTACT_TIME} 1"/>
      <default class="foot">
        <geom condim="3"/>
      </default>
    </default>
  </default>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" width="256" height="1536"
      rgb1="0.55 0.7 0.88" rgb2="0.93 0.95 0.97"/>
    <texture name="checker" type="2d" builtin="checker" width="512" height="512"
      rgb1="0.52 0.56 0.6" rgb2="0.6 0.64 0.68" mark="edge" markrgb="0.72 0.75 0.78"/>
    <material name="floor" texture="checker" texuniform="true" texrepeat="2 2" reflectance="0.08"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 0.05" material="floor"
      friction="{FRICTION} 0.005 0.0001" solref="{CONTACT_TIME} 1"/>
  </worldbody>
</mujoco>
"""


def make_spec() -> mujoco.MjSpec:
    """Return a spec of sky, ambient light and floor, with the default classes of a robot's geoms.

    The floor is the plane named `floor` at height 0. Classes are `visual`, `collision`, and within
    that `foot`.
    """
    spec = mujoco.MjSpec.from_string(_SCENE)
    for name in ("visual", "collision", "foot"):
        # Else MuJoCo's errors on a robot's shapes name a line of the scene.
        spec.find_default(name).geom.info = ""
    return spec


def add_sun(body: mujoco.MjsBody) -> None:
    """Add a light that travels with `body`, so that its shadow is drawn wherever it goes."""
    direction = np.array([0.05, 0.08, -1.0])
    body.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM,
        pos=-3 * direction,
        dir=direction,
        diffuse=[0.65, 0.63, 0.6],
        specular=[0.2, 0.2, 0.2],
        castshadow=True,
    )


def add_home(spec: mujoco.MjSpec, pose: np.ndarray | None, feet: list[str]) -> None:
    """Add the keyframe `home` to `spec`, which has all bodies, and collision geoms with names.

    `pose`, rad, are joint positions in the model's order; None: 0 or the limit nearest to it.
    `feet` name the geoms to stand on; without any, the lowest shape is.
    """
    model = spec.compile()
    floating = model.njnt > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    qpos = model.qpos0.copy()
    if pose is not None:
        qpos[7:] = pose
    else:
        limited = model.jnt_limited.astype(bool)
        qpos[model.jnt_qposadr[limited]] = np.clip(0, *model.jnt_range[limited].T)
    for row in range(model.neq):  # a joint that follows another
        follower, leader = model.eq_obj1id[row], model.eq_obj2id[row]
        offset, factor = model.eq_data[row, :2]
        at = model.jnt_qposadr
        leader_angle = qpos[at[leader]] if leader >= 0 else 0.0  # by a joint that is fixed
        qpos[at[follower]] = offset + factor * leader_angle
    if floating:
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        shapes = [model.geom(foot).id for foot in feet] or np.flatnonzero(model.geom_bodyid > 0)
        qpos[2] -= min((find_lowest_point(model, data, int(geom)) for geom in shapes), default=0.0)
    spec.add_key(name=HOME, qpos=qpos)


def exclude_overlaps(spec: mujoco.MjSpec) -> list[str]:
    """Exclude contacts of bodies that overlap in the home pose, and return the pairs for a report.

    A floating robot's contact with the floor stays.
    """
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    floating = model.njnt > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    overlapping = {
        tuple(sorted(model.geom_bodyid[contact.geom]))
        for contact in data.contact
        if contact.dist < 0 and (not floating or model.geom_bodyid[contact.geom].all())
    }
    pairs = [(model.body(a).name, model.body(b).name) for a, b in sorted(overlapping)]
    for first, second in pairs:
        spec.add_exclude(name=f"{first}-{second}", bodyname1=first, bodyname2=second)
    return [f"'{first}' and '{second}'" for first, second in pairs]


def find_lowest_point(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Find the height (m, world z) of a geom's lowest point by the kinematics in `data`."""
    size = model.geom_size[geom]
    # The direction `down` in the geom's own axes: the shape's extent along it is its support.
    down = -data.geom_xmat[geom].reshape(3, 3)[2]
    kind = model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        extent = size[0]
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        extent = np.abs(down) @ size
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        extent = size[0] * np.hypot(down[0], down[1]) + size[1] * abs(down[2])
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        extent = size[0] + size[1] * abs(down[2])
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        extent = np.max(vertices @ down)
    else:
        raise AssertionError(f"no URDF shape becomes a geom of type {kind}")
    return float(data.geom_xpos[geom, 2] - extent)


def make_training_shapes(spec: mujoco.MjSpec, feet: tuple[str, ...]) -> None:
    """Turn a robot's shapes into those whose height over the floor training measures.

    Meshes become the boxes around them. What is beyond the center of a foot is the foot's, whose
    sphere stands for it: the calves' shapes end there, and thick ones before it.
    """
    model = spec.compile()
    foot_of = {model.geom_bodyid[model.geom(foot).id]: model.geom(foot) for foot in feet}
    for geom in spec.geoms:
        foot = foot_of.get(model.geom_bodyid[geom.id])
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            center, axes, half = _compute_box(model, geom.id)
            geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_BOX, ""
            geom.pos, geom.size = center, half
            mujoco.mju_mat2Quat(geom.quat, axes.ravel())
        if foot is not None and geom.name not in feet:
            _cut_at_foot(geom, foot.pos, foot.size[0])


def compute_rotation(quat: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) of a quaternion wxyz (4,)."""
    entries = np.zeros(9)
    mujoco.mju_quat2Mat(entries, quat)
    return entries.reshape(3, 3)


def _cut_at_foot(geom: mujoco.MjsGeom, foot: np.ndarray, radius: float) -> None:
    """Cut a box, or a cylinder or capsule along the calf, at the `foot` (3,), m, in its body.

    It ends at the foot's center, or above it if it is thick. Its edge is then half the foot's
    radius above the floor while the calf leans by `LEAN`: nearer, a step would be a fall.
    """
    axes = compute_rotation(geom.quat)
    along = int(np.argmax(np.abs(foot @ axes)))
    if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
        side = along
        reach = np.linalg.norm(np.delete(geom.size, along)) * np.sin(LEAN)
    elif geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER and along == 2:
        side = 1  # half the length; a cylinder's axis is z
        reach = geom.size[0] * np.sin(LEAN)
    elif geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE and along == 2:
        side = 1
        reach = geom.size[0]  # of the half sphere at the end, whichever way it leans
    else:
        return
    out = axes[:, along] * np.sign(foot @ axes[:, along])
    above = (reach - radius / 2) / np.cos(LEAN)
    beyond = (geom.pos - foot) @ out + geom.size[side] + max(above, 0.0)
    if 1e-6 < beyond < 2 * geom.size[side]:
        geom.size[side] -= beyond / 2
        geom.pos -= out * beyond / 2


def add_spheres(
    spec: mujoco.MjSpec,
    trunk: str,
    feet: tuple[str, ...],
    calf_joints: tuple[str, ...],
    contacts: Contacts,
) -> None:
    """Add the spheres of `contacts` at knees, hips and trunk, which meet the floor as feet do.

    A knee is centered on the calf's joint and carried by the thigh, as thick as that is there, up
    to the foot's radius. A hip is centered on the thigh's joint and carried by the hip, as thick as
    that is there. Corners and tops touch from within the box around the trunk's collision shapes,
    at its bottom and top. Links without shapes are as thick as the foot.
    `spec` has no other geoms than collision shapes.
    """
    model = spec.compile()
    low, high = _compute_body_box(model, model.body(trunk).id)
    for i, leg in enumerate(LEGS):
        foot = spec.geom(feet[i])
        calf = model.joint(calf_joints[i]).bodyid[0]
        thigh, knee = model.body_parentid[calf], model.body_pos[calf]
        hip, shoulder = model.body_parentid[thigh], model.body_pos[thigh]
        thigh_radius = min(_measure_thickness(model, thigh, knee), foot.size[0])
        hip_radius = _measure_thickness(model, hip, shoulder)
        if not np.isfinite(hip_radius):
            hip_radius = foot.size[0]
        ahead, left = leg[0] == "F", leg[1] == "L"
        bottom, top = (
            np.where([ahead, left, above], high - CORNER_RADIUS, low + CORNER_RADIUS)
            for above in (False, True)
        )
        spheres = (
            (thigh, knee, thigh_radius),
            (trunk, bottom, CORNER_RADIUS),
            (trunk, top, CORNER_RADIUS),
            (hip, shoulder, hip_radius),
        )
        kinds = SPHERE_NAMES[: TOUCHING[contacts]]
        for names, (body, center, radius) in zip(kinds, spheres, strict=False):
            spec.body(model.body(body).name).add_geom(
                foot.classname,
                name=names[i],
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                pos=center,
                size=[radius, 0, 0],
                group=SPHERE_GROUP,
                contype=foot.contype,
                conaffinity=foot.conaffinity,
                friction=foot.friction,
            )


def _compute_body_box(model: mujoco.MjModel, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper corner (3,), m, of the box around a body's shapes, in its frame.

    Without shapes it is around the joints below: a trunk has the hips at its corners.
    """
    boxes = _compute_boxes(model, body)
    if not boxes:
        hips = model.body_pos[model.body_parentid == body]
        return hips.min(axis=0), hips.max(axis=0)
    reaches = [(center, np.abs(rotation) @ half) for center, rotation, half in boxes]
    low = np.min([center - reach for center, reach in reaches], axis=0)
    return low, np.max([center + reach for center, reach in reaches], axis=0)


def _measure_thickness(model: mujoco.MjModel, body: int, point: np.ndarray) -> float:
    """Return half the thickness, m, of the body's shape nearest to `point` (3,); inf for none."""
    shapes = []
    for center, rotation, half in _compute_boxes(model, body):
        beyond = np.maximum(np.abs((point - center) @ rotation) - half, 0)
        shapes.append((float(np.linalg.norm(beyond)), float(np.sort(half)[1])))
    return min(shapes, default=(0.0, np.inf))[1]


def _compute_boxes(model: mujoco.MjModel, body: int) -> list[tuple[np.ndarray, ...]]:
    return [_compute_box(model, int(geom)) for geom in np.flatnonzero(model.geom_bodyid == body)]


def _compute_box(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, ...]:
    """Return the box around a shape in its body's frame: center, axes (columns), half sides, m."""
    rotation = compute_rotation(model.geom_quat[geom])
    center, half = np.split(model.geom_aabb[geom].copy(), 2)
    return model.geom_pos[geom] + rotation @ center, rotation, half
