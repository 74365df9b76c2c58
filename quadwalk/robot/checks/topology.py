"""How links and joints hang together: one tree, unique names, and what follows what."""

from graphlib import CycleError, TopologicalSorter

from lxml import etree

from quadwalk.robot.checks.validate import Check, UrdfError
from quadwalk.robot.structure.tree import ONE_WAY


def check_topology(check: Check, root: etree._Element) -> None:
    """One tree: unique names, one root, one parent each, no cycle."""
    links, joints = root.findall("link"), root.findall("joint")
    for elements in (links, joints):
        seen: set[str] = set()
        for element in elements:
            if element.get("name") in seen:
                raise check.fail(element, "appears twice; expected unique names")
            seen.add(element.get("name"))
    names = [link.get("name") for link in links]
    parent_of: dict[str, str] = {}
    for joint in joints:
        parent, child = joint.find("parent").get("link"), joint.find("child").get("link")
        for end, name in (("parent", parent), ("child", child)):
            if name not in names:
                raise check.fail(joint, f"has {end} '{name}'; expected the name of a link")
        if parent == child:
            raise check.fail(joint, f"joins link '{child}' to itself; expected two links")
        if child in parent_of:
            raise check.fail(joint, f"gives link '{child}' a second parent; expected one")
        parent_of[child] = parent
    roots = [name for name in names if name not in parent_of]
    if len(roots) > 1:
        shown = ", ".join(f"'{name}'" for name in roots[:4]) + (", ..." if roots[4:] else "")
        raise UrdfError(
            f"{check.source}: {len(roots)} links have no parent ({shown}); expected one root link"
        )
    try:
        TopologicalSorter({child: [parent] for child, parent in parent_of.items()}).prepare()
    except CycleError as error:
        name = next(name for name in names if name in error.args[1])
        raise UrdfError(
            f"{check.source}: link '{name}' is its own ancestor; expected a tree of links"
        ) from None
    if "world" in names and roots != ["world"]:
        raise UrdfError(
            f"{check.source}: link 'world' is not the root; expected another name, for that one "
            "is the ground's"
        )


def check_mimic(check: Check, joints: list[etree._Element]) -> None:
    """Followers have a leader; what follows a joint that is fixed, or is fixed itself, is eased.

    A fixed joint follows nothing: its `<mimic>` is taken out. One that follows a fixed joint is
    held where that leaves it, by `offset`, as one that follows it with a multiplier.
    """
    kinds = {joint.get("name"): joint.get("type") for joint in joints}
    for joint in joints:
        mimic = joint.find("mimic")
        if mimic is not None and joint.get("type") == "fixed":
            check.report.add("dropped", "<mimic> of fixed joints", joint.get("name"))
            joint.remove(mimic)
    leader_of = {
        joint.get("name"): joint.find("mimic").get("joint")
        for joint in joints
        if joint.find("mimic") is not None
    }
    for joint in joints:
        name = joint.get("name")
        if name not in leader_of:
            continue
        leader = leader_of[name]
        if kinds.get(leader) not in (*ONE_WAY, "fixed") or kinds[name] not in ONE_WAY:
            raise check.fail(
                joint.find("mimic"),
                f"follows joint '{leader}'; expected joints that move in one direction",
            )
        if kinds[leader] == "fixed":
            check.report.add("assumed", "held still, for they follow a fixed joint", name)
        path = {name}
        while leader in leader_of:
            if leader in path:
                raise check.fail(
                    joint.find("mimic"), f"follows '{leader}' in a circle; expected a free joint"
                )
            path.add(leader)
            leader = leader_of[leader]
