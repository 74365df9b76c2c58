"""The elements of URDF, and what each may hold."""

from dataclasses import dataclass

JOINT_TYPES = ("revolute", "continuous", "prismatic", "planar", "floating", "fixed")
SHAPES = ("box", "sphere", "cylinder", "capsule", "mesh")


@dataclass(frozen=True)
class Form:
    """Attributes and child elements of an element."""

    required: tuple[str, ...] = ()  # attributes that must be there
    optional: tuple[str, ...] = ()  # attributes that may be there
    one: tuple[str, ...] = ()  # child elements that must be there once
    most_one: tuple[str, ...] = ()  # child elements that may be there once
    many: tuple[str, ...] = ()  # child elements that may be repeated
    ignored: tuple[str, ...] = ()  # of other tools; their numbers must be numbers nevertheless
    sizes: tuple[str, ...] = ()  # attributes that are lengths above 0
    not_negative: tuple[str, ...] = ()  # attributes that are 0 or more

    @property
    def attributes(self) -> tuple[str, ...]:
        """All attributes."""
        return self.required + self.optional

    @property
    def children(self) -> tuple[str, ...]:
        """All child elements."""
        return self.one + self.most_one + self.many


_LIMITS = ("effort", "velocity")
_DYNAMICS = ("damping", "friction", "armature")
# http://wiki.ros.org/urdf/XML; `ignored` is what PyBullet, Gazebo and older ROS files add.
FORMS = {
    "robot": Form(many=("link", "joint", "material", "mujoco")),
    "link": Form(
        required=("name",),
        most_one=("inertial",),
        many=("visual", "collision"),
        ignored=("contact", "audio_source", "self_collision_checking", "concave", "gazebo"),
    ),
    "joint": Form(
        required=("name", "type"),
        one=("parent", "child"),
        most_one=("origin", "axis", "limit", "dynamics", "mimic"),
        ignored=("joint_properties", "safety_controller", "calibration", "gazebo"),
    ),
    "inertial": Form(one=("mass", "inertia"), most_one=("origin",)),
    "visual": Form(optional=("name",), one=("geometry",), most_one=("origin",), many=("material",)),
    "collision": Form(
        optional=("name",),
        one=("geometry",),
        most_one=("origin",),
        ignored=("material", "group", "mask", "concave", "verbose", "contact_coefficients"),
    ),
    "geometry": Form(most_one=SHAPES),
    "origin": Form(optional=("xyz", "rpy", "quat_xyzw")),
    "mass": Form(required=("value",), not_negative=("value",)),
    "inertia": Form(required=("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "parent": Form(required=("link",)),
    "child": Form(required=("link",)),
    "axis": Form(required=("xyz",)),
    "limit": Form(optional=(*_LIMITS, "lower", "upper"), not_negative=_LIMITS),
    "dynamics": Form(optional=_DYNAMICS, not_negative=_DYNAMICS),
    "mimic": Form(required=("joint",), optional=("multiplier", "offset")),
    "box": Form(required=("size",), sizes=("size",)),
    "sphere": Form(required=("radius",), sizes=("radius",)),
    "cylinder": Form(required=("radius", "length"), sizes=("radius", "length")),
    "capsule": Form(required=("radius", "length"), sizes=("radius", "length")),
    "mesh": Form(required=("filename",), optional=("scale",)),
    "material": Form(
        optional=("name",),
        most_one=("color", "texture"),
        ignored=("specular", "ambient", "emissive"),
    ),
    "color": Form(required=("rgba",)),
    "texture": Form(optional=("filename",)),
    # MuJoCo's extension, of which only the folder of meshes is read.
    "mujoco": Form(many=("compiler",)),
    "compiler": Form(optional=("meshdir",)),
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
