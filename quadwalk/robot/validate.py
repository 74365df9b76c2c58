"""What a URDF must fulfil before it is converted: names, topology, numbers, physics.

Every finding is one line: the file, the element, what is wrong and what is expected.
"""

from lxml import etree

from quadwalk.errors import UserError


class UrdfError(UserError):
    """A URDF that cannot be read, or describes no robot that can exist."""


def check_robot(root: etree._Element, source: str) -> None:
    """Raise `UrdfError` for the first thing in the document that is not valid."""
    if root.tag != "robot":
        raise UrdfError(f"{source}: root element is <{root.tag}>; expected <robot>")
