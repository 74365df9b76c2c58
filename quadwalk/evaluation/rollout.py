"""A rollout: one episode of a policy, as plain arrays."""

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from quadwalk.env.randomization import EpisodeRandomization


@dataclass(frozen=True)
class Rollout:
    """One episode of T control steps on a quadruped with 12 joints.

    Row k of a (T, ...) array belongs to control step k; rows of the (T + 1, ...) arrays are the
    states before the first step and after each step. Joint columns are in the order of
    `Quadruped.joints`, foot columns in the order of `Quadruped.feet`. World frame: z up, x ahead.
    """

    control_dt: float  # s, one control step
    seed: int
    episode: int  # index of this episode in its evaluation
    end: str  # "time limit", or why it fell: "tipped", "low", "touched" (body on floor), "nan"
    qpos: np.ndarray  # (T + 1, 19) world position m, quaternion wxyz, joint positions rad
    qvel: np.ndarray  # (T + 1, 18) world linear m/s, body angular rad/s, joint rad/s
    action: np.ndarray  # (T, 12) in [-1, 1]
    target: np.ndarray  # (T, 12) joint position targets, rad
    torque: np.ndarray  # (T, 12) mean over the control step, Nm
    energy: np.ndarray  # (T,) mechanical energy spent in the step, sum of max(tau * qd, 0) dt, J
    observation: np.ndarray  # (T, n) what the policy saw before the step
    observation_names: tuple[str, ...]  # n names
    contact: np.ndarray  # (T, 4) bool, foot on the ground at the end of the step
    reward_terms: dict[str, np.ndarray]  # name -> (T,) raw terms, before scales
    reward: np.ndarray  # (T,) scaled total
    # (T, 3) the velocity command of the step: forward and lateral velocity in the frame of the
    # heading, m/s, lateral to the left, and yaw rate, rad/s; None where it ran along x
    command: np.ndarray | None = None
    # (T, 4) the floor's push along its normal, N; None until `with_foot_forces` adds it
    foot_force: np.ndarray | None = None
    # the episode's, of NumPy arrays; None in an ideal world, as are the next two
    conditions: "EpisodeRandomization | None" = None
    # (T, 12) the joint position targets that the motors obeyed at the end of the step, rad
    applied_target: np.ndarray | None = None
    # (T, m) what the first m numbers of `observation` would be without delay, noise and offsets
    truth: np.ndarray | None = None

    @property
    def steps(self) -> int:
        return len(self.action)

    @property
    def time(self) -> np.ndarray:
        """(T + 1,) simulated seconds of the states."""
        return np.arange(self.steps + 1) * self.control_dt

    @property
    def fell(self) -> bool:
        return self.end != "time limit"


def first_steps(rollout: Rollout, steps: int) -> Rollout:
    """The first `steps` control steps of `rollout`, with the states around them."""
    return _select_steps(rollout, 0, steps)


def later_steps(rollout: Rollout, start: int) -> Rollout:
    """Return the control steps of `rollout` from number `start` on, with the states around them."""
    return _select_steps(rollout, min(start, rollout.steps), rollout.steps)


def _select_steps(rollout: Rollout, start: int, stop: int) -> Rollout:
    """Return the control steps `start` to `stop`, the latter left out, and their states."""
    stops = {
        field.name: stop + (field.name in ("qpos", "qvel"))
        for field in fields(rollout)
        if isinstance(getattr(rollout, field.name), np.ndarray)
    }
    return replace(
        rollout,
        **{name: getattr(rollout, name)[start:end] for name, end in stops.items()},
        reward_terms={name: term[start:stop] for name, term in rollout.reward_terms.items()},
    )


def finite_states(rollout: Rollout) -> int:
    """How many states there are before the first that is not finite."""
    finite = np.isfinite(rollout.qpos).all(axis=1) & np.isfinite(rollout.qvel).all(axis=1)
    return _true_ahead(finite)


def finite_part(rollout: Rollout) -> Rollout:
    """`rollout` up to its last step with finite states, torque, energy and forces."""
    finite = np.isfinite(rollout.torque).all(axis=1) & np.isfinite(rollout.energy)
    if rollout.foot_force is not None:
        finite &= np.isfinite(rollout.foot_force).all(axis=1)
    steps = min(max(finite_states(rollout) - 1, 0), _true_ahead(finite))
    return rollout if steps == rollout.steps else first_steps(rollout, steps)


def _true_ahead(flags: np.ndarray) -> int:
    """How many of `flags` (n,) are true before the first that is not."""
    return len(flags) if flags.all() else int(np.argmin(flags))
