"""Checks of how links and joints hang together: one tree, unique names, and what follows what."""

from graphlib import CycleError, TopologicalSorter

from lxml import etree

from quadwalk.robot.checks.elements import Checker
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.tree import ONE_WAY


def check_topology(checker: Checker, root: etree._Element) -> None:
    """Raise `UrdfError` unless the links and joints in `root` form one tree.

    It has unique names, one root, one parent for each other link and no cycle.
    """
    links, joints = root.findall("link"), root.findall("joint")
    for elements in (links, joints):
        names: set[str] = set()
        for element in elements:
            if element.get("name") in names:
                checker.refuse(element, "appears twice; expected unique names")
            names.add(element.get("name"))
    links = [link.get("name") for link in links]
    parent_of: dict[str, str] = {}
    for joint in joints:
        parent, child = joint.find("parent").get("link"), joint.find("child").get("link")
        for end, name in (("parent", parent), ("child", child)):
            if name not in links:
                checker.refuse(joint, f"has {end} '{name}'; expected the name of a link")
        if parent == child:
            checker.refuse(joint, f"joins link '{child}' to itself; expected two links")
        if child in parent_of:
            checker.refuse(joint, f"gives link '{child}' a second parent; expected one")
        parent_of[child] = parent
    roots = [name for name in links if name not in parent_of]
    if len(roots) > 1:
        listing = ", ".join(f"'{name}'" for name in roots[:4]) + (", ..." if roots[4:] else "")
        raise UrdfError(
            f"{checker.source}: {len(roots)} links have no parent ({listing}); "
            "expected one root link"
        )
    try:
        TopologicalSorter({child: [parent] for child, parent in parent_of.items()}).prepare()
    except CycleError as error:
        name = next(name for name in links if name in error.args[1])
        raise UrdfError(
            f"{checker.source}: link '{name}' is its own ancestor; expected a tree of links"
        ) from None
    if "world" in links and roots != ["world"]:
        raise UrdfError(
            f"{checker.source}: link 'world' is not the root; expected another name, for that one "
            "is the ground's"
        )


def check_mimic(checker: Checker, joints: list[etree._Element]) -> None:
    """Raise `UrdfError` where a `<mimic>` names no joint of one direction, or forms a circle.

    The `<mimic>` of a fixed joint is removed. A joint that follows a fixed one stays at its
    `offset`. Both are noted in the report.
    """
    kinds = {joint.get("name"): joint.get("type") for joint in joints}
    mimics = {}
    for joint in joints:
        mimic = joint.find("mimic")
        if mimic is not None and joint.get("type") == "fixed":
            checker.report.add("dropped", "<mimic> of fixed joints", joint.get("name"))
            joint.remove(mimic)
        elif mimic is not None:
            mimics[joint.get("name")] = mimic
    leader_of = {name: mimic.get("joint") for name, mimic in mimics.items()}
    for name, mimic in mimics.items():
        leader = leader_of[name]
        if kinds.get(leader) not in (*ONE_WAY, "fixed") or kinds[name] not in ONE_WAY:
            checker.refuse(
                mimic, f"follows joint '{leader}'; expected joints that move in one direction"
            )
        if kinds[leader] == "fixed":
            checker.report.add("assumed", "held still, for they follow a fixed joint", name)
        path = {name}
        while leader in leader_of:
            if leader in path:
                checker.refuse(mimic, f"follows '{leader}' in a circle; expected a free joint")
            path.add(leader)
            leader = leader_of[leader]
