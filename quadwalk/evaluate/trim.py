"""Shorter rollouts out of longer ones."""

import dataclasses

import numpy as np

from quadwalk.evaluate.rollout import Rollout


def first_steps(rollout: Rollout, steps: int) -> Rollout:
    """The first `steps` control steps of `rollout`, with the states around them."""
    rows = {
        field.name: steps + (field.name in ("qpos", "qvel"))
        for field in dataclasses.fields(rollout)
        if isinstance(getattr(rollout, field.name), np.ndarray)
    }
    return dataclasses.replace(
        rollout,
        **{name: getattr(rollout, name)[:count] for name, count in rows.items()},
        reward_terms={name: term[:steps] for name, term in rollout.reward_terms.items()},
    )


def finite_part(rollout: Rollout) -> Rollout:
    """`rollout` up to its last step with finite states, torque, energy and forces."""
    finite = np.isfinite(rollout.qpos).all(axis=1) & np.isfinite(rollout.qvel).all(axis=1)
    finite[1:] &= np.isfinite(rollout.torque).all(axis=1) & np.isfinite(rollout.energy)
    if rollout.foot_force is not None:
        finite[1:] &= np.isfinite(rollout.foot_force).all(axis=1)
    if finite.all():
        return rollout
    return first_steps(rollout, max(int(np.argmin(finite)) - 1, 0))
