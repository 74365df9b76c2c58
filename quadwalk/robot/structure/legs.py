"""The four legs of a quadruped in a tree of links, found from geometry alone."""

import shlex
from dataclasses import dataclass

import numpy as np
import yourdfpy

from quadwalk.robot.meshes import Meshes
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.feet import Foot, find_foot
from quadwalk.robot.structure.tree import Tree, make_unique

LEGS = ("FR", "FL", "RR", "RL")
Chain = list[yourdfpy.Joint]  # of a leg, from the trunk outwards


@dataclass(frozen=True)
class Leg:
    """One leg: its joints and links from the trunk outwards, and its foot."""

    name: str  # FR, FL, RR or RL
    joints: tuple[str, str, str]  # names of the hip, thigh and calf joint
    links: tuple[str, str, str]  # names of the links that these move
    foot: Foot  # the sphere at its end
    foot_name: str  # what the foot's site and collision geom are called in the model


def find_legs(tree: Tree, meshes: Meshes | None = None) -> tuple[Leg, ...]:
    """Return the legs FR, FL, RR and RL of a trunk whose x is ahead and y left.

    A leg is a chain of three actuated joints from the trunk (the root body), with a foot at its
    end (see `find_foot`, which may need `meshes`). `UrdfError` says why it is no quadruped.
    """
    chains = find_chains(tree)
    hips = np.array([tree.compute_frame(chain[0])[:3, 3] for chain in chains])
    names = name_corners(hips)
    if sorted(names) != sorted(LEGS):
        raise UrdfError(
            f"{tree.source}: hips of link '{tree.root}' lie at (x, y) = "
            f"{', '.join(f'({x:.3g}, {y:.3g})' for x, y in hips[:, :2])}; "
            "expected one ahead and one behind on each side (x ahead, y left)"
        )
    legs = {
        name: _make_leg(tree, name, chain, meshes)
        for name, chain in zip(names, chains, strict=True)
    }
    return tuple(legs[name] for name in LEGS)


def find_chains(tree: Tree) -> list[Chain]:
    """Return a quadruped's four chains of three joints that turn, in the order of the tree.

    Raise `UrdfError` where the links hang together otherwise.
    """
    chains = [_follow_chain(tree, joint) for joint in tree.find_moving_joints(tree.root)]
    if len(chains) != 4 or any(len(chain) != 3 for chain in chains):
        counts = ", ".join(f"{chain[0].name} ({len(chain)})" for chain in chains) or "none"
        raise UrdfError(
            f"{tree.source}: chains of moving joints from link '{tree.root}': {counts}; "
            f"a quadruped has four of three joints each{_suggest_fix(chains)}"
        )
    if tree.root == "world":
        raise UrdfError(
            f"{tree.source}: the legs' joints lead from link 'world', the ground; expected a "
            "trunk, which one fixed joint may hold there"
        )
    for joint in (joint for chain in chains for joint in chain):
        if joint.type not in ("revolute", "continuous"):
            raise UrdfError(
                f"{tree.source}: joint '{joint.name}' of a leg is {joint.type}; expected one that "
                "turns"
            )
    return chains


def name_corners(hips: np.ndarray) -> list[str]:
    """Name each of the `hips` (4, 3), m, FR, FL, RR or RL by its place about their middle."""
    ahead, left = ((hips - hips.mean(axis=0))[:, :2] > 0).T
    return [LEGS[2 * (not x) + y] for x, y in zip(ahead, left, strict=True)]


def _follow_chain(tree: Tree, joint: yourdfpy.Joint) -> Chain:
    """Return the moving joints from `joint` outwards, in the order of the tree."""
    chain, pending = [], [joint]
    while pending:
        chain.append(pending.pop())
        pending.extend(reversed(tree.find_moving_joints(chain[-1].child)))
    return chain


def _suggest_fix(chains: list[Chain]) -> str:
    """Return the flag that leaves four legs of three joints, where it is clear which these are.

    Then a head, a lidar or an arm is beside the legs, or a wheel or an ankle at the end of each.
    """
    for fits in (lambda chain: len(chain) == 3, lambda chain: len(chain) >= 3):
        legs = [chain for chain in chains if fits(chain)]
        if len(legs) == 4:
            joints = {joint.name for chain in legs for joint in chain[:3]}
            others = [j.name for chain in chains for j in chain if j.name not in joints]
            return f"; or pass --robot.fix {shlex.join(others)}"
    return ""


def _make_leg(tree: Tree, name: str, chain: Chain, meshes: Meshes | None) -> Leg:
    for joint in chain:
        if tree.is_between_joints(joint.child):
            raise UrdfError(
                f"{tree.source}: link '{joint.child}' of leg {name} has no mass; expected "
                "<inertial>"
            )
    calf = chain[2].child
    foot = find_foot(tree, calf, meshes)
    if foot is None:
        raise UrdfError(
            f"{tree.source}: link '{calf}' and what is fixed to it have no shape and no frame; "
            f"expected a collision sphere at the end of leg {name}, as its foot"
        )
    return Leg(
        name=name,
        joints=tuple(joint.name for joint in chain),
        links=tuple(joint.child for joint in chain),
        foot=foot,
        foot_name=foot.link if foot.link != calf else make_unique(f"{calf}_foot", tree.links),
    )
