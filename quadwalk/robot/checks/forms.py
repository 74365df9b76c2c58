"""What each element of a URDF may hold."""

from dataclasses import dataclass

JOINT_TYPES = ("revolute", "continuous", "prismatic", "planar", "floating", "fixed")
SHAPES = ("box", "sphere", "cylinder", "capsule", "mesh")


@dataclass(frozen=True)
class Form:
    """What an element may hold."""

    need: tuple[str, ...] = ()  # attributes that must be there
    may: tuple[str, ...] = ()  # attributes that may be there
    one: tuple[str, ...] = ()  # child elements that must be there once
    most_one: tuple[str, ...] = ()  # child elements that may be there once
    many: tuple[str, ...] = ()  # child elements that may be repeated
    first: tuple[str, ...] = ()  # those of `many` of which only the first counts
    ignored: tuple[str, ...] = ()  # of other tools; their numbers must be numbers nevertheless
    sizes: tuple[str, ...] = ()  # attributes that are lengths above 0
    not_negative: tuple[str, ...] = ()  # attributes that are 0 or more


_LIMITS = ("effort", "velocity")
_DYNAMICS = ("damping", "friction", "armature")
# http://wiki.ros.org/urdf/XML; `ignored` is what PyBullet, Gazebo and older ROS files add.
FORMS = {
    "link": Form(
        need=("name",),
        most_one=("inertial",),
        many=("visual", "collision"),
        ignored=("contact", "audio_source", "self_collision_checking", "concave", "gazebo"),
    ),
    "joint": Form(
        need=("name", "type"),
        one=("parent", "child"),
        most_one=("origin", "axis", "limit", "dynamics", "mimic"),
        ignored=("joint_properties", "safety_controller", "calibration", "gazebo"),
    ),
    "inertial": Form(one=("mass", "inertia"), most_one=("origin",)),
    "visual": Form(
        may=("name",),
        one=("geometry",),
        most_one=("origin",),
        many=("material",),
        first=("material",),
    ),
    "collision": Form(
        may=("name",),
        one=("geometry",),
        most_one=("origin",),
        ignored=("material", "group", "mask", "concave", "verbose", "contact_coefficients"),
    ),
    "geometry": Form(most_one=SHAPES),
    "origin": Form(may=("xyz", "rpy", "quat_xyzw")),
    "mass": Form(need=("value",), not_negative=("value",)),
    "inertia": Form(need=("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "parent": Form(need=("link",)),
    "child": Form(need=("link",)),
    "axis": Form(need=("xyz",)),
    "limit": Form(may=(*_LIMITS, "lower", "upper"), not_negative=_LIMITS),
    "dynamics": Form(may=_DYNAMICS, not_negative=_DYNAMICS),
    "mimic": Form(need=("joint",), may=("multiplier", "offset")),
    "box": Form(need=("size",), sizes=("size",)),
    "sphere": Form(need=("radius",), sizes=("radius",)),
    "cylinder": Form(need=("radius", "length"), sizes=("radius", "length")),
    "capsule": Form(need=("radius", "length"), sizes=("radius", "length")),
    "mesh": Form(need=("filename",), may=("scale",)),
    "material": Form(
        may=("name",), most_one=("color", "texture"), ignored=("specular", "ambient", "emissive")
    ),
    "color": Form(need=("rgba",)),
    "texture": Form(may=("filename",)),
    # MuJoCo's extension, of which only the folder of meshes is read.
    "mujoco": Form(many=("compiler",)),
    "compiler": Form(may=("meshdir",)),
}
TEXT_ATTRIBUTES = frozenset({"name", "type", "link", "joint", "filename", "meshdir"})
LENGTHS = {"xyz": 3, "rpy": 3, "quat_xyzw": 4, "size": 3, "rgba": 4, "scale": 3}
# Where a joint's or a link's physics belongs: the element, and its attribute. Files that have it
# one level too high or too low would lose it.
MISPLACED = {
    "joint": {
        "axis": ("axis", ""),
        "limit": ("limit", ""),
        "lower": ("limit", "lower"),
        "upper": ("limit", "upper"),
        "min": ("limit", "lower"),
        "max": ("limit", "upper"),
        "effort": ("limit", "effort"),
        "velocity": ("limit", "velocity"),
        "dynamics": ("dynamics", ""),
        "damping": ("dynamics", "damping"),
        "friction": ("dynamics", "friction"),
        "armature": ("dynamics", "armature"),
    },
    "link": {"mass": ("inertial/mass", ""), "inertia": ("inertial/inertia", "")},
}
