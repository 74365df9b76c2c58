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

    @property
    def attributes(self) -> tuple[str, ...]:
        """All attributes."""
        return self.required + self.optional

    @property
    def children(self) -> tuple[str, ...]:
        """All child elements."""
        return self.one + self.most_one + self.many


# http://wiki.ros.org/urdf/XML
FORMS = {
    "robot": Form(many=("link", "joint", "material", "mujoco")),
    "link": Form(required=("name",), most_one=("inertial",), many=("visual", "collision")),
    "joint": Form(
        required=("name", "type"),
        one=("parent", "child"),
        most_one=("origin", "axis", "limit", "dynamics", "mimic"),
    ),
    "inertial": Form(one=("mass", "inertia"), most_one=("origin",)),
    "visual": Form(optional=("name",), one=("geometry",), most_one=("origin",), many=("material",)),
    "collision": Form(optional=("name",), one=("geometry",), most_one=("origin",)),
    "geometry": Form(most_one=SHAPES),
    "origin": Form(optional=("xyz", "rpy", "quat_xyzw")),
    "mass": Form(required=("value",)),
    "inertia": Form(required=("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "parent": Form(required=("link",)),
    "child": Form(required=("link",)),
    "axis": Form(required=("xyz",)),
    "limit": Form(optional=("effort", "velocity", "lower", "upper")),
    # `armature` and `home` are ours: other readers pass them over.
    "dynamics": Form(optional=("damping", "friction", "armature", "home")),
    "mimic": Form(required=("joint",), optional=("multiplier", "offset")),
    "box": Form(required=("size",)),
    "sphere": Form(required=("radius",)),
    "cylinder": Form(required=("radius", "length")),
    "capsule": Form(required=("radius", "length")),
    "mesh": Form(required=("filename",), optional=("scale",)),
    "material": Form(optional=("name",), most_one=("color", "texture")),
    "color": Form(required=("rgba",)),
    "texture": Form(optional=("filename",)),
    # MuJoCo's extension, of which only the folder of meshes is read.
    "mujoco": Form(many=("compiler",)),
    "compiler": Form(optional=("meshdir",)),
}
# Elements that PyBullet, Gazebo and older ROS files add, and their numbers must be numbers.
EXTENSIONS = {
    "link": {"contact", "audio_source", "self_collision_checking", "concave", "gazebo"},
    "joint": {"joint_properties", "safety_controller", "calibration", "gazebo"},
    "collision": {"material", "group", "mask", "concave", "verbose", "contact_coefficients"},
    "material": {"specular", "ambient", "emissive"},
}
TEXT_ATTRIBUTES = frozenset({"name", "type", "link", "joint", "filename", "meshdir"})
LENGTHS = {"xyz": 3, "rpy": 3, "quat_xyzw": 4, "size": 3, "rgba": 4, "scale": 3}
SIZES = ("size", "radius", "length")  # above 0
NOT_NEGATIVE = ("value", "effort", "velocity", "damping", "friction", "armature")
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
