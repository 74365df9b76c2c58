"""Pinocchio as an independent reader of a URDF, to compare a MuJoCo model's dynamics with."""

import re
import xml.etree.ElementTree as ET
from typing import Any

import mujoco
import numpy as np
import pinocchio

from quadwalk.robot.urdf import Urdf


class Pinocchio:
    """The same URDF in Pinocchio, which has a parser and dynamics algorithms of its own.

    Velocities are MuJoCo's: the base's linear one in world axes, its angular one in body axes;
    Pinocchio's free flyer has both in body axes.
    """

    def __init__(self, urdf: Urdf, model: mujoco.MjModel):
        self.pin = pinocchio
        self.mj = model
        self.floating = model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
        root = (self.pin.JointModelFreeFlyer(),) if self.floating else ()
        self.model = self.pin.buildModelFromXML(urdf.text, *root)
        self.model.gravity.linear = model.opt.gravity.copy()
        self.data = self.model.createData()
        self.joints, self.planes, self.floats = [], [], []
        joints = list(zip(self.model.names, self.model.joints, strict=True))
        for name, pinocchio_joint in joints[1:]:
            if self.floating and name == "root_joint":
                continue
            if pinocchio_joint.shortname() == "JointModelPlanar":
                self.planes.append(
                    ([model.joint(f"{name}_{s}") for s in ("x", "y", "turn")], pinocchio_joint)
                )
            elif pinocchio_joint.shortname() == "JointModelFreeFlyer":
                self.floats.append(
                    ([model.joint(f"{name}_{s}") for s in ("x", "ball")], pinocchio_joint)
                )
            else:
                self.joints.append((model.joint(name), pinocchio_joint))
        assert self.model.nv == model.nv
        # Links with one collision shape that is no mesh: the geom of that name, and its origin.
        self.shapes = []
        for link in ET.fromstring(re.sub(r"^\s*<\?xml.*?\?>", "", urdf.text)).findall("link"):
            shapes = link.findall("collision")
            if len(shapes) == 1 and shapes[0].find("geometry/mesh") is None:
                origin_element = shapes[0].find("origin")
                origin = {} if origin_element is None else origin_element.attrib
                xyz, rpy = (
                    np.array(origin.get(name, "0 0 0").split(), float) for name in ("xyz", "rpy")
                )
                placement = self.pin.SE3(self.pin.rpy.rpyToMatrix(*rpy), xyz)
                self.shapes.append((link.get("name"), placement))

    def to_configuration(self, qpos: np.ndarray) -> np.ndarray:
        """Return Pinocchio's configuration q for MuJoCo's `qpos`: the same pose."""
        q = np.zeros(self.model.nq)
        if self.floating:
            q[:7] = qpos[[0, 1, 2, 4, 5, 6, 3]]
        for mujoco_joint, pinocchio_joint in self.joints:
            angle = qpos[mujoco_joint.qposadr[0]]
            two = pinocchio_joint.nq == 2  # continuous: cosine and sine
            q[pinocchio_joint.idx_q : pinocchio_joint.idx_q + pinocchio_joint.nq] = (
                [np.cos(angle), np.sin(angle)] if two else [angle]
            )
        for (x, y, turn), pinocchio_joint in self.planes:
            angle = qpos[turn.qposadr[0]]
            q[pinocchio_joint.idx_q : pinocchio_joint.idx_q + 4] = [
                qpos[x.qposadr[0]],
                qpos[y.qposadr[0]],
                np.cos(angle),
                np.sin(angle),
            ]
        for (x, ball), pinocchio_joint in self.floats:
            first, at = x.qposadr[0], ball.qposadr[0]
            wxyz = qpos[at : at + 4]
            q[pinocchio_joint.idx_q : pinocchio_joint.idx_q + 7] = [
                *qpos[first : first + 3],
                *wxyz[1:],
                wxyz[0],
            ]
        return q

    def compute_velocity_map(
        self, qpos: np.ndarray, qvel: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return matrix G and vector d with v = G qvel and a = G qacc + d.

        v and a are Pinocchio's velocity and acceleration of the state that MuJoCo calls `qpos`,
        `qvel`.
        """
        nv = self.model.nv
        g, drift = np.zeros((nv, nv)), np.zeros(nv)
        if self.floating:
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, qpos[3:7])
            back = turn.reshape(3, 3).T
            g[:3, :3], g[3:6, 3:6] = back, np.eye(3)
            drift[:3] = -np.cross(qvel[3:6], back @ qvel[:3])
        for mujoco_joint, pinocchio_joint in self.joints:
            g[pinocchio_joint.idx_v, mujoco_joint.dofadr[0]] = 1
        for (x, _, turn), pinocchio_joint in self.planes:
            first, at = x.dofadr[0], pinocchio_joint.idx_v
            cos, sin = np.cos(qpos[turn.qposadr[0]]), np.sin(qpos[turn.qposadr[0]])
            back, rate = np.array([[cos, sin], [-sin, cos]]), qvel[turn.dofadr[0]]
            g[at : at + 2, first : first + 2], g[at + 2, turn.dofadr[0]] = back, 1
            across = back @ qvel[first : first + 2]
            drift[at : at + 2] = -rate * np.array([-across[1], across[0]])
        for (x, ball), pinocchio_joint in self.floats:
            first, at, spin = x.dofadr[0], pinocchio_joint.idx_v, ball.dofadr[0]
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, qpos[ball.qposadr[0] : ball.qposadr[0] + 4])
            back = turn.reshape(3, 3).T
            g[at : at + 3, first : first + 3], g[at + 3 : at + 6, spin : spin + 3] = back, np.eye(3)
            drift[at : at + 3] = -np.cross(qvel[spin : spin + 3], back @ qvel[first : first + 3])
        return g, drift

    def compute_errors(self, states: int, seed: int = 0) -> dict[str, float]:
        """Return the largest difference of each quantity in so many random states, by name.

        Quantities are those of `compute_quantities`; each difference is relative to the largest
        value of its quantity. Sets the MuJoCo model's armature to 0.
        """
        rng = np.random.default_rng(seed)
        self.mj.dof_armature[:] = 0  # no part of a URDF that Pinocchio reads
        data = mujoco.MjData(self.mj)
        errors: dict[str, float] = {}
        sizes: dict[str, float] = {}
        for _ in range(states):
            self.sample_state(data, rng)
            acceleration = rng.normal(size=self.mj.nv)
            for name, (value, expected) in self.compute_quantities(data, acceleration).items():
                error = float(np.abs(value - expected).max())
                errors[name] = max(errors.get(name, 0.0), error)
                sizes[name] = max(sizes.get(name, 1e-9), float(np.abs(expected).max()))
        return {name: errors[name] / sizes[name] for name in errors}

    def sample_state(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Set `data` to random positions within the joints' limits, and random velocities."""
        mj = self.mj
        for i in range(mj.njnt):
            at, kind = mj.jnt_qposadr[i], mj.jnt_type[i]
            free = kind == mujoco.mjtJoint.mjJNT_FREE
            if free:
                data.qpos[at : at + 3] = rng.normal(size=3)
            if free or kind == mujoco.mjtJoint.mjJNT_BALL:
                at += 3 * free
                quat = rng.normal(size=4)
                data.qpos[at : at + 4] = quat / np.linalg.norm(quat)
            elif mj.jnt_limited[i]:
                data.qpos[at] = rng.uniform(*mj.jnt_range[i])
            else:
                data.qpos[at] = rng.uniform(-np.pi, np.pi)
        data.qvel[:] = rng.normal(size=mj.nv)

    def compute_quantities(
        self, data: mujoco.MjData, acceleration: np.ndarray
    ) -> dict[str, tuple[Any, Any]]:
        """Return quantities of dynamics by name, each as computed by (MuJoCo, Pinocchio).

        `data` is the state and `acceleration` (nv,) that of the inverse dynamics. All are in
        MuJoCo's coordinates.
        """
        pin, mj = self.pin, self.mj
        mujoco.mj_forward(mj, data)
        data.qacc[:] = acceleration
        torque = np.zeros(mj.nv)
        mujoco.mj_rne(mj, data, 1, torque)
        mass_matrix = np.zeros((mj.nv, mj.nv))
        mujoco.mj_fullM(mj, data, mass_matrix)
        bodies = np.flatnonzero(mj.body_weldid != 0)
        masses = mj.body_mass[bodies]
        total = masses.sum()

        q = self.to_configuration(data.qpos)
        g, drift = self.compute_velocity_map(data.qpos, data.qvel)
        v = g @ data.qvel
        pin.framesForwardKinematics(self.model, self.data, q)
        center = pin.centerOfMass(self.model, self.data, q)
        upper = np.triu(pin.crba(self.model, self.data, q))
        full = upper + np.triu(upper, 1).T
        bias = g.T @ (pin.nonLinearEffects(self.model, self.data, q, v) + full @ drift)
        inverse = g.T @ pin.rnea(self.model, self.data, q, v, g @ acceleration + drift)
        total_of_pinocchio = pin.computeTotalMass(self.model)
        quantities = {
            "mass": (total, total_of_pinocchio) if self.floating else (0.0, 0.0),
            "center of mass": (masses @ data.xipos[bodies] / total, center),
            "mass matrix": (mass_matrix, g.T @ full @ g),
            "bias forces": (data.qfrc_bias, bias),
            "inverse dynamics": (torque, inverse),
        }
        for i in range(mj.nsite):
            name = mj.site(i).name
            frame = self.model.getFrameId(name, pin.FrameType.BODY)
            if frame < self.model.nframes:
                pose = self.data.oMf[frame]
                rotation = data.site_xmat[i].reshape(3, 3)
                quantities[f"position of {name}"] = (data.site_xpos[i], pose.translation)
                quantities[f"rotation of {name}"] = (rotation, pose.rotation)
        for link, placement in self.shapes:
            pose = self.data.oMf[self.model.getFrameId(link, pin.FrameType.BODY)] * placement
            geom = mj.geom(link).id
            rotation = data.geom_xmat[geom].reshape(3, 3)
            quantities[f"position of shape of {link}"] = (data.geom_xpos[geom], pose.translation)
            quantities[f"rotation of shape of {link}"] = (rotation, pose.rotation)
        return quantities
