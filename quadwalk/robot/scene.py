"""What surrounds a robot in its MJCF: sky, light, a floor on which motion can be seen."""

import mujoco
import numpy as np

# Rubber feet on asphalt or carpet slide at .6 to 1.0 of the load; MuJoCo takes the larger of two
# shapes' friction, so that floor and robot both state it.
FRICTION = 0.8

# Contacts settle within this, s, half of MuJoCo's default, under which the feet of a robot at 4 m/s
# sink 2 cm into the floor at each landing. It must be at least two physics steps.
CONTACT_TIME = 0.01


def add_scene(spec: mujoco.MjSpec) -> None:
    """Add the sky, ambient light, and the plane named `floor` at height 0 to `spec`."""
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.45, 0.45, 0.45]
    spec.visual.headlight.specular = [0.1, 0.1, 0.1]
    spec.visual.rgba.haze = [0.75, 0.82, 0.9, 1]
    spec.visual.global_.offwidth = 1920
    spec.visual.global_.offheight = 1080
    # A small shadow map around the robot, lit from nearly overhead: a wide or slanted one speckles
    # the floor with its own shadow.
    spec.visual.quality.shadowsize = 4096
    spec.visual.map.shadowclip = 0.6
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.55, 0.7, 0.88],
        rgb2=[0.93, 0.95, 0.97],
        width=256,
        height=1536,
    )
    spec.add_texture(
        name="checker",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.52, 0.56, 0.6],
        rgb2=[0.6, 0.64, 0.68],
        mark=mujoco.mjtMark.mjMARK_EDGE,
        markrgb=[0.72, 0.75, 0.78],
        width=512,
        height=512,
    )
    floor = spec.add_material(name="floor", texuniform=True, texrepeat=[2, 2], reflectance=0.08)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "checker"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        material="floor",
        friction=[FRICTION, 0.005, 0.0001],
        solref=[CONTACT_TIME, 1.0],
    )


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
